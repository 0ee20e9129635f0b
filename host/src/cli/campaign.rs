//! The options by which commands choose visits and read runs.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use crate::calibrate::{JointSource, ObserveOptions};
use crate::input::InputError;
use crate::robot::{Robot, shipped};
use crate::run::{self, JoinOptions, Run, Selection};

/// Which joint positions are believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Joints {
    /// q1 to qN, as the controller logged them
    Logged,
    /// cmd1 to cmdN, as they were commanded
    Commanded,
}

/// How a run is read.
#[derive(Debug, Args)]
pub struct RunOptions {
    /// Another robot description than the run's own: a robot.toml, or the name of a shipped arm
    #[arg(long, value_name = "FILE|NAME")]
    robot: Option<PathBuf>,
    /// Which joint positions to believe
    #[arg(long, value_enum, default_value = "logged")]
    joints: Joints,
    /// Use measured orientations too (run.toml must state the instrument's sigma_rad)
    #[arg(long)]
    orientations: bool,
    /// Longest gap of a sensor's readings to interpolate across, seconds [default: five periods, at least 120]
    #[arg(long, value_name = "S")]
    max_gap: Option<f64>,
    /// Choose visits: every:100, every:100:3, first:50, last:50, cycles:0-11 or poses:0-7,9
    #[arg(long, value_name = "SELECTION")]
    pub poses: Option<Selection>,
}

impl RunOptions {
    /// Reads a run and the description of its arm.
    ///
    /// # Errors
    /// Whatever is wrong with their files.
    pub fn read(&self, folder: &Path) -> Result<(Run, Robot), InputError> {
        let run = run::read(folder)?;
        let robot = match &self.robot {
            None => Robot::read(&run.description.robot)?,
            Some(named) => match named.to_str().and_then(shipped) {
                Some(robot) => robot,
                None => Robot::read(named)?,
            },
        };
        Ok((run, robot))
    }

    /// The options as the library takes them.
    pub fn observe(&self) -> ObserveOptions {
        ObserveOptions {
            joints: match self.joints {
                Joints::Logged => JointSource::Logged,
                Joints::Commanded => JointSource::Commanded,
            },
            orientations: self.orientations,
            join: JoinOptions { max_gap_s: self.max_gap },
        }
    }
}
