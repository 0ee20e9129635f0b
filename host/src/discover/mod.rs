//! Discovers what a calibrated model gets wrong: shows how far the residuals are from noise, names the physical causes of
//! the catalogue that the data support, and measures what each gains on data that it was not fitted to.

pub mod candidates;
mod chance;
pub mod fit;
mod noise;
pub mod normal;
pub mod readings;
pub mod search;
pub mod stage;
