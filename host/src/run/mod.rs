//! Run folders: reading, checking, writing, and joining points to poses and temperatures.
//!
//! A run is one folder of measured or simulated data and nothing in it says which it was. One file of this module owns
//! one file of the folder, both ways; [`RunFiles`] holds them as bytes between the disk and a checked [`Run`].

mod approach;
mod columns;
mod description;
mod distances;
mod files;
mod motion;
mod points;
mod poses;
mod selection;
mod temperatures;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use nalgebra::{UnitQuaternion, Vector3};

use crate::input::InputError;

pub use crate::table::WriteError;
pub use description::{Anchor, Instrument, RunDescription};
pub(crate) use description::{Checker, InstrumentToml};
pub use files::RunFiles;
pub use motion::{MotionStep, Phase};
pub use poses::{format_postures, read_postures};
pub use selection::{FoldError, Selection, SelectionError, folds_by_cycle, folds_by_pose};
pub(crate) use temperatures::ABSOLUTE_ZERO_CELSIUS;
pub use temperatures::{JoinOptions, Joined, SensorJoin, TemperatureLog, TemperatureSeries, TemperatureTable};

/// One run, checked: every number is finite, every point belongs to a visit, every visit has the same joints.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// The folder that the run was read from, or is to be written to.
    pub folder: PathBuf,
    /// What run.toml says.
    pub description: RunDescription,
    /// The visits in order of time (rows of equal time in the order of poses.csv).
    pub visits: Vec<Visit>,
    /// The names of targets and monuments, in the order in which they were first measured. Which of them are targets
    /// on the arm and which are monuments beside it is the robot description's to say.
    pub target_names: Vec<String>,
    /// The temperature log; `None` in a purely geometric run.
    pub temperatures: Option<TemperatureLog>,
    /// The steps of the schedule in order of their start; empty where the run has no motion.csv.
    pub motion: Vec<MotionStep>,
    /// What was odd but usable, counted, in words, each beginning with its file's name.
    pub notes: Vec<String>,
}

/// One visit of one posture: the unit of noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Visit {
    /// The cycle that the visit belongs to.
    pub cycle: u32,
    /// The number of the posture; the same posture has the same number in every cycle.
    pub pose: u32,
    /// When the arm stood there, s since the run began.
    pub time_s: f64,
    /// The joints as logged, rad or m, one a moving transform.
    pub joints: Vec<f64>,
    /// The joints as commanded, rad or m.
    pub commanded: Option<Vec<f64>>,
    /// What the arm carried, kg.
    pub payload_kg: Option<f64>,
    /// The sign of each joint's last motion, as the file gives it: -1, 0 or 1. [`Run::approach_directions`] derives it
    /// where it is absent.
    pub approach: Option<Vec<i8>>,
    /// The positions measured during the visit, in order of time; at most one a target.
    pub points: Vec<Point>,
    /// The distances measured during the visit, in order of time; at most one a target and anchor.
    pub distances: Vec<Distance>,
    /// The measurements that were tried and gave nothing, in order of time.
    pub broken_beams: Vec<BrokenBeam>,
}

/// One measured position of a target or a monument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// When it was measured, s since the run began.
    pub time_s: f64,
    /// Index into [`Run::target_names`].
    pub target: usize,
    /// Where it was, m, in the world frame.
    pub position: Vector3<f64>,
    /// How it was turned, in the world frame, for a target of six degrees of freedom.
    pub orientation: Option<UnitQuaternion<f64>>,
    /// 1-sigma of one coordinate, m, as the spread of its own samples tells it.
    pub sigma_m: Option<f64>,
}

/// One measured distance between a target and an anchor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance {
    /// When it was measured, s since the run began.
    pub time_s: f64,
    /// Index into [`Run::target_names`].
    pub target: usize,
    /// Index into [`RunDescription::anchors`].
    pub anchor: usize,
    /// The distance, m.
    pub distance_m: f64,
}

/// A measurement that gave nothing: the instrument did not see its target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BrokenBeam {
    /// When it was tried, s since the run began.
    pub time_s: f64,
    /// Index into [`Run::target_names`].
    pub target: usize,
    /// Index into [`RunDescription::anchors`] where a distance was tried; `None` where a position was.
    pub anchor: Option<usize>,
}

/// Reads and checks a run folder.
///
/// # Errors
/// The first thing that makes the folder unusable, with its file and line and what was expected.
pub fn read(folder: &Path) -> Result<Run, InputError> {
    RunFiles::load(folder)?.parse(folder)
}

/// Writes a run into a folder, which is created where it is missing.
///
/// What was read is read back the same to the last bit, and the same run always gives the same bytes; a run put
/// together by hand comes back with its visits in order of time and its names in the order of their points. All files
/// are complete on the disk before the first takes its place, and run.toml comes last, so that a folder is a run only
/// once it is whole. A file of an earlier run in that folder which this run does not have (say motion.csv) is removed.
/// A robot description inside the folder that the run was read from is copied along.
///
/// # Errors
/// A run that could not be read back (a number that is not finite, unequal counts of joints, an unusable name), or a
/// disk that does not take it. Nothing half-written is left.
pub fn write(run: &Run, folder: &Path) -> Result<(), WriteError> {
    RunFiles::of(run, folder)?.store(folder)
}

impl Run {
    /// How many joints every visit has.
    pub fn joint_count(&self) -> usize {
        self.visits.first().map_or(0, |visit| visit.joints.len())
    }

    /// How many positions were measured in all.
    pub fn point_count(&self) -> usize {
        self.visits.iter().map(|visit| visit.points.len()).sum()
    }

    /// The index of a target or monument into [`Run::target_names`].
    pub fn target_index(&self, name: &str) -> Option<usize> {
        self.target_names.iter().position(|known| known == name)
    }

    /// The cycles that have visits, ascending.
    pub fn cycles(&self) -> Vec<u32> {
        let mut cycles: Vec<u32> = self.visits.iter().map(|visit| visit.cycle).collect();
        cycles.sort_unstable();
        cycles.dedup();
        cycles
    }

    /// Checks that the run was made by an arm of so many joints.
    ///
    /// # Errors
    /// The counts and both files, where they differ.
    pub fn check_joint_count(&self, robot_joints: usize) -> Result<(), InputError> {
        let found = self.joint_count();
        if found == robot_joints {
            return Ok(());
        }
        Err(InputError::at_line(
            &self.folder.join("poses.csv"),
            1,
            format!(
                "has {found} joint column{} (q1 to q{found}), but {} has {robot_joints} moving transform{}; expected one \
                 column for each",
                if found == 1 { "" } else { "s" },
                self.description.robot.display(),
                if robot_joints == 1 { "" } else { "s" },
            ),
        ))
    }
}
