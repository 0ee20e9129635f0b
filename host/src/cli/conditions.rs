//! The options that say how much of a model is used, and at which temperatures.

use clap::{Args, ValueEnum};

use super::Failure;
use crate::compensate::Conditions;
use crate::model::{Level, Model};

/// How much of a model is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LevelName {
    /// The nominal arm, its base aligned to the measurements
    Nominal,
    /// The geometry of the reference cycle
    Geometric,
    /// With the thermal correction
    Thermal,
    /// With the effects that discover found
    Extended,
}

impl LevelName {
    /// As the library names it.
    pub fn level(self) -> Level {
        match self {
            LevelName::Nominal => Level::Nominal,
            LevelName::Geometric => Level::Geometric,
            LevelName::Thermal => Level::Thermal,
            LevelName::Extended => Level::Extended,
        }
    }
}

/// Temperatures given by hand.
#[derive(Debug, Args)]
pub struct Temperatures {
    /// A sensor's temperature, °C; sensors that are not given count as at the reference
    #[arg(long = "temperature", value_name = "SENSOR=C")]
    given: Vec<String>,
}

impl Temperatures {
    /// Whether none is given.
    pub fn is_empty(&self) -> bool {
        self.given.is_empty()
    }

    /// The conditions at these temperatures.
    ///
    /// # Errors
    /// A text that is no temperature, or of no sensor of the model.
    pub fn conditions(&self, model: &Model) -> Result<Conditions, Failure> {
        let mut conditions = Conditions { celsius: vec![None; model.temperatures.len()], ..Conditions::default() };
        for text in &self.given {
            let parsed = text.split_once('=').and_then(|(name, value)| Some((name, value.parse::<f64>().ok()?)));
            let Some((name, celsius)) = parsed.filter(|(_, celsius)| celsius.is_finite()) else {
                return Err(Failure::Usage(format!("--temperature {text}: expected a sensor and °C, as L0S1=25.5")));
            };
            let Some(sensor) = model.temperatures.iter().position(|reference| reference.sensor == name) else {
                let known = model.sensors().join(", ");
                return Err(Failure::Usage(format!("--temperature {text}: no such sensor, the model has {known}")));
            };
            conditions.celsius[sensor] = Some(celsius);
        }
        Ok(conditions)
    }
}
