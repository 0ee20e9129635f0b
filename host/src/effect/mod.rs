//! The catalogue of effects (contract `effects.md`): what a simulation can get wrong, each stated once.
//!
//! An effect knows where it can sit ([`Effect::sites`]), which nonlinear numbers it has ([`Effect::shapes`]) and what a
//! unit of each of its coefficients adds at every visit ([`Effect::terms`]): to joints, parameters, readings, the base, a
//! target. The simulator injects with that and discovery fits with it; nothing here knows who asks. Adding an effect is
//! adding one file and one line of [`catalogue`].

mod acts;
mod backlash;
mod clock_offset;
mod encoder_gain;
mod form;
mod frame_drift;
mod frame_jump;
mod gear_eccentricity;
mod given;
mod instance;
mod joint_compliance;
mod joint_coupling;
mod joint_log_early;
mod lost_motion;
pub mod pattern;
mod present;
mod scale_error;
mod scene;
mod sensor_bias;
mod sensor_chill;
mod sensor_detached;
mod sensor_swap;
mod site;
mod sum;
mod target_shift;
mod thermal_growth;
mod thermal_lag;
mod thermal_nonlinearity;
mod tool_slip;
mod unsensed_heat;

pub use acts::{Acts, Adjustment, tool_motion};
pub use form::{Form, InstanceError};
pub use given::Given;
pub use instance::{Instance, Named, Readings, Values};
pub use scene::{Growing, Scene, Seen, Sensed, Situation};
pub use site::{Site, SiteNames};
pub use sum::adjustments;

/// The name of what follows a pattern and is in no catalogue.
pub const UNEXPLAINED: &str = "unexplained";

/// What a unit of one coefficient adds at every visit: usually one act, several where it acts in several places.
pub type Term = Vec<Acts>;

/// A physical cause that the model leaves out.
pub trait Effect: Sync {
    /// Its name in the contract.
    fn name(&self) -> &'static str;

    /// Everywhere it can sit in this scene.
    fn sites(&self, scene: &Scene) -> Vec<Site>;

    /// A grid of its nonlinear numbers, fine enough that the best point of the grid leads to the best of all; one empty
    /// shape where it has none.
    fn shapes(&self, _scene: &Scene, _site: &Site) -> Vec<Vec<f64>> {
        vec![Vec::new()]
    }

    /// What a unit of each coefficient adds, one term a coefficient. `shape` is one of its shapes, or near one.
    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term>;

    /// The parameters of the contract, from the shape and the coefficients.
    fn parameters(&self, site: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named>;

    /// What identifies an instance at such a place, and how many numbers it has.
    fn form(&self, site: &Site) -> Form;

    /// The way back from [`Effect::parameters`]: shape and coefficients from the parameters of the contract.
    ///
    /// # Errors
    /// Parameters that are missing, or that have values they cannot have.
    fn values(&self, scene: &Scene, site: &Site, given: &mut Given) -> Result<Values, InstanceError>;

    /// Whether it belongs to one run (a knock, a clock) and not to the arm: a model does not carry it to other runs.
    fn is_of_run(&self) -> bool {
        false
    }

    /// The same for an effect of which some shapes belong to one run.
    fn is_of_run_with(&self, _shape: &[f64]) -> bool {
        self.is_of_run()
    }

    /// What this scene would need to have for the effect to be computed, in words; none where it has all.
    fn lacks(&self, _scene: &Scene, _site: &Site, _shape: &[f64]) -> Option<&'static str> {
        None
    }

    /// Puts into a log of true readings what the effect makes of them; most effects leave readings alone.
    fn spoil(&self, _scene: &Scene, _instance: &Instance, _log: &mut [Readings]) {}

    /// Half-widths of a neighbourhood in which each nonlinear number may be refined from a point of the grid; zero where
    /// it must not move (a choice rather than a number).
    fn refine(&self, _scene: &Scene, shape: &[f64]) -> Vec<f64> {
        vec![0.0; shape.len()]
    }

    /// Which of several families of shapes a shape belongs to. Families are held against noise each by itself, so that a long
    /// scan of the unlikely does not cost the likely its power.
    fn family(&self, _shape: &[f64]) -> u8 {
        0
    }

    /// Whether its terms change smoothly with its nonlinear numbers; a step in time does not.
    fn is_smooth(&self) -> bool {
        true
    }

    /// The one value that its coefficients can have by what the effect means; a search leaves them free all the same, and
    /// a coefficient far from this speaks against the effect.
    fn fixed_coefficient(&self) -> Option<f64> {
        None
    }

    /// Whether the sign and size that were found make sense.
    fn is_plausible(&self, _shape: &[f64], coefficients: &[f64]) -> bool {
        self.fixed_coefficient().is_none_or(|one| coefficients.iter().all(|value| (0.4..2.5).contains(&(value / one))))
    }

    /// What its parameter's amount changes by for a unit of a thermal coefficient, by the place of the coefficient among
    /// [`Scene::growth`], for a unit of its own coefficient; none where it does not depend on it.
    fn growth_derivative(&self, _: &Scene, _: &Site, _shape: &[f64], _growing: usize) -> Option<Vec<f64>> {
        None
    }

    /// Whether the effect lives in the temperature readings alone: the log itself tells of it, far better than the arm does.
    fn of_readings(&self) -> bool {
        false
    }
}

/// All effects that act on predictions, in the order of the contract. Exchanged labels and gross errors act on the list of
/// points itself and are found there.
pub fn catalogue() -> &'static [&'static dyn Effect] {
    &[
        &gear_eccentricity::GearEccentricity,
        &encoder_gain::EncoderGain,
        &backlash::Backlash,
        &lost_motion::LostMotion,
        &joint_log_early::JointLogEarly,
        &joint_compliance::JointCompliance,
        &joint_coupling::JointCoupling,
        &thermal_growth::ThermalGrowth,
        &thermal_lag::ThermalLag,
        &thermal_nonlinearity::ThermalNonlinearity,
        &unsensed_heat::UnsensedHeat,
        &frame_drift::FrameDrift,
        &frame_jump::FrameJump,
        &scale_error::ScaleError,
        &target_shift::TargetShift,
        &tool_slip::ToolSlip,
        &sensor_chill::SensorChill,
        &sensor_bias::SensorBias,
        &sensor_swap::SensorSwap,
        &sensor_detached::SensorDetached,
        &clock_offset::ClockOffset,
    ]
}

/// The effect of that name, the pattern outside the catalogue among them; none where there is none.
pub fn by_name(name: &str) -> Option<&'static dyn Effect> {
    let pattern: &'static dyn Effect = &pattern::Pattern;
    catalogue().iter().copied().chain([pattern]).find(|effect| effect.name() == name)
}

/// The names of the catalogue, for words.
fn names() -> String {
    catalogue().iter().map(|effect| effect.name()).collect::<Vec<_>>().join(", ")
}
