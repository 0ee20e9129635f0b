//! What discovery adds to a calibrated arm: physical effects with their values, and the geometry and growth that were fitted
//! together with them. The levels below keep their own values.

use super::geometry::{Geometry, Model};
use crate::effect::{Effect, Instance, InstanceError, Scene, SiteNames, Values, by_name};
use crate::robot::ParameterId;

/// A number of an effect by the contract's name, with its 95 % interval.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectParameter {
    /// `amplitude_rad`, say.
    pub name: String,
    /// Its value, SI units.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// An effect that a model carries.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelEffect {
    /// Its name: one of the catalogue's, or `unexplained`.
    pub effect: &'static str,
    /// Where it sits.
    pub place: SiteNames,
    /// Its nonlinear numbers.
    pub shape: Vec<f64>,
    /// Its coefficients.
    pub coefficients: Vec<f64>,
    /// The same by the names of the contract: for people and programs, predictions come from the numbers above.
    pub parameters: Vec<EffectParameter>,
}

/// A thermal coefficient as it was fitted together with the effects.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtendedGrowth {
    /// The parameter.
    pub parameter: ParameterId,
    /// The sensor's name.
    pub sensor: String,
    /// m/K or rad/K.
    pub coefficient: f64,
}

/// What discovery adds to a model.
#[derive(Debug, Clone, PartialEq)]
pub struct Extended {
    /// The geometry at the reference temperatures, fitted with the effects.
    pub geometry: Geometry,
    /// Thermal coefficients, fitted with the effects.
    pub growth: Vec<ExtendedGrowth>,
    /// The air's temperature from which effects of the air count, °C.
    pub air_reference_c: Option<f64>,
    /// The effects.
    pub effects: Vec<ModelEffect>,
    /// The noise that is left beside them; none in files that do not say.
    pub noise: Option<ExtendedNoise>,
}

/// Sizes of noise beside a model: standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtendedNoise {
    /// Of one coordinate of one point, in units of what run.toml states.
    pub point: f64,
    /// Of each joint from visit to visit, radians or metres.
    pub visit_rad: Vec<f64>,
    /// Of each joint at each posture, shared by its visits.
    pub posture_rad: f64,
    /// Of each joint in each cycle, shared by its visits.
    pub cycle_rad: f64,
}

impl ExtendedNoise {
    /// Nothing beside the instrument's own.
    pub fn of_instrument(joints: usize) -> Self {
        Self { point: 1.0, visit_rad: vec![0.0; joints], posture_rad: 0.0, cycle_rad: 0.0 }
    }
}

impl ModelEffect {
    /// The effect itself.
    ///
    /// # Errors
    /// A name that no effect has.
    pub fn kind(&self) -> Result<&'static dyn Effect, InstanceError> {
        by_name(self.effect).ok_or_else(|| InstanceError::NoEffect(self.effect.to_owned()))
    }

    /// The effect at its place in a scene, by the names of its sensors and of these targets.
    ///
    /// # Errors
    /// A place that the scene does not have, or numbers that do not make an instance.
    pub fn instance(&self, scene: &Scene, targets: &[String]) -> Result<Instance, InstanceError> {
        let kind = self.kind()?;
        let sensors: Vec<String> = scene.sensors.iter().map(|sensor| sensor.name.clone()).collect();
        let site =
            self.place.site(&scene.chain, &sensors, targets).ok_or_else(|| InstanceError::NoPlace(kind.name()))?;
        Instance::new(kind, site, Values::new(self.shape.clone(), self.coefficients.clone()))
    }

    /// The effect and its place, in words.
    pub fn words(&self) -> String {
        match self.place.to_string() {
            place if place.is_empty() => self.effect.to_owned(),
            place => format!("{} at {place}", self.effect),
        }
    }
}

/// Effects of a model as they act in another run.
#[derive(Debug, Clone, Default)]
pub struct Applied {
    /// Those that act.
    pub instances: Vec<Instance>,
    /// Those that do not, and why.
    pub notes: Vec<String>,
}

impl Model {
    /// The effects that it carries.
    pub fn effects(&self) -> &[ModelEffect] {
        self.extended.as_ref().map_or(&[], |extended| &extended.effects)
    }

    /// The effects as they act in a scene of another run than the one they were found on: those that belong to one run, and
    /// those that need what this run does not have, are left out with a note.
    pub fn effects_in(&self, scene: &Scene, targets: &[String]) -> Applied {
        let mut applied = Applied::default();
        for effect in self.effects() {
            let words = effect.words();
            if effect.kind().is_ok_and(|kind| kind.is_of_run_with(&effect.shape)) {
                applied.notes.push(format!("{words}: belongs to the run it was found on and is not applied"));
                continue;
            }
            match effect.instance(scene, targets) {
                Ok(instance) => match instance.lacks(scene) {
                    None => applied.instances.push(instance),
                    Some(what) => applied.notes.push(format!("{words}: not applied, the run lacks {what}")),
                },
                Err(error) => applied.notes.push(format!("{words}: not applied: {error}")),
            }
        }
        applied
    }
}
