//! The boot number, greater at every start: nonces are made of it, so it is written before anything is sent.
//!
//! Two flash sectors hold a growing list of numbers, each a word and its complement. A start appends the next number; a
//! full sector gives way to the other one, which is erased only when the new sector's first number is about to be
//! written, so that a loss of power at any moment leaves the greatest number readable or unwritten, never smaller.

use embedded_storage::nor_flash::NorFlash;

/// The bytes of an entry: a number, then its complement.
const ENTRY: usize = 8;

/// Why there is no boot number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BootsError<E> {
    /// The flash reports an error.
    Flash(E),
    /// All 2^32 numbers are used.
    Exhausted,
}

/// Takes the next boot number from a log in two sectors of flash that begin at `offset`; at least `first`.
///
/// # Errors
///
/// When the flash fails; then nothing may be sent, for the number could have been used before.
pub fn next_boot<F: NorFlash>(flash: &mut F, offset: u32, first: u32) -> Result<u32, BootsError<F::Error>> {
    let sector = F::ERASE_SIZE;
    let entries = sector / ENTRY;
    // The greatest number and its sector, and for each sector how many entries from its start are in use.
    let mut greatest: Option<(u32, usize)> = None;
    let mut used = [0; 2];
    for (index, used) in used.iter_mut().enumerate() {
        for entry in 0..entries {
            let mut bytes = [0; ENTRY];
            flash.read(place(offset, sector, index, entry), &mut bytes).map_err(BootsError::Flash)?;
            if bytes == [0xFF; ENTRY] {
                continue;
            }
            *used = entry + 1;
            if let Some(number) = number(bytes)
                && greatest.is_none_or(|(seen, _)| number > seen)
            {
                greatest = Some((number, index));
            }
        }
    }
    let boot = match greatest {
        Some((seen, _)) => seen.checked_add(1).ok_or(BootsError::Exhausted)?.max(first),
        None => first,
    };
    let mut current = greatest.map_or(0, |(_, index)| index);
    if used[current] == entries || greatest.is_none() {
        // A sector full of torn entries, or none at all, is erased too: it holds no number that counts.
        current = if greatest.is_none() { 0 } else { 1 - current };
        let from = place(offset, sector, current, 0);
        flash.erase(from, from + sector as u32).map_err(BootsError::Flash)?;
        used[current] = 0;
    }
    let mut bytes = [0; ENTRY];
    bytes[..4].copy_from_slice(&boot.to_le_bytes());
    bytes[4..].copy_from_slice(&(!boot).to_le_bytes());
    flash.write(place(offset, sector, current, used[current]), &bytes).map_err(BootsError::Flash)?;
    Ok(boot)
}

fn place(offset: u32, sector: usize, index: usize, entry: usize) -> u32 {
    offset + (index * sector + entry * ENTRY) as u32
}

/// The number of an entry, or nothing if it was torn by a loss of power.
fn number(bytes: [u8; ENTRY]) -> Option<u32> {
    let [a, b, c, d, e, f, g, h] = bytes;
    let (number, complement) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
    (number == !complement).then_some(number)
}
