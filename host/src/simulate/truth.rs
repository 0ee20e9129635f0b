//! What only the simulator knows: for tests and `--truth`, never inside a run folder.

use serde::Serialize;

use super::hidden::HiddenEffect;

/// The truth behind a simulated run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Truth {
    /// The scenario's name.
    pub scenario: String,
    /// The run's seed.
    pub seed: u64,
    /// The arm's seed.
    pub arm_seed: u64,
    /// The temperature at which `parameters` hold, °C.
    pub reference_c: f64,
    /// Every parameter of the chain.
    pub parameters: Vec<TrueParameter>,
    /// The targets' true places.
    pub targets: Vec<TrueTarget>,
    /// 1-sigma of every joint from visit to visit, rad or m.
    pub joint_sigma: f64,
    /// The sensors' spots and biases.
    pub sensors: Vec<TrueSensor>,
    /// Every visit.
    pub visits: Vec<TrueVisit>,
    /// Every cycle.
    pub cycles: Vec<TrueCycle>,
    /// Effects of the catalogue that the scenario asked for.
    pub effects: Vec<HiddenEffect>,
}

/// A parameter and its true value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrueParameter {
    /// Its name.
    pub name: String,
    /// m or rad.
    pub nominal: f64,
    /// With every node at the reference temperature, m or rad.
    pub value: f64,
}

/// A target and its true place.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrueTarget {
    /// Its name.
    pub name: String,
    /// In the flange frame, m.
    pub position: [f64; 3],
}

/// A sensor's spot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrueSensor {
    /// Its name.
    pub name: String,
    /// The share of the core in what it feels.
    pub core_share: f64,
    /// Its constant error, K.
    pub bias_k: f64,
}

/// A visit as it truly was.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrueVisit {
    /// The cycle.
    pub cycle: u32,
    /// The posture.
    pub pose: u32,
    /// When the arm had come to rest, s.
    pub time_s: f64,
    /// Where the joints truly were, rad or m.
    pub joints: Vec<f64>,
    /// Temperatures of the nodes at that time, °C: core and housing of each link in turn, the base's first.
    pub nodes_c: Vec<f64>,
    /// Change of every parameter by heat since the reference temperature, m or rad, in the order of the parameters.
    pub growth: Vec<f64>,
}

/// A cycle in a few numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrueCycle {
    /// The cycle.
    pub cycle: u32,
    /// When its first visit was, s.
    pub time_s: f64,
    /// Mean distance from the measured points to those that the nominal model expects, m.
    pub nominal_error_m: f64,
    /// Mean distance by which heat alone has displaced the targets since cycle 0, m.
    pub drift_m: f64,
    /// The highest temperature of a housing, °C.
    pub warmest_housing_c: f64,
    /// The air, °C.
    pub air_c: f64,
}
