//! The command line: one file a command. Arguments in, calls, words out.

mod board;
mod calibrate;
mod campaign;
mod compensate;
mod conditions;
mod demo;
mod discover;
mod export;
mod import;
mod log;
mod method_table;
mod output;
mod plan;
mod progress;
mod report;
mod robot;
mod simulate;
mod upkeep;
mod validate;
mod words;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::input::InputError;

/// Calibrates industrial robots and their thermal drift, and explains what is left.
#[derive(Debug, Parser)]
#[command(name = "thermokin", version, propagate_version = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

/// One variant a command; each is carried out by the file of its name.
#[derive(Debug, Subcommand)]
enum Command {
    Simulate(simulate::Arguments),
    Board(board::Arguments),
    Calibrate(calibrate::Arguments),
    Log(log::Arguments),
    Validate(validate::Arguments),
    Discover(discover::Arguments),
    Compensate(compensate::Arguments),
    Plan(plan::Arguments),
    Report(report::Arguments),
    Export(export::Arguments),
    Robot(robot::Arguments),
    Import(import::Arguments),
    Demo(demo::Arguments),
}

/// Why a command did not do what it was asked to: decides the exit code.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Bad usage or bad input: exit code 2.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Bad usage that the argument parser cannot see: exit code 2.
    #[error("{0}")]
    Usage(String),
    /// The work itself failed: exit code 1.
    #[error("{0}")]
    Work(String),
}

impl Failure {
    fn exit_code(&self) -> ExitCode {
        match self {
            Failure::Input(_) | Failure::Usage(_) => ExitCode::from(2),
            Failure::Work(_) => ExitCode::from(1),
        }
    }
}

/// Runs the command that the process was started with.
pub fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let outcome: Result<(), Failure> = match &arguments.command {
        Command::Simulate(arguments) => simulate::run(arguments),
        Command::Board(arguments) => board::run(arguments),
        Command::Log(arguments) => log::run(arguments),
        Command::Calibrate(arguments) => calibrate::run(arguments),
        Command::Validate(arguments) => validate::run(arguments),
        Command::Discover(arguments) => discover::run(arguments),
        Command::Compensate(arguments) => compensate::run(arguments),
        Command::Plan(arguments) => plan::run(arguments),
        Command::Report(arguments) => report::run(arguments),
        Command::Export(arguments) => export::run(arguments),
        Command::Robot(arguments) => robot::run(arguments),
        Command::Import(arguments) => import::run(arguments),
        Command::Demo(arguments) => demo::run(arguments),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("thermokin: {failure}");
            failure.exit_code()
        }
    }
}
