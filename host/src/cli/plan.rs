//! `thermokin plan`: what is worth measuring.

mod poses;
mod probes;
mod schedule;
mod sensors;
mod write;

use clap::{Args, Subcommand};

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
#[command(after_help = AFTER_HELP, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Arguments {
    #[command(subcommand)]
    what: Option<What>,
    #[command(flatten)]
    poses: Option<poses::Arguments>,
}

#[derive(Debug, Subcommand)]
enum What {
    Poses(poses::Arguments),
    Sensors(sensors::Arguments),
    Schedule(schedule::Arguments),
    Probes(probes::Arguments),
}

/// Carries the command out.
///
/// # Errors
/// Bad usage or input; a plan that does not exist; a disk that does not take it.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    match (&arguments.what, &arguments.poses) {
        (Some(What::Poses(poses)), _) | (None, Some(poses)) => poses::run(poses),
        (Some(What::Sensors(sensors)), _) => sensors::run(sensors),
        (Some(What::Schedule(schedule)), _) => schedule::run(schedule),
        (Some(What::Probes(probes)), _) => probes::run(probes),
        (None, None) => {
            Err(Failure::Usage("expected a robot, or one of poses, sensors, schedule and probes".to_owned()))
        }
    }
}
