//! distances.csv, our extension of the contract's form: distances between targets and the anchors of run.toml.

use std::path::Path;

use super::points::{Names, first_duplicate, name_of, visit_of_row};
use super::poses::Visits;
use super::{Anchor, BrokenBeam, Distance, Run, Visit, WriteError};
use crate::input::InputError;
use crate::table::{Table, TableWriter};

/// The name of the file in its folder.
pub(super) const FILE: &str = "distances.csv";

const COLUMNS: [&str; 6] = ["time_s", "cycle", "pose", "target", "anchor", "distance_m"];

/// Reads distances.csv into the visits.
pub(super) fn parse(
    folder: &Path,
    bytes: &[u8],
    anchors: &[Anchor],
    visits: &mut Visits,
    names: &mut Names,
    notes: &mut Vec<String>,
) -> Result<(), InputError> {
    let file = folder.join(FILE);
    let mut table = Table::open(&file, bytes, &COLUMNS)?;
    table.note_form(|name| COLUMNS.contains(&name), notes);
    let [time, cycle, pose] = [table.required("time_s")?, table.required("cycle")?, table.required("pose")?];
    let [target_column, anchor_column] = [table.required("target")?, table.required("anchor")?];
    let distance_column = table.required("distance_m")?;

    let mut broken = 0_usize;
    let mut rows: Vec<((usize, usize, usize), usize)> = Vec::new();
    while let Some(row) = table.next_row()? {
        let time_s = row.number(time, "a time in seconds")?;
        let visit = visit_of_row(&row, [cycle, pose], visits)?;
        let target = names.index_of(row.name(target_column, "the name of a target")?);
        let anchor_name = row.name(anchor_column, "the name of an anchor")?;
        let anchor = anchors.iter().position(|anchor| anchor.name == anchor_name).ok_or_else(|| {
            let known: Vec<&str> = anchors.iter().map(|anchor| anchor.name.as_str()).collect();
            let known = if known.is_empty() { "none there".to_owned() } else { known.join(", ") };
            row.unexpected(anchor_column, &format!("an [[anchor]] of run.toml ({known})"))
        })?;
        let expected = "metres above 0 (empty where the measurement failed)";
        match row.optional_number(distance_column, expected)? {
            None => {
                visits.visits[visit].broken_beams.push(BrokenBeam { time_s, target, anchor: Some(anchor) });
                broken += 1;
            }
            Some(distance_m) if distance_m > 0.0 => {
                rows.push(((visit, target, anchor), row.offset));
                visits.visits[visit].distances.push(Distance { time_s, target, anchor, distance_m });
            }
            Some(_) => return Err(row.unexpected(distance_column, expected)),
        }
    }
    table.note_decimal_comma(notes);
    if let Some((earlier, later)) = first_duplicate(rows) {
        return Err(table.error_at(
            later,
            format!(
                "the same cycle, pose, target and anchor stand in line {} already; expected each once a visit",
                table.line_at(earlier)
            ),
        ));
    }
    if broken > 0 {
        notes.push(format!("{FILE}: {broken} without a distance (empty distance_m)"));
    }
    for visit in &mut visits.visits {
        visit.distances.sort_by(|left, right| left.time_s.total_cmp(&right.time_s));
    }
    Ok(())
}

/// One row of distances.csv.
pub(super) struct DistanceRow {
    time_s: f64,
    pub(super) target: usize,
    anchor: usize,
    distance_m: Option<f64>,
}

/// A visit's rows of distances.csv in the order in which they are written: by time, what was measured first.
pub(super) fn rows(visit: &Visit) -> Vec<DistanceRow> {
    let measured = visit.distances.iter().map(|&Distance { time_s, target, anchor, distance_m }| DistanceRow {
        time_s,
        target,
        anchor,
        distance_m: Some(distance_m),
    });
    let broken = visit.broken_beams.iter().filter_map(|&BrokenBeam { time_s, target, anchor }| {
        anchor.map(|anchor| DistanceRow { time_s, target, anchor, distance_m: None })
    });
    let mut rows: Vec<_> = measured.chain(broken).collect();
    rows.sort_by(|left, right| left.time_s.total_cmp(&right.time_s));
    rows
}

/// Whether the run has anything for distances.csv.
pub(super) fn has_rows(run: &Run) -> bool {
    run.visits.iter().any(|visit| !rows(visit).is_empty())
}

/// distances.csv's bytes; `None` for a run without distances.
pub(super) fn format(run: &Run, folder: &Path) -> Result<Option<Vec<u8>>, WriteError> {
    if !has_rows(run) {
        return Ok(None);
    }
    let anchors = &run.description.anchors;
    let mut table = TableWriter::new(folder.join(FILE), &COLUMNS.map(str::to_owned))?;
    for visit in &run.visits {
        for row in rows(visit) {
            let anchor = anchors.get(row.anchor).ok_or_else(|| WriteError::Content {
                file: folder.join(FILE),
                message: format!("anchor {} has no name; the run names {}", row.anchor, anchors.len()),
            })?;
            table.number(row.time_s)?;
            table.whole(visit.cycle.into());
            table.whole(visit.pose.into());
            table.name(&name_of(run, row.target, folder)?)?;
            table.name(&anchor.name)?;
            table.optional_numbers(row.distance_m.as_ref().map(std::slice::from_ref), 1)?;
            table.end_row()?;
        }
    }
    table.finish().map(Some)
}
