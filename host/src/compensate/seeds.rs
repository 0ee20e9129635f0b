//! Where a search for joints begins that was given no place to begin at: points that fill the joints' ranges evenly, and the
//! mirror images of a solution, where the other branches of most arms lie.

use std::f64::consts::{PI, TAU};

use super::inverse::Limit;

/// Points of an additive recurrence with the generalised golden ratio: every prefix of it fills the ranges evenly, in any
/// number of dimensions, and it is the same on every machine.
pub fn even(limits: &[Limit]) -> impl Iterator<Item = Vec<f64>> + '_ {
    let steps = steps(limits.len());
    (0_u32..).map(move |number| {
        limits
            .iter()
            .zip(&steps)
            .map(|(limit, step)| {
                let share = (0.5 + step * f64::from(number)).fract();
                let (low, high) = limit.range();
                low + (high - low) * share
            })
            .collect()
    })
}

/// The powers of 1/φ, where φ solves x^(d+1) = x + 1: the golden ratio in d dimensions.
fn steps(dimensions: usize) -> Vec<f64> {
    let power = 1.0 / (dimensions as f64 + 1.0);
    let ratio = (0..40).fold(2.0_f64, |x, _| libm::pow(1.0 + x, power));
    (1..=dimensions).map(|place| libm::pow(1.0 / ratio, place as f64)).collect()
}

/// The mirror images of a solution: a wrist turned over, a shoulder turned round, an elbow bent the other way. They are
/// near to solutions for the arms that have such branches, and no worse than other seeds for those that have not.
pub fn mirrored(joints: &[f64], limits: &[Limit]) -> Vec<Vec<f64>> {
    let turn = |angle: f64| if angle > 0.0 { angle - PI } else { angle + PI };
    let mut images = Vec::new();
    for place in 0..joints.len() {
        if !limits[place].turns {
            continue;
        }
        let mut turned = joints.to_vec();
        turned[place] = turn(turned[place]);
        images.push(turned);
        let mut bent = joints.to_vec();
        bent[place] = -bent[place];
        images.push(bent);
        // Three axes of a wrist: the middle one bends the other way, those beside it turn by half a turn.
        if place > 0 && place + 1 < joints.len() {
            let mut over = joints.to_vec();
            over[place - 1] = turn(over[place - 1]);
            over[place] = -over[place];
            over[place + 1] = turn(over[place + 1]);
            images.push(over);
        }
    }
    images
}

/// A revolute joint's position moved by whole turns so that it is nearest to `to`.
pub fn nearest_turn(angle: f64, to: f64) -> f64 {
    angle - TAU * libm::round((angle - to) / TAU)
}
