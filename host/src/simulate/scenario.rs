//! What a scenario says: the arm as it truly is, the schedule, heat, growth, sensors and the instrument.
//!
//! The types mirror the file (`host/docs/scenario.md`); [`super::reading`] checks it. SI units, radians, °C.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Deserialize;

use super::hidden::HiddenEffect;
use crate::robot::{ParameterId, Robot};

/// A checked scenario, ready to be simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// The run's name.
    pub name: String,
    /// The seed of what differs between two runs of one arm: schedule, repeatability, noise.
    pub seed: u64,
    /// The arm's nominal description.
    pub robot: Robot,
    /// How the true arm differs from it.
    pub arm: Arm,
    /// What moves when.
    pub schedule: Schedule,
    /// Where it is measured.
    pub postures: Postures,
    /// Where heat comes from and goes.
    pub heat: Heat,
    /// What heat does to the geometry.
    pub growth: Vec<Growth>,
    /// How temperatures are read.
    pub sensors: Sensors,
    /// How positions are measured.
    pub instrument: Tracker,
    /// What is wrong beyond geometry and growth.
    pub effects: Vec<HiddenEffect>,
}

/// How the true arm differs from its nominal description.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// A shipped arm's name, or the path of a `robot.toml`, relative to the scenario.
    pub robot: String,
    /// The seed of what this arm is: geometric errors, transmission, sensor spots and biases.
    pub seed: u64,
    /// 1-sigma of the error of each length after the base, m.
    pub length_error_m: f64,
    /// 1-sigma of the error of each angle after the base, rad.
    pub angle_error_rad: f64,
    /// 1-sigma of the error of each length of transform 0, m.
    pub base_length_error_m: f64,
    /// 1-sigma of the error of each angle of transform 0, rad.
    pub base_angle_error_rad: f64,
    /// 1-sigma of one coordinate of a target's true place against the one in `robot.toml`, m.
    #[serde(default)]
    pub target_error_m: f64,
    /// True places of targets in the flange frame, m: for those without a position in `robot.toml`, or instead of it.
    #[serde(default)]
    pub targets: BTreeMap<String, [f64; 3]>,
    /// Errors of single parameters, m or rad, instead of drawn ones.
    #[serde(default)]
    pub offsets: BTreeMap<String, f64>,
    /// The temperature of every node at which the true parameters hold, °C.
    pub reference_c: f64,
    /// Repeatability, m: three times the root mean square by which a target is displaced from visit to visit, averaged
    /// over postures and targets.
    pub repeatability_m: f64,
    /// Amplitude of each revolute joint's transmission error, a wave of its position that no parameter describes, rad.
    #[serde(default)]
    pub transmission_error_rad: f64,
    /// What the flange carries, kg; written to poses.csv where given.
    pub payload_kg: Option<f64>,
}

/// What moves when.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Rest before the first measurement and after the last, s.
    pub rest_s: f64,
    /// Warm-up and cool-down in their order. Cycle 0 is measured cold before them.
    pub phases: Vec<DrivePhase>,
    /// The shortest and longest time of a cycle (movement, pause and measurement), s.
    pub cycle_s: [f64; 2],
    /// Pause between movement and measurement, s.
    pub pause_s: f64,
    /// Root-mean-square speed of each joint in the exercise at full override, rad/s or m/s.
    pub rms_speed: Vec<f64>,
    /// How much the speeds vary from cycle to cycle: 1-sigma as a share of themselves.
    #[serde(default)]
    pub speed_spread: f64,
    /// Speed override on the way from posture to posture, 0 to 1.
    pub measure_override: f64,
    /// The shortest and longest time from posture to posture, s.
    pub transit_s: [f64; 2],
    /// Wait before the first target of a visit, s.
    pub settle_s: f64,
    /// Time a target takes, s.
    pub target_s: f64,
}

/// One stretch of cycles at one speed.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DrivePhase {
    /// Speed override of the exercise, 0 to 1.
    #[serde(rename = "override")]
    pub speed_override: f64,
    /// How many cycles.
    pub cycles: u32,
    /// The joints that move in the exercise, counted from 1; absent: all.
    pub joints: Option<Vec<usize>>,
}

/// The postures that are measured, the same in every cycle.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Postures {
    /// Joint positions of each posture, rad or m; absent: drawn.
    pub joints: Option<Vec<Vec<f64>>>,
    /// A table of them in the form of a run's poses.csv, relative to the scenario; reading puts its rows into `joints`.
    pub file: Option<PathBuf>,
    /// How they are drawn.
    pub drawn: Option<DrawnPostures>,
}

/// Postures drawn within a window of joint positions, as far from each other as can be had.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DrawnPostures {
    /// Their seed.
    pub seed: u64,
    /// How many.
    pub count: usize,
    /// Lowest position of each joint, rad or m.
    pub min: Vec<f64>,
    /// Highest position of each joint, rad or m.
    pub max: Vec<f64>,
    /// The largest angle between the flange's z and the direction to the instrument, rad; absent: any.
    pub facing_rad: Option<f64>,
    /// The lowest height of the flange above the base, against gravity, m; absent: any.
    pub lowest_m: Option<f64>,
}

/// Where heat comes from and goes.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heat {
    /// The longest step of the integration, s.
    pub step_s: f64,
    /// The air of the cell.
    pub ambient: Ambient,
    /// The floor's temperature, °C.
    pub floor_c: f64,
    /// Conductance from the first link's housing to the floor, W/K.
    pub floor_w_per_k: f64,
    /// The links' masses, from the base outwards; each conducts to the next.
    pub links: Vec<LinkHeat>,
    /// The joints' losses, in the order of the chain.
    pub joints: Vec<JointHeat>,
}

/// The air's temperature: `start_c + trend_k_per_h t + swing_k sin(2π t / swing_s + swing_phase_rad)`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ambient {
    /// °C at the start, without the swing.
    pub start_c: f64,
    /// K/h.
    #[serde(default)]
    pub trend_k_per_h: f64,
    /// K.
    #[serde(default)]
    pub swing_k: f64,
    /// s.
    #[serde(default = "one_hour")]
    pub swing_s: f64,
    /// rad.
    #[serde(default)]
    pub swing_phase_rad: f64,
}

fn one_hour() -> f64 {
    3600.0
}

impl Ambient {
    /// The air's temperature, °C, at a time in s since the run began.
    pub fn celsius(&self, time_s: f64) -> f64 {
        let turn = std::f64::consts::TAU * time_s / self.swing_s + self.swing_phase_rad;
        self.start_c + self.trend_k_per_h * time_s / 3600.0 + self.swing_k * libm::sin(turn)
    }
}

/// One link's two nodes: the core, where motors and gears sit, and the housing, which the air sees.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkHeat {
    /// Heat capacity of the core, J/K.
    pub core_j_per_k: f64,
    /// Heat capacity of the housing, J/K.
    pub housing_j_per_k: f64,
    /// From core to housing, W/K.
    pub inside_w_per_k: f64,
    /// From this core to the next link's, through the joint's gear and bearings, W/K.
    pub next_w_per_k: f64,
    /// From the housing to still air, W/K.
    pub air_w_per_k: f64,
    /// What the link's own motion adds to that: W/K per rad/s of the root-sum-square speed of the joints up to it.
    pub moving_w_per_k: f64,
}

/// One joint's losses: `holding_w + coulomb ω + viscous ω²` at its root-mean-square speed `ω`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointHeat {
    /// The motor's loss while it holds the arm, W.
    #[serde(default)]
    pub holding_w: f64,
    /// Dry friction, N·m (N).
    pub coulomb: f64,
    /// Viscous friction and the motor's losses in acceleration, N·m·s (N·s/m).
    pub viscous: f64,
    /// The share of the loss that heats the core of the link that the joint moves; the rest heats the one before.
    #[serde(default)]
    pub beyond: f64,
}

/// How one parameter follows the arm's temperatures.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Growth {
    /// Its name, such as `d1`.
    pub parameter: ParameterName,
    /// Its change is the sum of these.
    pub terms: Vec<GrowthTerm>,
}

/// A parameter's name in a scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ParameterName(pub ParameterId);

impl<'de> Deserialize<'de> for ParameterName {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map(Self).map_err(serde::de::Error::custom)
    }
}

/// One node's part in a parameter's growth.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GrowthTerm {
    /// The link.
    pub link: usize,
    /// Which of its nodes.
    pub node: Node,
    /// m/K or rad/K of the node's temperature above `arm.reference_c`.
    pub per_k: f64,
}

/// One of a link's two nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Node {
    /// Where motors and gears sit.
    Core,
    /// What the air sees.
    Housing,
}

/// How temperatures are read.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensors {
    /// Time between two readings of a sensor, s.
    pub period_s: f64,
    /// 1-sigma by which a board's round comes early or late, s.
    #[serde(default)]
    pub jitter_s: f64,
    /// First-order response, s.
    pub response_s: f64,
    /// The least and greatest share of the core in what a sensor's spot feels; the housing has the rest.
    pub core_share: [f64; 2],
    /// 1-sigma of a sensor's constant error, K.
    #[serde(default)]
    pub bias_k: f64,
    /// 1-sigma of one reading, K.
    #[serde(default)]
    pub noise_k: f64,
    /// How far moving air pulls an uncovered sensor below its spot: K per rad/s of its link's speed. 0: under foam.
    #[serde(default)]
    pub chill_k: f64,
    /// The name of the sensor that reads the air; absent: none.
    pub ambient: Option<String>,
}

/// How positions are measured: a laser tracker.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tracker {
    /// What it is called.
    pub name: String,
    /// Where it stands, m, in the world frame.
    pub position: [f64; 3],
    /// Readings averaged a point.
    pub readings: u32,
    /// 1-sigma of one reading along the beam.
    pub radial: Noise,
    /// 1-sigma of one reading along either direction across the beam.
    pub transverse: Noise,
    /// The probability that a point is not seen.
    #[serde(default)]
    pub broken_beam: f64,
}

/// A deviation that grows with distance: `sigma_m + sigma_per_m · distance`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Noise {
    /// m.
    pub sigma_m: f64,
    /// m per m.
    #[serde(default)]
    pub sigma_per_m: f64,
}

impl Noise {
    /// The deviation at a distance, both m.
    pub fn at(&self, distance_m: f64) -> f64 {
        self.sigma_m + self.sigma_per_m * distance_m
    }
}
