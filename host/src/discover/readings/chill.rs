//! A sensor that the draught of movement cools: what its mates leave of it follows motion and rest, downward.

use super::candidate::{Candidate, Context, Estimate, Undo};
use super::explained::{Fit, Response};
use crate::discover::golden::golden;

/// Time constants that are tried, s.
const TAUS_S: [f64; 13] = [12.0, 18.0, 26.0, 37.0, 52.0, 73.0, 102.0, 143.0, 200.0, 280.0, 390.0, 550.0, 770.0];

/// Independent shapes among them: neighbours are nearly the same.
const TRIALS: f64 = 4.0;

/// Less depth than this, K, is left to the heat that nobody knows.
const LEAST_DEPTH_K: f64 = 0.2;

/// The depth in the first and in the second half of the run must each be at least this share of the whole's: heat in
/// unknown ways depends on how fast the arm moves and how warm it is, a draught's chill does not.
const LEAST_OF_HALF: f64 = 0.4;

/// Fewer movements than this cannot be told from other causes.
const FEWEST_MOVEMENTS: usize = 3;

/// The chill that explains most of what mates leave of a sensor.
pub(super) fn find(context: &Context<'_>, sensor: usize, response: &Response) -> Option<Candidate> {
    if context.movements() < FEWEST_MOVEMENTS {
        return None;
    }
    let fit = |tau_s: f64| response.fit(&context.motion.followed(tau_s, &context.times_s));
    let ratio = |tau_s: f64| fit(tau_s).filter(|fit| fit.coefficient < 0.0).map_or(0.0, |fit| fit.ratio);
    let best = TAUS_S.into_iter().map(|tau| (ratio(tau), tau)).max_by(|left, right| left.0.total_cmp(&right.0))?;
    if context.freedom.ln_p(best.0) > context.hopeless(TRIALS) {
        return None;
    }
    let tau_s = sharpened(&ratio, best.1);
    let fit: Fit = fit(tau_s)?;
    let depth_k = -fit.coefficient;
    let shape = context.motion.followed(tau_s, &context.times_s);
    let middle = shape.len() / 2;
    let half = |keep: &dyn Fn(usize) -> bool| -> Vec<f64> {
        shape.iter().enumerate().map(|(row, value)| if keep(row) { *value } else { 0.0 }).collect()
    };
    let halves = response.fit_two([&half(&|row| row < middle), &half(&|row| row >= middle)])?;
    if depth_k < LEAST_DEPTH_K || halves.iter().any(|half| -half < LEAST_OF_HALF * depth_k) {
        return None;
    }
    let reach = context.freedom.quantile() * context.freedom.sigma(&fit);
    // Both ends of the time constant: where what is left has grown as it does by one standard error of a parameter at a
    // time, taken to the quantile.
    let square = response.square / (1.0 + fit.ratio);
    let allowed = square * (1.0 + context.freedom.quantile().powi(2) / context.freedom.count());
    let left = |tau_s: f64| response.square / (1.0 + ratio(tau_s));
    let end = |outward: f64| {
        let (mut inside, mut outside) = (tau_s, tau_s * outward);
        for _ in 0..24 {
            let middle = (inside * outside).sqrt();
            if left(middle) <= allowed { inside = middle } else { outside = middle }
        }
        inside
    };
    let name = &context.grid.sensors[sensor].name;
    Some(Candidate {
        effect: "sensor_chill",
        sensors: vec![sensor],
        score: context.freedom.score(fit.ratio),
        ln_p: context.freedom.ln_p(fit.ratio) + (TRIALS * context.sensors()).ln(),
        parameters: vec![
            Estimate::new("depth_k", depth_k, depth_k - reach, depth_k + reach),
            Estimate::new("tau_s", tau_s, end(0.2), end(5.0)),
        ],
        evidence: format!(
            "{name} reads {depth_k:.2} K low while the arm moves, following its starts and stops within {tau_s:.0} s, over \
             {} movements alike; with that, the sensors around it explain it to {:.3} K",
            context.movements(),
            fit.left.sqrt(),
        ),
        undo: Undo::Chill { sensor, depth_k, tau_s },
    })
}

/// The best time constant near one of the grid, by golden section on its logarithm.
fn sharpened(ratio: &impl Fn(f64) -> f64, tau_s: f64) -> f64 {
    golden((tau_s / 1.45).ln(), (tau_s * 1.45).ln(), 18, |log| ratio(log.exp())).0.exp()
}
