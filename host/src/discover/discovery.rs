//! A whole discovery: gross errors put right, the baseline, the search, what is left, and what the extension gains.

use super::candidates::{Score, candidates, is_pattern};
use super::chance::ln_chi_square;
use super::estimate::{Estimate, estimates};
use super::fit::{Fit, positional, update_growth};
use super::gain::{Question, folds};
use super::gross::{Outlier, Swap, plainly_wrong, put_labels_right, without};
use super::normal::{Rows, Strata, System};
use super::readings::{ReadingFault, examine};
use super::search::{Search, search};
use super::separate::{Doubt, separated_by};
use super::stage::{Point, Stage, errors};
use crate::calibrate::{Calibration, CalibrationError, Campaign, Request, calibrate, start};
use crate::effect::pattern;
use crate::effect::{Instance, Scene, SiteNames};
use crate::model::{ErrorTally, Errors};
use crate::robot::Robot;
use crate::run::Run;

/// What a discovery is asked to do.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DiscoveryRequest {
    /// How the baseline is calibrated.
    pub calibration: Request,
    /// Seed of the draws that calibrate the search.
    pub seed: u64,
    /// Whether gains are measured on held-out data.
    pub hold_out: bool,
}

/// Errors at one level, fitted and held out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// On the data it was fitted to.
    pub fitted: Errors,
    /// On whole cycles and poses that were held out; none where there are too few.
    pub held_out: Option<Errors>,
}

/// What a finding gains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain {
    /// Held-out RMS without it, with those found before it, mm.
    pub before_mm: f64,
    /// Held-out RMS with it, mm.
    pub after_mm: f64,
}

/// A candidate that explains the same as well.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// The effect's name.
    pub effect: &'static str,
    /// Where.
    pub place: SiteNames,
    /// Log evidence relative to the finding: negative is less.
    pub log_evidence: f64,
}

/// A named cause.
#[derive(Debug, Clone)]
pub struct Finding {
    /// The effect's name.
    pub effect: &'static str,
    /// Where.
    pub place: SiteNames,
    /// Logarithm of the chance that the whole search would find as much in noise.
    pub ln_p: f64,
    /// Its numbers.
    pub parameters: Vec<Estimate>,
    /// What the data cannot tell from it.
    pub alternatives: Vec<Alternative>,
    /// What it moves the targets by, RMS, mm.
    pub cost_rms_mm: f64,
    /// What it gains on held-out data.
    pub gain: Option<Gain>,
    /// The cycles that it concerns, for exchanged labels.
    pub cycles: Vec<u32>,
    /// The points that it concerns, for gross errors.
    pub points: Vec<Outlier>,
    /// As the model has it; none for gross errors.
    pub instance: Option<Instance>,
    /// What speaks for it, in a sentence, where it was not found in positions.
    pub evidence: Option<String>,
    /// What would tell it from its nearest alternative, in words; none where there is no alternative.
    pub separate_by: Option<String>,
}

/// A part of what has no name.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// The covariates that it follows.
    pub follows: Vec<String>,
    /// Its share of the square of the baseline's errors, 0 to 1.
    pub share: f64,
    /// What it moves the targets by beyond what calibration absorbs, RMS, mm.
    pub rms_mm: f64,
}

/// How much an effect would explain of what the baseline leaves: how far residuals are from noise along what it follows.
#[derive(Debug, Clone, PartialEq)]
pub struct Test {
    /// The effect.
    pub effect: &'static str,
    /// Its best place.
    pub place: SiteNames,
    /// Logarithm of the chance of it in noise, over all its places and shapes and all effects.
    pub ln_p: f64,
    /// Twice the log likelihood that it gains.
    pub ratio: f64,
    /// The share of it that calibration does not absorb.
    pub visible: f64,
}

/// What is significant and has no name.
#[derive(Debug, Clone, PartialEq)]
pub struct Unexplained {
    /// Whether there is any.
    pub significant: bool,
    /// Logarithm of the chance of it in noise.
    pub ln_p: f64,
    /// Its parts by the covariates that they follow.
    pub parts: Vec<Part>,
    /// What all of it moves the targets by, RMS, mm.
    pub rms_mm: f64,
}

impl Unexplained {
    /// The covariates that it follows, in words.
    pub fn follows(&self) -> Vec<&str> {
        self.parts.iter().flat_map(|part| &part.follows).map(String::as_str).collect()
    }
}

/// What was discovered.
pub struct Discovery {
    /// The baseline calibration, of the run with gross errors put right.
    pub calibration: Calibration,
    /// The run as effects see it.
    pub scene: Scene,
    /// The measurements that were used.
    pub campaign: Campaign,
    /// The search.
    pub search: Search,
    /// What was named.
    pub findings: Vec<Finding>,
    /// Each effect's test against what the baseline leaves, the least likely to be noise first.
    pub tests: Vec<Test>,
    /// Geometry and growth.
    pub baseline: Level,
    /// With all that was found.
    pub extended: Level,
    /// What is left.
    pub unexplained: Unexplained,
    /// The strata of noise.
    pub noise: Strata,
    /// Noise of one coordinate of a point, micrometres.
    pub noise_um: f64,
    /// RMS distance that noise alone makes, mm.
    pub floor_rms_mm: f64,
    /// Remarks in words.
    pub notes: Vec<String>,
}

/// Why a discovery cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum DiscoveryError {
    /// The baseline cannot be calibrated.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The data leave no freedom to judge anything.
    #[error("the run is too small to judge residuals: geometry takes all its freedom")]
    TooSmall,
}

/// Rounds of setting plainly wrong points aside.
const ROUNDS: usize = 4;

/// How often the search is made again with other points set aside.
const AGAIN: usize = 2;

/// Rivals within this of a finding, in log evidence, are alternatives.
const CLOSE: f64 = 3.0;

/// At most so many are told.
const TOLD: usize = 3;

/// Errors that postures or cycles share are noise like that of visits as long as they are smaller than this share of it.
const LEAST_SHARED: f64 = 0.5;

/// The chance of calling noise unexplained.
const FALSE_REST: f64 = 0.003;

/// Examines a run.
///
/// # Errors
/// What calibration refuses, and runs too small to judge.
pub fn discover(robot: &Robot, run: &Run, request: &DiscoveryRequest) -> Result<Discovery, DiscoveryError> {
    discover_in_steps(robot, run, request, &|| ())
}

/// Steps of a discovery, more where points come back that were set aside.
pub const STEPS: u64 = 5;

/// Examines a run. `done` is called after every one of its [`STEPS`].
///
/// # Errors
/// What calibration refuses, and runs too small to judge.
pub fn discover_in_steps(
    robot: &Robot,
    run: &Run,
    request: &DiscoveryRequest,
    done: &(dyn Fn() + Sync),
) -> Result<Discovery, DiscoveryError> {
    let (mut labelled, swaps) = put_labels_right(robot, run, &request.calibration).map_err(CalibrationError::from)?;
    let examined = examine(robot, &labelled);
    if let Some(log) = examined.corrected {
        labelled.temperatures = Some(log);
    }
    let mut set_aside: Vec<Outlier> = Vec::new();
    let mut again = AGAIN;
    let mut looks_for_wrong = true;
    let (calibration, scene, unknowns, beginning, found) = loop {
        let (calibration, mut scene) =
            baseline_of(robot, &labelled, &mut set_aside, looks_for_wrong, &request.calibration)?;
        looks_for_wrong = false;
        let unknowns = positional(&calibration.joint.unknowns);
        let beginning = Point { state: calibration.state.clone(), effects: Vec::new() };
        let campaign = &calibration.campaign;
        let found = search(campaign, &mut scene, beginning.clone(), &unknowns, request.seed, &done)
            .ok_or(DiscoveryError::TooSmall)?;
        // What is plainly wrong is told last: what an effect explains comes back, and what only an effect hid goes.
        let last = &found.last.point;
        let wrong = match last.effects.is_empty() || again == 0 {
            true => set_aside.clone(),
            false => still_wrong(robot, &labelled, &request.calibration, &calibration, last)?,
        };
        let places = |points: &[Outlier]| {
            points.iter().map(|wrong| (wrong.visit, wrong.target.clone())).collect::<std::collections::BTreeSet<_>>()
        };
        if places(&wrong) == places(&set_aside) {
            set_aside = wrong;
            break (calibration, scene, unknowns, beginning, found);
        }
        set_aside = wrong;
        again -= 1;
    };
    done();
    let campaign = calibration.campaign.clone();
    let mut findings = gross_findings(&swaps, &set_aside, run);
    findings.extend(examined.faults.into_iter().map(of_readings));
    let all = candidates(&scene);
    let question = Question {
        campaign: &campaign,
        scene: &scene,
        unknowns: &unknowns,
        start: &beginning,
        candidates: &all,
        trials: &found.trials,
        noise: Some(found.last.strata.clone()),
    };
    let folds = if request.hold_out { folds(&campaign) } else { Vec::new() };
    let mut held_out_before = None;
    let mut held_out_after = None;
    let mut steps = Vec::new();
    if !folds.is_empty() {
        if found.last.point.effects.is_empty() {
            held_out_before = question.with(&found.baseline.point, &folds);
            held_out_after = held_out_before;
        } else {
            if let Some(nested) = question.nested(&folds) {
                held_out_before = Some(nested.before);
                held_out_after = Some(nested.after);
            }
            let mut last = held_out_before;
            for count in 1..=found.last.point.effects.len() {
                let effects = found.last.point.effects[..count].to_vec();
                let next = question.with(&Point { effects, ..found.last.point.clone() }, &folds);
                steps.push(last.zip(next).map(|(before, after)| Gain {
                    before_mm: before.errors().rms_mm,
                    after_mm: after.errors().rms_mm,
                }));
                last = next;
            }
        }
    }
    done();
    let floor_of_noise_m = floor_m(&found.last.stage, &found.last.strata);
    for (place, named) in found.named.iter().enumerate() {
        let instance = &found.last.point.effects[place];
        if is_pattern(instance.effect) {
            continue;
        }
        let bounds: Vec<(usize, f64, f64)> = named
            .between
            .map(|(low, high)| (instance.shape.len() - 1, low, end_of_visit(&labelled, high)))
            .into_iter()
            .collect();
        findings.push(Finding {
            effect: instance.effect.name(),
            place: instance.site.named(&campaign.chain, &campaign.sensors, &campaign.targets),
            ln_p: named.ln_p,
            parameters: estimates(instance, &found.last.covariances[place], &bounds),
            separate_by: named.rivals.iter().find(|rival| is_close(&named.score, rival)).and_then(|rival| {
                separated_by(
                    &Doubt {
                        robot,
                        run: &labelled,
                        calibration: &calibration,
                        campaign: &campaign,
                        scene: &scene,
                        unknowns: &unknowns,
                        fitted: &found.last,
                        floor_m: floor_of_noise_m,
                    },
                    place,
                    &rival.instance,
                )
            }),
            alternatives: alternatives(&campaign, &named.score, &named.rivals),
            cost_rms_mm: cost(&campaign, &scene, &found.last, place),
            gain: steps.get(place).copied().flatten(),
            cycles: Vec::new(),
            points: Vec::new(),
            instance: Some(instance.clone()),
            evidence: None,
        });
    }
    let baseline = level(&campaign, &scene, &found.baseline.point, held_out_before);
    let extended = level(&campaign, &scene, &found.last.point, held_out_after);
    let unexplained = rest(&campaign, &scene, &found, baseline.fitted.rms_mm);
    let sigma = campaign.visits.iter().map(|visit| visit.sigma).sum::<f64>() / campaign.visits.len() as f64;
    let noise = found.last.strata.clone();
    let notes = calibration.notes.clone();
    let test = |score: &Score| Test {
        effect: score.instance.effect.name(),
        place: score.instance.site.named(&campaign.chain, &campaign.sensors, &campaign.targets),
        ln_p: found.trials.over_all(&score.instance, score.ln_p),
        ratio: score.ratio,
        visible: score.visible,
    };
    let tests = found.tests().into_iter().map(test).collect();
    done();
    Ok(Discovery {
        notes,
        noise_um: noise.point * sigma * 1e6,
        floor_rms_mm: floor_of_noise_m * 1e3,
        noise,
        unexplained,
        baseline,
        extended,
        findings,
        tests,
        search: found,
        campaign,
        scene,
        calibration,
    })
}

/// When the last point was measured of the visit that began at a time: a step may come between two points.
fn end_of_visit(run: &Run, time_s: f64) -> f64 {
    let points = run.visits.iter().filter(|visit| visit.time_s == time_s).flat_map(|visit| &visit.points);
    points.fold(time_s, |last, point| last.max(point.time_s))
}

/// Calibrates what is left of a run when plainly wrong points are set aside. Where it `looks_for_wrong` ones, they are added.
fn baseline_of(
    robot: &Robot,
    run: &Run,
    set_aside: &mut Vec<Outlier>,
    looks_for_wrong: bool,
    request: &Request,
) -> Result<(Calibration, Scene), DiscoveryError> {
    let mut rounds = 0;
    loop {
        let cleaned = without(run, set_aside);
        let calibration = calibrate(robot, &cleaned, request, |_| true)?;
        let mut scene = scene_of(&calibration, &cleaned);
        if !looks_for_wrong || rounds == ROUNDS {
            return Ok((calibration, scene));
        }
        let point = Point { state: calibration.state.clone(), effects: Vec::new() };
        update_growth(&mut scene, &calibration.campaign, &point);
        let stage = Stage::new(&calibration.campaign, &scene, &point, &positional(&calibration.joint.unknowns));
        let wrong = outliers(&calibration.campaign, &stage);
        rounds += 1;
        if wrong.is_empty() {
            return Ok((calibration, scene));
        }
        set_aside.extend(wrong);
    }
}

/// The points of the whole run that are plainly wrong in the presence of effects.
fn still_wrong(
    robot: &Robot,
    run: &Run,
    request: &Request,
    calibration: &Calibration,
    point: &Point,
) -> Result<Vec<Outlier>, DiscoveryError> {
    let observed = start(robot, run, request, |_| true).map_err(CalibrationError::from)?.observed.campaign;
    let whole = Campaign { growth: calibration.campaign.growth.clone(), ..observed };
    let mut scene = scene_over(&whole, calibration, run);
    update_growth(&mut scene, &whole, point);
    let stage = Stage::new(&whole, &scene, point, &positional(&calibration.joint.unknowns));
    Ok(outliers(&whole, &stage))
}

fn level(campaign: &Campaign, scene: &Scene, point: &Point, held_out: Option<ErrorTally>) -> Level {
    let mut own = scene.clone();
    update_growth(&mut own, campaign, point);
    let mut tally = ErrorTally::default();
    errors(campaign, &own, point, |_, _, error| tally.add(error.norm()));
    Level { fitted: tally.errors(), held_out: held_out.map(|tally| tally.errors()) }
}

/// The scene of a calibrated run.
pub fn scene_of(calibration: &Calibration, run: &Run) -> Scene {
    scene_over(&calibration.campaign, calibration, run)
}

/// The scene of the visits of a campaign of a run.
pub(super) fn scene_over(campaign: &Campaign, calibration: &Calibration, run: &Run) -> Scene {
    let robot = &calibration.model.robot;
    let unknown: Vec<usize> = (0..robot.targets.len()).filter(|&t| robot.targets[t].position.is_none()).collect();
    Scene::new(
        robot,
        run,
        campaign.seen(),
        &calibration.state.geometry.parameters,
        &calibration.model.temperatures,
        calibration.state.geometry.targets.clone(),
        &unknown,
    )
}

fn outliers(campaign: &Campaign, stage: &Stage) -> Vec<Outlier> {
    plainly_wrong(campaign, stage)
        .into_iter()
        .map(|(visit, position, error, statistic)| {
            let seen = &campaign.visits[visit];
            Outlier {
                visit: seen.place,
                cycle: seen.cycle,
                pose: seen.pose,
                target: campaign.targets[seen.positions[position].target].clone(),
                error,
                ln_p: ln_chi_square(statistic, 3),
            }
        })
        .collect()
}

/// A finding with nothing but its name.
fn bare(effect: &'static str, place: SiteNames, ln_p: f64) -> Finding {
    Finding {
        effect,
        place,
        ln_p,
        parameters: Vec::new(),
        alternatives: Vec::new(),
        cost_rms_mm: 0.0,
        gain: None,
        cycles: Vec::new(),
        points: Vec::new(),
        instance: None,
        evidence: None,
        separate_by: None,
    }
}

/// Where a fault of readings sits.
fn sensors_named(mut sensors: Vec<String>) -> SiteNames {
    match sensors.len() {
        1 => SiteNames { sensor: sensors.pop(), ..SiteNames::default() },
        _ => SiteNames { sensors, ..SiteNames::default() },
    }
}

fn of_readings(fault: ReadingFault) -> Finding {
    let mut finding = bare(fault.effect, sensors_named(fault.sensors), fault.ln_p);
    let own = |estimate: super::readings::Estimate| Estimate {
        name: estimate.name.to_string(),
        value: estimate.value,
        low: estimate.low,
        high: estimate.high,
    };
    finding.parameters = fault.parameters.into_iter().map(own).collect();
    let other = |(effect, sensors, log_evidence)| Alternative { effect, place: sensors_named(sensors), log_evidence };
    finding.alternatives =
        fault.alternatives.into_iter().map(other).filter(|other| other.log_evidence > -CLOSE).collect();
    finding.evidence = Some(fault.evidence);
    finding
}

fn gross_findings(swaps: &[Swap], set_aside: &[Outlier], run: &Run) -> Vec<Finding> {
    let exact = |name: &str, value: f64| Estimate { name: name.to_owned(), value, low: value, high: value };
    let mut findings: Vec<Finding> = swaps
        .iter()
        .map(|swap| {
            let mut finding =
                bare("target_swap", SiteNames { targets: swap.targets.to_vec(), ..SiteNames::default() }, swap.ln_p);
            finding.cycles = swap.cycles.clone();
            finding.parameters = vec![exact("visits", swap.visits.len() as f64)];
            finding
        })
        .collect();
    if !set_aside.is_empty() {
        let least = set_aside.iter().map(|wrong| wrong.ln_p).fold(0.0, f64::min);
        let mut finding = bare("outliers", SiteNames::default(), least + (run.point_count() as f64).ln());
        finding.parameters = vec![exact("fraction", set_aside.len() as f64 / run.point_count() as f64)];
        finding.points = set_aside.to_vec();
        findings.push(finding);
    }
    findings
}

/// Whether a rival explains about as much, and has a name.
fn is_close(own: &Score, rival: &Score) -> bool {
    !is_pattern(rival.instance.effect) && rival.ln_p < own.ln_p + CLOSE
}

fn alternatives(campaign: &Campaign, own: &Score, rivals: &[Score]) -> Vec<Alternative> {
    rivals
        .iter()
        .filter(|rival| is_close(own, rival))
        .take(TOLD)
        .map(|rival| Alternative {
            effect: rival.instance.effect.name(),
            place: rival.instance.site.named(&campaign.chain, &campaign.sensors, &campaign.targets),
            // Both refitted, the rival is behind: else it would stand in the other's place.
            log_evidence: (own.ln_p - rival.ln_p).min(0.0),
        })
        .collect()
}

/// What an effect moves the targets by, RMS over all points, mm.
fn cost(campaign: &Campaign, scene: &Scene, fitted: &Fit, place: usize) -> f64 {
    let mut without = fitted.point.clone();
    without.effects.remove(place);
    let mut with = Vec::new();
    errors(campaign, scene, &fitted.point, |_, _, error| with.push(error));
    let (mut sum, mut count) = (0.0, 0);
    errors(campaign, scene, &without, |_, _, error| {
        sum += (error - with[count]).norm_squared();
        count += 1;
    });
    (sum / count.max(1) as f64).sqrt() * 1e3
}

/// RMS distance that noise of points and visits makes, metres.
fn floor_m(stage: &Stage, noise: &Strata) -> f64 {
    let (mut sum, mut points) = (0.0, 0.0);
    for block in &stage.blocks {
        let rows = block.residual.len() as f64;
        sum += rows * (noise.point * block.sigma).powi(2);
        points += rows / 3.0;
    }
    (sum / points + moved_m(stage, &noise.visit).powi(2)).sqrt()
}

/// What is left after the search: patterns that it found outside the catalogue, and errors that postures or cycles share.
fn rest(campaign: &Campaign, scene: &Scene, found: &Search, baseline_rms_mm: f64) -> Unexplained {
    let mut parts = Vec::new();
    let mut ln_p = 0.0_f64;
    let of_baseline = |square: f64| (square / baseline_rms_mm.powi(2)).min(1.0);
    for (place, named) in found.named.iter().enumerate() {
        let instance = &found.last.point.effects[place];
        if is_pattern(instance.effect) {
            ln_p = ln_p.min(named.ln_p);
            // Calibration absorbs the rest of what it moves the targets by.
            let square = named.score.visible * cost(campaign, scene, &found.last, place).powi(2);
            let follows = pattern::follows(scene, &instance.site, &instance.shape);
            parts.push(Part { follows, share: of_baseline(square), rms_mm: square.sqrt() });
        }
    }
    let stage = &found.last.stage;
    let Strata { posture, cycle, visit, .. } = found.last.strata.clone();
    let system = System::new(stage, &Rows::new(stage), &found.last.strata);
    let all = system.log_likelihood(posture, cycle);
    let of_visits = moved_m(stage, &visit) * 1e3;
    let mut shared = |sigma: f64, without: f64, words: &str| {
        let rms_mm = moved_m(stage, &vec![sigma; visit.len()]) * 1e3;
        if sigma > 0.0 && rms_mm > LEAST_SHARED * of_visits {
            // On the edge of what a variance can be, half of the chance is at zero.
            let own = 0.5_f64.ln() + ln_chi_square(2.0 * (all - without), 1);
            if own < FALSE_REST.ln() {
                ln_p = ln_p.min(own);
                parts.push(Part { follows: vec![words.to_owned()], share: of_baseline(rms_mm.powi(2)), rms_mm });
            }
        }
    };
    shared(posture, system.log_likelihood(0.0, cycle), "posture");
    shared(cycle, system.log_likelihood(posture, 0.0), "cycle");
    Unexplained {
        significant: ln_p < FALSE_REST.ln(),
        ln_p,
        // The sum of nothing is minus zero.
        rms_mm: parts.iter().fold(0.0, |sum, part| sum + part.rms_mm.powi(2)).sqrt(),
        parts,
    }
}

/// What errors of the joints of given sizes move the targets by, RMS, metres.
fn moved_m(stage: &Stage, sizes: &[f64]) -> f64 {
    let (mut sum, mut points) = (0.0, 0.0);
    for block in &stage.blocks {
        let joints = block.places.column_iter().zip(sizes);
        let square: f64 = joints.map(|(column, size)| column.norm_squared() * size * size).sum();
        sum += square * block.sigma * block.sigma;
        points += block.residual.len() as f64 / 3.0;
    }
    (sum / points).sqrt()
}
