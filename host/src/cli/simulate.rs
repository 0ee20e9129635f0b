//! `thermokin simulate`: a scenario, or a model on the visits of a run, into a run folder.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::Failure;
use super::output::JsonOption;
use crate::calibrate::ObserveOptions;
use crate::discover::{Replayed, replay};
use crate::model::Model;
use crate::robot::Robot;
use crate::run;
use crate::simulate::{SHIPPED_SCENARIOS, Scenario, Simulated, TrueCycle, simulate};

const AFTER_HELP: &str = "Example:\n  thermokin simulate thesis-75-25 --out /tmp/run --seed 3\n  thermokin simulate RUN --model extended.json --out /tmp/again\n\n\
    Scenarios that ship: thesis-75-25 and thesis-90-30 (one arm, two runs), small. host/docs/scenario.md says how to \
    write one.";

/// Simulate a run: an arm that warms up and cools down, its temperature sensors and a laser tracker
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct Arguments {
    /// A scenario file, or the name of one that ships; with --model, a run folder
    #[arg(value_name = "SCENARIO")]
    scenario: PathBuf,
    /// Measure the visits of a run again, at its temperatures, on an arm that is as this model says, noise and effects included
    #[arg(long, value_name = "MODEL", conflicts_with = "truth")]
    model: Option<PathBuf>,
    /// The run folder to make
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
    /// The seed of the run instead of the scenario's; the arm keeps its own. With --model: of the noise
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Write what only the simulator knows, as JSON
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
    /// Replace the run in a folder that is not empty
    #[arg(long)]
    force: bool,
}

/// Carries the command out.
///
/// # Errors
/// Bad usage or input; a disk that does not take the run.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let out = &arguments.out;
    let occupied = std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
    if occupied && !arguments.force {
        return Err(Failure::Usage(format!("{}: is not empty; expected a new folder, or --force", out.display())));
    }
    if let Some(model) = &arguments.model {
        return again(arguments, &Model::read(model)?);
    }
    let mut scenario = scenario(&arguments.scenario)?;
    if let Some(seed) = arguments.seed {
        scenario.seed = seed;
    }
    let simulated = simulate(&scenario).map_err(|error| Failure::Usage(format!("{}: {error}", scenario.name)))?;
    simulated.write(out).map_err(|error| Failure::Work(error.to_string()))?;
    if let Some(file) = &arguments.truth {
        let text = serde_json::to_string_pretty(&simulated.truth).map_err(|error| Failure::Work(error.to_string()))?;
        std::fs::write(file, format!("{text}\n"))
            .map_err(|error| Failure::Work(format!("{}: cannot be written: {error}", file.display())))?;
    }
    if arguments.json.leaves_words() {
        print_summary(&simulated, out);
    }
    arguments.json.write(&summary_json(&simulated))
}

/// A run that is measured again on an arm that is as a model says.
fn again(arguments: &Arguments, model: &Model) -> Result<(), Failure> {
    let run = run::read(&arguments.scenario)?;
    let robot = Robot::read(&run.description.robot)?;
    let seed = arguments.seed.unwrap_or(1);
    let Replayed { run: replayed, notes } = replay(model, &run, &robot, &ObserveOptions::default(), seed)?;
    run::write(&replayed, &arguments.out).map_err(|error| Failure::Work(error.to_string()))?;
    if arguments.json.leaves_words() {
        let (visits, points) = (replayed.visits.len(), replayed.point_count());
        println!("{}: {visits} visits, {points} points, as {} has them", arguments.out.display(), model.robot.name);
        for note in &notes {
            println!("note: {note}");
        }
    }
    arguments.json.write(&json!({
        "format": 1, "command": "simulate", "seed": seed, "visits": replayed.visits.len(),
        "points": replayed.point_count(), "notes": notes,
    }))
}

fn scenario(named: &Path) -> Result<Scenario, Failure> {
    if !named.exists()
        && let Some(scenario) = named.to_str().and_then(Scenario::shipped)
    {
        return Ok(scenario);
    }
    if !named.exists() && named.extension().is_none() {
        let names: Vec<&str> = SHIPPED_SCENARIOS.iter().map(|(name, _)| *name).collect();
        let message = format!("{}: no such file; expected one, or one of {}", named.display(), names.join(", "));
        return Err(Failure::Usage(message));
    }
    Ok(Scenario::read(named)?)
}

/// The highest value of a kind over the cycles; 0 at least.
fn highest(cycles: &[TrueCycle], value: impl Fn(&TrueCycle) -> f64) -> f64 {
    cycles.iter().map(value).fold(0.0, f64::max)
}

fn summary_json(simulated: &Simulated) -> serde_json::Value {
    let truth = &simulated.truth;
    json!({
        "format": 1,
        "command": "simulate",
        "scenario": truth.scenario,
        "seed": truth.seed,
        "arm_seed": truth.arm_seed,
        "cycles": truth.cycles.len(),
        "visits": simulated.run.visits.len(),
        "points": simulated.run.point_count(),
        "broken_beams": simulated.run.visits.iter().map(|visit| visit.broken_beams.len()).sum::<usize>(),
        "nominal_mean_mm": truth.cycles.first().map_or(0.0, |cycle| cycle.nominal_error_m * 1e3),
        "drift_max_mm": highest(&truth.cycles, |cycle| cycle.drift_m) * 1e3,
        "warmest_housing_c": highest(&truth.cycles, |cycle| cycle.warmest_housing_c),
    })
}

fn print_summary(simulated: &Simulated, out: &Path) {
    let (run, truth) = (&simulated.run, &simulated.truth);
    let cycles = &truth.cycles;
    let end_s = run.motion.last().map_or(0.0, |step| step.end_s);
    println!("{}: {} (run seed {}, arm seed {})", out.display(), truth.scenario, truth.seed, truth.arm_seed);
    println!(
        "  {} cycles in {:.1} h, {} visits, {} points, {} beams broken",
        cycles.len(),
        end_s / 3600.0,
        run.visits.len(),
        run.point_count(),
        run.visits.iter().map(|visit| visit.broken_beams.len()).sum::<usize>()
    );
    println!(
        "  nominal error {:.2} mm on average when cold",
        cycles.first().map_or(0.0, |cycle| cycle.nominal_error_m) * 1e3
    );
    println!(
        "  warmest housing {:.1} °C; drift of the tool at most {:.2} mm on average over a cycle",
        highest(cycles, |cycle| cycle.warmest_housing_c),
        highest(cycles, |cycle| cycle.drift_m) * 1e3
    );
}
