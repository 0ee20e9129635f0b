//! `thermokin robot`: a robot.toml from a URDF or a Denavit-Hartenberg table, and a drawing of the arm.

use std::path::{Path, PathBuf};

use clap::Args;
use nalgebra::Vector3;
use serde_json::json;

use super::Failure;
use super::output::JsonOption;
use crate::input::InputError;
use crate::robot::{Between, DhOrder, Robot, drawing, from_dh_rows, from_urdf, parametrise, shipped};

const AFTER_HELP: &str = "\
Examples:
  thermokin robot arm.urdf --tip tool0 --out robot.toml --svg arm.svg
  thermokin robot dh.csv --name \"My arm\" --out robot.toml
  thermokin robot staubli-tx90 --svg arm.svg

A table has a row a joint and the columns d_m (or d_mm), theta_rad (or theta_deg), a_m, alpha_rad, and where wanted joint
(revolute or prismatic), min and max. The world is the arm's base: put the tracker's rough place into transform 0.";

/// A complete, minimal and proportional robot.toml from a URDF or a DH table, and a drawing that shows a wrong sign
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct Arguments {
    /// A URDF (.urdf, .xml), a table (.csv), a robot.toml (.toml), or the name of a shipped arm
    source: PathBuf,
    /// The robot.toml to write
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Draw the arm
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// The arm's name, where the source has none or another
    #[arg(long)]
    name: Option<String>,
    /// The link at which the chain of a URDF ends
    #[arg(long, value_name = "LINK")]
    tip: Option<String>,
    /// The table is of modified parameters (Craig): alpha and a of a row come before its joint
    #[arg(long)]
    modified: bool,
    #[command(flatten)]
    json: JsonOption,
}

/// Carries the command out.
///
/// # Errors
/// Bad usage or input, a disk that does not take the files.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.out.is_none() && arguments.svg.is_none() {
        return Err(Failure::Usage("expected --out for a robot.toml, --svg for a drawing, or both".to_owned()));
    }
    let robot = robot(arguments)?;
    // Written only if it can be read again: what a source is missing is said here and not when it is used.
    let text = robot.to_toml();
    Robot::parse(&arguments.source, &text)?;
    let write = |file: &Path, text: &str| {
        std::fs::write(file, text)
            .map_err(|error| Failure::Work(format!("{}: cannot be written: {error}", file.display())))
    };
    if let Some(out) = &arguments.out {
        write(out, &text)?;
    }
    if let Some(svg) = &arguments.svg {
        write(svg, &drawing(&robot))?;
    }
    let parameters = robot.nominal().len();
    let remarks = robot.remarks();
    if arguments.json.leaves_words() {
        println!("{}: {} joints, {parameters} parameters", robot.name, robot.joint_count());
        remarks.iter().for_each(|remark| println!("note: {remark}"));
    }
    arguments.json.write(&json!({
        "format": 1, "command": "robot", "name": robot.name, "joints": robot.joint_count(), "parameters": parameters,
        "remarks": remarks,
    }))
}

fn robot(arguments: &Arguments) -> Result<Robot, Failure> {
    let source = &arguments.source;
    let extension = source.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    let read =
        || std::fs::read(source).map_err(|error| InputError::of_file(source, format!("cannot be read: {error}")));
    let (name, axes) = match extension {
        "toml" => return Ok(named(Robot::read(source)?, arguments)),
        "urdf" | "xml" => {
            let bytes = read()?;
            let text = String::from_utf8(bytes).map_err(|_| InputError::of_file(source, "is not UTF-8 text"))?;
            from_urdf(&text, arguments.tip.as_deref())
                .map_err(|error| InputError::of_file(source, error.to_string().replace('\n', " ")))?
        }
        "csv" => {
            let order = if arguments.modified { DhOrder::Modified } else { DhOrder::Standard };
            (String::new(), from_dh_rows(source, &read()?, order)?)
        }
        _ => match source.to_str().and_then(shipped) {
            Some(robot) => return Ok(named(robot, arguments)),
            None => {
                let message = format!(
                    "{}: expected a .urdf, .xml, .csv or .toml file, or the name of a shipped arm",
                    source.display()
                );
                return Err(Failure::Usage(message));
            }
        },
    };
    if axes.joints.is_empty() {
        return Err(InputError::of_file(source, "has no joint that moves; expected an arm").into());
    }
    let transforms = parametrise(&axes, Between::Proportional).map_err(|error| Failure::Work(error.to_string()))?;
    let name = if name.is_empty() { "arm".to_owned() } else { name };
    Ok(named(
        Robot {
            name,
            gravity: Vector3::new(0.0, 0.0, -9.80665),
            transforms,
            targets: Vec::new(),
            monuments: Vec::new(),
            bodies: Vec::new(),
            sensors: Vec::new(),
            thermal: Vec::new(),
        },
        arguments,
    ))
}

fn named(robot: Robot, arguments: &Arguments) -> Robot {
    Robot { name: arguments.name.clone().unwrap_or(robot.name), ..robot }
}
