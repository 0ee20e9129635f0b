//! A model tried on a run: errors of position of each level, overall, by cycle and by pose.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::align::{align, base_unknowns, target_unknowns};
use super::campaign::{Campaign, ObservedVisit};
use super::folded::folded;
use super::identify::{Manner, identify};
use super::observe::{ObserveOptions, Observed, observe};
use super::problem::Problem;
use super::unknown::{GrowthTerm, State};
use crate::effect::{Scene, adjustments};
use crate::input::InputError;
use crate::model::{ErrorTally, Errors, Level, Model};
use crate::robot::Robot;
use crate::run::Run;

/// What is found anew on the other run before the model is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Refit {
    /// The base: the instrument has moved, or the arm.
    pub base: bool,
    /// The targets: another tool.
    pub targets: bool,
}

/// The levels that a model has, in the order of results.
pub const LEVELS: [Level; 4] = [Level::Nominal, Level::Geometric, Level::Thermal, Level::Extended];

/// Errors of the levels over one cycle or one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Group {
    /// The cycle's or the pose's number.
    pub number: u32,
    /// When its first visit took place, seconds.
    pub time_s: f64,
    /// Mean temperature of the model's sensors, degrees Celsius; of the air where the model has none.
    pub temperature: Option<f64>,
    /// Errors in the order of [`LEVELS`].
    pub errors: [Errors; 4],
}

/// A model judged on a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Validation {
    /// Visits judged.
    pub visits: usize,
    /// Points judged.
    pub points: usize,
    /// Errors over the whole run in the order of [`LEVELS`]; the extended level is the thermal one where the model carries
    /// no effects.
    pub errors: [Errors; 4],
    /// Whether the model carries effects, so that the extended level is worth reporting.
    pub has_effects: bool,
    /// By cycle.
    pub cycles: Vec<Group>,
    /// By pose.
    pub poses: Vec<Group>,
    /// What was left out, filled in or found anew, in words.
    pub notes: Vec<String>,
}

/// A model set up on the visits of a run: for each level, the measurements with the growth and the effects that it knows.
#[derive(Debug, Clone)]
pub struct Trial {
    /// The measurements.
    pub campaign: Campaign,
    /// Whether the model carries effects, so that there is an extended level.
    pub has_effects: bool,
    /// What was left out, filled in or found anew, in words.
    pub notes: Vec<String>,
    levels: Vec<(Campaign, State)>,
    options: ObserveOptions,
}

impl Trial {
    /// Sets a model up on the visits of a run that `pick` chooses.
    ///
    /// # Errors
    /// A run that does not fit the model's arm, or none of whose visits is chosen.
    pub fn new(
        model: &Model,
        run: &Run,
        run_robot: &Robot,
        options: &ObserveOptions,
        refit: Refit,
        pick: impl Fn(&ObservedVisit) -> bool,
    ) -> Result<Trial, InputError> {
        let mut robot = model.robot.clone();
        robot.monuments = run_robot.monuments.clone();
        if refit.targets {
            // Another tool has other targets; the model's own do not matter then.
            robot.targets = run_robot
                .targets
                .iter()
                .cloned()
                .map(|target| crate::robot::Target { position: None, ..target })
                .collect();
        }
        let observed = observe(&robot, run, options, Some(&model.temperatures))?;
        let campaign = observed.campaign.select(pick);
        if campaign.visits.is_empty() {
            let message = "no visit is left to validate with: the choice of poses leaves none";
            return Err(InputError::of_file(&run.folder.join("poses.csv"), message));
        }
        let mut notes = observed.notes.clone();
        let has_effects = model.extended.is_some();
        let mut levels = Vec::new();
        for level in LEVELS {
            if level == Level::Extended && !has_effects {
                break;
            }
            let mut own = campaign.clone();
            let mut coefficients = grown(model, level, &mut own, &mut notes);
            let mut geometry = model.geometry(level).clone();
            if refit.targets {
                geometry.targets = observed.nominal.geometry.targets.clone();
                geometry.turns = observed.nominal.geometry.turns.clone();
            }
            if level == Level::Extended {
                let scene = scene_of(model, run, &observed, &own, &coefficients);
                let applied = model.effects_in(&scene, &own.targets);
                notes.extend(applied.notes);
                let adjustments = adjustments(&scene, &applied.instances, &geometry.targets);
                let (with_effects, ones) = folded(&own, &adjustments, &scene.station);
                own = with_effects;
                coefficients.extend(ones);
            }
            let state = refitted(&robot, &own, State { geometry, growth: coefficients }, refit);
            levels.push((own, state));
        }
        if refit.base || refit.targets {
            let what = match (refit.base, refit.targets) {
                (true, true) => "base and targets were",
                (true, false) => "the base was",
                _ => "the targets were",
            };
            notes.push(format!("{what} found anew on this run, for each level of the model alone"));
        }
        Ok(Trial { campaign, has_effects, notes, levels, options: *options })
    }

    /// Gives every error of position, measured less predicted, metres: the level's place in [`LEVELS`], the visit, the
    /// target. The levels come one after the other, each with the same points in the same order; the extended level comes
    /// only where the model carries effects.
    pub fn errors(&self, mut each: impl FnMut(usize, &ObservedVisit, usize, Vector3<f64>)) {
        for (place, (campaign, state)) in self.levels.iter().enumerate() {
            Problem::new(campaign, Vec::new(), state)
                .distances(state, |visit, target, error| each(place, visit, target, error));
        }
    }

    /// The errors summed up, overall, by cycle and by pose.
    pub fn validation(&self, model: &Model, run: &Run) -> Validation {
        let mut overall = [ErrorTally::default(); 4];
        let mut by_cycle: BTreeMap<u32, (f64, [ErrorTally; 4])> = BTreeMap::new();
        let mut by_pose: BTreeMap<u32, (f64, [ErrorTally; 4])> = BTreeMap::new();
        let last = self.levels.len() - 1;
        self.errors(|level, visit, _, error| {
            let distance = error.norm();
            let time = run.visits[visit.place].time_s;
            let cycle = &mut by_cycle.entry(visit.cycle).or_insert((time, Default::default())).1;
            let pose = &mut by_pose.entry(visit.pose).or_insert((time, Default::default())).1;
            // Levels that the model does not have are as the last that it has.
            for place in level..if level == last { LEVELS.len() } else { level + 1 } {
                overall[place].add(distance);
                cycle[place].add(distance);
                pose[place].add(distance);
            }
        });
        let warm =
            |group: &dyn Fn(&ObservedVisit) -> bool| mean_temperature(model, run, &self.options, &self.campaign, group);
        let groups = |sums: BTreeMap<u32, (f64, [ErrorTally; 4])>, cycles: bool| {
            sums.into_iter()
                .map(|(number, (time_s, tallies))| Group {
                    number,
                    time_s,
                    temperature: warm(&|visit| if cycles { visit.cycle == number } else { visit.pose == number }),
                    errors: tallies.map(|tally| tally.errors()),
                })
                .collect()
        };
        Validation {
            visits: self.campaign.visits.len(),
            points: overall[0].count(),
            errors: overall.map(|tally| tally.errors()),
            has_effects: self.has_effects,
            cycles: groups(by_cycle, true),
            poses: groups(by_pose, false),
            notes: self.notes.clone(),
        }
    }
}

/// Tries a model on the visits of a run that `pick` chooses.
///
/// # Errors
/// A run that does not fit the model's arm, or none of whose visits is chosen.
pub fn validate(
    model: &Model,
    run: &Run,
    run_robot: &Robot,
    options: &ObserveOptions,
    refit: Refit,
    pick: impl Fn(&ObservedVisit) -> bool,
) -> Result<Validation, InputError> {
    Ok(Trial::new(model, run, run_robot, options, refit, pick)?.validation(model, run))
}

/// Gives a campaign the growth of a level of a model as far as the run has its sensors, and returns the coefficients.
fn grown(model: &Model, level: Level, campaign: &mut Campaign, notes: &mut Vec<String>) -> Vec<f64> {
    let mut coefficients = Vec::new();
    for (parameter, sensor, coefficient) in model.growth_at(level) {
        let places = (campaign.chain.place(parameter), campaign.sensors.iter().position(|name| name == sensor));
        if let (Some(parameter), Some(sensor)) = places {
            campaign.growth.push(GrowthTerm { parameter, sensor });
            coefficients.push(coefficient);
        } else if level == Level::Thermal {
            notes.push(format!("{parameter} cannot follow {sensor}: the run has no such readings"));
        }
    }
    coefficients
}

/// Gives a campaign the growth of a level of a model; its coefficients, and the run as the model's effects see it.
pub(crate) fn growth_and_scene(
    model: &Model,
    run: &Run,
    observed: &Observed,
    campaign: &mut Campaign,
    level: Level,
    notes: &mut Vec<String>,
) -> (Vec<f64>, Scene) {
    let coefficients = grown(model, level, campaign, notes);
    let scene = scene_of(model, run, observed, campaign, &coefficients);
    (coefficients, scene)
}

/// The run as the model's effects see it, with the thermal model fitted together with them.
fn scene_of(model: &Model, run: &Run, observed: &Observed, campaign: &Campaign, coefficients: &[f64]) -> Scene {
    // Torques follow from the geometry that discovery took them from.
    let mut scene = Scene::new(
        &observed.robot,
        run,
        campaign.seen(),
        &model.reference.parameters,
        &observed.temperatures,
        observed.nominal.geometry.targets.clone(),
        &observed.unknown_targets,
    );
    scene.air_reference_c = model.extended.as_ref().and_then(|extended| extended.air_reference_c);
    scene.growth = campaign.growing(coefficients);
    scene
}

/// A state with base or targets found anew.
fn refitted(robot: &Robot, campaign: &Campaign, start: State, refit: Refit) -> State {
    let seen = campaign.seen_targets();
    let targets: Vec<usize> =
        if refit.targets { (0..seen.len()).filter(|&target| seen[target]).collect() } else { Vec::new() };
    let mut unknowns = target_unknowns(&targets);
    if refit.base {
        unknowns.extend(base_unknowns(campaign));
    }
    if unknowns.is_empty() {
        return start;
    }
    let start = match refit.base {
        true => align(robot, campaign, &start, &targets).unwrap_or(start),
        false => start,
    };
    identify(campaign, unknowns, start, &Manner::default()).solution.state
}

/// Mean over the visits of a group of the model's sensors' mean; of the run's ambient sensor where there is none.
fn mean_temperature(
    model: &Model,
    run: &Run,
    options: &ObserveOptions,
    campaign: &Campaign,
    group: &dyn Fn(&ObservedVisit) -> bool,
) -> Option<f64> {
    let visits: Vec<&ObservedVisit> = campaign.visits.iter().filter(|visit| group(visit)).collect();
    let mean = |values: Vec<f64>| {
        let count = values.len() as f64;
        (count > 0.0).then(|| values.iter().sum::<f64>() / count)
    };
    let of_sensors = visits.iter().flat_map(|visit| {
        campaign.sensors.iter().zip(&visit.rises).filter_map(|(name, rise)| {
            let reference = model.temperatures.iter().find(|reference| reference.sensor == *name)?;
            Some(reference.celsius + rise)
        })
    });
    mean(of_sensors.collect()).or_else(|| {
        let log = run.temperatures.as_ref()?;
        let sensor = log.index_of(run.description.ambient.as_deref()?)?;
        let series = &log.series[sensor];
        let gap = series.max_gap_s(&options.join);
        mean(visits.iter().filter_map(|visit| series.at(run.visits[visit.place].time_s, gap).celsius()).collect())
    })
}
