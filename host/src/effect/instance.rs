//! An effect at a place with values: what discovery finds, a model file keeps and the simulator is asked for.

use super::{Effect, Scene, Site, Term};

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
