//! `thermokin report`: everything on one page.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::{Value, json};

use super::campaign::RunOptions;
use super::output::{JsonOption, write_whole};
use super::progress::Steps;
use super::validate::RefitName;
use super::{Failure, calibrate as calibrate_command, discover as discover_command, validate as validate_command};
use crate::calibrate::{
    Calibration, CalibrationError, Folds, HeldOutBy, ObserveOptions, Refit, Request, Trial, calibrate, held_out,
};
use crate::discover::{Discovery, DiscoveryError, DiscoveryRequest, discover};
use crate::input::InputError;
use crate::model::Model;
use crate::report::{
    Contents, InputFile, LinkQuality, Provenance, Quality, Tried, coefficients, page, parameters, sha256_of,
    sha256_of_run, verdict,
};
use crate::robot::Robot;
use crate::run::{self, Run};

/// Put everything that is known of a run and its model on one HTML page that opens from disk
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  thermokin report run-75-25 model.json --validate run-90-30 --out report.html\n  \
    thermokin report host/data/ur10 ur10.json --poses every:10 --out report.html")]
pub struct Arguments {
    /// The run folder
    run: PathBuf,
    /// The model, as calibrate or discover wrote it
    model: PathBuf,
    /// Judge the model on this run, too, of which its calibration saw nothing
    #[arg(long, value_name = "RUN2")]
    validate: Option<PathBuf>,
    /// Find these anew on that run before judging
    #[arg(long, value_enum, value_delimiter = ',', value_name = "base,targets", requires = "validate")]
    refit: Vec<RefitName>,
    /// The page
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    options: RunOptions,
    /// Do not look for what the model gets wrong: much faster
    #[arg(long)]
    no_discover: bool,
    /// What `log export --json` said of the temperatures: what was lost, how well the clocks are known
    #[arg(long, value_name = "FILE")]
    log_export: Option<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
}

/// A run with the description of its arm.
pub(super) struct Described {
    /// The run.
    pub run: Run,
    /// Its arm.
    pub robot: Robot,
}

/// A discovery for a page.
pub(super) enum Sought<'a> {
    /// It is left out.
    No,
    /// It is to be made.
    Yes,
    /// It has been made; none where the run was too small to judge.
    Done(Option<&'a Discovery>),
}

/// What a report is made from.
pub(super) struct Material<'a> {
    /// The run that the report is about.
    pub own: &'a Described,
    /// Which of its visits the model was calibrated on; none: all of them.
    pub taken: Option<Vec<bool>>,
    /// Another run to judge the model by.
    pub other: Option<&'a Described>,
    /// What to find anew on it.
    pub refit: Refit,
    /// The model, and the name of its file.
    pub model: (&'a Model, &'a Path),
    /// How runs are read.
    pub observe: ObserveOptions,
    /// What the model gets wrong.
    pub discovery: Sought<'a>,
    /// What the export of the temperatures said.
    pub link: Option<LinkQuality>,
    /// The command that makes the page.
    pub command: String,
}

/// A page with the results that it shows.
pub(super) struct Made {
    /// The object of `--json`.
    pub results: Value,
    /// The HTML.
    pub html: String,
}

/// Carries the command out.
///
/// # Errors
/// Bad input, or work that fails.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let model = Model::read(&arguments.model)?;
    let (run, robot) = arguments.options.read(&arguments.run)?;
    let taken = arguments.options.poses.as_ref().map(|selection| selection.mask(&run.visits));
    let own = Described { run, robot };
    let other = arguments.validate.as_deref().map(Described::read).transpose()?;
    let link = arguments.log_export.as_deref().map(read_link).transpose()?;
    let made = make(&Material {
        own: &own,
        taken,
        other: other.as_ref(),
        refit: Refit {
            base: arguments.refit.contains(&RefitName::Base),
            targets: arguments.refit.contains(&RefitName::Targets),
        },
        model: (&model, &arguments.model),
        observe: arguments.options.observe(),
        discovery: if arguments.no_discover { Sought::No } else { Sought::Yes },
        link,
        command: as_given(),
    })?;
    write_whole(&arguments.out, made.html.as_bytes())?;
    if arguments.json.leaves_words() {
        for sentence in made.results["verdict"].as_array().into_iter().flatten().filter_map(Value::as_str) {
            println!("{sentence}");
        }
        println!("report written to {}", arguments.out.display());
    }
    arguments.json.write(&made.results)
}

impl Described {
    /// Reads a run and its own robot description.
    ///
    /// # Errors
    /// Whatever is wrong with their files.
    pub fn read(folder: &Path) -> Result<Self, InputError> {
        let run = run::read(folder)?;
        let robot = Robot::read(&run.description.robot)?;
        Ok(Self { run, robot })
    }
}

/// The command line as it was given, fit for a shell.
pub(super) fn as_given() -> String {
    let quoted = |word: String| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:,=+@%".contains(c);
        if !word.is_empty() && word.chars().all(plain) { word } else { format!("'{}'", word.replace('\'', "'\\''")) }
    };
    let words = std::env::args_os().skip(1).map(|word| quoted(word.to_string_lossy().into_owned()));
    std::iter::once("thermokin".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}

fn read_link(file: &Path) -> Result<LinkQuality, InputError> {
    let text =
        std::fs::read_to_string(file).map_err(|error| InputError::of_file(file, format!("cannot be read: {error}")))?;
    let written: Export = serde_json::from_str(&text).map_err(|error| {
        let message = format!("is not what log export --json writes: {error}");
        InputError { file: file.to_owned(), line: (error.line() > 0).then(|| error.line()), message }
    })?;
    Ok(written.exported)
}

/// What `log export --json` writes, as far as it is needed here.
#[derive(serde::Deserialize)]
struct Export {
    exported: LinkQuality,
}

/// Computes what a page shows, and writes it as HTML.
///
/// # Errors
/// A model that does not fit the run, and work that fails.
pub(super) fn make(material: &Material<'_>) -> Result<Made, Failure> {
    let Described { run, robot } = material.own;
    let (model, _) = material.model;
    let learns = |place: usize| material.taken.as_ref().is_none_or(|mask| mask[place]);
    let request = Request { observe: material.observe, ..Request::default() };
    let steps = Steps::new(5, "reporting");

    let trial = Trial::new(model, run, robot, &material.observe, Refit::default(), |visit| learns(visit.place))?;
    let other = match material.other {
        Some(other) => Some(Trial::new(model, &other.run, &other.robot, &material.observe, material.refit, |_| true)?),
        None if (0..run.visits.len()).all(learns) => None,
        None => Some(Trial::new(model, run, robot, &material.observe, Refit::default(), |visit| !learns(visit.place))?),
    };
    steps.done();
    let calibration = match calibrate(robot, run, &request, |visit| learns(visit.place)) {
        Ok(calibration) => Some(calibration),
        Err(CalibrationError::NotConverged(_)) => None,
        Err(error) => return Err(error.into()),
    };
    steps.done();
    let made;
    let discovery = match material.discovery {
        Sought::No => None,
        Sought::Yes => {
            made = look(robot, run, &request, true)?;
            made.as_ref()
        }
        Sought::Done(discovery) => discovery,
    };
    steps.done();
    let unseen = match &other {
        Some(trial) => judged(material, trial),
        None => folded(robot, run, &request, calibration.as_ref(), discovery, model),
    };
    steps.done();

    let hours =
        run.visits.last().zip(run.visits.first()).map_or(0.0, |(last, first)| last.time_s - first.time_s) / 3600.0;
    let mut results = json!({
        "format": 1, "command": "report",
        "robot": model.robot.name, "model": material.model.1,
        "run": {"name": run.description.name, "folder": run.folder, "hours": hours},
        "on_run": validate_command::as_json(&trial.validation(model, run)),
        "held_out": unseen,
        "parameters": parameters(model),
        "thermal_coefficients": coefficients(model),
        "identification": calibration.as_ref().map(|found| calibrate_command::as_json(found, None, None)),
        "discovery": discovery.map(discover_command::as_json),
        "quality": Quality::of(run, robot, &material.observe.join, material.link.clone()),
        "provenance": provenance(material)?,
    });
    results["verdict"] = json!(verdict(&results));
    let second = material.other.unwrap_or(material.own);
    let html = page(&Contents {
        results: &results,
        model,
        own: Tried { run, robot, trial: &trial },
        other: other.as_ref().map(|trial| Tried { run: &second.run, robot: &second.robot, trial }),
        calibration: calibration.as_ref(),
        discovery,
    });
    steps.done();
    Ok(Made { results, html })
}

/// What a discovery finds; none where the run is too small to judge.
pub(super) fn look(robot: &Robot, run: &Run, request: &Request, hold_out: bool) -> Result<Option<Discovery>, Failure> {
    let request = DiscoveryRequest { calibration: request.clone(), seed: 1, hold_out };
    match discover(robot, run, &request) {
        Ok(discovery) => Ok(Some(discovery)),
        Err(DiscoveryError::TooSmall) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// The model's errors on data that it did not see.
fn judged(material: &Material<'_>, trial: &Trial) -> Value {
    let (run, how) = match material.other {
        Some(other) => {
            (&other.run, format!("run {}, of which the calibration saw nothing", other.run.description.name))
        }
        None => (
            &material.own.run,
            format!("the {} visits of this run that the model was not calibrated on", trial.campaign.visits.len()),
        ),
    };
    let mut value = validate_command::as_json(&trial.validation(material.model.0, run));
    value["how"] = json!(how);
    value
}

/// Errors on folds of the run itself, each predicted by a calibration that was made without it.
fn folded(
    robot: &Robot,
    run: &Run,
    request: &Request,
    calibration: Option<&Calibration>,
    discovery: Option<&Discovery>,
    model: &Model,
) -> Value {
    let folds = Folds { by: HeldOutBy::Pose, count: 5, seed: 1 };
    let found = calibration.and_then(|found| held_out(robot, run, request, &found.campaign, folds, |_| ()).ok());
    let extended = discovery.and_then(|discovery| discovery.extended.held_out).filter(|_| model.extended.is_some());
    match (found, extended) {
        (None, None) => Value::Null,
        (found, extended) => {
            let mut value = json!({
                "how": "calibrations of this run made anew without a fifth of its poses each, whose errors these are",
            });
            if let Some(found) = found {
                value["thermal"] = json!(found.errors);
            }
            if let Some(extended) = extended {
                value["extended"] = json!(extended);
            }
            value
        }
    }
}

fn provenance(material: &Material<'_>) -> Result<Provenance, Failure> {
    let unreadable = |error: crate::report::ProvenanceError| Failure::Work(error.to_string());
    let of = |described: &Described| -> Result<Vec<InputFile>, Failure> {
        sha256_of_run(&described.run.folder, &described.run.description.robot).map_err(unreadable)
    };
    let mut inputs = of(material.own)?;
    inputs.push(sha256_of(material.model.1).map_err(unreadable)?);
    if let Some(other) = material.other {
        inputs.extend(of(other)?);
    }
    Ok(Provenance {
        command: material.command.clone(),
        version: env!("CARGO_PKG_VERSION"),
        charts: "plotly.js 3.7.0",
        inputs,
    })
}
