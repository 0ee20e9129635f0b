//! The link board's firmware: samples temperature sensors on a fixed grid and keeps every record until the host has it
//! on disk.
//!
//! This library knows no chip. A board is a binary that constructs a bus, a network, a clock and a configuration, puts
//! them into a [`Board`] and calls [`Board::run`]; everything after that is the same on every board.
//!
//! | module | owns |
//! | --- | --- |
//! | [`sensor`] | the thermometers, a part a file |
//! | [`bus`] | what the sampler asks of an I2C bus, and how a stuck one is freed |
//! | [`grid`] | the sampling times |
//! | [`sampler`] | all sensors at one time, a status each |
//! | [`uplink`] | records to the host, answers back |
//! | [`power`] | duty cycles counted, and the current that they cost |
//! | [`vigil`] | whether sampling and uplink both progress, which the watchdog waits for |
//! | [`boots`] | the boot number, greater at every start |
//! | [`update`] | new programs over the air, and back from one that does not reach the host |
//! | [`board`] | the parts put together |
#![no_std]

pub mod board;
pub mod boots;
pub mod bus;
pub mod grid;
mod log;
pub mod power;
pub mod sampler;
pub mod sensor;
pub mod update;
pub mod uplink;
pub mod vigil;

pub use board::{Board, Link, Radio, SENSORS, Store, Supply, Watchdog};

/// This firmware's version, as boards report it.
pub const VERSION: thermokin_protocol::Firmware = thermokin_protocol::Firmware {
    major: decimal(env!("CARGO_PKG_VERSION_MAJOR")),
    minor: decimal(env!("CARGO_PKG_VERSION_MINOR")),
    patch: decimal(env!("CARGO_PKG_VERSION_PATCH")),
};

/// The value of a text of decimal digits, at compile time.
const fn decimal(text: &str) -> u16 {
    match u16::from_str_radix(text, 10) {
        Ok(value) => value,
        Err(_) => panic!("cargo gives versions as decimal numbers"),
    }
}
