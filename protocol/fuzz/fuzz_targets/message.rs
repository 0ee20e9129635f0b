//! Arbitrary messages, sealed with the right key, to either end.
#![no_main]

use libfuzzer_sys::fuzz_target;

#[allow(dead_code, reason = "each target uses one of the two")]
#[path = "../../tests/ends/mod.rs"]
mod ends;

fuzz_target!(|bytes: &[u8]| ends::message(bytes));
