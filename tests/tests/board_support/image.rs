//! The emulated board's program: its ELF file read, and the bootloader's part, which the tests play.

use std::fs;
use std::ops::Range;
use std::path::Path;

use super::REPOSITORY;

/// Where the board looks for the parts of an update in its flash chip: firmware/boards/emulated/src/flash.rs.
const OTADATA: usize = 0x2000;
const SLOTS: [usize; 2] = [0x1_0000, 0x5_0000];
/// The most that a program may take.
pub const SLOT_LENGTH: usize = 0x4_0000;
const LENGTH: usize = 0x9_0000;
/// The part of the processor's flash that holds the program.
const PROGRAM_LENGTH: usize = 0x3_FC00;

/// The ELF file that was built.
fn elf() -> Vec<u8> {
    let path = Path::new(REPOSITORY).join("firmware/target/thumbv7m-none-eabi/release/emulated");
    fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}: bash firmware/ci build", path.display()))
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn half(bytes: &[u8], at: usize) -> usize {
    usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]))
}

/// The program as it lies in flash, from its first byte on.
pub fn program() -> Vec<u8> {
    let elf = elf();
    let (table, entry, count) = (word(&elf, 0x1C) as usize, half(&elf, 0x2A), half(&elf, 0x2C));
    let mut flat = Vec::new();
    for at in (0..count).map(|index| table + index * entry) {
        let (kind, offset, place, length) =
            (word(&elf, at), word(&elf, at + 4) as usize, word(&elf, at + 12) as usize, word(&elf, at + 16) as usize);
        const LOADED: u32 = 1;
        if kind != LOADED || length == 0 {
            continue;
        }
        flat.resize(flat.len().max(place + length), 0xFF);
        flat[place..place + length].copy_from_slice(&elf[offset..offset + length]);
    }
    assert!(flat.len() > 10_000 && flat.len() <= SLOT_LENGTH, "{} bytes", flat.len());
    flat
}

/// The address of an instruction that jumps to itself.
pub fn endless_loop() -> u32 {
    let program = program();
    let at = (0x400..program.len()).step_by(2).find(|&at| program[at..at + 2] == [0xFE, 0xE7]);
    at.expect("a processor's start-up code has such a loop") as u32
}

/// The RAM that is left for the stack: from the end of what is static to the end.
pub fn stack() -> Range<u32> {
    const RAM: Range<u32> = 0x2000_0000..0x2001_0000;
    let elf = elf();
    let (table, entry, count) = (word(&elf, 0x20) as usize, half(&elf, 0x2E), half(&elf, 0x30));
    let ends = (0..count).map(|index| table + index * entry).filter_map(|at| {
        let (flags, address, length) = (word(&elf, at + 8), word(&elf, at + 12), word(&elf, at + 20));
        const ALLOCATED: u32 = 2;
        (flags & ALLOCATED != 0 && RAM.contains(&address)).then_some(address + length)
    });
    ends.max().expect("static memory")..RAM.end
}

/// A flash chip with a program in its first slot and nothing else.
pub fn new_chip(program: &[u8]) -> Vec<u8> {
    let mut chip = vec![0xFF; LENGTH];
    chip[SLOTS[0]..SLOTS[0] + program.len()].copy_from_slice(program);
    chip
}

/// The slot that ESP-IDF's bootloader would start: that of the valid entry of otadata with the higher number.
pub fn chosen_slot(chip: &[u8]) -> usize {
    let numbers = [OTADATA, OTADATA + 0x1000].into_iter().filter_map(|at| {
        let (number, state, check) = (word(chip, at), word(chip, at + 24), word(chip, at + 28));
        // Its check is the CRC-32 of the number's bytes that begins with all bits clear.
        let crc = !number.to_le_bytes().iter().fold(0, |crc: u32, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xEDB8_8320 } else { 0 })
        });
        (number != u32::MAX && check == crc && state != 3 && state != 4).then_some(number)
    });
    numbers.max().map_or(0, |number| (number as usize - 1) % 2)
}

/// The program in a slot, as much of it as the processor's flash holds.
pub fn in_slot(chip: &[u8], slot: usize) -> &[u8] {
    &chip[SLOTS[slot]..SLOTS[slot] + PROGRAM_LENGTH]
}

/// How much of a slot is written, in bytes from its start.
pub fn written(chip: &[u8], slot: usize) -> usize {
    let slot = &chip[SLOTS[slot]..SLOTS[slot] + SLOT_LENGTH];
    slot.iter().rposition(|&byte| byte != 0xFF).map_or(0, |last| last + 1)
}
