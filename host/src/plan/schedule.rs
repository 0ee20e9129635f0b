//! When to warm an arm up and cool it down, and how to warm it one joint at a time: schedules tried on the twin before hours
//! are spent on them.
//!
//! A schedule is good where it tells the thermal coefficients apart: links must warm, and not all together. A scenario says
//! what is believed of the arm's heat; its run is simulated, and the derivatives of a calibration at it give the information
//! about growth with all of geometry unknown too. The index is the determinant of that information.
//!
//! Links that warm together cannot be told apart by any number of poses: the share of a link's rise that no combination of
//! the others' has says how far they are apart. When all joints move this share is small; when one joint moves at a time
//! (thesis, section 7.2) each link has a rise of its own.

use nalgebra::DMatrix;

use crate::calibrate::{
    GrowthTerm, ObserveOptions, OrthogonalFactor, Problem, State, Unknown, geometric_unknowns, identifiable, observe,
};
use crate::input::InputError;
use crate::simulate::{DrivePhase, Postures, Scenario, SimulationError, simulate};

/// Why there is no schedule.
#[derive(Debug, thiserror::Error)]
pub enum ScheduleError {
    /// The scenario cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// Its run cannot be used.
    #[error(transparent)]
    Run(#[from] InputError),
    /// Nothing follows a sensor.
    #[error("{0}: no parameter grows with a link that has a sensor; expected [[growth]] and the robot's [[sensor]]")]
    NoGrowth(String),
    /// Too little time.
    #[error("{hours} h are {cycles} cycles of {cycle_s:.0} s; expected {least} cycles or more")]
    TooShort {
        /// The time that is given.
        hours: f64,
        /// The cycles that fit.
        cycles: u32,
        /// The time of a cycle.
        cycle_s: f64,
        /// The fewest that make a schedule.
        least: u32,
    },
    /// Overrides that make no schedule.
    #[error("expected two different overrides or more, from 0 to 1")]
    NoOverrides,
}

/// What a schedule tells of growth.
#[derive(Debug, Clone, PartialEq)]
pub struct TriedSchedule {
    /// The schedule.
    pub phases: Vec<DrivePhase>,
    /// Name and standard deviation of each thermal coefficient, m/K or rad/K; infinite where it cannot be told.
    pub coefficients: Vec<(String, f64)>,
    /// The determinant's root: the geometric mean of what the coefficients are told by, 1/(m/K) or 1/(rad/K).
    pub index: f64,
    /// Each link with sensors: its number, how much its rise varies (standard deviation over the visits, K), and the share
    /// of that which no combination of the other links' rises has, from 0 to 1.
    pub links: Vec<(usize, f64, f64)>,
    /// How long it takes, s.
    pub duration_s: f64,
}

/// A rise that varies less than this, K, is noise of readings.
const LEAST_RISE: f64 = 0.05;

/// The terms by which a calibration would describe the growth of a scenario: those of robot.toml where it has them, else
/// each growing parameter with the first sensor of each link that it is said to follow.
fn growth_terms(scenario: &Scenario, sensors: &[String]) -> Vec<GrowthTerm> {
    let robot = &scenario.robot;
    let chain = robot.chain();
    let place = |name: &str| sensors.iter().position(|own| own == name);
    let mut terms: Vec<GrowthTerm> = Vec::new();
    let mut add = |parameter: Option<usize>, sensor: Option<usize>| {
        if let (Some(parameter), Some(sensor)) = (parameter, sensor) {
            let term = GrowthTerm { parameter, sensor };
            if !terms.contains(&term) {
                terms.push(term);
            }
        }
    };
    for choice in &robot.thermal {
        choice.sensors.iter().for_each(|name| add(chain.place(choice.parameter), place(name)));
    }
    if robot.thermal.is_empty() {
        for growth in &scenario.growth {
            for term in &growth.terms {
                let first =
                    robot.sensors.iter().find(|sensor| sensor.link == term.link && place(&sensor.name).is_some());
                add(chain.place(growth.parameter.0), first.and_then(|sensor| place(&sensor.name)));
            }
        }
    }
    terms
}

/// What the schedule of a scenario tells of growth.
///
/// # Errors
/// A scenario that cannot be simulated, or in which nothing grows.
pub fn tell_apart(scenario: &Scenario) -> Result<TriedSchedule, ScheduleError> {
    let simulated = simulate(scenario)?;
    let observed = observe(&simulated.robot, &simulated.run, &ObserveOptions::default(), None)?;
    let mut campaign = observed.campaign;
    campaign.growth = growth_terms(scenario, &campaign.sensors);
    if campaign.growth.is_empty() {
        return Err(ScheduleError::NoGrowth(scenario.name.clone()));
    }
    let count = campaign.growth.len();
    let state = State { growth: vec![0.0; count], ..observed.nominal };
    let mut unknowns = geometric_unknowns(&campaign, &observed.unknown_targets, &[], &[]);
    unknowns.extend((0..count).map(Unknown::Growth));
    let (kept, _) = identifiable(&campaign, unknowns, &state);
    let problem = Problem::new(&campaign, kept, &state);
    let mut factor = OrthogonalFactor::new(problem.unknowns().len());
    problem.linearise(&state, &mut problem.scratch(), &mut factor);
    let sigmas = factor.inverse_row_norms();
    let names = campaign.names();
    let mut logarithm = 0.0;
    let mut coefficients = Vec::with_capacity(count);
    for term in 0..count {
        let unknown = Unknown::Growth(term);
        // Growth comes last in the order of unknowns: its part of the triangle has geometry eliminated.
        let column = problem.unknowns().iter().position(|&own| own == unknown);
        logarithm += column.map_or(f64::NEG_INFINITY, |column| factor.entry(column, column).abs().ln());
        coefficients.push((names.name(unknown), column.map_or(f64::INFINITY, |column| sigmas[column])));
    }
    let rises: Vec<&[f64]> = campaign.visits.iter().map(|visit| visit.rises.as_slice()).collect();
    Ok(TriedSchedule {
        phases: scenario.schedule.phases.clone(),
        coefficients,
        index: (logarithm / count as f64).exp(),
        links: links(scenario, &campaign.sensors, &rises),
        duration_s: simulated.run.motion.last().map_or(0.0, |step| step.end_s),
    })
}

/// How much the links' rises vary, and how much of that each has to itself.
fn links(scenario: &Scenario, sensors: &[String], rises: &[&[f64]]) -> Vec<(usize, f64, f64)> {
    let link_of = |name: &String| scenario.robot.sensor(name).map(|place| scenario.robot.sensors[place].link);
    let mut numbers: Vec<usize> = sensors.iter().filter_map(link_of).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let mean_rise = |link: usize, visit: &[f64]| {
        let own = sensors.iter().zip(visit).filter(|(name, _)| link_of(name) == Some(link)).map(|(_, rise)| *rise);
        let (count, sum) = own.fold((0.0, 0.0), |(count, sum), rise| (count + 1.0, sum + rise));
        sum / count
    };
    let visits = rises.len() as f64;
    let mut columns: Vec<(usize, f64, Vec<f64>)> = Vec::new();
    for link in numbers {
        let mut own: Vec<f64> = rises.iter().map(|visit| mean_rise(link, visit)).collect();
        let mean = own.iter().sum::<f64>() / visits;
        own.iter_mut().for_each(|rise| *rise -= mean);
        let deviation = (own.iter().map(|rise| rise * rise).sum::<f64>() / visits).sqrt();
        if deviation > LEAST_RISE {
            own.iter_mut().for_each(|rise| *rise /= deviation * visits.sqrt());
            columns.push((link, deviation, own));
        }
    }
    let matrix = DMatrix::from_fn(rises.len(), columns.len(), |row, column| columns[column].2[row]);
    // The diagonal of the inverse of the correlations is one over the share that a column has to itself.
    let inverse = matrix.tr_mul(&matrix).cholesky().map(|cholesky| cholesky.inverse());
    let share = |column: usize| inverse.as_ref().map_or(0.0, |inverse| 1.0 / inverse[(column, column)]);
    columns.iter().enumerate().map(|(column, (link, deviation, _))| (*link, *deviation, share(column))).collect()
}

/// The scenario with other postures where they are given, and with cycles long enough that at most half of each is measured.
pub fn prepared(base: &Scenario, postures: Option<&[Vec<f64>]>) -> Scenario {
    let mut scenario = base.clone();
    if let Some(postures) = postures {
        scenario.postures = Postures { joints: Some(postures.to_vec()), file: None, drawn: None };
    }
    let count = match (&scenario.postures.joints, &scenario.postures.drawn) {
        (Some(given), _) => given.len(),
        (None, Some(drawn)) => drawn.count,
        (None, None) => 0,
    };
    let schedule = &mut scenario.schedule;
    let measured = schedule.longest_measurement_s(count, scenario.robot.targets.len()) + schedule.pause_s;
    schedule.cycle_s = schedule.cycle_s.map(|length| length.max((2.0 * measured).ceil()));
    scenario
}

/// How many cycles a time has room for.
fn cycles_in(scenario: &Scenario, hours: f64, least: u32) -> Result<u32, ScheduleError> {
    let schedule = &scenario.schedule;
    let cycle_s = 0.5 * (schedule.cycle_s[0] + schedule.cycle_s[1]);
    // Cycle 0 is measured without movement before it: about half a cycle.
    let room = (hours * 3600.0 - 2.0 * schedule.rest_s) / cycle_s - 0.5;
    let cycles = room.floor().clamp(0.0, 10_000.0) as u32;
    if cycles < least { Err(ScheduleError::TooShort { hours, cycles, cycle_s, least }) } else { Ok(cycles) }
}

fn driven(speed_override: f64, cycles: u32) -> DrivePhase {
    DrivePhase { speed_override, cycles, joints: None }
}

/// The split of a time into warm-up at one override and cool-down at a lower one that tells growth apart best: the schedules
/// that were tried, best first. `progress` is told how many there are and after each.
///
/// # Errors
/// Too little time or too few overrides, or a scenario that cannot be simulated.
pub fn schedule_of(
    scenario: &Scenario,
    hours: f64,
    overrides: &[f64],
    mut progress: impl FnMut(usize),
) -> Result<Vec<TriedSchedule>, ScheduleError> {
    const LEAST: u32 = 4;
    let cycles = cycles_in(scenario, hours, LEAST)?;
    let mut pairs: Vec<(f64, f64)> = Vec::new();
    for &warm in overrides {
        pairs.extend(overrides.iter().filter(|&&cool| cool < warm).map(|&cool| (warm, cool)));
    }
    if pairs.is_empty() {
        return Err(ScheduleError::NoOverrides);
    }
    let mut tried: Vec<TriedSchedule> = Vec::new();
    let mut attempt = |warm: f64, cool: f64, first: u32, tried: &mut Vec<TriedSchedule>| {
        let mut other = scenario.clone();
        other.schedule.phases = vec![driven(warm, first), driven(cool, cycles - first)];
        tried.push(tell_apart(&other)?);
        progress(tried.len());
        Ok::<_, ScheduleError>(())
    };
    let coarse = |share: f64| ((f64::from(cycles) * share).round() as u32).clamp(1, cycles - 1);
    for (warm, cool) in pairs {
        for share in [0.3, 0.45, 0.6, 0.75] {
            attempt(warm, cool, coarse(share), &mut tried)?;
        }
    }
    let order = |one: &TriedSchedule, other: &TriedSchedule| other.index.total_cmp(&one.index);
    tried.sort_by(order);
    // Around the best of these, cycle by cycle.
    let [best, end] = [0, 1].map(|place| tried[0].phases[place].clone());
    let step = (cycles / 10).max(1);
    for first in best.cycles.saturating_sub(step).max(1)..=(best.cycles + step).min(cycles - 1) {
        if first != best.cycles {
            attempt(best.speed_override, end.speed_override, first, &mut tried)?;
        }
    }
    tried.sort_by(order);
    tried.dedup_by(|one, other| one.phases == other.phases);
    Ok(tried)
}

/// Probes of single joints in a time: each joint warms alone at an override, then everything rests. Joints far from each other
/// follow each other, so that one's links cool while the other's warm. Beside it the same cycles with all joints at once, all
/// warm-ups before all rests.
///
/// # Errors
/// Too little time.
pub fn probes(
    scenario: &Scenario,
    hours: f64,
    speed_override: f64,
) -> Result<(Vec<DrivePhase>, Vec<DrivePhase>), ScheduleError> {
    let joints = scenario.robot.joint_count();
    let cycles = cycles_in(scenario, hours, 2 * joints as u32)?;
    let each = cycles / joints as u32;
    let warm = (3 * each).div_ceil(5).clamp(1, each - 1);
    let half = joints.div_ceil(2);
    let order = (0..half).flat_map(|place| [place, place + half]).filter(|&joint| joint < joints);
    let alone = order.flat_map(|joint| {
        [DrivePhase { speed_override, cycles: warm, joints: Some(vec![joint + 1]) }, driven(0.0, each - warm)]
    });
    let together = vec![driven(speed_override, warm * joints as u32), driven(0.0, (each - warm) * joints as u32)];
    Ok((alone.collect(), together))
}
