//! Gross errors of the list of points: exchanged labels, and points that are plainly wrong.
//!
//! Labels are put right before anything is calibrated, since a few of them spoil every fit. Points that no motion of the
//! joints and no noise explains are set aside, not deleted: what an effect that is found later explains comes back.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Matrix3};

use super::noise::robust;
use super::normal::Strata;
use super::stage::Stage;
use crate::calibrate::{Campaign, Loss, Manner, Request, State, geometric_unknowns, identify, start};
use crate::input::InputError;
use crate::robot::Robot;
use crate::run::Run;

/// Two targets whose labels were exchanged in some cycles.
#[derive(Debug, Clone, PartialEq)]
pub struct Swap {
    /// The targets' names.
    pub targets: [String; 2],
    /// The cycles.
    pub cycles: Vec<u32>,
    /// The visits, by their place in the run.
    pub visits: Vec<usize>,
    /// Logarithm of the chance of it, by what the exchange takes off the squares.
    pub ln_p: f64,
}

/// A point that is plainly wrong.
#[derive(Debug, Clone, PartialEq)]
pub struct Outlier {
    /// The visit's place in the run.
    pub visit: usize,
    /// The cycle.
    pub cycle: u32,
    /// The posture.
    pub pose: u32,
    /// The target's name.
    pub target: String,
    /// How far it is off, metres.
    pub error: f64,
    /// Logarithm of the chance of so large an error.
    pub ln_p: f64,
}

/// An exchange must leave less than this share of the squares of the two points.
const LEFT: f64 = 0.25;

/// Rounds of fitting and exchanging.
const ROUNDS: usize = 4;

/// Finds exchanged labels and gives the run with the labels put right.
///
/// # Errors
/// What [`start`] refuses.
pub fn put_labels_right(robot: &Robot, run: &Run, request: &Request) -> Result<(Run, Vec<Swap>), InputError> {
    let mut corrected = run.clone();
    let mut exchanged: Vec<(usize, usize, usize, f64)> = Vec::new();
    if run.target_names.len() < 2 {
        return Ok((corrected, Vec::new()));
    }
    let mut scale = 1.0;
    for _ in 0..ROUNDS {
        let begun = start(robot, &corrected, request, |_| true)?;
        let campaign = &begun.observed.campaign;
        let unknowns = geometric_unknowns(campaign, &begun.observed.unknown_targets, &[], &begun.fixed);
        let manner = Manner { loss: Loss::Cauchy, ..request.manner };
        let state = identify(campaign, unknowns, begun.nominal, &manner).solution.state;
        let (found, spread) = exchanges(campaign, &state);
        scale = spread;
        if found.is_empty() {
            break;
        }
        for &(visit, one, other, gain) in &found {
            // The run's names may come in another order than the robot's targets.
            let index = |target: usize| corrected.target_index(&campaign.targets[target]);
            let (Some(a), Some(b)) = (index(one), index(other)) else { continue };
            for point in &mut corrected.visits[visit].points {
                point.target = if point.target == a {
                    b
                } else if point.target == b {
                    a
                } else {
                    point.target
                };
            }
            let (low, high) = (a.min(b), a.max(b));
            match exchanged.iter().position(|known| (known.0, known.1, known.2) == (visit, low, high)) {
                // Exchanged twice is not exchanged.
                Some(place) => {
                    exchanged.remove(place);
                }
                None => exchanged.push((visit, low, high, gain)),
            }
        }
    }
    exchanged.sort_by_key(|&(visit, low, high, _)| (low, high, visit));
    let swaps = exchanged
        .chunk_by(|left, right| (left.1, left.2) == (right.1, right.2))
        .map(|same| {
            let mut cycles: Vec<u32> = same.iter().map(|(visit, ..)| run.visits[*visit].cycle).collect();
            cycles.dedup();
            let mut targets = [run.target_names[same[0].1].clone(), run.target_names[same[0].2].clone()];
            targets.sort_by_key(|name| robot.targets.iter().position(|target| target.name == *name));
            Swap {
                targets,
                cycles,
                visits: same.iter().map(|(visit, ..)| *visit).collect(),
                ln_p: -0.5 * same.iter().map(|(.., gain)| gain).sum::<f64>() / scale,
            }
        })
        .collect();
    Ok((corrected, swaps))
}

/// Visits where two points fit far better with their labels exchanged: visit (in the run), the targets, the squares gained;
/// and the median square of a coordinate's error as the labels stand.
fn exchanges(campaign: &Campaign, state: &State) -> (Vec<(usize, usize, usize, f64)>, f64) {
    let prepared = campaign.chain.prepare(&state.geometry.parameters);
    let mut found = Vec::new();
    let mut squares = Vec::new();
    for visit in &campaign.visits {
        let flange = prepared.flange(&visit.posture);
        let square = |position: usize, target: usize| {
            (visit.positions[position].at - flange.point(&state.geometry.targets[target])).norm_squared()
        };
        let mut best: Option<(usize, usize, f64)> = None;
        for one in 0..visit.positions.len() {
            squares.push(square(one, visit.positions[one].target) / 3.0);
            for other in one + 1..visit.positions.len() {
                let (a, b) = (visit.positions[one].target, visit.positions[other].target);
                let (as_is, exchanged) = (square(one, a) + square(other, b), square(one, b) + square(other, a));
                let gain = as_is - exchanged;
                if exchanged < LEFT * as_is && best.is_none_or(|(.., most)| gain > most) {
                    best = Some((a, b, gain));
                }
            }
        }
        if let Some((a, b, gain)) = best {
            found.push((visit.place, a, b, gain));
        }
    }
    let middle = squares.len() / 2;
    let scale = *squares.select_nth_unstable_by(middle, f64::total_cmp).1;
    // An exchange of neighbours that noise could make is none.
    let plain = |(.., gain): &(usize, usize, usize, f64)| *gain > 100.0 * scale;
    found.retain(plain);
    // Where one of the two was not seen, the other bears its name all the same.
    let mut pairs: Vec<(usize, usize)> = found.iter().flat_map(|&(_, a, b, _)| [(a, b), (b, a)]).collect();
    pairs.sort_unstable();
    pairs.dedup();
    for visit in &campaign.visits {
        let flange = prepared.flange(&visit.posture);
        let seen = |target: usize| visit.positions.iter().any(|position| position.target == target);
        let alone = visit.positions.iter().flat_map(|position| {
            let others = pairs.iter().filter(|(own, other)| *own == position.target && !seen(*other));
            others.map(move |&(own, other)| (position.at, own, other))
        });
        let exchanged = alone.filter_map(|(at, own, other)| {
            let square = |target: usize| (at - flange.point(&state.geometry.targets[target])).norm_squared();
            let (as_is, exchanged) = (square(own), square(other));
            (exchanged < LEFT * as_is).then_some((visit.place, own, other, as_is - exchanged))
        });
        found.extend(exchanged.max_by(|a, b| a.3.total_cmp(&b.3)).filter(plain));
    }
    (found, scale.max(f64::MIN_POSITIVE))
}

/// The square of an error in units of its noise beyond which a point is plainly wrong: a chance of 1e-9 for three
/// coordinates.
const PLAIN: f64 = 45.0;

/// A target of which more than this share of the visits is wrong has moved; its points are not outliers.
const MOVED: f64 = 0.3;

/// Fewer visits of a posture than this do not tell what comes back from what happens once.
const FEWEST_TO_COME_BACK: usize = 4;

/// The points of a stage that are plainly wrong: visit and position of the campaign, error in metres, test statistic.
pub fn plainly_wrong(campaign: &Campaign, stage: &Stage) -> Vec<(usize, usize, f64, f64)> {
    let noise = robust(stage);
    let mut found = Vec::new();
    for visit in 0..stage.blocks.len() {
        let mut active: Vec<usize> = (0..campaign.visits[visit].positions.len()).collect();
        // The worst first: it drags the others along.
        while active.len() > 1 {
            let worst = statistics(stage, visit, &active, &noise)
                .into_iter()
                .filter(|(.., statistic)| *statistic > PLAIN)
                .max_by(|a, b| a.2.total_cmp(&b.2));
            let Some((position, error, statistic)) = worst else { break };
            found.push((visit, position, error, statistic));
            active.retain(|other| *other != position);
        }
    }
    let target = |(visit, position, ..): &(usize, usize, f64, f64)| campaign.visits[*visit].positions[*position].target;
    let seen = |target: usize| {
        let all = campaign.visits.iter().flat_map(|visit| &visit.positions);
        all.filter(|position| position.target == target).count() as f64
    };
    let moved: Vec<usize> = (0..campaign.targets.len())
        .filter(|&number| found.iter().filter(|wrong| target(wrong) == number).count() as f64 > MOVED * seen(number))
        .collect();
    found.retain(|wrong| !moved.contains(&target(wrong)));
    // What comes back whenever the arm stands so is no gross error.
    let key = |visit: usize, position: usize| {
        let seen = &campaign.visits[visit];
        (seen.pose, seen.positions[position].target)
    };
    let mut times: BTreeMap<(u32, usize), (usize, usize)> = BTreeMap::new();
    for (visit, seen) in campaign.visits.iter().enumerate() {
        (0..seen.positions.len()).for_each(|position| times.entry(key(visit, position)).or_default().0 += 1);
    }
    for &(visit, position, ..) in &found {
        times.entry(key(visit, position)).or_default().1 += 1;
    }
    found.retain(|&(visit, position, ..)| {
        let (visits, wrong) = times[&key(visit, position)];
        visits < FEWEST_TO_COME_BACK || wrong as f64 <= MOVED * visits as f64
    });
    found
}

/// For each position that is active: its error given all the others, metres, and the square of it in units of its noise.
fn statistics(stage: &Stage, visit: usize, active: &[usize], noise: &Strata) -> Vec<(usize, f64, f64)> {
    let block = &stage.blocks[visit];
    let rows: Vec<usize> = active.iter().flat_map(|position| 3 * position..3 * position + 3).collect();
    let mut spread = block.places.select_rows(&rows).columns(0, noise.visit.len()).into_owned();
    for (mut column, sigma) in spread.column_iter_mut().zip(&noise.visit) {
        column.scale_mut(*sigma);
    }
    let covariance =
        &spread * spread.transpose() + DMatrix::from_diagonal_element(rows.len(), rows.len(), noise.point.powi(2));
    let Some(inverse) = covariance.cholesky().map(|factor| factor.inverse()) else { return Vec::new() };
    let weighed = &inverse * block.residual.select_rows(&rows);
    active
        .iter()
        .enumerate()
        .filter_map(|(rank, &position)| {
            let own: Matrix3<f64> = inverse.fixed_view::<3, 3>(3 * rank, 3 * rank).into_owned();
            let force = weighed.fixed_rows::<3>(3 * rank).into_owned();
            let error = own.try_inverse()? * force;
            Some((position, error.norm() * block.sigma, force.dot(&error)))
        })
        .collect()
}

/// The run without the points of these visits (places in the run) and targets (names).
pub fn without(run: &Run, points: &[Outlier]) -> Run {
    let mut rest = run.clone();
    for wrong in points {
        if let Some(target) = run.target_index(&wrong.target) {
            rest.visits[wrong.visit].points.retain(|point| point.target != target);
        }
    }
    rest
}
