//! An import's import.toml as any bytes.
#![no_main]

#[path = "../property.rs"]
mod property;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| property::holds("import/import.toml", bytes));
