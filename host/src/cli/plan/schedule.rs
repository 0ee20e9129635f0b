//! `thermokin plan schedule`: when to warm up and cool down.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use super::write;
use crate::cli::Failure;
use crate::cli::output::JsonOption;
use crate::cli::progress::Steps;
use crate::plan::{ScheduleError, TriedSchedule, prepared, schedule_of, tell_apart};

/// Warm-up and cool-down that tell thermal coefficients apart best in a given time
#[derive(Debug, Args)]
pub struct Arguments {
    /// What is believed of the arm and its heat: a scenario file, or the name of one that ships
    scenario: PathBuf,
    /// How long the run may take, hours
    #[arg(long, value_name = "H")]
    hours: f64,
    /// Speed overrides to try for warm-up and cool-down, from 0 (rest) to 1
    #[arg(long, value_name = "A,B", value_delimiter = ',', default_value = "0,0.25,0.5,0.75,1")]
    overrides: Vec<f64>,
    /// The postures to measure, as `plan poses` writes them [default: the scenario's]
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// The scenario to write, for `thermokin simulate`
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
}

impl From<ScheduleError> for Failure {
    fn from(error: ScheduleError) -> Self {
        match error {
            ScheduleError::Run(error) => Failure::Input(error),
            error => Failure::Usage(error.to_string()),
        }
    }
}

pub(super) fn as_json(tried: &TriedSchedule) -> Value {
    json!({
        "phases": tried.phases.iter().map(|phase| json!({
            "override": phase.speed_override, "cycles": phase.cycles, "joints": phase.joints,
        })).collect::<Vec<_>>(),
        "duration_s": tried.duration_s, "index": tried.index,
        "coefficients": tried.coefficients.iter().map(|(name, sigma)| json!({"name": name, "sigma": sigma})).collect::<Vec<_>>(),
        "links": tried.links.iter().map(|(link, rise, share)| json!({
            "link": link, "rise_k": rise, "share_of_its_own": share,
        })).collect::<Vec<_>>(),
    })
}

pub(super) fn hours(value: f64) -> Result<(), Failure> {
    match value.is_finite() && value > 0.0 && value <= 1000.0 {
        true => Ok(()),
        false => Err(Failure::Usage(format!("--hours {value}: expected a number above 0, 1000 at most"))),
    }
}

/// Carries the command out.
///
/// # Errors
/// Bad usage or input; too little time.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    hours(arguments.hours)?;
    if let Some(wrong) = arguments.overrides.iter().find(|value| !(0.0..=1.0).contains(*value)) {
        return Err(Failure::Usage(format!("--overrides {wrong}: expected shares from 0 to 1")));
    }
    let base = write::read(&arguments.scenario)?;
    let postures = write::postures(&base, arguments.poses.as_deref())?;
    let planned = prepared(&base.scenario, postures.as_deref());
    let before = tell_apart(&planned)?;
    let pairs = arguments.overrides.len() * arguments.overrides.len().saturating_sub(1) / 2;
    let steps = Steps::new(4 * pairs as u64, "trying schedules");
    let tried = schedule_of(&planned, arguments.hours, &arguments.overrides, |_| steps.done())?;
    drop(steps);
    let best = &tried[0];
    if let Some(out) = &arguments.out {
        write::scenario(&base, &planned, &best.phases, out)?;
    }
    if arguments.json.leaves_words() {
        println!("{}: {} schedules tried, best first, then the scenario's own", base.scenario.name, tried.len());
        println!("\n  index (larger tells more)   hours   cycle 0 cold, then");
        for own in tried.iter().take(5).chain([&before]) {
            let words: Vec<String> = own.phases.iter().map(write::phase).collect();
            println!("  {:25.4e} {:7.1}   {}", own.index, own.duration_s / 3600.0, words.join(", "));
        }
        println!("\n  thermal coefficient   SD, best schedule   SD, the scenario's own   (1e-6 m/K or rad/K)");
        for ((name, sigma), (_, other)) in best.coefficients.iter().zip(&before.coefficients) {
            println!("  {name:<21} {:17.4} {:24.4}", sigma * 1e6, other * 1e6);
        }
        if let Some(out) = &arguments.out {
            println!("\n  written to {}", out.display());
        }
    }
    arguments.json.write(&json!({
        "format": 1, "command": "plan", "plan": "schedule", "hours": arguments.hours,
        "best": as_json(best), "own": as_json(&before), "tried": tried.iter().map(as_json).collect::<Vec<_>>(),
    }))
}
