//! A calibrated arm: nominal, geometric and thermal parameters, the effects that discovery found, its file, and what it
//! predicts.
//!
//! Knows nothing of how the values were found.

mod bounds;
mod errors;
mod extended;
mod extended_file;
mod file;
mod geometry;

pub use bounds::CorrectionBounds;
pub use errors::{ErrorTally, Errors};
pub use extended::{Applied, EffectParameter, Extended, ExtendedGrowth, ExtendedNoise, ModelEffect};
pub use file::{HOW_TO_APPLY, ModelFileError};
pub use geometry::{Geometry, Growth, Level, Model, ParameterEstimate, ReferenceTemperature};
