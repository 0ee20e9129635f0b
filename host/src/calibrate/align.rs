//! Where a roughly known base and unknown targets are: found in closed form before any parameter of the arm is touched.
//!
//! For given targets the base is an absolute orientation (Kabsch 1976); for a given base each target is a mean. The two
//! alternate from targets at the flange's origin, which needs no idea of where the base is.

use nalgebra::Vector3;

use super::campaign::Campaign;
use super::problem::Problem;
use super::solve::{Stopping, solve};
use super::unknown::{State, Unknown};
use crate::model::ErrorTally;
use crate::robot::{Convention, Frame, ParameterId, Robot, Symbol};

/// An arm errs by millimetres; when known targets are further off than this on average, metres, it is the base's place
/// that is only roughly known.
const ROUGH_BASE: f64 = 0.02;

/// Alternations of base and targets: each shrinks the error at least by the ratio of tool to workspace.
const ALTERNATIONS: usize = 500;

/// The unknowns that place the base: transform 0, and the slide along and the turn about the first axis.
pub fn base_unknowns(campaign: &Campaign) -> Vec<Unknown> {
    let in_base =
        |id: &ParameterId| id.transform == 0 || (id.transform == 1 && matches!(id.symbol, Symbol::D | Symbol::Theta));
    (0..campaign.chain.parameters().len())
        .filter(|&place| in_base(&campaign.chain.parameters()[place]))
        .map(Unknown::Parameter)
        .collect()
}

/// The unknown coordinates of targets.
pub fn target_unknowns(targets: &[usize]) -> Vec<Unknown> {
    targets.iter().flat_map(|&target| (0..3).map(move |axis| Unknown::Target { target, axis })).collect()
}

/// Root mean square of the distances between measured and predicted positions, metres.
fn rms(campaign: &Campaign, state: &State) -> f64 {
    let mut tally = ErrorTally::default();
    Problem::new(campaign, Vec::new(), state).distances(state, |_, _, error| tally.add(error.norm()));
    tally.errors().rms_mm * 1e-3
}

/// Aligns base and unknown targets of a nominal state to the measurements, where it is needed: when a target's place is
/// unknown, or when known targets are centimetres away. Gives none where the nominal state is good as it is, or where too
/// little was measured.
pub fn align(robot: &Robot, campaign: &Campaign, nominal: &State, unknown_targets: &[usize]) -> Option<State> {
    if unknown_targets.is_empty() && rms(campaign, nominal) <= ROUGH_BASE {
        return None;
    }
    if campaign.visits.iter().map(|visit| visit.positions.len()).sum::<usize>() < 3 {
        return None;
    }
    let mut state = nominal.clone();
    let base = place_base(campaign, &mut state, unknown_targets);
    set_base(robot, campaign, &mut state, &base);
    let mut unknowns = target_unknowns(unknown_targets);
    unknowns.extend(base_unknowns(campaign));
    let start = if rms(campaign, &state) < rms(campaign, nominal) { state } else { nominal.clone() };
    Some(solve_what_can_be(campaign, unknowns, start))
}

/// Solves for unknowns after leaving out those that the data do not tell apart.
fn solve_what_can_be(campaign: &Campaign, unknowns: Vec<Unknown>, start: State) -> State {
    let kept = super::identify::identifiable(campaign, unknowns, &start).0;
    solve(&Problem::new(campaign, kept, &start), start, &Stopping::default()).state
}

/// Finds the motion of the first frame of the chain and the unknown targets by alternation.
fn place_base(campaign: &Campaign, state: &mut State, unknown_targets: &[usize]) -> Frame {
    let prepared = campaign.chain.prepare(&state.geometry.parameters);
    let Some(first) = campaign.visits.first() else { return Frame::identity() };
    let nominal_base = prepared.frames(&first.posture)[0];
    let from_base = nominal_base.inverse();
    let flanges: Vec<Frame> =
        campaign.visits.iter().map(|visit| from_base.then(&prepared.flange(&visit.posture))).collect();
    let mut base = nominal_base;
    let mut before = f64::INFINITY;
    for _ in 0..ALTERNATIONS {
        let pairs = campaign.visits.iter().zip(&flanges).flat_map(|(visit, flange)| {
            let targets = &state.geometry.targets;
            visit.positions.iter().map(move |position| (flange.point(&targets[position.target]), position.at))
        });
        base = Frame::registered(pairs);
        for &target in unknown_targets {
            let (mut sum, mut count) = (Vector3::zeros(), 0.0);
            for (visit, flange) in campaign.visits.iter().zip(&flanges) {
                for position in visit.positions.iter().filter(|position| position.target == target) {
                    sum += base.then(flange).local(&position.at);
                    count += 1.0;
                }
            }
            if count > 0.0 {
                state.geometry.targets[target] = sum / count;
            }
        }
        let mut squares = 0.0;
        for (visit, flange) in campaign.visits.iter().zip(&flanges) {
            let flange = base.then(flange);
            for position in &visit.positions {
                squares += (position.at - flange.point(&state.geometry.targets[position.target])).norm_squared();
            }
        }
        // Gauss-Newton finishes what has become small.
        if unknown_targets.is_empty() || before - squares < 1e-4 * squares {
            break;
        }
        before = squares;
    }
    base
}

/// The value nearest to `near` that differs from `angle` by whole turns.
fn unwrap(angle: f64, near: f64) -> f64 {
    angle + ((near - angle) / std::f64::consts::TAU).round() * std::f64::consts::TAU
}

/// Chooses the parameters of the base so that the first frame lies at `base`, as far as its convention can; what is left
/// is for Gauss-Newton.
fn set_base(robot: &Robot, campaign: &Campaign, state: &mut State, base: &Frame) {
    let place = |symbol, transform| campaign.chain.place(ParameterId::new(symbol, transform));
    let first = &robot.transforms[0];
    let values = &mut state.geometry.parameters;
    let rotation = &base.rotation;
    match first.convention {
        Convention::Hayati => {
            // The axis of the first joint crosses the world's xy plane at (theta, a); alpha and beta tilt it.
            let axis = rotation.column(2).into_owned();
            if axis.z.abs() < 1e-3 {
                return;
            }
            let crossing = base.origin - axis * (base.origin.z / axis.z);
            let nominal_a = first.value(Symbol::A);
            let sign = if nominal_a < 0.0 { -1.0 } else { 1.0 };
            let theta = libm::atan2(sign * crossing.y, sign * crossing.x);
            let (sin, cos) = libm::sincos(theta);
            let seen = Vector3::new(cos * axis.x + sin * axis.y, cos * axis.y - sin * axis.x, axis.z);
            let beta = libm::asin(seen.x.clamp(-1.0, 1.0));
            let alpha = libm::atan2(-seen.y, seen.z);
            for (symbol, value) in [
                (Symbol::Theta, unwrap(theta, first.value(Symbol::Theta))),
                (Symbol::A, sign * crossing.xy().norm()),
                (Symbol::Alpha, unwrap(alpha, first.value(Symbol::Alpha))),
                (Symbol::Beta, beta),
            ] {
                if let Some(place) = place(symbol, 0) {
                    values[place] = value;
                }
            }
            // What the first frame still lacks is a slide along and a turn about its own axis.
            let reached = campaign.chain.prepare(values).frames(&campaign.visits[0].posture)[0];
            let rest = reached.inverse().then(base);
            if let Some(place) = place(Symbol::D, 1) {
                values[place] += rest.origin.z;
            }
            if let Some(place) = place(Symbol::Theta, 1) {
                let turn = libm::atan2(rest.rotation[(1, 0)], rest.rotation[(0, 0)]);
                values[place] = unwrap(values[place] + turn, values[place]);
            }
        }
        Convention::Full => {
            let alpha = libm::asin(rotation[(2, 1)].clamp(-1.0, 1.0));
            let theta = libm::atan2(-rotation[(0, 1)], rotation[(1, 1)]);
            let beta = libm::atan2(-rotation[(2, 0)], rotation[(2, 2)]);
            let (sin, cos) = libm::sincos(theta);
            let along_x = cos * base.origin.x + sin * base.origin.y;
            let along_y = cos * base.origin.y - sin * base.origin.x;
            let (sin_alpha, cos_alpha) = libm::sincos(alpha);
            if cos_alpha.abs() < 1e-3 {
                return;
            }
            let b = along_y / cos_alpha;
            for (symbol, value) in [
                (Symbol::Theta, theta),
                (Symbol::Alpha, alpha),
                (Symbol::Beta, beta),
                (Symbol::A, along_x),
                (Symbol::B, b),
                (Symbol::D, base.origin.z - b * sin_alpha),
            ] {
                if let Some(place) = place(symbol, 0) {
                    values[place] = value;
                }
            }
        }
        Convention::Dh => {}
    }
}
