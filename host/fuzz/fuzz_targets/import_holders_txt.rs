//! An import's holders.txt as any bytes.
#![no_main]

#[path = "../property.rs"]
mod property;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| property::holds("import/holders.txt", bytes));
