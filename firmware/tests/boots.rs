//! The boot number grows at every start, whatever a loss of power leaves in flash.

mod common;

use common::flash::Dark;
use proptest::prelude::*;
use thermokin_firmware::boots::{BootsError, next_boot};

const SECTOR: usize = 64;
const OFFSET: u32 = 128;

type Flash = common::flash::Flash<SECTOR>;

/// Flash of a few small sectors.
fn flash(fill: u8) -> Flash {
    Flash::new(fill, 512)
}

#[test]
fn numbers_follow_each_other_over_many_sectors() {
    let mut flash = flash(0xFF);
    for expected in 7..200 {
        assert_eq!(next_boot(&mut flash, OFFSET, 7), Ok(expected));
    }
    let bytes = flash.bytes();
    assert!(bytes[..OFFSET as usize].iter().chain(&bytes[OFFSET as usize + 2 * SECTOR..]).all(|&byte| byte == 0xFF));
}

#[test]
fn a_greater_first_number_is_followed_and_a_smaller_one_is_not() {
    let mut flash = flash(0xFF);
    assert_eq!(next_boot(&mut flash, OFFSET, 10), Ok(10));
    assert_eq!(next_boot(&mut flash, OFFSET, 1000), Ok(1000));
    assert_eq!(next_boot(&mut flash, OFFSET, 10), Ok(1001));
}

#[test]
fn the_last_number_is_not_followed_by_the_first() {
    let mut flash = flash(0xFF);
    assert_eq!(next_boot(&mut flash, OFFSET, u32::MAX), Ok(u32::MAX));
    assert_eq!(next_boot(&mut flash, OFFSET, 0), Err(BootsError::Exhausted));
}

#[test]
fn flash_that_holds_something_else_is_cleared() {
    let mut flash = flash(0x5A);
    assert_eq!(next_boot(&mut flash, OFFSET, 3), Ok(3));
    assert_eq!(next_boot(&mut flash, OFFSET, 3), Ok(4));
}

proptest! {
    /// The power goes at any byte of any start; a start that was given its number gave one greater than all before.
    #[test]
    fn no_number_is_given_twice(
        powers in proptest::collection::vec((proptest::option::of(1usize..12), any::<u64>()), 1..120),
    ) {
        let mut flash = flash(0xFF);
        let mut greatest = 0;
        for (power, noise) in powers {
            flash.set_power(power, noise);
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
