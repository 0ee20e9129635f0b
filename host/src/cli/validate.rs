//! `thermokin validate`: the errors of a model on other data.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::json;

use super::Failure;
use super::campaign::RunOptions;
use super::output::JsonOption;
use super::words;
use crate::calibrate::{Group, Refit, Validation, validate};
use crate::model::Model;

/// What can be found anew on the other run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum RefitName {
    /// The base: the instrument or the arm stands elsewhere
    Base,
    /// The targets: another tool
    Targets,
}

/// Judge a model by the errors of position on another run
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  thermokin validate model.json run-90-30\n  \
    thermokin validate tx2.json other-day --refit base,targets")]
pub struct Arguments {
    /// The model, as calibrate wrote it
    model: PathBuf,
    /// The run folder
    run: PathBuf,
    #[command(flatten)]
    options: RunOptions,
    /// Find these anew on the run before judging
    #[arg(long, value_enum, value_delimiter = ',', value_name = "base,targets")]
    refit: Vec<RefitName>,
    #[command(flatten)]
    json: JsonOption,
}

/// Carries the command out.
///
/// # Errors
/// Bad input.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let model = Model::read(&arguments.model)?;
    let (run, robot) = arguments.options.read(&arguments.run)?;
    let mask = arguments.options.poses.as_ref().map(|selection| selection.mask(&run.visits));
    let refit = Refit {
        base: arguments.refit.contains(&RefitName::Base),
        targets: arguments.refit.contains(&RefitName::Targets),
    };
    let validation = validate(&model, &run, &robot, &arguments.options.observe(), refit, |visit| {
        mask.as_ref().is_none_or(|mask| mask[visit.place])
    })?;
    if arguments.json.leaves_words() {
        say(&model, &validation);
    }
    arguments.json.write(&as_json(&validation))
}

/// Longer tables than this are for programs.
const MOST_ROWS: usize = 40;

fn say(model: &Model, validation: &Validation) {
    println!("{}: {} visits, {} points", model.robot.name, validation.visits, validation.points);
    for note in &validation.notes {
        println!("note: {note}");
    }
    println!("\nposition error       mean      RMS      max  mm");
    let levels = levels(validation);
    for (name, errors) in levels.iter().zip(&validation.errors) {
        println!("{}", words::errors(name, errors));
    }
    for (name, groups) in [("cycle", &validation.cycles), ("pose", &validation.poses)] {
        if groups.len() < 2 {
            continue;
        }
        if groups.len() > MOST_ROWS {
            println!("\nmean error of {} {name}s: see --json", groups.len());
            continue;
        }
        let heads: Vec<String> = levels.iter().map(|level| format!("{level:>10}")).collect();
        println!("\n{name:>6}   time s      °C {}  (mean, mm)", heads.concat());
        for group in groups {
            let temperature = group.temperature.map_or_else(|| "-".to_owned(), |celsius| format!("{celsius:.2}"));
            let means: Vec<String> =
                levels.iter().zip(&group.errors).map(|(_, errors)| format!("{:10.3}", errors.mean_mm)).collect();
            println!("{:6} {:8.0} {temperature:>7} {}", group.number, group.time_s, means.concat());
        }
    }
}

/// The levels that are worth reporting, by their names.
fn levels(validation: &Validation) -> &'static [&'static str] {
    match validation.has_effects {
        true => &["nominal", "geometric", "thermal", "extended"],
        false => &["nominal", "geometric", "thermal"],
    }
}

/// The object of `--json` (contract `results.md`).
pub(super) fn as_json(validation: &Validation) -> serde_json::Value {
    let levels = levels(validation);
    let row = |name: &str, group: &Group| {
        let mut value = json!({ name: group.number, "time_s": group.time_s, "temperature_c": group.temperature });
        for (level, errors) in levels.iter().zip(&group.errors) {
            value[format!("{level}_mm")] = json!(errors.mean_mm);
        }
        value
    };
    let mut value =
        json!({ "format": 1, "command": "validate", "visits": validation.visits, "points": validation.points });
    for (level, errors) in levels.iter().zip(&validation.errors) {
        value[*level] = json!(errors);
    }
    value["cycles"] = validation.cycles.iter().map(|group| row("cycle", group)).collect();
    value["poses"] = validation.poses.iter().map(|group| row("pose", group)).collect();
    value["notes"] = json!(validation.notes);
    value
}
