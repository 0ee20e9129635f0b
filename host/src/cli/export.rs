//! `thermokin export`: a model as what controllers and other programs read.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::json;

use super::Failure;
use super::conditions::{LevelName, Temperatures};
use super::output::JsonOption;
use crate::calibrate::{ObserveOptions, Refit, Trial};
use crate::compensate::Arm;
use crate::compensate::export::{Portable, apart, c_header, dh_table, from_dh_table, matlab, python};
use crate::model::Model;
use crate::report::write_tables;
use crate::robot::{Between, Robot, Transform, from_urdf, parametrise, urdf};
use crate::run;

/// What is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Form {
    /// A table of Denavit-Hartenberg parameters; refused where two axes are nearly parallel
    Dh,
    /// The same with Hayati-Mirmirani parameters between nearly parallel axes
    Table,
    /// URDF with calibrated origins
    Urdf,
    /// A module of Python that needs numpy alone
    Python,
    /// A function of MATLAB or Octave
    Matlab,
    /// A header of C99
    C,
    /// A run and what the model leaves of it, as a folder of Parquet files
    Parquet,
}

const AFTER_HELP: &str = "\
Examples:
  thermokin export model.json --form urdf --temperature L1S1=31.5 --out arm.urdf
  thermokin export model.json --form python --out arm.py
  thermokin export model.json --form parquet --run run-75-25 --out tables

dh, table and urdf hold the geometry at one state of temperatures; python, matlab and c take temperatures and directions.

parquet writes poses, points, temperatures, motion and distances with the columns of the run's files (poses with celsius_ and the\n\
sensor's name beside them), and residuals: time_s, cycle, pose, target, level, dx_m, dy_m, dz_m (measured less predicted, in the\n\
world frame) and distance_m.";

/// Corrected DH tables, URDF, Python, MATLAB and C from a model, each held against it before it is written
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct Arguments {
    /// The model, as calibrate or discover wrote it
    model: PathBuf,
    /// What to write
    #[arg(long, value_enum)]
    form: Form,
    /// The file to write; the folder for parquet
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// How much of the model is used
    #[arg(long, value_enum, default_value = "extended")]
    level: LevelName,
    /// The run for parquet
    #[arg(long, value_name = "RUN", required_if_eq("form", "parquet"))]
    run: Option<PathBuf>,
    #[command(flatten)]
    temperatures: Temperatures,
    #[command(flatten)]
    json: JsonOption,
}

/// What is promised of an export, m and of the components of unit vectors.
const PROMISED: f64 = 1e-9;

/// Carries the command out.
///
/// # Errors
/// Bad usage or input, a model that the form cannot hold, a disk that does not take the file.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let model = Model::read(&arguments.model)?;
    if arguments.form == Form::Parquet {
        return tables(arguments, &model);
    }
    if arguments.run.is_some() {
        return Err(Failure::Usage("--run is for parquet: the others hold a model alone".to_owned()));
    }
    let level = arguments.level.level();
    let mut notes = Vec::new();
    let (text, apart) = match arguments.form {
        Form::Dh | Form::Table | Form::Urdf => {
            let arm = Arm::new(&model, level);
            let values = arm.parameters(&arguments.temperatures.conditions(&model)?);
            notes.extend(arm.notes().iter().cloned());
            notes.extend(arm.effects_on_joints().iter().map(|effect| {
                format!(
                    "{}: adds to a joint at every posture and has no place in a table: not exported",
                    effect.effect.name()
                )
            }));
            let (text, transforms) = geometry(arguments.form, &model.robot, &values)?;
            let apart = apart(&model.robot, &values, &transforms);
            if apart.is_nan() || apart > PROMISED {
                let message =
                    format!("the export, read back, differs from the model by {apart:e} m: nothing is written");
                return Err(Failure::Work(message));
            }
            (text, Some(apart))
        }
        _ => {
            if !arguments.temperatures.is_empty() {
                let message = "--temperature is for dh, table and urdf: the others take temperatures with each call";
                return Err(Failure::Usage(message.to_owned()));
            }
            let portable = Portable::new(&model, level).map_err(|error| Failure::Usage(error.to_string()))?;
            notes.extend(portable.notes.iter().cloned());
            let text = match arguments.form {
                Form::Python => python(&portable),
                Form::C => c_header(&portable),
                _ => matlab(&portable, function_name(&arguments.out)?),
            };
            (text, None)
        }
    };
    std::fs::write(&arguments.out, text)
        .map_err(|error| Failure::Work(format!("{}: cannot be written: {error}", arguments.out.display())))?;
    if arguments.json.leaves_words() {
        notes.iter().for_each(|note| println!("note: {note}"));
        if let Some(apart) = apart {
            println!("read back: the flange stands within {apart:.1e} m of the model's");
        }
    }
    arguments.json.write(&json!({ "format": 1, "command": "export", "apart": apart, "notes": notes }))
}

/// The run and its residuals as Parquet.
fn tables(arguments: &Arguments, model: &Model) -> Result<(), Failure> {
    if !arguments.temperatures.is_empty() {
        return Err(Failure::Usage("--temperature is for dh, table and urdf: a run has its own".to_owned()));
    }
    let folder = arguments.run.as_deref().ok_or_else(|| Failure::Usage("--form parquet needs --run RUN".to_owned()))?;
    let run = run::read(folder)?;
    let robot = Robot::read(&run.description.robot)?;
    let options = ObserveOptions::default();
    let trial = Trial::new(model, &run, &robot, &options, Refit::default(), |_| true)?;
    let written =
        write_tables(&run, &trial, &options.join, &arguments.out).map_err(|error| Failure::Work(error.to_string()))?;
    if arguments.json.leaves_words() {
        run.notes.iter().chain(&trial.notes).for_each(|note| println!("note: {note}"));
        for table in &written {
            println!("{}: {} rows, {} columns, read back the same", table.file.display(), table.rows, table.columns);
        }
    }
    let tables: Vec<_> = written
        .iter()
        .map(|table| json!({ "file": table.file, "rows": table.rows, "columns": table.columns }))
        .collect();
    let notes: Vec<&String> = run.notes.iter().chain(&trial.notes).collect();
    arguments.json.write(&json!({ "format": 1, "command": "export", "tables": tables, "notes": notes }))
}

/// The text of a form that holds geometry alone, and the transforms that are read back from it.
fn geometry(form: Form, robot: &Robot, values: &[f64]) -> Result<(String, Vec<Transform>), Failure> {
    let refused = |error: &dyn std::fmt::Display| Failure::Work(error.to_string());
    if form == Form::Urdf {
        let text = urdf(robot, values).map_err(|error| refused(&error))?;
        let (_, axes) = from_urdf(&text, None).map_err(|error| refused(&error))?;
        let transforms = parametrise(&axes, Between::Proportional).map_err(|error| refused(&error))?;
        return Ok((text, transforms));
    }
    let between = if form == Form::Dh { Between::DhAlone } else { Between::Proportional };
    let text = dh_table(robot, values, between).map_err(|error| refused(&error))?;
    let transforms = from_dh_table(&text).map_err(|error| refused(&error))?;
    Ok((text, transforms))
}

/// The name of a MATLAB function, which is that of its file.
fn function_name(file: &Path) -> Result<&str, Failure> {
    let name = file.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    let letters = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    match letters
        && name.starts_with(|c: char| c.is_ascii_alphabetic())
        && file.extension().is_some_and(|ext| ext == "m")
    {
        true => Ok(name),
        false => {
            let message = format!("--out {}: expected NAME.m with letters, digits and _ in NAME", file.display());
            Err(Failure::Usage(message))
        }
    }
}
