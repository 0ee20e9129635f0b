//! `thermokin plan`: what is worth measuring.

mod poses;
mod probes;
mod schedule;
mod sensors;
mod write;

use std::ffi::OsString;

use clap::{Args, Parser, Subcommand};

use super::Failure;

const AFTER_HELP: &str = "\
Examples:
  thermokin plan staubli-tx90 --count 20 --target 0,0,0.1 --tracker 3,0,0.5 --out poses.csv
  thermokin plan poses ur10/robot.toml --count 40 --run ur10
  thermokin plan sensors model.json run-75-25 --bound-mm 0.02
  thermokin plan schedule thesis-75-25 --hours 4 --out planned.toml
  thermokin plan probes thesis-75-25 --hours 8 --out probes.toml

`thermokin plan ROBOT` is `thermokin plan poses ROBOT`. host/docs/plan.md says what is best, and what counts as seen.";

/// What is worth measuring: poses, temperature sensors, when to warm up and cool down, probes of single joints
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP, arg_required_else_help = true)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Poses(poses::Arguments),
    Sensors(sensors::Arguments),
    Schedule(schedule::Arguments),
    Probes(probes::Arguments),
    /// A robot in place of one of these: its poses
    #[command(external_subcommand)]
    Robot(Vec<OsString>),
}

/// `thermokin plan ROBOT`, which is `thermokin plan poses ROBOT`.
#[derive(Debug, Parser)]
#[command(name = "thermokin plan")]
struct Poses {
    #[command(flatten)]
    poses: poses::Arguments,
}

/// Carries the command out.
///
/// # Errors
/// Bad usage or input; a plan that does not exist; a disk that does not take it.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.what {
        What::Poses(poses) => poses::run(poses),
        What::Sensors(sensors) => sensors::run(sensors),
        What::Schedule(schedule) => schedule::run(schedule),
        What::Probes(probes) => probes::run(probes),
        What::Robot(words) => {
            let words = [OsString::from("thermokin plan")].into_iter().chain(words.iter().cloned());
            poses::run(&Poses::parse_from(words).poses)
        }
    }
}
