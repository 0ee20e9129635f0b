//! A flash chip beside the processor, for new programs: a file of whoever runs the emulator, reached by semihosting.
//!
//! The LM3S6965's own flash cannot be programmed in QEMU (the machine has no model of its controller), and the program
//! is put there from outside at every start of the emulator. So whoever starts it plays the bootloader, and puts there
//! what the chip's otadata chooses.

use cortex_m_semihosting::{nr, syscall};
use defmt::Format;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use thermokin_firmware::update::Layout;

/// The chip's parts, as tests/tests/board_support has them too.
pub const LAYOUT: Layout = Layout { journal: 0, otadata: 0x2000, slots: [0x1_0000, 0x5_0000], slot_length: 0x4_0000 };
/// Its length.
const LENGTH: u32 = 0x9_0000;
/// The file, in the folder in which the emulator runs.
const NAME: &[u8] = b"flash.bin\0";

/// The chip cannot be reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Format)]
pub struct Unreachable;

impl NorFlashError for Unreachable {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// The chip.
#[derive(Debug)]
pub struct Chip {
    file: usize,
}

impl Chip {
    /// The chip, if the emulator was started with one. Only for an emulator started with semihosting: without it, asking
    /// stops the processor.
    pub fn open() -> Result<Self, Unreachable> {
        // SAFETY: the name ends with a zero that its length leaves out; the host reads it and nothing else.
        let file = unsafe { syscall!(OPEN, NAME.as_ptr(), nr::open::RW_BINARY, NAME.len() - 1) };
        if file == usize::MAX { Err(Unreachable) } else { Ok(Self { file }) }
    }

    fn seek(&mut self, offset: u32) -> Result<(), Unreachable> {
        // SAFETY: it takes no memory of this program's.
        done(unsafe { syscall!(SEEK, self.file, offset) })
    }

    fn write_at(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Unreachable> {
        self.seek(offset)?;
        // SAFETY: the host reads `bytes`, which live until the call returns.
        done(unsafe { syscall!(WRITE, self.file, bytes.as_ptr(), bytes.len()) })
    }
}

/// A call gives what it did not do.
fn done(left: usize) -> Result<(), Unreachable> {
    if left == 0 { Ok(()) } else { Err(Unreachable) }
}

impl ErrorType for Chip {
    type Error = Unreachable;
}

impl ReadNorFlash for Chip {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Unreachable> {
        self.seek(offset)?;
        // SAFETY: the host writes `bytes`, which nobody else reads or writes before the call returns.
        done(unsafe { syscall!(READ, self.file, bytes.as_mut_ptr(), bytes.len()) })
    }

    fn capacity(&self) -> usize {
        LENGTH as usize
    }
}

impl NorFlash for Chip {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Unreachable> {
        (from..to).step_by(256).try_for_each(|at| self.write_at(at, &[0xFF; 256]))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Unreachable> {
        let mut at = offset;
        for part in bytes.chunks(256) {
            // As in flash, bits are only cleared.
            let mut cells = [0; 256];
            self.read(at, &mut cells[..part.len()])?;
            for (cell, byte) in cells.iter_mut().zip(part) {
                *cell &= byte;
            }
            self.write_at(at, &cells[..part.len()])?;
            at += part.len() as u32;
        }
        Ok(())
    }
}
