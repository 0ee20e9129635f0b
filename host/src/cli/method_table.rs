//! The table of `calibrate --compare-methods`.

use serde::Serialize;

use super::Failure;
use crate::calibrate::methods::{self, Trial};
use crate::calibrate::{Campaign, ObservedVisit, Problem, Request, State, geometric_unknowns, identifiable, start};
use crate::robot::Robot;
use crate::run::Run;

/// Steepest descent is given up after so many steps.
const MOST_STEPS: usize = 20_000;

/// One row.
#[derive(Debug, Serialize)]
pub struct Row {
    method: &'static str,
    steps: usize,
    time_s: f64,
    loss: f64,
    reached_minimum: bool,
}

/// Compares the methods on the reference cycle's visits that `pick` chooses.
///
/// # Errors
/// Bad input.
pub fn compare(
    robot: &Robot,
    run: &Run,
    request: &Request,
    pick: impl Fn(&ObservedVisit) -> bool,
) -> Result<Vec<Row>, Failure> {
    let reference = run.description.reference_cycle;
    let begun = start(robot, run, request, |visit| visit.cycle == reference && pick(visit))?;
    let campaign = Campaign { growth: Vec::new(), ..begun.observed.campaign };
    let nominal = State { growth: Vec::new(), ..begun.nominal };
    let asked =
        geometric_unknowns(&campaign, &begun.observed.unknown_targets, &begun.observed.unknown_anchors, &begun.fixed);
    let (unknowns, _) = identifiable(&campaign, asked, &nominal);
    let problem = Problem::new(&campaign, unknowns, &nominal);
    Ok(methods::compare(&problem, &nominal, MOST_STEPS).iter().map(row).collect())
}

fn row(trial: &Trial) -> Row {
    Row {
        method: trial.method.words(),
        steps: trial.steps,
        time_s: trial.time.as_secs_f64(),
        loss: trial.loss,
        reached_minimum: trial.reached,
    }
}

/// The table in words.
pub fn words(rows: &[Row]) -> String {
    let mut text = String::from("method                  steps      time ms             loss\n");
    for row in rows {
        let reached = if row.reached_minimum { "" } else { "  (not the minimum yet)" };
        text.push_str(&format!(
            "{:<20} {:8} {:12.3} {:16.6}{reached}\n",
            row.method,
            row.steps,
            row.time_s * 1e3,
            row.loss
        ));
    }
    text
}
