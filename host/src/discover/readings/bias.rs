//! A sensor whose zero moves: a step that no body makes, or a drift that its mates do not share.

use super::candidate::{Candidate, Context, Estimate, Undo};
use super::explained::{Fit, Response};

/// Smallest step, K, and drift, K/h, that are named, and the least that a drift adds up to, K.
const LEAST_STEP_K: f64 = 0.15;
const LEAST_DRIFT_K_PER_H: f64 = 0.08;
const LEAST_DRIFTED_K: f64 = 0.3;

/// Independent steps among all rows.
const STEP_TRIALS: f64 = 100.0;

/// Rows on each side that show a step by themselves.
const REACH: usize = 8;

/// A step as the readings on both sides of it show it may differ from the whole run's by this share and this much, K.
const STEP_SLACK: (f64, f64) = (0.3, 0.12);

/// Either half of a run shows at least this share of a drift.
const LEAST_OF_HALF: f64 = 0.35;

/// The step that explains most of what mates leave of a sensor.
pub(super) fn find_step(context: &Context<'_>, sensor: usize, response: &Response) -> Option<Candidate> {
    let squares = response.explained.step_squares();
    let rows = squares.len();
    let mut product = 0.0;
    let mut best: Option<(usize, Fit)> = None;
    for row in (0..rows).rev() {
        product += response.rest[row];
        if row < REACH || row + REACH > rows || squares[row] < 0.5 {
            continue;
        }
        let fit = response.fit_to(product, squares[row]);
        if best.as_ref().is_none_or(|(_, best)| fit.ratio > best.ratio) {
            best = Some((row, fit));
        }
    }
    let (row, fit) = best?;
    let step_k = fit.coefficient;
    if step_k.abs() < LEAST_STEP_K || context.freedom.ln_p(fit.ratio) > context.hopeless(STEP_TRIALS) {
        return None;
    }
    let jump_k = local_jump(response, row, step_k);
    if (jump_k - step_k).abs() > STEP_SLACK.0 * step_k.abs() + STEP_SLACK.1 {
        return None;
    }
    // The sensor's own readings tell between which two the step was.
    let (before_s, after_s) = (context.times_s[row - 1], context.times_s[row]);
    let slack_s = 0.1 * (after_s - before_s);
    let reach = context.freedom.quantile() * context.freedom.sigma(&fit);
    let name = &context.grid.sensors[sensor].name;
    Some(Candidate {
        effect: "sensor_bias",
        sensors: vec![sensor],
        score: context.freedom.score(fit.ratio),
        ln_p: context.freedom.ln_p(fit.ratio) + (STEP_TRIALS * context.sensors()).ln(),
        parameters: vec![
            Estimate::new("time_s", 0.5 * (before_s + after_s), before_s - slack_s, after_s + slack_s),
            Estimate::new("step_k", step_k, step_k - reach, step_k + reach),
        ],
        evidence: format!(
            "{name} steps by {step_k:+.2} K between {before_s:.0} and {after_s:.0} s and stays there, the sensors around it \
             do not; no body's temperature jumps"
        ),
        undo: Undo::Step { sensor, time_s: 0.5 * (before_s + after_s), step_k },
    })
}

/// The jump between straight lines through the readings just before and just after a row, of what mates leave of a sensor
/// that steps there.
fn local_jump(response: &Response, row: usize, step_k: f64) -> f64 {
    let step: Vec<f64> = (0..response.rest.len()).map(|at| if at < row { 0.0 } else { 1.0 }).collect();
    let own = response.explained.rest(&step);
    let at = |row: usize| response.rest[row] - step_k * own[row] + step_k * step[row];
    let line = |rows: std::ops::Range<usize>| -> f64 {
        let count = rows.len() as f64;
        let middle = rows.clone().map(|at| at as f64).sum::<f64>() / count;
        let mean = rows.clone().map(at).sum::<f64>() / count;
        let slope = rows.clone().map(|row| (row as f64 - middle) * at(row)).sum::<f64>()
            / rows.map(|row| (row as f64 - middle).powi(2)).sum::<f64>();
        mean + slope * (row as f64 - 0.5 - middle)
    };
    line(row..row + REACH) - line(row - REACH..row)
}

/// The drift that explains what mates leave of a sensor.
pub(super) fn find_drift(context: &Context<'_>, sensor: usize, response: &Response) -> Option<Candidate> {
    let start_s = *context.times_s.first()?;
    let hours: Vec<f64> = context.times_s.iter().map(|time| (time - start_s) / 3600.0).collect();
    let span_h = *hours.last()?;
    let fit = response.fit(&hours)?;
    let drift = fit.coefficient;
    if drift.abs() < LEAST_DRIFT_K_PER_H
        || drift.abs() * span_h < LEAST_DRIFTED_K
        || context.freedom.ln_p(fit.ratio) > context.hopeless(1.0)
    {
        return None;
    }
    let early: Vec<f64> = hours.iter().map(|h| h.min(0.5 * span_h)).collect();
    let late: Vec<f64> = hours.iter().map(|h| (h - 0.5 * span_h).max(0.0)).collect();
    let halves = response.fit_two([&early, &late])?;
    if halves.iter().any(|half| half / drift < LEAST_OF_HALF) {
        return None;
    }
    let reach = context.freedom.quantile() * context.freedom.sigma(&fit);
    let name = &context.grid.sensors[sensor].name;
    Some(Candidate {
        effect: "sensor_bias",
        sensors: vec![sensor],
        score: context.freedom.score(fit.ratio),
        ln_p: context.freedom.ln_p(fit.ratio) + context.sensors().ln(),
        parameters: vec![Estimate::new("drift_k_per_h", drift, drift - reach, drift + reach)],
        evidence: format!(
            "{name} drifts by {drift:+.2} K an hour against the sensors around it, in both halves of the run; without the \
             drift they explain it to {:.3} K",
            fit.left.sqrt(),
        ),
        undo: Undo::Drift { sensor, start_s, drift_k_per_h: drift },
    })
}
