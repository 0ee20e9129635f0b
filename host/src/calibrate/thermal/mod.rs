//! Thermal calibration: which parameters follow which sensors, and by how much.

mod choice;
mod per_cycle;

pub use choice::{Choice, ChosenBy, choose};
pub use per_cycle::{CycleGeometry, PerCycle, per_cycle};
