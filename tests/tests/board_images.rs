//! What the boards' images are made of: which memory map each was linked with, and how large it has become.

use std::fs;
use std::ops::Range;
use std::path::Path;

use espflash::flasher::{FlashData, FlashSettings, FlashSize};
use espflash::image_format::idf::IdfBootloaderFormat;
use espflash::target::{Chip, XtalFrequency};
use sha2::{Digest, Sha256};

const REPOSITORY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// The ESP32-C3's memories as a program sees them (technical reference manual, "System and memory", table 3-1).
const C3_FLASH: [Range<u32>; 2] = [0x3C00_0000..0x3C80_0000, 0x4200_0000..0x4280_0000];
const C3_RAM: [Range<u32>; 3] = [0x3FC8_0000..0x3FCE_0000, 0x4037_C000..0x403E_0000, 0x5000_0000..0x5000_2000];

/// Bounds on the ESP32-C3's image. Who must raise one says why in the changelog.
const C3_MOST_FLASH: u32 = 600 * 1024;
/// Code in RAM, data, and zeroed data: mostly the store of records (168 KiB) and the radio's heap (36 KiB).
const C3_MOST_STATIC_RAM: u32 = 300 * 1024;
/// What is left for the stack of the main task; the radio's tasks have theirs from the heap.
const C3_LEAST_STACK: u32 = 32 * 1024;
/// Bounds on the emulated board's image.
const EMULATED_MOST_FLASH: u32 = 128 * 1024;
const EMULATED_LEAST_STACK: u32 = 24 * 1024;

/// A section of an ELF file that takes memory.
#[derive(Debug)]
struct Section {
    name: String,
    address: u32,
    size: u32,
    /// Whether the file holds its bytes; the others are zeroed or left alone at the start.
    filled: bool,
}

impl Section {
    fn lies_in(&self, memories: &[Range<u32>]) -> bool {
        memories.iter().any(|memory| memory.contains(&self.address) && self.address + self.size <= memory.end)
    }
}

/// The sections of a board's image that take memory, the smallest part of ELF that says so.
fn sections(target: &str, board: &str) -> Vec<Section> {
    let path = Path::new(REPOSITORY).join(format!("firmware/target/{target}/release/{board}"));
    let elf = fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}: bash firmware/ci build", path.display()));
    assert_eq!(elf[..6], *b"\x7FELF\x01\x01", "a 32-bit little-endian ELF file");
    let half = |at: usize| usize::from(u16::from_le_bytes([elf[at], elf[at + 1]]));
    let word = |at: usize| u32::from_le_bytes([elf[at], elf[at + 1], elf[at + 2], elf[at + 3]]);
    let (table, entry, count, names) = (word(0x20) as usize, half(0x2E), half(0x30), half(0x32));
    let names = word(table + names * entry + 0x10) as usize;
    let mut sections = Vec::new();
    for at in (0..count).map(|index| table + index * entry) {
        let (kind, flags) = (word(at + 4), word(at + 8));
        const ALLOCATED: u32 = 2;
        const NOTHING_IN_FILE: u32 = 8;
        if flags & ALLOCATED == 0 || word(at + 0x14) == 0 {
            continue;
        }
        let name = &elf[names + word(at) as usize..];
        let name = name.split(|&byte| byte == 0).next().unwrap();
        sections.push(Section {
            name: String::from_utf8_lossy(name).into_owned(),
            address: word(at + 0x0C),
            size: word(at + 0x14),
            filled: kind != NOTHING_IN_FILE,
        });
    }
    assert!(!sections.is_empty());
    sections
}

fn emulated() -> Vec<Section> {
    sections("thumbv7m-none-eabi", "emulated")
}

fn esp32c3() -> Vec<Section> {
    sections("riscv32imc-unknown-none-elf", "esp32c3")
}

/// The memories that the repository's `memory.x` names: flash and RAM.
fn memory_x() -> [Range<u32>; 2] {
    let text = fs::read_to_string(Path::new(REPOSITORY).join("memory.x")).unwrap();
    ["FLASH", "RAM"].map(|name| {
        let line = text.lines().find(|line| line.trim_start().starts_with(name)).unwrap();
        let value = |key: &str| {
            let value = line.split(key).nth(1).unwrap().trim_start_matches([' ', '=']);
            let value = value.split([',', ' ']).next().unwrap();
            match (value.strip_prefix("0x"), value.strip_suffix('K')) {
                (Some(digits), _) => u32::from_str_radix(digits, 16).unwrap(),
                (None, Some(kibibytes)) => kibibytes.parse::<u32>().unwrap() * 1024,
                (None, None) => panic!("a length or origin that is neither hexadecimal nor in K: {value}"),
            }
        };
        let origin = value("ORIGIN");
        origin..origin + value("LENGTH")
    })
}

#[test]
fn the_emulated_board_is_linked_with_the_repositorys_map() {
    let memories = memory_x();
    for section in emulated() {
        assert!(section.lies_in(&memories), "{section:?} lies outside of memory.x");
    }
    let vectors = emulated().into_iter().find(|section| section.name == ".vector_table").unwrap();
    assert_eq!(vectors.address, memories[0].start);
}

#[test]
fn the_esp32c3_is_linked_with_its_hals_map() {
    let memories = [&C3_FLASH[..], &C3_RAM[..]].concat();
    let foreign = memory_x();
    for section in esp32c3() {
        assert!(section.lies_in(&memories), "{section:?} lies outside of the chip's memories");
        assert!(!section.lies_in(&foreign), "{section:?} lies in the emulated board's memory");
    }
    let named: Vec<_> = esp32c3().into_iter().map(|section| section.name).collect();
    for expected in [".flash.appdesc", ".text", ".rodata", ".rwtext.wifi"] {
        assert!(named.iter().any(|name| name == expected), "no section {expected}: {named:?}");
    }
}

#[test]
fn no_other_map_lies_where_a_linker_would_find_it_first() {
    // Cargo links each image in the workspace's folder.
    for folder in ["firmware", "firmware/boards/esp32c3", "firmware/boards/emulated"] {
        assert!(!Path::new(REPOSITORY).join(folder).join("memory.x").exists(), "{folder}/memory.x");
    }
}

#[test]
fn the_esp32c3_stays_within_its_bounds() {
    let sections = esp32c3();
    // Gaps that keep addresses of two views apart, memory that only the heap uses, and the stack, take none of their own.
    let counted = |section: &&Section| {
        !section.name.ends_with("_dummy") && section.name != ".stack" && section.name != ".dram2_uninit"
    };
    let flash: u32 = sections.iter().filter(counted).filter(|section| section.filled).map(|section| section.size).sum();
    let ram = sections.iter().filter(counted).filter(|section| section.lies_in(&C3_RAM)).map(|section| section.size);
    let ram: u32 = ram.sum();
    let stack = sections.iter().find(|section| section.name == ".stack").unwrap().size;
    println!("esp32c3: {flash} bytes of flash, {ram} of static RAM, {stack} left for the main stack");
    assert!(flash <= C3_MOST_FLASH, "{flash} bytes of flash, bound {C3_MOST_FLASH}");
    assert!(ram <= C3_MOST_STATIC_RAM, "{ram} bytes of static RAM, bound {C3_MOST_STATIC_RAM}");
    assert!(stack >= C3_LEAST_STACK, "{stack} bytes of stack, bound {C3_LEAST_STACK}");
}

#[test]
fn the_emulated_board_stays_within_its_bounds() {
    let sections = emulated();
    let [_, ram] = memory_x();
    let flash: u32 = sections.iter().filter(|section| section.filled).map(|section| section.size).sum();
    let used: u32 =
        sections.iter().filter(|section| section.lies_in(std::slice::from_ref(&ram))).map(|section| section.size).sum();
    let stack = ram.end - ram.start - used;
    println!("emulated: {flash} bytes of flash, {used} of static RAM, {stack} left for the stack");
    assert!(flash <= EMULATED_MOST_FLASH, "{flash} bytes of flash, bound {EMULATED_MOST_FLASH}");
    assert!(stack >= EMULATED_LEAST_STACK, "{stack} bytes of stack, bound {EMULATED_LEAST_STACK}");
}

#[test]
fn the_program_looks_where_the_partition_table_says() {
    let board = Path::new(REPOSITORY).join("firmware/boards/esp32c3");
    let table = fs::read_to_string(board.join("partitions.csv")).unwrap();
    let program = fs::read_to_string(board.join("src/flash.rs")).unwrap();
    let number =
        |text: &str| u32::from_str_radix(text.trim().trim_start_matches("0x").replace('_', "").as_str(), 16).unwrap();
    let partitions: Vec<(String, Range<u32>)> = table
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            let fields: Vec<_> = line.split(',').map(str::trim).collect();
            (fields[0].to_owned(), number(fields[3])..number(fields[3]) + number(fields[4]))
        })
        .collect();
    let constant = |name: &str| {
        let line = program.lines().find(|line| line.starts_with(&format!("const {name}: u32"))).unwrap();
        number(line.split('=').nth(1).unwrap().trim_end_matches(';'))
    };
    let partition = |name: &str| partitions.iter().find(|(found, _)| found == name).unwrap().1.clone();
    assert_eq!(constant("CONFIGURATION"), partition("thermokin").start);
    assert_eq!(constant("BOOTS")..constant("BOOTS") + 2 * 0x1000, partition("boots"));
    assert_eq!(constant("UPDATES")..constant("UPDATES") + 2 * 0x1000, partition("updates"));
    assert_eq!(constant("OTADATA")..constant("OTADATA") + 2 * 0x1000, partition("otadata"));
    for (slot, name) in [("OTA_0", "ota_0"), ("OTA_1", "ota_1")] {
        assert_eq!(constant(slot)..constant(slot) + constant("SLOT_LENGTH"), partition(name));
    }
    for (earlier, later) in partitions.iter().zip(&partitions[1..]) {
        assert!(earlier.1.end <= later.1.start, "{} overlaps {}", earlier.0, later.0);
    }
    assert!(partitions.last().unwrap().1.end <= 4 << 20, "beyond 4 MiB of flash");
    assert!(C3_MOST_FLASH <= partition("ota_0").len() as u32);
}

/// The image that `espflash save-image` writes of the ESP32-C3's program, laid out by the board's table: by the same
/// library, in this process.
fn saved_image() -> Vec<u8> {
    let elf = fs::read(Path::new(REPOSITORY).join("firmware/target/riscv32imc-unknown-none-elf/release/esp32c3"));
    let elf = elf.unwrap_or_else(|error| panic!("esp32c3: {error}: bash firmware/ci build"));
    let settings = FlashSettings::new(None, Some(FlashSize::_4Mb), None);
    let data = FlashData::new(settings, 0, None, Chip::Esp32c3, XtalFrequency::_40Mhz);
    let table = Path::new(REPOSITORY).join("firmware/boards/esp32c3/partitions.csv");
    let format = IdfBootloaderFormat::new(&elf, &data, Some(&table), None, None, Some("ota_0"));
    let format = format.unwrap_or_else(|error| panic!("espflash refuses the image: {error}"));
    let segments: Vec<_> = format.ota_segments().collect();
    let [program] = &segments[..] else { panic!("{} parts of flash", segments.len()) };
    assert_eq!(program.addr, 0x1_0000, "the first slot");
    program.data.to_vec()
}

#[test]
fn the_saved_image_is_what_the_bootloader_takes_and_fits_its_slot() {
    let image = saved_image();
    let word = |at: usize| u32::from_le_bytes([image[at], image[at + 1], image[at + 2], image[at + 3]]);
    let half = |at: usize| u16::from_le_bytes([image[at], image[at + 1]]);
    // The header (ESP-IDF, "App image format"): magic, segments, and the chip's number, which is 5.
    let (magic, segments, entry) = (image[0], image[1], word(4));
    assert_eq!((magic, half(12)), (0xE9, 5));
    assert!(C3_RAM.iter().chain(&C3_FLASH).any(|memory| memory.contains(&entry)), "it begins at {entry:#x}");
    let (mut at, mut check, mut mapped) = (24, 0xEF_u8, 0);
    for _ in 0..segments {
        let (address, length) = (word(at), word(at + 4) as usize);
        at += 8;
        // What fills up to a mapped segment's page is loaded nowhere: address 0.
        if address == 0 {
            assert!(image[at..at + length].iter().all(|&byte| byte == 0), "padding at {at:#x}");
        }
        let section = Section { name: format!("segment at {at:#x}"), address, size: length as u32, filled: true };
        assert!(address == 0 || section.lies_in(&[&C3_FLASH[..], &C3_RAM[..]].concat()), "{section:?}");
        if C3_FLASH.iter().any(|flash| flash.contains(&address)) {
            // The bootloader maps whole pages of 64 KiB: a mapped segment has the same place in its page in both.
            assert_eq!(at % 0x1_0000, address as usize % 0x1_0000, "{section:?}");
            mapped += 1;
        }
        check = image[at..at + length].iter().fold(check, |check, byte| check ^ byte);
        at += length;
    }
    assert!(mapped == 2, "{mapped} segments of flash, expected constants and code");
    // The check is the last byte of the next 16, and the SHA-256 of all before follows.
    let end = at / 16 * 16 + 16;
    assert_eq!(image[end - 1], check);
    assert_eq!(image[23], 1, "a digest is appended");
    assert_eq!(image[end..end + 32], Sha256::digest(&image[..end])[..]);
    // Nothing that counts follows.
    assert!(image[end + 32..].iter().all(|&byte| byte == 0xFF));
    // The program's descriptor, where the bootloader and `thermokin board update` look for it.
    assert_eq!(word(32), 0xABCD_5432);
    let text = |range: Range<usize>| String::from_utf8(image[range].split(|&byte| byte == 0).next().unwrap().to_vec());
    assert_eq!(text(48..80).unwrap(), "0.1.0");
    assert_eq!(text(80..112).unwrap(), "thermokin-board-esp32c3");
    const SLOT: usize = 0x1F_0000;
    println!("esp32c3: an image of {} bytes, {}% of its slot", image.len(), image.len() * 100 / SLOT);
    assert!(image.len() <= SLOT);
}
