//! Arbitrary datagrams, to either end.
#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../../tests/ends/mod.rs"]
mod ends;

fuzz_target!(|bytes: &[u8]| ends::datagram(bytes));
