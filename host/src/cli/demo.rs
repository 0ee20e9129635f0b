//! `thermokin demo`: the whole chain on one machine, told in ten lines.

mod link;
mod measured;
mod twin;

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use super::Failure;
use super::output::{JsonOption, write_whole};
use super::report::{Described, Made};
use crate::calibrate::{Calibration, ObservedVisit, Request, Validation, calibrate};
use crate::model::{Errors, Model};
use crate::robot::Robot;
use crate::run::Run;

/// What the demonstration works on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Data {
    /// Two runs of one simulated arm, whose temperatures go through link boards and the logger
    Simulated,
    /// The measured run that ships with thermokin
    Ur10,
}

/// Show the whole chain at work: a run, a calibration, its errors on data that it did not see, what it gets wrong, a report
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  thermokin demo --out /tmp/demo\n  thermokin demo --data ur10")]
pub struct Arguments {
    /// The folder that the runs, the models and the report are written into
    #[arg(long, value_name = "DIR", default_value = "thermokin-demo")]
    out: PathBuf,
    /// What to work on
    #[arg(long, value_enum, default_value = "simulated")]
    data: Data,
    #[command(flatten)]
    json: JsonOption,
}

/// What a demonstration has to say: lines for people, an object for programs.
struct Told {
    lines: Vec<String>,
    result: Value,
}

/// Carries the command out.
///
/// # Errors
/// A disk that does not take the files.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let told = match arguments.data {
        Data::Simulated => twin::tell(&arguments.out)?,
        Data::Ur10 => measured::tell(&arguments.out)?,
    };
    if arguments.json.leaves_words() {
        for line in &told.lines {
            println!("{line}");
        }
    }
    arguments.json.write(&told.result)
}

/// A calibration and the seconds that it took.
fn timed_calibration(
    robot: &Robot,
    run: &Run,
    pick: impl Fn(&ObservedVisit) -> bool,
) -> Result<(Calibration, f64), Failure> {
    let begun = Instant::now();
    let calibration = calibrate(robot, run, &Request::default(), pick)?;
    Ok((calibration, begun.elapsed().as_secs_f64()))
}

fn write_model(model: &Model, file: &Path) -> Result<(), Failure> {
    model.write(file).map_err(|error| Failure::Work(error.to_string()))
}

/// Writes a report's page, and says where.
fn write_report(made: &Made, out: &Path) -> Result<String, Failure> {
    let page = out.join("report.html");
    write_whole(&page, made.html.as_bytes())?;
    Ok(format!("all of it with its plots, in a browser: {}", page.display()))
}

fn unwritable(file: &Path, error: &std::io::Error) -> Failure {
    Failure::Work(format!("{}: cannot be written: {error}", file.display()))
}

/// "30 of 30 unknowns, 9 thermal coefficients".
fn found(calibration: &Calibration) -> String {
    let joint = &calibration.joint;
    let growth = calibration.model.growth.len();
    let asked = joint.unknowns.len() + joint.held.len() + joint.weak.len();
    let geometric = format!("{} of {} unknowns of geometry", joint.unknowns.len() - growth, asked - growth);
    if growth == 0 { geometric } else { format!("{geometric}, {growth} thermal coefficients") }
}

fn means([nominal, geometric, thermal]: &[Errors; 3]) -> String {
    let growth = if geometric == thermal { String::new() } else { format!(", thermal {:.3} mm", thermal.mean_mm) };
    format!("nominal {:.3} mm, geometric {:.3} mm{growth}", nominal.mean_mm, geometric.mean_mm)
}

fn levels([nominal, geometric, thermal]: &[Errors; 3]) -> Value {
    json!({ "nominal": nominal, "geometric": geometric, "thermal": thermal })
}

/// The levels of a model that carries no effects.
fn without_effects(validation: &Validation) -> [Errors; 3] {
    let [nominal, geometric, thermal, _] = validation.errors;
    [nominal, geometric, thermal]
}

/// What a discovery found, in words: every finding with its place and its first number.
fn findings(results: &Value) -> String {
    let findings = results["discovery"]["findings"].as_array().map_or(&[][..], Vec::as_slice);
    let told = findings.iter().map(|finding| {
        let numbers = finding["parameters"].as_array().map_or(&[][..], Vec::as_slice);
        let number = numbers.first().filter(|number| number["low"].is_number()).map(|number| {
            let [value, low, high] = ["value", "low", "high"].map(|field| number[field].as_f64().unwrap_or(f64::NAN));
            format!(" ({} {value:.2e}, 95 % {low:.2e} to {high:.2e})", number["name"].as_str().unwrap_or(""))
        });
        format!("{}{}", crate::report::finding_name(finding), number.unwrap_or_default())
    });
    match told.collect::<Vec<_>>() {
        told if told.is_empty() => "no cause that the data support".to_owned(),
        told => told.join(", "),
    }
}

/// A run read back from its folder, as a user's is.
fn read(folder: &Path) -> Result<Described, Failure> {
    Ok(Described::read(folder)?)
}
