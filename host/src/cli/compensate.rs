//! `thermokin compensate`: what a robot has to be told so that it stands where it should.

use std::io::{Read as _, Write as _};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args};
use serde_json::json;

use super::Failure;
use super::conditions::{LevelName, Temperatures};
use super::output::JsonOption;
use super::upkeep::keep;
use crate::calibrate::Drift;
use crate::compensate::batch::{self, BatchError, Outcome, Setting, Task};
use crate::compensate::live::{Listening, Server, Source};
use crate::compensate::{Arm, Conditions};
use crate::input::InputError;
use crate::logger::serve::stop_on_signals;
use crate::model::{Level, Model};
use crate::run::TemperatureLog;

const AFTER_HELP: &str = "\
Examples:
  thermokin compensate model.json --correct path.csv --temperatures run/temperatures.csv --out corrected.csv
  thermokin compensate model.json --inverse poses.csv --all
  thermokin compensate model.json --live 127.0.0.1:7117 --store thermokin-log
  thermokin compensate model.json --checks checks-2026 --out model-now.json

host/docs/compensate.md says what the tables hold and what is asked and answered live.";

/// Forward and inverse kinematics of a calibrated arm at given or present temperatures
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
#[command(group = ArgGroup::new("task").required(true).multiple(false))]
pub struct Arguments {
    /// The model, as calibrate or discover wrote it
    model: PathBuf,
    /// Where the flange stands: a table with q1 to qN (rad, m), - for standard input
    #[arg(long, value_name = "FILE", group = "task")]
    forward: Option<PathBuf>,
    /// What to command instead of q1 to qN so that the arm stands where the nominal one would
    #[arg(long, value_name = "FILE", group = "task")]
    correct: Option<PathBuf>,
    /// Joints for places of the flange: x_m, y_m, z_m, qw, qx, qy, qz in the world frame, seeds q1 to qN where given
    #[arg(long, value_name = "FILE", group = "task")]
    inverse: Option<PathBuf>,
    /// Answer a robot at this address of the machine itself (TCP), a line of JSON each
    #[arg(long, value_name = "ADDRESS", group = "task")]
    live: Option<SocketAddr>,
    /// The same at a Unix socket
    #[cfg(unix)]
    #[arg(long, value_name = "PATH", group = "task")]
    live_unix: Option<PathBuf>,
    /// Refine the model by occasional checks of single targets: a run folder of them; --out is the refined model
    #[arg(long, value_name = "RUN", group = "task", requires = "out")]
    checks: Option<PathBuf>,
    /// With --checks: 1-sigma by which thermal coefficients drift in a year, as a share of themselves
    #[arg(long, value_name = "SHARE", default_value_t = 0.14, requires = "checks")]
    drift: f64,
    /// With --checks: error of a position that stays with a posture, 1-sigma of a coordinate, mm
    #[arg(long, value_name = "MM", default_value_t = 0.2, requires = "checks")]
    posture_error: f64,
    /// The solutions of all branches, a row each
    #[arg(long, requires = "inverse")]
    all: bool,
    /// Temperatures as a run has them: at each row's time_s, or the last ones; live: followed as they are added
    #[arg(long, value_name = "FILE", conflicts_with = "store")]
    temperatures: Option<PathBuf>,
    /// The store of the logger whose present temperatures are followed
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
    #[command(flatten)]
    given: Temperatures,
    /// What the flange carries, kg, where the table has no payload_kg
    #[arg(long, value_name = "KG", default_value_t = 0.0)]
    payload: f64,
    /// How much of the model is used
    #[arg(long, value_enum, default_value = "extended")]
    level: LevelName,
    /// The table of answers [default: standard output]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
}

/// Carries the command out.
///
/// # Errors
/// Bad usage or input; a disk or an address that is not to be had.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let model = Model::read(&arguments.model)?;
    let level = arguments.level.level();
    if let Some(listening) = arguments.listening() {
        return live(arguments, &model, level, &listening);
    }
    if let (Some(checks), Some(out)) = (&arguments.checks, &arguments.out) {
        return keep(&model, checks, out, arguments.drift()?, &arguments.json);
    }
    let arm = Arm::new(&model, level);
    for note in arm.notes() {
        eprintln!("note: {note}");
    }
    if arguments.store.is_some() {
        return Err(Failure::Usage("--store is followed live; expected --temperatures for a table".to_owned()));
    }
    let (task, file) = arguments.task()?;
    let setting = arguments.setting(&arm)?;
    let bytes = read(file)?;
    let outcome = batch::run(&arm, task, &setting, file, &bytes).map_err(|error| match error {
        BatchError::Input(error) => Failure::Input(error),
        BatchError::Output(error) => Failure::Work(error.to_string()),
    })?;
    match &arguments.out {
        Some(out) => std::fs::write(out, &outcome.table)
            .map_err(|error| Failure::Work(format!("{}: cannot be written: {error}", out.display())))?,
        None if arguments.json.leaves_words() => std::io::stdout()
            .write_all(&outcome.table)
            .map_err(|error| Failure::Work(format!("standard output: {error}")))?,
        None => {}
    }
    say(&outcome);
    arguments.json.write(&json!({
        "format": 1, "command": "compensate", "rows": outcome.rows, "failed": outcome.failed, "bounded": outcome.bounded,
        "largest_correction": outcome.largest, "notes": arm.notes(),
    }))?;
    match outcome.failed {
        0 => Ok(()),
        failed => {
            Err(Failure::Work(format!("{failed} of {} rows have no solution; their status says why", outcome.rows)))
        }
    }
}

fn say(outcome: &Outcome) {
    let bounded = match outcome.bounded {
        0 => String::new(),
        count => format!(", {count} of them made smaller to stay within the model's bounds"),
    };
    eprintln!("{} rows{bounded}", outcome.rows);
}

fn read(file: &Path) -> Result<Vec<u8>, InputError> {
    let mut bytes = Vec::new();
    let outcome = match file == Path::new("-") {
        true => std::io::stdin().read_to_end(&mut bytes).map(|_| bytes),
        false => std::fs::read(file),
    };
    outcome.map_err(|error| InputError::of_file(file, format!("cannot be read: {error}")))
}

impl Arguments {
    fn listening(&self) -> Option<Listening> {
        #[cfg(unix)]
        if let Some(path) = &self.live_unix {
            return Some(Listening::Unix(path.clone()));
        }
        self.live.map(Listening::Tcp)
    }

    fn drift(&self) -> Result<Drift, Failure> {
        for (name, value) in [("drift", self.drift), ("posture-error", self.posture_error)] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Failure::Usage(format!("--{name} {value}: expected a number from 0")));
            }
        }
        const DAYS: f64 = 365.0;
        Ok(Drift {
            coefficient_share: self.drift / DAYS.sqrt(),
            posture_m: self.posture_error * 1e-3,
            ..Drift::default()
        })
    }

    fn task(&self) -> Result<(Task, &Path), Failure> {
        let tasks = [
            (Task::Forward, &self.forward),
            (Task::Correct, &self.correct),
            (Task::Inverse { all: self.all }, &self.inverse),
        ];
        let given = tasks.into_iter().find_map(|(task, file)| Some((task, file.as_deref()?)));
        given.ok_or_else(|| Failure::Usage("expected --forward, --correct, --inverse, --checks or --live".to_owned()))
    }

    fn setting(&self, arm: &Arm) -> Result<Setting, Failure> {
        if !(self.payload.is_finite() && self.payload >= 0.0) {
            return Err(Failure::Usage(format!("--payload {}: expected kilograms from 0", self.payload)));
        }
        if !self.given.is_empty() && self.temperatures.is_some() {
            return Err(Failure::Usage("--temperature and --temperatures: expected one of them".to_owned()));
        }
        let conditions = Conditions { payload_kg: self.payload, ..self.given.conditions(arm.model())? };
        let Some(file) = &self.temperatures else { return Ok(Setting { conditions, log: None }) };
        let mut notes = Vec::new();
        let log = TemperatureLog::read(file, &mut notes)?;
        notes.iter().for_each(|note| eprintln!("note: {note}"));
        let last =
            log.series.iter().filter_map(|series| series.times_s().last().copied()).fold(f64::NEG_INFINITY, f64::max);
        let conditions =
            batch::at_time(arm, &log, last, &conditions).map_err(|message| InputError::of_file(file, message))?;
        Ok(Setting { conditions, log: Some(log) })
    }
}

fn live(arguments: &Arguments, model: &Model, level: Level, listening: &Listening) -> Result<(), Failure> {
    if !arguments.given.is_empty() {
        return Err(Failure::Usage("--temperature is for tables; live, give --store or --temperatures".to_owned()));
    }
    let source = match (&arguments.store, &arguments.temperatures) {
        (Some(store), _) => Some(Source::store(store)),
        (None, Some(file)) => Some(Source::table(file)),
        (None, None) => None,
    };
    let stop = stop_on_signals().map_err(|error| Failure::Work(format!("signals: {error}")))?;
    for note in Arm::new(model, level).notes() {
        eprintln!("note: {note}");
    }
    let server = Server::begin(model, level, source, listening, stop, |words| eprintln!("{words}"))
        .map_err(|error| Failure::Usage(error.to_string()))?;
    match server.address() {
        Some(address) => eprintln!("listening at {address}"),
        None => eprintln!("listening"),
    }
    server.wait();
    Ok(())
}
