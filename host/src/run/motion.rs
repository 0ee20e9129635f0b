//! motion.csv: the steps of the schedule, how fast the arm moved and when it paused.

use std::path::Path;

use super::{Run, WriteError};
use crate::input::InputError;
use crate::table::{Table, TableWriter, numbered_suffix};

/// The name of the file in its folder.
pub(super) const FILE: &str = "motion.csv";

const REQUIRED: [&str; 6] = ["start_s", "end_s", "cycle", "phase", "override", "rms1"];

/// One step of the schedule.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionStep {
    /// When it began, s since the run began.
    pub start_s: f64,
    /// When it ended, s since the run began; not before it began.
    pub end_s: f64,
    /// The cycle that it leads to or belongs to.
    pub cycle: u32,
    /// What the arm did.
    pub phase: Phase,
    /// The speed override, 0 to 1.
    pub speed_override: f64,
    /// The root-mean-square speed of each joint, rad/s or m/s.
    pub rms: Vec<f64>,
}

/// What the arm does in a step of the schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// It moves, to warm up or to cool down.
    Move,
    /// It stands.
    Pause,
    /// It visits postures and is measured.
    Measure,
}

impl Phase {
    const ALL: [Self; 3] = [Self::Move, Self::Pause, Self::Measure];

    /// The phase's name in motion.csv.
    pub fn name(self) -> &'static str {
        match self {
            Self::Move => "move",
            Self::Pause => "pause",
            Self::Measure => "measure",
        }
    }
}

/// Reads motion.csv of a run whose visits have so many joints.
pub(super) fn parse(
    folder: &Path,
    bytes: &[u8],
    joints: usize,
    notes: &mut Vec<String>,
) -> Result<Vec<MotionStep>, InputError> {
    let file = folder.join(FILE);
    let mut table = Table::open(&file, bytes, &REQUIRED)?;
    table.note_form(|name| REQUIRED.contains(&name) || numbered_suffix(name, "rms").is_some(), notes);
    let [start, end, cycle] = [table.required("start_s")?, table.required("end_s")?, table.required("cycle")?];
    let [phase_column, override_column] = [table.required("phase")?, table.required("override")?];
    let rms_columns = table.numbered("rms")?;
    if rms_columns.len() != joints {
        return Err(table.header_error(format!(
            "has {} rms columns, but poses.csv has {joints} joints; expected rms1 to rms{joints}",
            rms_columns.len()
        )));
    }

    let mut steps = Vec::new();
    while let Some(row) = table.next_row()? {
        let start_s = row.number(start, "a time in seconds")?;
        let end_s = row.number(end, "a time in seconds")?;
        if end_s < start_s {
            return Err(row.unexpected(end, &format!("a time in seconds from start_s, {start_s}, on")));
        }
        let phase_name = row.name(phase_column, "move, pause or measure")?;
        let phase = Phase::ALL.into_iter().find(|phase| phase.name() == phase_name);
        let speed_override = row.number(override_column, "a share from 0 to 1")?;
        if !(0.0..=1.0).contains(&speed_override) {
            return Err(row.unexpected(override_column, "a share from 0 to 1"));
        }
        let speed = |&column: &usize| {
            let expected = "rad/s or m/s, not negative";
            let speed = row.number(column, expected)?;
            if speed < 0.0 { Err(row.unexpected(column, expected)) } else { Ok(speed) }
        };
        steps.push(MotionStep {
            start_s,
            end_s,
            cycle: row.whole(cycle)?,
            phase: phase.ok_or_else(|| row.unexpected(phase_column, "move, pause or measure"))?,
            speed_override,
            rms: rms_columns.iter().map(speed).collect::<Result<_, _>>()?,
        });
    }
    table.note_decimal_comma(notes);
    steps.sort_by(|left, right| left.start_s.total_cmp(&right.start_s));
    Ok(steps)
}

/// motion.csv's bytes; `None` for a run without a schedule.
pub(super) fn format(run: &Run, folder: &Path) -> Result<Option<Vec<u8>>, WriteError> {
    if run.motion.is_empty() {
        return Ok(None);
    }
    let mut header: Vec<String> = ["start_s", "end_s", "cycle", "phase", "override"].map(str::to_owned).into();
    header.extend((1..=run.joint_count()).map(|joint| format!("rms{joint}")));
    let mut table = TableWriter::new(folder.join(FILE), &header)?;
    for step in &run.motion {
        table.number(step.start_s)?;
        table.number(step.end_s)?;
        table.whole(step.cycle.into());
        table.name(step.phase.name())?;
        table.number(step.speed_override)?;
        table.numbers(&step.rms)?;
        table.end_row()?;
    }
    table.finish().map(Some)
}
