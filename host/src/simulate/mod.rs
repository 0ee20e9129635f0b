//! The twin: runs of an arm that warms up and cools down, from a scenario file.
//!
//! A scenario says how the true arm differs from its nominal description, what moves when, where heat comes from and
//! goes, and how temperatures and positions are measured; [`simulate`] makes the run folder's content of it. The same
//! scenario and seed give the same bytes on every machine: random numbers come from ChaCha8 streams, and every function
//! beyond arithmetic and square roots comes from `libm`.
//!
//! | module | owns |
//! | --- | --- |
//! | `scenario`, `reading` | what a scenario says, and its file |
//! | `timetable`, `posture` | what is when, and where |
//! | `heat`, `warmth` | the network of heat, and the arm's temperatures over time |
//! | `arm` | the true geometry, its growth, and the joints' errors |
//! | `hidden` | effects of the catalogue that a scenario hides |
//! | `sensors`, `tracker` | what is read of temperatures and positions |
//! | `truth` | what only the simulator knows |

mod arm;
mod heat;
mod hidden;
mod posture;
pub(crate) mod random;
mod reading;
mod scenario;
mod sensors;
mod timetable;
mod tracker;
mod truth;
mod warmth;

use std::path::Path;

use nalgebra::Vector3;

use crate::robot::{ParameterId, Posture, Robot};
use crate::run::{BrokenBeam, Instrument, Point, Run, RunDescription, RunFiles, Visit, WriteError};

pub use hidden::HiddenEffect;
pub use reading::SHIPPED_SCENARIOS;
pub use scenario::{
    Ambient, Arm, DrawnPostures, DrivePhase, Growth, GrowthTerm, Heat, JointHeat, LinkHeat, Node, Noise, ParameterName,
    Postures, Scenario, Schedule, Sensors, Tracker,
};
pub use truth::{TrueCycle, TrueParameter, TrueSensor, TrueTarget, TrueVisit, Truth};

use crate::effect::Adjustment;
use arm::{TrueArm, node_place};
use hidden::Doing;
use random::{Purpose, Stream};
use tracker::Measuring;
use warmth::Warmth;

/// The name of the robot description in a simulated run's folder.
const ROBOT_FILE: &str = "robot.toml";

/// Why a scenario cannot be simulated although each of its values is right.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SimulationError {
    /// Too few postures within the window meet the conditions.
    #[error(
        "{found} of {wanted} postures found in [postures.drawn]; expected a wider window, or weaker facing_rad or lowest_m"
    )]
    NoSuchPostures {
        /// How many are asked for.
        wanted: usize,
        /// How many candidates there are.
        found: usize,
    },
    /// Neither given nor drawn postures: a scenario that was not read from a file.
    #[error("the scenario has no postures")]
    NoPostures,
    /// A target without a place: a scenario that was not read from a file.
    #[error("target {0} has no position")]
    UnplacedTarget(String),
    /// A growth of a parameter that the chain does not have: a scenario that was not read from a file.
    #[error("the chain has no parameter {0}")]
    NoParameter(ParameterId),
    /// An effect that does not exist, or cannot be where or as large as the scenario says.
    #[error("effect {}: {message}", number + 1)]
    Effect {
        /// Its place among the scenario's effects.
        number: usize,
        /// What is wrong.
        message: String,
    },
}

/// A simulated run and the truth behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// The run, as if it had been measured.
    pub run: Run,
    /// The arm's nominal description.
    pub robot: Robot,
    /// What was put in.
    pub truth: Truth,
}

impl Simulated {
    /// Writes the run's folder; see [`RunFiles::store`].
    ///
    /// # Errors
    /// A disk that does not take it, or a run that could not be read back. Nothing half-written is left.
    pub fn write(&self, folder: &Path) -> Result<(), WriteError> {
        self.files(folder)?.store(folder)
    }

    /// The files of the run's folder.
    ///
    /// # Errors
    /// A run that could not be read back.
    pub fn files(&self, folder: &Path) -> Result<RunFiles, WriteError> {
        let mut run = self.run.clone();
        run.folder = folder.to_owned();
        run.description.robot = folder.join(ROBOT_FILE);
        let mut files = RunFiles::of(&run, folder)?;
        files.robot = Some((ROBOT_FILE.into(), self.robot.to_toml().into_bytes()));
        Ok(files)
    }
}

/// Simulates a scenario.
///
/// # Errors
/// Postures that cannot be found.
pub fn simulate(scenario: &Scenario) -> Result<Simulated, SimulationError> {
    let postures = posture::postures(scenario)?;
    let arm = TrueArm::new(scenario, &postures)?;
    let timetable = timetable::timetable(scenario, postures.len());
    let warmth = warmth::warmth(&scenario.robot, &scenario.heat, &timetable.steps);
    let spots = sensors::spots(scenario);
    let temperatures = sensors::readings(scenario, &spots, &warmth);

    let home = posture::home(&postures);
    let mut repeatability = Stream::new(scenario.seed, Purpose::Repeatability);
    let mut true_joints: Vec<Vec<f64>> = Vec::new();
    let visit = |planned: &timetable::PlannedVisit| {
        let posture = &postures[planned.pose];
        let before = planned.pose.checked_sub(1).map_or(&home, |previous| &postures[previous]);
        true_joints.push(arm.joints(posture).iter().map(|q| q + arm.joint_sigma * repeatability.normal()).collect());
        Visit {
            cycle: planned.cycle,
            pose: planned.pose as u32,
            time_s: planned.time_s,
            joints: posture.clone(),
            commanded: None,
            payload_kg: scenario.arm.payload_kg,
            approach: Some(posture::approach(before, posture)),
            points: Vec::new(),
            distances: Vec::new(),
            broken_beams: Vec::new(),
        }
    };
    let visits = timetable.visits.iter().map(visit).collect();
    let (sigma_m, sigma_per_m) = scenario.instrument.stated_sigma();
    let mut run = Run {
        folder: Path::new("").to_owned(),
        description: RunDescription {
            name: scenario.name.clone(),
            robot: ROBOT_FILE.into(),
            reference_cycle: 0,
            ambient: scenario.sensors.ambient.clone(),
            instrument: Instrument {
                name: scenario.instrument.name.clone(),
                position: scenario.instrument.position,
                sigma_m,
                sigma_per_m,
                sigma_rad: None,
            },
            anchors: Vec::new(),
        },
        visits,
        target_names: scenario.robot.targets.iter().map(|target| target.name.clone()).collect(),
        temperatures: Some(temperatures),
        motion: timetable.steps,
        notes: Vec::new(),
    };
    let Doing { adjustments, log } = hidden::doing(scenario, &arm, &run)?;
    run.temperatures = log;

    let station = Vector3::from(scenario.instrument.position);
    let mut measuring = Measuring::new(&scenario.instrument, scenario.seed);
    let mut true_visits: Vec<TrueVisit> = Vec::new();
    let standing = timetable.visits.iter().zip(&mut run.visits).zip(true_joints).zip(&adjustments);
    for (((planned, visit), mut joints), adjustment) in standing {
        joints.iter_mut().zip(&adjustment.joints).for_each(|(joint, more)| *joint += more);
        for (target, (&time_s, place)) in planned.points_s.iter().zip(&arm.targets).enumerate() {
            let flange = arm.flange(&joints, &warmth.nodes.at(time_s), adjustment);
            let seen = adjustment.seen(&flange.point(&(place + adjustment.targets[target])), &station);
            match measuring.measure(&seen) {
                Some(position) => {
                    visit.points.push(Point { time_s, target, position, orientation: None, sigma_m: None })
                }
                None => visit.broken_beams.push(BrokenBeam { time_s, target, anchor: None }),
            }
        }
        let nodes_c = warmth.nodes.at(planned.time_s);
        let growth = arm.growth(&nodes_c);
        let Visit { cycle, pose, time_s, .. } = *visit;
        true_visits.push(TrueVisit { cycle, pose, time_s, joints, nodes_c, growth });
    }
    let cycles = cycles(scenario, &arm, &postures, &warmth, &run, &adjustments);
    let truth = Truth {
        scenario: scenario.name.clone(),
        seed: scenario.seed,
        arm_seed: scenario.arm.seed,
        reference_c: scenario.arm.reference_c,
        parameters: (scenario.robot.chain().parameters().iter())
            .zip(scenario.robot.nominal().into_iter().zip(&arm.cold))
            .map(|(id, (nominal, &value))| TrueParameter { name: id.to_string(), nominal, value })
            .collect(),
        targets: (scenario.robot.targets.iter())
            .zip(&arm.targets)
            .map(|(target, &place)| TrueTarget { name: target.name.clone(), position: place.into() })
            .collect(),
        joint_sigma: arm.joint_sigma,
        sensors: spots
            .iter()
            .map(|spot| TrueSensor { name: spot.name.clone(), core_share: spot.core_share, bias_k: spot.bias_k })
            .collect(),
        visits: true_visits,
        cycles,
        effects: scenario.effects.clone(),
    };
    Ok(Simulated { run, robot: scenario.robot.clone(), truth })
}

/// Each cycle in a few numbers.
fn cycles(
    scenario: &Scenario,
    arm: &TrueArm,
    postures: &[Vec<f64>],
    warmth: &Warmth,
    run: &Run,
    adjustments: &[Adjustment],
) -> Vec<TrueCycle> {
    let nominal = scenario.robot.chain().prepare(&scenario.robot.nominal());
    // Targets without a nominal place are compared with where they truly sit.
    let expected: Vec<Vector3<f64>> = scenario
        .robot
        .targets
        .iter()
        .zip(&arm.targets)
        .map(|(target, place)| target.position.unwrap_or(*place))
        .collect();
    let mut cold: Vec<(u32, Vec<Vector3<f64>>)> = Vec::new();
    let mut cycles: Vec<(TrueCycle, usize, usize)> = Vec::new();
    for (visit, adjustment) in run.visits.iter().zip(adjustments) {
        let posture = &postures[visit.pose as usize];
        let joints: Vec<f64> = arm.joints(posture).iter().zip(&adjustment.joints).map(|(q, more)| q + more).collect();
        let nodes_c = warmth.nodes.at(visit.time_s);
        let flange = arm.flange(&joints, &nodes_c, adjustment);
        let places: Vec<Vector3<f64>> = arm.targets.iter().map(|place| flange.point(place)).collect();
        if !cold.iter().any(|(pose, _)| *pose == visit.pose) {
            cold.push((visit.pose, places.clone()));
        }
        if cycles.last().is_none_or(|(cycle, ..)| cycle.cycle != visit.cycle) {
            let air_c = scenario.heat.ambient.celsius(visit.time_s);
            let cycle = TrueCycle {
                cycle: visit.cycle,
                time_s: visit.time_s,
                nominal_error_m: 0.0,
                drift_m: 0.0,
                warmest_housing_c: f64::NEG_INFINITY,
                air_c,
            };
            cycles.push((cycle, 0, 0));
        }
        let Some((cycle, measured, displaced)) = cycles.last_mut() else { continue };
        for link in 0..scenario.heat.links.len() {
            cycle.warmest_housing_c = cycle.warmest_housing_c.max(nodes_c[node_place(link, Node::Housing)]);
        }
        let model = nominal.flange(&Posture::new(posture));
        for point in &visit.points {
            cycle.nominal_error_m += (point.position - model.point(&expected[point.target])).norm();
            *measured += 1;
        }
        if let Some((_, before)) = cold.iter().find(|(pose, _)| *pose == visit.pose) {
            for (now, before) in places.iter().zip(before) {
                cycle.drift_m += (now - before).norm();
                *displaced += 1;
            }
        }
    }
    cycles
        .into_iter()
        .map(|(mut cycle, measured, displaced)| {
            cycle.nominal_error_m /= measured.max(1) as f64;
            cycle.drift_m /= displaced.max(1) as f64;
            cycle
        })
        .collect()
}
