//! What an instance of an effect is made of: what identifies it, and how many numbers it has. Model files and scenarios are
//! held against it before anything is computed with them.

use std::ops::RangeInclusive;

use super::{Effect, Site};

/// What identifies an instance, and how many numbers it has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Form {
    joint: bool,
    from: bool,
    parameter: bool,
    sensors: usize,
    targets: usize,
    shape: RangeInclusive<usize>,
    coefficients: RangeInclusive<usize>,
}

impl Form {
    /// An effect of the whole run or arm, with one coefficient and no nonlinear number.
    pub fn whole() -> Self {
        Self { joint: false, from: false, parameter: false, sensors: 0, targets: 0, shape: 0..=0, coefficients: 1..=1 }
    }

    /// It sits at a joint.
    pub fn joint(self) -> Self {
        Self { joint: true, ..self }
    }

    /// It comes from another joint.
    pub fn from(self) -> Self {
        Self { from: true, ..self }
    }

    /// It sits at a parameter.
    pub fn parameter(self) -> Self {
        Self { parameter: true, ..self }
    }

    /// It sits at so many sensors.
    pub fn sensors(self, count: usize) -> Self {
        Self { sensors: count, ..self }
    }

    /// It sits at so many targets.
    pub fn targets(self, count: usize) -> Self {
        Self { targets: count, ..self }
    }

    /// It has so many nonlinear numbers.
    pub fn shape(self, count: RangeInclusive<usize>) -> Self {
        Self { shape: count, ..self }
    }

    /// It has so many coefficients.
    pub fn coefficients(self, count: RangeInclusive<usize>) -> Self {
        Self { coefficients: count, ..self }
    }

    /// What `where` must hold, in words.
    fn place(&self) -> String {
        let mut words = Vec::new();
        for (asked, name) in [(self.from, "from"), (self.joint, "joint"), (self.parameter, "parameter")] {
            if asked {
                words.push(name);
            }
        }
        for (count, names) in [(self.sensors, ["sensor", "sensors"]), (self.targets, ["target", "targets"])] {
            match count {
                0 => {}
                1 => words.push(names[0]),
                _ => words.push(names[1]),
            }
        }
        if words.is_empty() { "nothing".to_owned() } else { words.join(" and ") }
    }

    fn fits_place(&self, site: &Site) -> bool {
        let distinct = |indices: &[usize]| (1..indices.len()).all(|place| !indices[..place].contains(&indices[place]));
        self.joint == site.joint.is_some()
            && self.from == site.from.is_some()
            && (site.from.is_none() || site.from != site.joint)
            && self.parameter == site.parameter.is_some()
            && self.sensors == site.sensors.len()
            && self.targets == site.targets.len()
            && distinct(&site.sensors)
            && distinct(&site.targets)
    }
}

/// Why there is no such instance of an effect.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InstanceError {
    /// A name that no effect has.
    #[error("no effect '{0}', expected one of {list}", list = super::names())]
    NoEffect(String),
    /// A place that the arm or the run does not have.
    #[error("{0}: where names a joint, parameter, sensor or target that is not there")]
    NoPlace(&'static str),
    /// A place of another kind.
    #[error("{effect}: expected where to hold {expected} and nothing else")]
    Place {
        /// The effect.
        effect: &'static str,
        /// What identifies it.
        expected: String,
    },
    /// Too few or too many numbers, or numbers that are none.
    #[error("{effect}: {shape} nonlinear numbers and {coefficients} coefficients do not make one")]
    Numbers {
        /// The effect.
        effect: &'static str,
        /// How many nonlinear numbers there are.
        shape: usize,
        /// How many coefficients.
        coefficients: usize,
    },
    /// A parameter that is needed and not given.
    #[error("{effect}: expected the parameter {name}")]
    Missing {
        /// The effect.
        effect: &'static str,
        /// The parameter.
        name: String,
    },
    /// A parameter that it does not have.
    #[error("{effect}: no parameter {name}, expected {expected}")]
    Unknown {
        /// The effect.
        effect: &'static str,
        /// What was given.
        name: String,
        /// What it has.
        expected: String,
    },
    /// A value that it cannot have.
    #[error("{effect}: {name} is {value}, expected {expected}")]
    Value {
        /// The effect.
        effect: &'static str,
        /// The parameter.
        name: String,
        /// Its value.
        value: f64,
        /// What it can be.
        expected: &'static str,
    },
    /// A pattern outside the catalogue has no parameters in the contract.
    #[error("{0}: has no parameters to be made from; expected a model file that carries it")]
    OfModelsAlone(&'static str),
}

/// Holds a place against an effect's form.
///
/// # Errors
/// A place of another kind.
pub fn check_place(effect: &dyn Effect, site: &Site) -> Result<(), InstanceError> {
    let form = effect.form(site);
    match form.fits_place(site) {
        true => Ok(()),
        false => Err(InstanceError::Place { effect: effect.name(), expected: form.place() }),
    }
}

/// Holds numbers against an effect's form.
///
/// # Errors
/// Too few or too many, or one that is no number.
pub fn check_numbers(
    effect: &dyn Effect,
    site: &Site,
    shape: &[f64],
    coefficients: &[f64],
) -> Result<(), InstanceError> {
    let form = effect.form(site);
    let fit = form.shape.contains(&shape.len()) && form.coefficients.contains(&coefficients.len());
    match fit && shape.iter().chain(coefficients).all(|value| value.is_finite()) {
        true => Ok(()),
        false => {
            Err(InstanceError::Numbers { effect: effect.name(), shape: shape.len(), coefficients: coefficients.len() })
        }
    }
}
