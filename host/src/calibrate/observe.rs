//! From a run folder to a campaign: which measured names are targets, which joints are believed, how warm each sensor was.

use nalgebra::{UnitQuaternion, Vector3};

use super::campaign::{Campaign, ObservedDistance, ObservedPosition, ObservedTurn, ObservedVisit};
use super::unknown::State;
use crate::input::InputError;
use crate::model::{Geometry, ReferenceTemperature};
use crate::robot::{Posture, Robot, Target};
use crate::run::{JoinOptions, Run, Visit};

/// Which joint positions of the run are believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum JointSource {
    /// `q1…qN`, as the controller logged them.
    #[default]
    Logged,
    /// `cmd1…cmdN`, as they were commanded.
    Commanded,
}

/// How a run is read into a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ObserveOptions {
    /// Which joints.
    pub joints: JointSource,
    /// Whether measured orientations are used (the instrument's `sigma_rad` must be stated).
    pub orientations: bool,
    /// How readings are joined to visits.
    pub join: JoinOptions,
}

/// A run as a campaign, with the state it starts from.
#[derive(Debug, Clone)]
pub struct Observed {
    /// The arm; where its description names no targets, those of the run.
    pub robot: Robot,
    /// The measurements.
    pub campaign: Campaign,
    /// Nominal geometry, no growth.
    pub nominal: State,
    /// Targets whose place is not known.
    pub unknown_targets: Vec<usize>,
    /// Anchors whose place is not known.
    pub unknown_anchors: Vec<usize>,
    /// The reference of each of the campaign's sensors.
    pub temperatures: Vec<ReferenceTemperature>,
    /// What was left out or filled in, in words.
    pub notes: Vec<String>,
}

/// Standard deviation of a coordinate where an instrument states none, metres: so that weights are finite.
const SMALLEST_SIGMA: f64 = 1e-9;

fn joints<'v>(run: &Run, visit: &'v Visit, source: JointSource) -> Result<&'v [f64], InputError> {
    match (source, &visit.commanded) {
        (JointSource::Logged, _) => Ok(&visit.joints),
        (JointSource::Commanded, Some(commanded)) => Ok(commanded),
        (JointSource::Commanded, None) => Err(InputError::at_line(
            &run.folder.join("poses.csv"),
            1,
            "commanded joints were asked for, expected columns cmd1 to cmdN",
        )),
    }
}

/// Mean of the values that are there.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut count, mut sum) = (0.0, 0.0);
    for value in values {
        count += 1.0;
        sum += value;
    }
    (count > 0.0).then(|| sum / count)
}

/// The rises of the robot's sensors at every visit, and their references.
struct Warmth {
    sensors: Vec<String>,
    references: Vec<ReferenceTemperature>,
    /// Visits by sensors.
    rises: Vec<Vec<Option<f64>>>,
    notes: Vec<String>,
}

fn warmth(robot: &Robot, run: &Run, options: &JoinOptions, references: Option<&[ReferenceTemperature]>) -> Warmth {
    let table = run.temperatures_at_visits(options);
    let mut warmth = Warmth { sensors: Vec::new(), references: Vec::new(), rises: Vec::new(), notes: table.notes() };
    let mut columns = Vec::new();
    for sensor in &robot.sensors {
        let Some(column) = table.sensors.iter().position(|name| *name == sensor.name) else {
            if run.temperatures.is_some() {
                warmth.notes.push(format!("temperatures.csv has no readings of sensor {}", sensor.name));
            }
            continue;
        };
        let at = |visit: usize| table.at_visit(visit)[column];
        let own = (0..run.visits.len()).filter(|&visit| run.visits[visit].cycle == run.description.reference_cycle);
        let reference = match references {
            Some(known) => known.iter().find(|known| known.sensor == sensor.name).map(|known| known.celsius),
            None => mean(own.filter_map(at)),
        };
        let Some(celsius) = reference else {
            if references.is_none() {
                let cycle = run.description.reference_cycle;
                warmth.notes.push(format!("sensor {} has no temperature in the reference cycle {cycle}", sensor.name));
            }
            continue;
        };
        let all = (0..run.visits.len()).filter_map(at);
        let (lowest, highest) =
            all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
        warmth.sensors.push(sensor.name.clone());
        warmth.references.push(ReferenceTemperature { sensor: sensor.name.clone(), celsius, lowest, highest });
        columns.push((column, celsius));
    }
    warmth.rises = (0..run.visits.len())
        .map(|visit| columns.iter().map(|&(column, zero)| table.at_visit(visit)[column].map(|t| t - zero)).collect())
        .collect();
    warmth
}

/// Fills a missing rise by the mean of the other sensors of its link; counts what was filled. A visit where a whole link is
/// silent has no rises.
fn fill(robot: &Robot, sensors: &[String], rises: &[Option<f64>], filled: &mut usize) -> Option<Vec<f64>> {
    let link = |sensor: usize| robot.sensor(&sensors[sensor]).map(|place| robot.sensors[place].link);
    (0..sensors.len())
        .map(|sensor| {
            rises[sensor].or_else(|| {
                *filled += 1;
                mean((0..sensors.len()).filter(|&other| link(other) == link(sensor)).filter_map(|other| rises[other]))
            })
        })
        .collect()
}

/// Reads a run as measurements of an arm. `references` gives the temperatures from which rises count; without it they are
/// those of the run's reference cycle.
///
/// # Errors
/// A joint count that is not the arm's, a measured name that the arm does not know, joints or orientations that the run
/// does not have, a run without any usable measurement.
pub fn observe(
    robot: &Robot,
    run: &Run,
    options: &ObserveOptions,
    references: Option<&[ReferenceTemperature]>,
) -> Result<Observed, InputError> {
    run.check_joint_count(robot.joint_count())?;
    let mut robot = robot.clone();
    let mut notes = Vec::new();
    let points_file = run.folder.join("points.csv");
    if robot.targets.is_empty() {
        let monuments = robot.monuments.clone();
        let names = run.target_names.iter().filter(|name| !monuments.contains(name));
        robot.targets = names.map(|name| Target { name: name.clone(), position: None }).collect();
        notes.push(
            "the robot's description names no target: every measured name is taken as one of unknown place".into(),
        );
    }
    let targets: Vec<Option<usize>> = run.target_names.iter().map(|name| robot.target(name)).collect();
    for (name, target) in run.target_names.iter().zip(&targets) {
        if target.is_none() && !robot.monuments.contains(name) {
            let message = format!("'{name}' is neither a [[target]] nor a [[monument]] of {}", robot.name);
            return Err(InputError::of_file(&points_file, message));
        }
    }
    let instrument = &run.description.instrument;
    if options.orientations && instrument.sigma_rad.is_none() {
        let message = "orientations were asked for, expected sigma_rad in [instrument]: one sigma of an orientation";
        return Err(InputError::of_file(&run.folder.join("run.toml"), message));
    }
    let warmth = warmth(&robot, run, &options.join, references);
    notes.extend(warmth.notes);
    let station = Vector3::from(instrument.position);
    let (mut filled, mut silent, mut empty) = (0, 0, 0);
    let mut visits = Vec::with_capacity(run.visits.len());
    for (place, visit) in run.visits.iter().enumerate() {
        let seen: Vec<(usize, &crate::run::Point)> =
            visit.points.iter().filter_map(|point| targets[point.target].map(|target| (target, point))).collect();
        let distances: Vec<ObservedDistance> = visit
            .distances
            .iter()
            .filter_map(|distance| {
                targets[distance.target].map(|target| ObservedDistance {
                    target,
                    anchor: distance.anchor,
                    distance: distance.distance_m,
                    sigma: run.description.anchors[distance.anchor].sigma_m.max(SMALLEST_SIGMA),
                })
            })
            .collect();
        if seen.is_empty() && distances.is_empty() {
            empty += 1;
            continue;
        }
        let Some(rises) = fill(&robot, &warmth.sensors, &warmth.rises[place], &mut filled) else {
            silent += 1;
            continue;
        };
        let away = mean(seen.iter().map(|(_, point)| (point.position - station).norm())).unwrap_or(0.0);
        // The spread of samples shows an arm that had not come to rest; that an instrument errs alike in all of them it hides.
        let own_noise = mean(seen.iter().filter_map(|(_, point)| point.sigma_m.map(|sigma| sigma * sigma)));
        let own_noise = own_noise.map_or(0.0, f64::sqrt);
        let turns = seen.iter().filter(|_| options.orientations).filter_map(|&(target, point)| {
            let at: UnitQuaternion<f64> = point.orientation?;
            Some(ObservedTurn { target, at })
        });
        visits.push(ObservedVisit {
            place,
            cycle: visit.cycle,
            pose: visit.pose,
            posture: Posture::new(joints(run, visit, options.joints)?),
            rises,
            turns: turns.collect(),
            positions: seen.iter().map(|&(target, point)| ObservedPosition { target, at: point.position }).collect(),
            sigma: (instrument.sigma_m + instrument.sigma_per_m * away).max(own_noise).max(SMALLEST_SIGMA),
            turn_sigma: instrument.sigma_rad.unwrap_or(1.0).max(SMALLEST_SIGMA),
            distances,
        });
    }
    if empty > 0 {
        notes.push(format!("{empty} visits without any measurement of a target are left out"));
    }
    if filled > 0 {
        notes.push(format!("{filled} missing temperatures are filled by the mean of their link's other sensors"));
    }
    if silent > 0 {
        notes.push(format!("{silent} visits at which all sensors of a link are silent are left out"));
    }
    if visits.is_empty() {
        return Err(InputError::of_file(&points_file, "no visit has a measured target, expected at least one"));
    }
    let campaign = Campaign {
        chain: robot.chain(),
        targets: robot.targets.iter().map(|target| target.name.clone()).collect(),
        anchors: run.description.anchors.iter().map(|anchor| anchor.name.clone()).collect(),
        sensors: warmth.sensors,
        growth: Vec::new(),
        visits,
    };
    let mut geometry = Geometry::nominal(&robot);
    geometry.anchors =
        run.description.anchors.iter().map(|anchor| anchor.position.map(Vector3::from).unwrap_or_default()).collect();
    let seen = campaign.seen_targets();
    Ok(Observed {
        unknown_targets: (0..robot.targets.len())
            .filter(|&target| seen[target] && robot.targets[target].position.is_none())
            .collect(),
        unknown_anchors: (0..run.description.anchors.len())
            .filter(|&anchor| run.description.anchors[anchor].position.is_none())
            .collect(),
        robot,
        campaign,
        nominal: State { geometry, growth: Vec::new() },
        temperatures: warmth.references,
        notes,
    })
}
