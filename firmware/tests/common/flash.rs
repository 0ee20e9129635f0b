//! Flash of small sectors: erasing sets bits, writing clears them, and the power may go at any moment.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

/// Flash with sectors of a length. A clone is the same flash: the test keeps one, the firmware has the other.
#[derive(Debug, Clone)]
pub struct Flash<const SECTOR: usize>(Rc<RefCell<Cells>>);

#[derive(Debug)]
struct Cells {
    bytes: Vec<u8>,
    /// How many more steps (a byte written, a sector erased) until the power goes; none: it stays.
    power: Option<usize>,
    /// Steps done.
    steps: usize,
    /// What a step that is cut short leaves.
    noise: u64,
}

/// The power went.
#[derive(Debug, PartialEq, Eq)]
pub struct Dark;

impl NorFlashError for Dark {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl<const SECTOR: usize> Flash<SECTOR> {
    pub fn new(fill: u8, length: usize) -> Self {
        Self(Rc::new(RefCell::new(Cells { bytes: vec![fill; length], power: None, steps: 0, noise: 0 })))
    }

    /// The power goes in the midst of the step after so many, and stays away until this is called again.
    pub fn set_power(&self, steps: Option<usize>, noise: u64) {
        let mut cells = self.0.borrow_mut();
        (cells.power, cells.noise) = (steps, noise);
    }

    pub fn is_dark(&self) -> bool {
        self.0.borrow().power == Some(0)
    }

    pub fn steps(&self) -> usize {
        self.0.borrow().steps
    }

    pub fn bytes(&self) -> Vec<u8> {
        self.0.borrow().bytes.clone()
    }

    /// Puts bytes there, whatever was there.
    pub fn put(&self, at: usize, bytes: &[u8]) {
        self.0.borrow_mut().bytes[at..at + bytes.len()].copy_from_slice(bytes);
    }
}

impl Cells {
    /// Whether the next step is the one that is cut short; after it nothing is done any more.
    fn step(&mut self) -> Result<bool, Dark> {
        self.steps += 1;
        match &mut self.power {
            Some(0) => Err(Dark),
            Some(left) => {
                *left -= 1;
                Ok(*left == 0)
            }
            None => Ok(false),
        }
    }

    fn noise(&mut self) -> u8 {
        self.noise = self.noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.noise >> 56) as u8
    }
}

impl<const SECTOR: usize> ErrorType for Flash<SECTOR> {
    type Error = Dark;
}

impl<const SECTOR: usize> ReadNorFlash for Flash<SECTOR> {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Dark> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4), "whole words are read");
        bytes.copy_from_slice(&self.0.borrow().bytes[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.borrow().bytes.len()
    }
}

impl<const SECTOR: usize> NorFlash for Flash<SECTOR> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Dark> {
        let (from, to) = (from as usize, to as usize);
        assert!(from.is_multiple_of(SECTOR) && to.is_multiple_of(SECTOR), "whole sectors are erased");
        let cells = &mut *self.0.borrow_mut();
        for sector in (from..to).step_by(SECTOR) {
            let cut = cells.step()?;
            for at in sector..sector + SECTOR {
                // An erasure that is cut short leaves any bit of the whole sector as it was.
                cells.bytes[at] |= if cut { cells.noise() } else { 0xFF };
            }
            if cut {
                return Err(Dark);
            }
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Dark> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4), "whole words are written");
        let cells = &mut *self.0.borrow_mut();
        for (at, &byte) in (offset as usize..).zip(bytes) {
            let cut = cells.step()?;
            cells.bytes[at] &= if cut { byte | cells.noise() } else { byte };
            if cut {
                return Err(Dark);
            }
        }
        Ok(())
    }
}
