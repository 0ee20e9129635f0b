//! Identification of an arm from measurements: geometry, thermal coefficients, what the data can tell, and how surely.
//!
//! Identification knows nothing of effects beyond geometry and temperature; `validation` applies those that a model carries.

mod align;
mod calibration;
mod campaign;
mod covariance;
mod factor;
mod folded;
mod heldout;
mod identify;
pub mod methods;
mod observe;
mod problem;
mod rank;
mod recursive;
mod robust;
mod solve;
mod strata;
pub mod thermal;
mod unknown;
mod upkeep;
mod validation;

pub use align::{align, base_unknowns, target_unknowns};
pub use calibration::{Calibration, CalibrationError, Request, Start, calibrate, position_errors, start};
pub use campaign::{Campaign, ObservedDistance, ObservedPosition, ObservedTurn, ObservedVisit};
pub use covariance::{Noise, Uncertainty, uncertainty};
pub use factor::{NewRows, OrthogonalFactor};
pub use folded::folded;
pub use heldout::{Folds, HeldOut, HeldOutBy, HeldOutError, held_out};
pub use identify::{Identification, Manner, Weak, geometric_unknowns, identifiable, identify};
pub use observe::{JointSource, ObserveOptions, Observed, observe};
pub use problem::{Problem, Scratch, VisitRows};
pub use rank::{Held, Observability, in_words, observability};
pub use recursive::Recursive;
pub use robust::Loss;
pub use solve::{Solution, Stop, Stopping, solve, solve_from};
pub use strata::{WeighedGrowth, weighed_growth};
pub use unknown::{GrowthTerm, Names, State, Unknown, keep_order};
pub use upkeep::{Drift, Innovation, Upkeep};
pub(crate) use validation::growth_and_scene;
pub use validation::{Group, LEVELS, Refit, Trial, Validation, validate};
