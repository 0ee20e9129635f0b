//! The MAX30205 human body temperature sensor.
//!
//! Facts from the datasheet 19-8226 (Maxim Integrated): 16-bit two's complement, 1/256 °C a count; 44 ms (typical) to
//! 50 ms (maximum) a conversion; operating range 0 °C to +50 °C; 32 addresses by wiring A0 and A1 to GND, VDD, SCL or
//! SDA and A2 to GND or VDD, 0x40 to 0x5F in 7 bits.

use embassy_time::Duration;

use super::lm75::Part;

/// Bit 7, one-shot: with shutdown set, starts one conversion; always reads 0.
const ONE_SHOT: u8 = 1 << 7;
/// Bit 0, shutdown: only the interface stays awake (3.5 µA at most).
const SHUTDOWN: u8 = 1 << 0;

/// The MAX30205, in its normal data format (bit 5 clear: the extended one is offset by 64 °C).
pub static MAX30205: Part = Part {
    addresses: 0x40..=0x5F,
    shutdown: SHUTDOWN,
    one_shot: SHUTDOWN | ONE_SHOT,
    one_shot_bit: ONE_SHOT,
    conversion: Duration::from_millis(50),
    counts: 0..=50 * 256,
};
