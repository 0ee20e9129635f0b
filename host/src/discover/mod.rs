//! Discovers what a calibrated model gets wrong: shows how far the residuals are from noise, names the physical causes of
//! the catalogue that the data support, and measures what each gains on data that it was not fitted to.

pub mod candidates;
mod chance;
mod discovery;
mod estimate;
mod extension;
mod factor;
pub mod fit;
pub mod gain;
mod golden;
mod gross;
mod noise;
pub mod normal;
mod postures;
pub mod readings;
mod replay;
pub mod search;
mod separate;
pub mod stage;

pub use discovery::{
    Alternative, Discovery, DiscoveryError, DiscoveryRequest, Finding, Gain, Level, Part, STEPS, Test, Unexplained,
    discover, discover_in_steps,
};
pub use estimate::Estimate;
pub use gross::{Outlier, Swap};
pub use replay::{Replayed, replay};
