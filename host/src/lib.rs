//! thermokin: calibration of industrial arms and of their thermal drift.
//!
//! Each module is a room with one owner; ARCHITECTURE.md at the top of the project says which room does what.

pub mod calibrate;
pub mod cli;
pub mod compensate;
pub mod discover;
pub mod effect;
pub mod import;
pub mod input;
pub mod live;
pub mod logger;
pub mod model;
pub mod plan;
pub mod report;
pub mod robot;
pub mod run;
pub mod simulate;
pub(crate) mod table;
