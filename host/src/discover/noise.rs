//! How large the strata of noise are, by restricted maximum likelihood.
//!
//! The noise of a point follows from the part of each visit that no motion of the joints can make; that of a visit from what
//! differs between visits of one posture; the shared errors of postures and cycles from what is left.

use super::normal::{Normal, Strata, Whitened};
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
        squares.extend(beyond.map(|(row, _)| block.residual[row].powi(2)));
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
            within.map(move |(row, reach)| block.residual[row].powi(2) / (point * point + visit * visit * reach))
        });
        median(of_block.collect()).unwrap_or(0.0)
    };
    let (mut low, mut high) = (LEAST.ln(), MOST.ln());
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if typical(middle.exp()) > MEDIAN_SQUARE { low = middle } else { high = middle }
    }
    Strata { point, visit: low.exp(), posture: 0.0, cycle: 0.0 }
}

/// The largest value of a function of one logarithm between bounds, by golden section.
fn golden(mut low: f64, mut high: f64, steps: usize, mut of: impl FnMut(f64) -> f64) -> (f64, f64) {
    const SECTION: f64 = 0.618_033_988_749_895;
    let (mut left, mut right) = (high - SECTION * (high - low), low + SECTION * (high - low));
    let (mut at_left, mut at_right) = (of(left), of(right));
    for _ in 0..steps {
        if at_left > at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - SECTION * (high - low);
            at_left = of(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + SECTION * (high - low);
            at_right = of(right);
        }
    }
    if at_left > at_right { (left, at_left) } else { (right, at_right) }
}

/// Bounds of a joint's error, radians: a tenth of a microradian moves a target by less than any instrument sees, ten
/// milliradians by centimetres.
const LEAST: f64 = 1e-7;
const MOST: f64 = 1e-2;

/// So large a shared error takes all freedom that it can.
const FREE: f64 = 1.0;

/// The strata of a stage.
pub fn strata(stage: &Stage) -> Strata {
    let mut strata = Strata { point: point(stage).unwrap_or(1.0), visit: 0.0, posture: 0.0, cycle: 0.0 };
    // Between the visits of a posture alone, so that what is fixed by the posture does not count.
    let free = if stage.repeats() { FREE } else { 0.0 };
    let (visit, _) = golden(LEAST.ln(), MOST.ln(), 16, |log| {
        let white = Whitened::new(stage, &Strata { visit: log.exp(), ..strata });
        Normal::new(&white, 0, |_, _| unreachable!("no draws were asked for"))
            .factor(free, 0.0)
            .map_or(f64::NEG_INFINITY, |factor| factor.log_likelihood)
    });
    strata.visit = visit.exp();
    let white = Whitened::new(stage, &strata);
    let normal = Normal::new(&white, 0, |_, _| unreachable!("no draws were asked for"));
    let (posture, cycle) = shared(&normal);
    Strata { posture, cycle, ..strata }
}

/// The shared errors of postures and cycles of given normal equations.
pub fn shared(normal: &Normal<'_>) -> (f64, f64) {
    let likelihood = |posture: f64, cycle: f64| {
        normal.factor(posture, cycle).map_or(f64::NEG_INFINITY, |factor| factor.log_likelihood)
    };
    let (mut posture, mut cycle) = (0.0, 0.0);
    for _ in 0..2 {
        if normal.layout.postures > 0 {
            let (log, value) = golden(LEAST.ln(), MOST.ln(), 12, |log| likelihood(log.exp(), cycle));
            let without = likelihood(0.0, cycle);
            posture = if value > without + WORTH { log.exp() } else { 0.0 };
        }
        if normal.layout.cycles > 0 {
            let (log, value) = golden(LEAST.ln(), MOST.ln(), 12, |log| likelihood(posture, log.exp()));
            let without = likelihood(posture, 0.0);
            cycle = if value > without + WORTH { log.exp() } else { 0.0 };
        }
        if posture == 0.0 || cycle == 0.0 {
            break;
        }
    }
    (posture, cycle)
}
