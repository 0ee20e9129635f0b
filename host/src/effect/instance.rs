//! An effect at a place with values: what discovery finds, a model file keeps and the simulator is asked for.

use super::form::{check_numbers, check_place};
use super::{Effect, Given, InstanceError, Scene, Site, Term};

/// A number of an effect by its name in the contract.
#[derive(Debug, Clone, PartialEq)]
pub struct Named {
    /// `amplitude_rad`, say.
    pub name: String,
    /// Its value, SI units.
    pub value: f64,
}

impl Named {
    /// A number with its name.
    pub fn new(name: impl Into<String>, value: f64) -> Self {
        Self { name: name.into(), value }
    }
}

/// Nonlinear numbers and coefficients.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Values {
    /// Nonlinear numbers.
    pub shape: Vec<f64>,
    /// Coefficients, one a term.
    pub coefficients: Vec<f64>,
}

impl Values {
    /// Nonlinear numbers and coefficients.
    pub fn new(shape: impl Into<Vec<f64>>, coefficients: impl Into<Vec<f64>>) -> Self {
        Self { shape: shape.into(), coefficients: coefficients.into() }
    }
}

/// The log of one sensor, as effects of readings spoil it.
#[derive(Debug, Clone, PartialEq)]
pub struct Readings {
    /// The name that the log gives it.
    pub sensor: String,
    /// When it was read, s, ascending.
    pub times_s: Vec<f64>,
    /// What was read, °C.
    pub celsius: Vec<f64>,
}

/// An effect at a place with values.
#[derive(Clone)]
pub struct Instance {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Where.
    pub site: Site,
    /// Its nonlinear numbers.
    pub shape: Vec<f64>,
    /// Its coefficients, one a term.
    pub coefficients: Vec<f64>,
}

impl std::fmt::Debug for Instance {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {:?} {:?} {:?}", self.effect.name(), self.site, self.shape, self.coefficients)
    }
}

impl Instance {
    /// An instance of an effect at a place with numbers.
    ///
    /// # Errors
    /// A place of another kind, or another number of numbers, than the effect has.
    pub fn new(effect: &'static dyn Effect, site: Site, values: Values) -> Result<Self, InstanceError> {
        check_place(effect, &site)?;
        check_numbers(effect, &site, &values.shape, &values.coefficients)?;
        Ok(Self { effect, site, shape: values.shape, coefficients: values.coefficients })
    }

    /// An instance from the parameters of the contract.
    ///
    /// # Errors
    /// A place of another kind, and parameters that are missing, unknown or out of range.
    pub fn from_parameters(
        effect: &'static dyn Effect,
        scene: &Scene,
        site: Site,
        named: &[Named],
    ) -> Result<Self, InstanceError> {
        check_place(effect, &site)?;
        let mut given = Given::new(effect.name(), named);
        let values = effect.values(scene, &site, &mut given)?;
        given.finish()?;
        Self::new(effect, site, values)
    }

    /// What a scene would need to have for the effect to be computed, in words; none where it has all.
    pub fn lacks(&self, scene: &Scene) -> Option<&'static str> {
        self.effect.lacks(scene, &self.site, &self.shape).or_else(|| {
            let terms = self.terms(scene).len();
            (terms != self.coefficients.len()).then_some("the sensors that it was found with")
        })
    }

    /// Whether it belongs to one run and not to the arm.
    pub fn is_of_run(&self) -> bool {
        self.effect.is_of_run_with(&self.shape)
    }

    /// What a unit of each coefficient adds.
    pub fn terms(&self, scene: &Scene) -> Vec<Term> {
        self.effect.terms(scene, &self.site, &self.shape)
    }

    /// Its numbers by the names of the contract.
    pub fn parameters(&self) -> Vec<Named> {
        self.effect.parameters(&self.site, &self.shape, &self.coefficients)
    }

    /// Whether two instances are the same effect at the same place.
    pub fn same_name(&self, other: &Instance) -> bool {
        self.effect.name() == other.effect.name() && self.site == other.site
    }
}
