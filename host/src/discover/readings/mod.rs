//! Faults of the temperature log, found in the log itself before any calibration.
//!
//! Nobody knows how heat flows in the arm at hand, so nothing here models it. Each search uses what no heat can do: a
//! body does not jump, does not cool at once because it moves while the metal beside it does not, does not answer before
//! its cause. What the sensors around one say of it is projected out (`mates`), and a fault must explain far more of the
//! rest than heat in unknown ways would (`explained`). The surest fault is undone in the log and the search begins anew.
//!
//! | module | owns |
//! | --- | --- |
//! | `grid`, `motion` | the log on common times, and when the arm moved |
//! | `explained`, `mates` | least squares by projection, and what other sensors say of one |
//! | `candidate` | a possible fault, what it must pass, and how it is undone |
//! | `chill`, `bias`, `detached`, `swap`, `clock` | one fault each |

mod bias;
mod candidate;
mod chill;
mod clock;
mod detached;
mod explained;
mod grid;
mod mates;
mod motion;
mod swap;
#[cfg(test)]
mod tests;

use crate::robot::Robot;
use crate::run::{Run, TemperatureLog};

pub use candidate::Estimate;
use candidate::{Candidate, Context};
use explained::Response;
use grid::Grid;
use mates::Mates;
use motion::Motion;

/// More faults than this are no log.
const MOST_FAULTS: usize = 4;

/// Candidates that are worse by more than this log evidence are no alternatives, nor more than so many.
const FAR: f64 = 12.0;
const MOST_ALTERNATIVES: usize = 3;

/// A fault of the readings.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadingFault {
    /// The contract's name.
    pub effect: &'static str,
    /// The sensors at fault; none where the whole log is.
    pub sensors: Vec<String>,
    /// Its numbers, with 95 % intervals.
    pub parameters: Vec<Estimate>,
    /// Natural logarithm of the chance that a run without faults would be given one as sure as this.
    pub ln_p: f64,
    /// What speaks for it, one sentence.
    pub evidence: String,
    /// What explains the same nearly as well: name, sensors, log evidence relative to the fault.
    pub alternatives: Vec<(&'static str, Vec<String>, f64)>,
}

/// What the log says of itself.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Examined {
    /// The faults, in the order in which they were found.
    pub faults: Vec<ReadingFault>,
    /// The log with all faults undone; none where there are none.
    pub corrected: Option<TemperatureLog>,
}

/// Looks for faults of a run's temperature log. A run without temperatures, or with too few of them, has none.
pub fn examine(robot: &Robot, run: &Run) -> Examined {
    let Some(log) = &run.temperatures else { return Examined::default() };
    let motion = Motion::new(&run.motion);
    let ambient = run.description.ambient.as_deref();
    let mut examined = Examined::default();
    while examined.faults.len() < MOST_FAULTS {
        let log = examined.corrected.as_ref().unwrap_or(log);
        let Some(grid) = Grid::new(robot, run, log) else { break };
        let context = Context::new(&grid, &motion);
        // The clock first, and once: all other searches rely on it, and it on no single sensor.
        let clock = if examined.faults.is_empty() { clock::find(&context).filter(Candidate::is_sure) } else { None };
        let found = match clock {
            Some(clock) => vec![clock],
            None => of_sensors(&context),
        };
        let Some(best) = found.first() else { break };
        let fault = named(best, &found[1..], &grid);
        let known = |earlier: &ReadingFault| earlier.effect == fault.effect && earlier.sensors == fault.sensors;
        if examined.faults.iter().any(known) {
            break;
        }
        examined.corrected = Some(best.undo.applied(log, &grid, &motion, ambient));
        examined.faults.push(fault);
    }
    examined
}

/// All sure candidates at single sensors and pairs, the best first.
fn of_sensors(context: &Context<'_>) -> Vec<Candidate> {
    let mates = Mates::new(context.grid);
    let mut found = swap::find(context, &mates);
    for sensor in 0..context.grid.sensors.len() {
        let near = mates.near(sensor);
        if near.len() >= 2 {
            let response = Response::new(mates.free(&near), mates.read(sensor));
            found.extend(chill::find(context, sensor, &response));
            found.extend(bias::find_step(context, sensor, &response));
            found.extend(bias::find_drift(context, sensor, &response));
        }
        found.extend(detached::find(context, &mates, sensor));
    }
    found.retain(Candidate::is_sure);
    found.sort_by(|left, right| right.score.total_cmp(&left.score));
    found
}

/// The best candidate as a fault, with those that come near it.
fn named(best: &Candidate, others: &[Candidate], grid: &Grid) -> ReadingFault {
    let names = |candidate: &Candidate| -> Vec<String> {
        candidate.sensors.iter().map(|&sensor| grid.sensors[sensor].name.clone()).collect()
    };
    let mut alternatives: Vec<_> = others
        .iter()
        .filter(|other| other.score > best.score - FAR)
        .take(MOST_ALTERNATIVES)
        .map(|other| (other.effect, names(other), other.score - best.score))
        .collect();
    if let Some(offset) = best.parameters.iter().find(|parameter| parameter.name == "offset_s" && parameter.value > 0.0)
    {
        // A lag of everything else is the same to first order; the later the kinks, the less heat can excuse it.
        alternatives.push(("thermal_lag", Vec::new(), -0.5 * (offset.value / 30.0).powi(2)));
    }
    ReadingFault {
        effect: best.effect,
        sensors: names(best),
        parameters: best.parameters.clone(),
        ln_p: best.ln_p_of_all(),
        evidence: best.evidence.clone(),
        alternatives,
    }
}
