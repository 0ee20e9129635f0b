//! How large the strata of noise are, by restricted maximum likelihood.
//!
//! The noise of a point follows from the part of each visit that no motion of the joints can make; that of a visit from what
//! differs between visits of one posture; the shared errors of postures and cycles from what is left.

use super::golden::golden;
use super::normal::{Rows, Strata, System};
use super::stage::Stage;

/// The instrument's word is taken where fewer numbers than this would tell the noise of a point.
const FEWEST: f64 = 20.0;

/// A shared error must lift the restricted log likelihood by this much to be taken for real.
const WORTH: f64 = 0.5;

/// The median of the square of a standard normal number.
const MEDIAN_SQUARE: f64 = 0.454_936_423_119_572_7;

/// What is beyond this many standard deviations does not count towards one.
const GROSS: f64 = 5.0;

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The noise of one point in units of the instrument's: root mean square of what lies beyond the reach of the joints, but
/// for what is gross.
fn point(stage: &Stage) -> Option<f64> {
    let mut squares = Vec::new();
    for block in &stage.blocks {
        let largest = block.spectrum.iter().copied().fold(0.0, f64::max);
        let beyond = block.spectrum.iter().enumerate().filter(|(_, reach)| **reach < 1e-9 * largest);
        squares.extend(beyond.map(|(axis, _)| block.axes.column(axis).dot(&block.residual).powi(2)));
    }
    // Unknown targets are fitted to these rows as well; parameters of the arm move targets together and are not.
    let fitted = (3 * stage.places.targets()) as f64;
    let robust = median(squares.clone())? / MEDIAN_SQUARE;
    squares.retain(|square| *square <= GROSS * GROSS * robust);
    let count = squares.len() as f64 - fitted;
    (count >= FEWEST).then(|| (squares.iter().sum::<f64>() / count).sqrt())
}

/// The noise of points and visits by medians, whatever a few points do: by it gross errors are told.
pub fn robust(stage: &Stage) -> Strata {
    let point = point(stage).unwrap_or(1.0);
    let typical = |visit: f64| {
        let of_block = stage.blocks.iter().flat_map(|block| {
            let largest = block.spectrum.iter().copied().fold(0.0, f64::max);
            let within = block.spectrum.iter().enumerate().filter(move |(_, reach)| **reach > 1e-4 * largest);
            within.map(move |(axis, reach)| {
                let along = block.axes.column(axis).dot(&block.residual);
                along.powi(2) / (point * point + visit * visit * reach)
            })
        });
        median(of_block.collect()).unwrap_or(0.0)
    };
    let (mut low, mut high) = (LEAST.ln(), MOST.ln());
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if typical(middle.exp()) > MEDIAN_SQUARE { low = middle } else { high = middle }
    }
    Strata { point, visit: vec![low.exp(); stage.places.joints()], posture: 0.0, cycle: 0.0 }
}

/// Bounds of a joint's error, radians: a tenth of a microradian moves a target by less than any instrument sees, ten
/// milliradians by centimetres.
const LEAST: f64 = 1e-7;
const MOST: f64 = 1e-2;

/// So large a shared error takes all freedom that it can.
const FREE: f64 = 1.0;

/// Rounds in which the joints' noises find their sizes, and the change of a logarithm at which they have.
const JOINT_ROUNDS: usize = 12;
const SETTLED: f64 = 0.02;

/// The strata of a stage. `near` are those of a model that differs little, from which the search for them begins.
pub fn strata(stage: &Stage, near: Option<&Strata>) -> Strata {
    let joints = stage.places.joints();
    let mut strata =
        Strata { point: point(stage).unwrap_or(1.0), visit: vec![LEAST; joints], posture: 0.0, cycle: 0.0 };
    let rows = Rows::new(stage);
    // Between the visits of a posture alone, so that what is fixed by the posture does not count.
    let free = if stage.repeats() { FREE } else { 0.0 };
    strata.visit = match near {
        Some(near) => near.visit.clone(),
        None => {
            let (visit, _) = golden(LEAST.ln(), MOST.ln(), 9, |log| {
                let visit = vec![log.exp(); joints];
                System::new(stage, &rows, &Strata { visit, ..strata.clone() }).log_likelihood(free, 0.0)
            });
            vec![visit.exp(); joints]
        }
    };
    // From there each joint's own: where residuals say more of a joint's errors than noise of its size would,
    // the size grows in proportion.
    for _ in 0..JOINT_ROUNDS {
        let system = System::new(stage, &rows, &strata);
        let Some(factor) = system.factor(free, 0.0) else { break };
        let scores = factor.joint_scores(stage, &rows, &system.layout, &strata);
        let mut change = 0.0_f64;
        for (sigma, (found, expected)) in strata.visit.iter_mut().zip(scores) {
            if expected > 0.0 {
                let next = (*sigma * (found / expected).sqrt()).clamp(LEAST, MOST);
                change = change.max((next / *sigma).ln().abs());
                *sigma = next;
            }
        }
        if change < SETTLED {
            break;
        }
    }
    let (posture, cycle) = shared(&System::new(stage, &rows, &strata));
    Strata { posture, cycle, ..strata }
}

/// The shared errors of postures and cycles of given normal equations.
fn shared(system: &System) -> (f64, f64) {
    let size = |of: &dyn Fn(f64) -> f64| {
        let (log, value) = golden(LEAST.ln(), MOST.ln(), 10, |log| of(log.exp()));
        if value > of(0.0) + WORTH { log.exp() } else { 0.0 }
    };
    let (mut posture, mut cycle) = (0.0, 0.0);
    for _ in 0..2 {
        if system.layout.postures > 0 {
            posture = size(&|sigma| system.log_likelihood(sigma, cycle));
        }
        if system.layout.cycles > 0 {
            cycle = size(&|sigma| system.log_likelihood(posture, sigma));
        }
        if posture == 0.0 || cycle == 0.0 {
            break;
        }
    }
    (posture, cycle)
}
