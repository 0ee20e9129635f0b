//! The calibration put to work: what a robot has to be told so that it stands where it should.
//!
//! [`Arm`] is a model made ready; under [`Conditions`] it becomes a [`Present`] that answers forward and inverse
//! kinematics with everything the model knows. [`Corrector`] makes corrections of joints with it, within the model's
//! bounds, and [`Guard`] bounds how fast they change. [`batch`] does it for files, [`live`] for a robot that moves;
//! [`export`] writes the model as what other programs read.
//!
//! Knows nothing of how a model was found, and nothing of runs.

mod arm;
pub mod batch;
mod correction;
pub mod export;
mod inverse;
pub mod live;
mod seeds;
#[cfg(test)]
mod tests;

pub use arm::{Arm, Conditions, Present};
pub use correction::{Corrected, Corrector, Guard};
pub use inverse::{Attempt, Branches, InverseError, Solution};
