//! Which of the two slots the bootloader starts: ESP-IDF's "otadata", two sectors of one entry each.
//!
//! The valid entry with the higher number counts; the number's parity names the slot. A choice is written into the
//! sector of the other entry, so that a loss of power leaves the earlier choice or the new one, never none.

use embedded_storage::nor_flash::NorFlash;

/// One of the two places for a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Slot {
    /// The first, which is started when no choice was ever written.
    A,
    /// The second.
    B,
}

impl Slot {
    /// The other one.
    pub fn other(self) -> Self {
        match self {
            Slot::A => Slot::B,
            Slot::B => Slot::A,
        }
    }
}

/// An entry: its number, a label that nobody reads, a state, and the number's check.
const ENTRY: usize = 32;
const STATE: usize = 24;
const CHECK: usize = 28;
/// States in which the bootloader passes an entry by: invalid and aborted.
const PASSED_BY: [u32; 2] = [3, 4];

/// The slot that the bootloader starts.
pub fn selected<F: NorFlash>(flash: &mut F, otadata: u32) -> Result<Slot, F::Error> {
    Ok(newest(flash, otadata)?.map_or(Slot::A, |(number, _)| slot_of(number)))
}

/// Has the bootloader start a slot from now on.
pub fn select<F: NorFlash>(flash: &mut F, otadata: u32, slot: Slot) -> Result<(), F::Error> {
    let newest = newest(flash, otadata)?;
    if newest.map_or(Slot::A, |(number, _)| slot_of(number)) == slot {
        return Ok(());
    }
    // Numbers are never used up: each is a program that was sent over the air.
    let number = newest.map_or(0, |(number, _)| number);
    let number = if slot_of(number.wrapping_add(1)) == slot { number.wrapping_add(1) } else { number.wrapping_add(2) };
    let mut entry = [0xFF; ENTRY];
    entry[..4].copy_from_slice(&number.to_le_bytes());
    entry[CHECK..].copy_from_slice(&check(number).to_le_bytes());
    let sector = F::ERASE_SIZE as u32;
    let at = otadata + newest.map_or(0, |(_, index)| 1 - index) * sector;
    flash.erase(at, at + sector)?;
    flash.write(at, &entry)
}

/// The number that counts, and the index of its sector.
fn newest<F: NorFlash>(flash: &mut F, otadata: u32) -> Result<Option<(u32, u32)>, F::Error> {
    let mut newest = None;
    for index in 0..2 {
        let mut entry = [0; ENTRY];
        flash.read(otadata + index * F::ERASE_SIZE as u32, &mut entry)?;
        let word = |at: usize| u32::from_le_bytes([entry[at], entry[at + 1], entry[at + 2], entry[at + 3]]);
        let number = word(0);
        let counts =
            number != 0 && number != u32::MAX && word(CHECK) == check(number) && !PASSED_BY.contains(&word(STATE));
        if counts && newest.is_none_or(|(other, _)| number > other) {
            newest = Some((number, index));
        }
    }
    Ok(newest)
}

fn slot_of(number: u32) -> Slot {
    if number % 2 == 1 { Slot::A } else { Slot::B }
}

/// The ROM's CRC-32 of the number's bytes, begun with all bits set, which its inversion makes a beginning with none.
fn check(number: u32) -> u32 {
    !number.to_le_bytes().iter().fold(0, |crc: u32, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xEDB8_8320 } else { 0 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checks_are_those_that_esp_idf_writes() {
        // As otadata begins after ESP-IDF chose ota_0 and then ota_1 for the first time.
        assert_eq!([check(1), check(2)], [0x4743_989A, 0x55F6_3774]);
    }
}
