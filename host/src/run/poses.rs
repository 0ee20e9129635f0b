//! poses.csv: the visits, with the joints as logged and as commanded.

use std::collections::HashMap;
use std::path::Path;

use super::{Run, Visit, WriteError};
use crate::input::InputError;
use crate::table::{Row, Table, TableWriter, numbered_suffix};

/// The name of the file in its folder.
pub(super) const FILE: &str = "poses.csv";

const REQUIRED: [&str; 4] = ["time_s", "cycle", "pose", "q1"];
const NUMBERED: [&str; 3] = ["q", "cmd", "approach"];

/// The visits in order of time, and where each stands.
pub(super) struct Visits {
    pub(super) visits: Vec<Visit>,
    /// From (cycle, pose) to the visit's index.
    pub(super) index: HashMap<(u32, u32), usize>,
}

/// Reads poses.csv, whatever `file` is called.
pub(super) fn parse(file: &Path, bytes: &[u8], notes: &mut Vec<String>) -> Result<Visits, InputError> {
    let mut table = Table::open(file, bytes, &REQUIRED)?;
    table.note_form(is_known, notes);
    let [time, cycle, pose] = [table.required("time_s")?, table.required("cycle")?, table.required("pose")?];
    let joints = table.numbered("q")?;
    let commanded = joint_columns(&table, "cmd", joints.len())?;
    let approach = joint_columns(&table, "approach", joints.len())?;
    let payload = table.column("payload_kg");

    let mut visits: Vec<Visit> = Vec::new();
    let mut offsets: HashMap<(u32, u32), usize> = HashMap::new();
    while let Some(row) = table.next_row()? {
        let visit = Visit {
            cycle: row.whole(cycle)?,
            pose: row.whole(pose)?,
            time_s: row.number(time, "a time in seconds")?,
            joints: joints.iter().map(|&column| row.number(column, "radians or metres")).collect::<Result<_, _>>()?,
            commanded: row.optional_numbers(&commanded, "radians or metres")?,
            payload_kg: match payload {
                Some(column) => row.optional_number(column, "kilograms")?,
                None => None,
            },
            approach: approach_signs(&row, &approach)?,
            points: Vec::new(),
            distances: Vec::new(),
            broken_beams: Vec::new(),
        };
        let offset = row.offset;
        if let Some(earlier) = offsets.insert((visit.cycle, visit.pose), offset) {
            let message = format!(
                "cycle {}, pose {} stands twice (first in line {}); expected each visit once",
                visit.cycle,
                visit.pose,
                table.line_at(earlier)
            );
            return Err(table.error_at(offset, message));
        }
        visits.push(visit);
    }
    table.note_decimal_comma(notes);
    if visits.is_empty() {
        return Err(table.header_error("has no rows below its header; expected one a visit"));
    }
    visits.sort_by(|left, right| left.time_s.total_cmp(&right.time_s));
    note_gaps(&visits, notes);
    let index = visits.iter().enumerate().map(|(index, visit)| ((visit.cycle, visit.pose), index)).collect();
    Ok(Visits { visits, index })
}

/// The postures of a table in the form of poses.csv: the visits of its first cycle in the order of their times, rad or m.
///
/// # Errors
/// A file that cannot be read, or is no such table.
pub fn read_postures(file: &Path) -> Result<Vec<Vec<f64>>, InputError> {
    let bytes = std::fs::read(file).map_err(|error| InputError::of_file(file, format!("cannot be read: {error}")))?;
    let Visits { visits, .. } = parse(file, &bytes, &mut Vec::new())?;
    let first = visits.iter().map(|visit| visit.cycle).min();
    Ok(visits.into_iter().filter(|visit| Some(visit.cycle) == first).map(|visit| visit.joints).collect())
}

/// A table in the form of poses.csv: one visit of each posture in cycle 0, a second apart.
///
/// # Errors
/// Postures that are no finite numbers.
pub fn format_postures(postures: &[Vec<f64>]) -> Result<Vec<u8>, WriteError> {
    let joints = postures.first().map_or(0, Vec::len);
    let mut header: Vec<String> = ["time_s", "cycle", "pose"].map(str::to_owned).into();
    header.extend((1..=joints).map(|joint| format!("q{joint}")));
    let mut table = TableWriter::new(FILE.into(), &header)?;
    for (pose, posture) in postures.iter().enumerate() {
        table.number(pose as f64)?;
        table.whole(0);
        table.whole(pose as i64);
        table.numbers(posture)?;
        table.end_row()?;
    }
    table.finish()
}

fn is_known(name: &str) -> bool {
    matches!(name, "time_s" | "cycle" | "pose" | "payload_kg")
        || NUMBERED.iter().any(|prefix| numbered_suffix(name, prefix).is_some())
}

/// The columns `prefix1` to `prefixN`: one for each joint, or none.
fn joint_columns(table: &Table<'_>, prefix: &str, joints: usize) -> Result<Vec<usize>, InputError> {
    let columns = table.numbered(prefix)?;
    if columns.is_empty() || columns.len() == joints {
        return Ok(columns);
    }
    Err(table.header_error(format!(
        "has {} columns {prefix}1 to {prefix}{} but q1 to q{joints}; expected one {prefix} for each joint, or none",
        columns.len(),
        columns.len()
    )))
}

fn approach_signs(row: &Row<'_>, columns: &[usize]) -> Result<Option<Vec<i8>>, InputError> {
    let expected = "-1, 0 or 1, the sign of the joint's last motion";
    let Some(values) = row.optional_numbers(columns, expected)? else { return Ok(None) };
    values
        .into_iter()
        .zip(columns)
        .map(|(value, &column)| match value {
            -1.0 => Ok(-1),
            0.0 => Ok(0),
            1.0 => Ok(1),
            _ => Err(row.unexpected(column, expected)),
        })
        .collect::<Result<_, _>>()
        .map(Some)
}

fn note_gaps(visits: &[Visit], notes: &mut Vec<String>) {
    let mut cycles: Vec<u32> = visits.iter().map(|visit| visit.cycle).collect();
    cycles.sort_unstable();
    cycles.dedup();
    let gaps: Vec<String> = cycles
        .windows(2)
        .filter(|pair| pair[1] - pair[0] > 1)
        .map(|pair| match (pair[0] + 1, pair[1] - 1) {
            (first, last) if first == last => first.to_string(),
            (first, last) => format!("{first} to {last}"),
        })
        .collect();
    if !gaps.is_empty() {
        let shown = gaps.iter().take(8).cloned().collect::<Vec<_>>().join(", ");
        let rest = if gaps.len() > 8 { format!(" and {} more gaps", gaps.len() - 8) } else { String::new() };
        notes.push(format!("{FILE}: no poses in cycle {shown}{rest}"));
    }
}

/// poses.csv's bytes.
pub(super) fn format(run: &Run, folder: &Path) -> Result<Vec<u8>, WriteError> {
    let joints = run.joint_count();
    let has_commanded = run.visits.iter().any(|visit| visit.commanded.is_some());
    let has_payload = run.visits.iter().any(|visit| visit.payload_kg.is_some());
    let has_approach = run.visits.iter().any(|visit| visit.approach.is_some());

    let mut header: Vec<String> = ["time_s", "cycle", "pose"].map(str::to_owned).into();
    let numbered = |prefix: &'static str| (1..=joints).map(move |joint| format!("{prefix}{joint}"));
    header.extend(numbered("q"));
    if has_commanded {
        header.extend(numbered("cmd"));
    }
    if has_payload {
        header.push("payload_kg".to_owned());
    }
    if has_approach {
        header.extend(numbered("approach"));
    }

    let mut table = TableWriter::new(folder.join(FILE), &header)?;
    for visit in &run.visits {
        table.number(visit.time_s)?;
        table.whole(visit.cycle.into());
        table.whole(visit.pose.into());
        table.numbers(&visit.joints)?;
        if has_commanded {
            table.optional_numbers(visit.commanded.as_deref(), joints)?;
        }
        if has_payload {
            table.optional_numbers(visit.payload_kg.as_ref().map(std::slice::from_ref), 1)?;
        }
        if has_approach {
            match &visit.approach {
                Some(signs) => signs.iter().for_each(|&sign| table.whole(sign.into())),
                None => table.empty(joints),
            }
        }
        table.end_row()?;
    }
    table.finish()
}
