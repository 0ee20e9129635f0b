//! The TMP105 temperature sensor, which answers for the LM75's family.
//!
//! Facts from the datasheet SLOS648B (Texas Instruments): 9 to 12 bits left-justified in 16, so 1/256 °C a count with
//! the low 4 bits clear at 12; 220 ms (typical) to 300 ms (maximum) a conversion at 12 bits; range −40 °C to +125 °C;
//! addresses 0x48 to 0x4F. An LM75 ignores the resolution bits and reads on in its 9.

use embassy_time::Duration;

use super::lm75::Part;

/// Bit 7, one-shot: with shutdown set, starts one conversion; reads 0 while and after it.
const ONE_SHOT: u8 = 1 << 7;
/// Bits 6 and 5, both set: 12 bits.
const TWELVE_BITS: u8 = 0b11 << 5;
/// Bit 0, shutdown.
const SHUTDOWN: u8 = 1 << 0;

/// The TMP105 at its finest resolution.
pub static TMP105: Part = Part {
    addresses: 0x48..=0x4F,
    shutdown: TWELVE_BITS | SHUTDOWN,
    one_shot: TWELVE_BITS | SHUTDOWN | ONE_SHOT,
    one_shot_bit: ONE_SHOT,
    conversion: Duration::from_millis(300),
    counts: -40 * 256..=125 * 256,
};
