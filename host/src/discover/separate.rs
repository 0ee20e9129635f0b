//! What would tell two explanations apart: among visits that the arm could make, those at which their predictions differ most
//! (T-optimality, Atkinson and Fedorov 1975). Both are fitted to the run, and the difference is taken as it stands.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::discovery::scene_over;
use super::fit::{Fit, fit, update_growth};
use super::stage::{Point, errors};
use crate::calibrate::{Calibration, Campaign, ObservedPosition, ObservedVisit, Unknown};
use crate::effect::{Instance, Scene};
use crate::robot::{Posture, Robot};
use crate::run::Run;

/// A run with the model that was found on it.
pub struct Doubt<'a> {
    /// The arm.
    pub robot: &'a Robot,
    /// The run.
    pub run: &'a Run,
    /// Its baseline.
    pub calibration: &'a Calibration,
    /// Its measurements.
    pub campaign: &'a Campaign,
    /// Its scene.
    pub scene: &'a Scene,
    /// What calibration estimates.
    pub unknowns: &'a [Unknown],
    /// The model with effects.
    pub fitted: &'a Fit,
    /// RMS distance that noise makes, metres.
    pub floor_m: f64,
}

/// Postures that are looked at, and cycles.
const POSTURES: usize = 120;
const CYCLES: usize = 6;

/// How far beyond the run's range a joint may go, as a share of it, where robot.toml gives no limits.
const BEYOND: f64 = 0.5;

/// The best so many visits are described.
const BEST: usize = 15;

/// The log evidence by which two explanations are told apart.
const ENOUGH: f64 = 5.0;

/// More visits than this would be too many to ask for.
const MOST_VISITS: f64 = 300.0;

/// What would tell an effect of the model from a rival in its place, in words. None where the rival cannot be fitted.
pub fn separated_by(doubt: &Doubt<'_>, place: usize, rival: &Instance) -> Option<String> {
    let Doubt { campaign, fitted, .. } = doubt;
    let own = fitted.point.effects.get(place)?;
    let mut point = fitted.point.clone();
    point.effects[place] = rival.clone();
    let mut scene = doubt.scene.clone();
    let other = fit(campaign, &mut scene, point, doubt.unknowns, Some(fitted.strata.clone()))?;
    let visits = possible(doubt);
    let predicted = |point: &Point| -> Vec<(usize, Vector3<f64>)> {
        let mut scene = scene_over(&visits.0, doubt.calibration, &visits.1);
        scene.origin_s = doubt.scene.origin_s;
        scene.air_reference_c = doubt.scene.air_reference_c.or_else(|| doubt.scene.air_at_first());
        update_growth(&mut scene, &visits.0, point);
        let mut all = Vec::new();
        errors(&visits.0, &scene, point, |visit, _, error| all.push((visit, error)));
        all
    };
    // The noise of one coordinate; what a visit's targets share makes them worth a little less than this says.
    let variance = doubt.floor_m.powi(2) / 3.0;
    let mut worth = vec![0.0; visits.0.visits.len()];
    for ((visit, a), (_, b)) in predicted(&fitted.point).into_iter().zip(predicted(&other.point)) {
        worth[visit] += (a - b).norm_squared() / (2.0 * variance);
    }
    let mut order: Vec<usize> = (0..worth.len()).collect();
    order.sort_by(|&a, &b| worth[b].total_cmp(&worth[a]));
    order.truncate(BEST);
    let each = order.iter().map(|&visit| worth[visit]).sum::<f64>() / order.len().max(1) as f64;
    if each.is_nan() || each * MOST_VISITS < ENOUGH {
        return Some(other_means(own, rival).to_owned());
    }
    let count = (ENOUGH / each).ceil().max(1.0);
    let times = if count > 1.0 { "visits" } else { "visit" };
    Some(format!("{count} {times} at {}", described(doubt, &visits.0, &order)))
}

/// Visits that the arm could make: random postures within its limits, at the temperatures of cycles all over the run.
fn possible(doubt: &Doubt<'_>) -> (Campaign, Run) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut uniform = move || (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
    let seen = &doubt.campaign.visits;
    let joints: Vec<_> = doubt.robot.transforms.iter().filter_map(|transform| transform.joint.as_ref()).collect();
    let ranges: Vec<(f64, f64)> = (0..joints.len())
        .map(|joint| {
            let (low, high) = range(doubt.scene, joint);
            let more = BEYOND * (high - low);
            (joints[joint].min.unwrap_or(low - more), joints[joint].max.unwrap_or(high + more))
        })
        .collect();
    let step = (seen.len() / CYCLES).max(1);
    let moments: Vec<&ObservedVisit> = seen.iter().step_by(step).take(CYCLES).collect();
    let mut run = Run { visits: Vec::new(), ..doubt.run.clone() };
    let mut campaign = Campaign { visits: Vec::new(), ..doubt.campaign.clone() };
    for pose in 0..POSTURES as u32 {
        let posture: Vec<f64> = ranges.iter().map(|(low, high)| low + (high - low) * uniform()).collect();
        let approach: Vec<i8> = ranges.iter().map(|_| if uniform() < 0.5 { -1 } else { 1 }).collect();
        for &moment in &moments {
            let like = &doubt.run.visits[moment.place];
            campaign.visits.push(ObservedVisit {
                place: run.visits.len(),
                pose,
                posture: Posture::new(&posture),
                positions: (0..campaign.targets.len())
                    .map(|target| ObservedPosition { target, at: Vector3::zeros() })
                    .collect(),
                turns: Vec::new(),
                distances: Vec::new(),
                ..moment.clone()
            });
            run.visits.push(crate::run::Visit {
                pose,
                joints: posture.clone(),
                commanded: None,
                approach: Some(approach.clone()),
                points: Vec::new(),
                distances: Vec::new(),
                broken_beams: Vec::new(),
                ..like.clone()
            });
        }
    }
    (campaign, run)
}

fn range(scene: &Scene, joint: usize) -> (f64, f64) {
    scene.visits.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), visit| {
        (low.min(visit.joints[joint]), high.max(visit.joints[joint]))
    })
}

/// What the best visits have in common; the best of them where they have nothing.
fn described(doubt: &Doubt<'_>, campaign: &Campaign, best: &[usize]) -> String {
    let mut words = Vec::new();
    for joint in 0..campaign.chain.joint_count() {
        let (low, high) = range(doubt.scene, joint);
        let values: Vec<f64> = best.iter().map(|&visit| campaign.visits[visit].posture.positions()[joint]).collect();
        let most = 0.8 * values.len() as f64;
        let above = values.iter().copied().filter(|value| *value > high);
        let below = values.iter().copied().filter(|value| *value < low);
        if above.clone().count() as f64 >= most {
            words.push(format!("joint {} beyond {:.2} rad", joint + 1, high));
        } else if below.clone().count() as f64 >= most {
            words.push(format!("joint {} below {:.2} rad", joint + 1, low));
        }
    }
    let first = &campaign.visits[best[0]];
    let posture: Vec<String> = first.posture.positions().iter().map(|q| format!("{q:.2}")).collect();
    let example = format!("q = ({}) in cycle {}", posture.join(", "), first.cycle);
    match words.is_empty() {
        true => format!("postures such as {example}"),
        false => format!("poses with {}, such as {example}", words.join(" and ")),
    }
}

/// What else would tell, where no posture does.
fn other_means(own: &Instance, rival: &Instance) -> &'static str {
    let names = [own.effect.name(), rival.effect.name()];
    let among = |of: &[&str]| names.iter().any(|name| of.contains(name));
    if among(&["joint_compliance", "lost_motion"]) {
        "the same poses with another payload"
    } else if among(&["backlash", "joint_log_early"]) {
        "every pose approached from both sides"
    } else if among(&["unsensed_heat", "thermal_lag", "thermal_growth", "thermal_nonlinearity", "clock_offset"]) {
        "a run in which the joints move one at a time, with long pauses between"
    } else if among(&["frame_jump", "frame_drift", "scale_error"]) {
        "targets beside the base, measured in every cycle"
    } else {
        "more poses of another kind: none of those that were looked at tells them apart"
    }
}
