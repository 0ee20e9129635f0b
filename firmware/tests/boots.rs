//! The boot number grows at every start, whatever a loss of power leaves in flash.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use proptest::prelude::*;
use thermokin_firmware::boots::{BootsError, next_boot};

const SECTOR: usize = 64;
const OFFSET: u32 = 128;

/// Flash of a few small sectors: erasing sets bits, writing clears them, and the power may go at any byte.
#[derive(Debug, Clone)]
struct Flash {
    bytes: Vec<u8>,
    /// How many more bytes are erased or written before the power goes; none: it stays.
    power: Option<usize>,
}

/// The power went.
#[derive(Debug, PartialEq, Eq)]
struct Dark;

impl NorFlashError for Dark {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl Flash {
    fn new(fill: u8) -> Self {
        Self { bytes: vec![fill; 512], power: None }
    }

    fn change(&mut self, index: usize, value: u8) -> Result<(), Dark> {
        match &mut self.power {
            Some(0) => return Err(Dark),
            Some(left) => *left -= 1,
            None => {}
        }
        self.bytes[index] = value;
        Ok(())
    }
}

impl ErrorType for Flash {
    type Error = Dark;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Dark> {
        bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Dark> {
        assert!(
            (from as usize).is_multiple_of(SECTOR) && (to as usize).is_multiple_of(SECTOR),
            "whole sectors are erased"
        );
        (from as usize..to as usize).try_for_each(|index| self.change(index, 0xFF))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Dark> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4), "whole words are written");
        bytes.iter().enumerate().try_for_each(|(index, &byte)| {
            let at = offset as usize + index;
            self.change(at, self.bytes[at] & byte)
        })
    }
}

#[test]
fn numbers_follow_each_other_over_many_sectors() {
    let mut flash = Flash::new(0xFF);
    for expected in 7..200 {
        assert_eq!(next_boot(&mut flash, OFFSET, 7), Ok(expected));
    }
    assert!(
        flash.bytes[..OFFSET as usize].iter().chain(&flash.bytes[OFFSET as usize + 2 * SECTOR..]).all(|&b| b == 0xFF)
    );
}

#[test]
fn a_greater_first_number_is_followed_and_a_smaller_one_is_not() {
    let mut flash = Flash::new(0xFF);
    assert_eq!(next_boot(&mut flash, OFFSET, 10), Ok(10));
    assert_eq!(next_boot(&mut flash, OFFSET, 1000), Ok(1000));
    assert_eq!(next_boot(&mut flash, OFFSET, 10), Ok(1001));
}

#[test]
fn the_last_number_is_not_followed_by_the_first() {
    let mut flash = Flash::new(0xFF);
    assert_eq!(next_boot(&mut flash, OFFSET, u32::MAX), Ok(u32::MAX));
    assert_eq!(next_boot(&mut flash, OFFSET, 0), Err(BootsError::Exhausted));
}

#[test]
fn flash_that_holds_something_else_is_cleared() {
    let mut flash = Flash::new(0x5A);
    assert_eq!(next_boot(&mut flash, OFFSET, 3), Ok(3));
    assert_eq!(next_boot(&mut flash, OFFSET, 3), Ok(4));
}

proptest! {
    /// The power goes at any byte of any start; a start that was given its number gave one greater than all before.
    #[test]
    fn no_number_is_given_twice(powers in proptest::collection::vec(proptest::option::of(0usize..80), 1..120)) {
        let mut flash = Flash::new(0xFF);
        let mut greatest = 0;
        for power in powers {
            flash.power = power;
            match next_boot(&mut flash, OFFSET, 1) {
                Ok(boot) => {
                    prop_assert!(boot > greatest, "boot {boot} after {greatest}");
                    greatest = boot;
                }
                Err(error) => prop_assert_eq!(error, BootsError::Flash(Dark)),
            }
        }
    }
}
