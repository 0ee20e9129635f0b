//! points.csv: the measured positions of targets and monuments, and the table of their names.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::poses::Visits;
use super::{BrokenBeam, Point, Run, Visit, WriteError, distances};
use crate::input::InputError;
use crate::table::{Row, Table, TableWriter};

/// The name of the file in its folder.
pub(super) const FILE: &str = "points.csv";

const REQUIRED: [&str; 7] = ["time_s", "cycle", "pose", "target", "x_m", "y_m", "z_m"];
const ORIENTATION: [&str; 4] = ["qw", "qx", "qy", "qz"];
const SIGMA: &str = "sigma_m";

/// How far a quaternion's norm may be from 1: three decimals, rounded, stay within it.
const NORM_TOLERANCE: f64 = 2e-3;

/// A norm this near to 1 is 1 up to the rounding of a double. Such a quaternion is kept to the last bit, so that what
/// was written is read back unchanged.
const NORM_EXACT: f64 = 1e-14;

/// The names of targets and monuments as they come.
#[derive(Default)]
pub(super) struct Names {
    pub(super) names: Vec<String>,
    index: HashMap<String, usize>,
}

impl Names {
    /// The index of a name, which is added where it is new.
    pub(super) fn index_of(&mut self, name: &str) -> usize {
        if let Some(&index) = self.index.get(name) {
            return index;
        }
        let index = self.names.len();
        self.names.push(name.to_owned());
        self.index.insert(name.to_owned(), index);
        index
    }
}

/// The visit that a row belongs to.
pub(super) fn visit_of_row(row: &Row<'_>, columns: [usize; 2], visits: &Visits) -> Result<usize, InputError> {
    let (cycle, pose) = (row.whole(columns[0])?, row.whole(columns[1])?);
    visits.index.get(&(cycle, pose)).copied().ok_or_else(|| {
        row.error(format!("cycle {cycle}, pose {pose} is not in poses.csv; expected one of the visits there"))
    })
}

/// The first row, in the order of the file, whose key stood before: (offset of the earlier row, offset of this row).
pub(super) fn first_duplicate<K: Ord + Copy>(mut rows: Vec<(K, usize)>) -> Option<(usize, usize)> {
    rows.sort_unstable();
    let repeated = rows.windows(2).filter(|pair| pair[0].0 == pair[1].0);
    repeated.map(|pair| (pair[0].1, pair[1].1)).min_by_key(|&(_, later)| later)
}

/// Reads points.csv into the visits.
pub(super) fn parse(
    folder: &Path,
    bytes: &[u8],
    visits: &mut Visits,
    names: &mut Names,
    notes: &mut Vec<String>,
) -> Result<(), InputError> {
    let file = folder.join(FILE);
    let mut table = Table::open(&file, bytes, &REQUIRED)?;
    table.note_form(|name| REQUIRED.contains(&name) || ORIENTATION.contains(&name) || name == SIGMA, notes);
    let [time, cycle, pose] = [table.required("time_s")?, table.required("cycle")?, table.required("pose")?];
    let target_column = table.required("target")?;
    let position = [table.required("x_m")?, table.required("y_m")?, table.required("z_m")?];
    let orientation = orientation_columns(&table)?;
    let sigma = table.column(SIGMA);

    let mut broken = 0_usize;
    let mut rows: Vec<((usize, usize), usize)> = Vec::new();
    while let Some(row) = table.next_row()? {
        let time_s = row.number(time, "a time in seconds")?;
        let visit = visit_of_row(&row, [cycle, pose], visits)?;
        let target = names.index_of(row.name(target_column, "the name of a target or monument")?);
        if position.iter().all(|&column| row.is_empty(column)) {
            visits.visits[visit].broken_beams.push(BrokenBeam { time_s, target, anchor: None });
            broken += 1;
            continue;
        }
        let coordinate = |column| row.number(column, "metres (x_m, y_m and z_m all empty for a broken beam)");
        let point = Point {
            time_s,
            target,
            position: Vector3::new(coordinate(position[0])?, coordinate(position[1])?, coordinate(position[2])?),
            orientation: parse_orientation(&row, &orientation)?,
            sigma_m: parse_sigma(&row, sigma)?,
        };
        rows.push(((visit, target), row.offset));
        visits.visits[visit].points.push(point);
    }
    table.note_decimal_comma(notes);
    if let Some((earlier, later)) = first_duplicate(rows) {
        return Err(table.error_at(
            later,
            format!(
                "the same cycle, pose and target stand in line {} already; expected each target once a visit",
                table.line_at(earlier)
            ),
        ));
    }
    if broken > 0 {
        let beams = if broken == 1 { "beam" } else { "beams" };
        notes.push(format!("{FILE}: {broken} broken {beams} (empty x_m, y_m, z_m)"));
    }
    for visit in &mut visits.visits {
        visit.points.sort_by(|left, right| left.time_s.total_cmp(&right.time_s));
    }
    Ok(())
}

fn orientation_columns(table: &Table<'_>) -> Result<Vec<usize>, InputError> {
    let columns: Vec<usize> = ORIENTATION.iter().filter_map(|name| table.column(name)).collect();
    if columns.is_empty() || columns.len() == ORIENTATION.len() {
        return Ok(columns);
    }
    Err(table.header_error("has some of the columns qw, qx, qy, qz; expected all of them, or none"))
}

fn parse_orientation(row: &Row<'_>, columns: &[usize]) -> Result<Option<UnitQuaternion<f64>>, InputError> {
    let expected = "a part of a unit quaternion (qw, qx, qy and qz all empty where there is none)";
    let Some(parts) = row.optional_numbers(columns, expected)? else { return Ok(None) };
    let quaternion = Quaternion::new(parts[0], parts[1], parts[2], parts[3]);
    let deviation = (quaternion.norm() - 1.0).abs();
    if deviation <= NORM_EXACT {
        Ok(Some(UnitQuaternion::new_unchecked(quaternion)))
    } else if deviation <= NORM_TOLERANCE {
        Ok(Some(UnitQuaternion::from_quaternion(quaternion)))
    } else {
        Err(row.error(format!("qw, qx, qy, qz have the norm {:.4}; expected a unit quaternion", quaternion.norm())))
    }
}

fn parse_sigma(row: &Row<'_>, column: Option<usize>) -> Result<Option<f64>, InputError> {
    let Some(column) = column else { return Ok(None) };
    let expected = "metres, not negative (empty where it is not known)";
    match row.optional_number(column, expected)? {
        Some(sigma) if sigma < 0.0 => Err(row.unexpected(column, expected)),
        sigma => Ok(sigma),
    }
}

/// One row of points.csv.
pub(super) enum PointRow<'a> {
    Measured(&'a Point),
    Broken(&'a BrokenBeam),
}

/// A visit's rows of points.csv in the order in which they are written: by time, what was measured first.
pub(super) fn rows(visit: &Visit) -> Vec<PointRow<'_>> {
    let measured = visit.points.iter().map(|point| (point.time_s, PointRow::Measured(point)));
    let broken = visit.broken_beams.iter().filter(|beam| beam.anchor.is_none());
    let mut rows: Vec<_> = measured.chain(broken.map(|beam| (beam.time_s, PointRow::Broken(beam)))).collect();
    rows.sort_by(|left, right| left.0.total_cmp(&right.0));
    rows.into_iter().map(|(_, row)| row).collect()
}

/// Puts the table of names into the order in which the written files will name them, so that a run that is written
/// and read again is the same to the last index.
pub(super) fn order_names(visits: &mut [Visit], names: Names) -> Vec<String> {
    let mut order = Names::default();
    for visit in visits.iter() {
        for row in rows(visit) {
            let (PointRow::Measured(Point { target, .. }) | PointRow::Broken(BrokenBeam { target, .. })) = row;
            order.index_of(&names.names[*target]);
        }
    }
    for visit in visits.iter() {
        for row in distances::rows(visit) {
            order.index_of(&names.names[row.target]);
        }
    }
    let moved: Vec<usize> = names.names.iter().map(|name| order.index_of(name)).collect();
    for visit in visits {
        visit.points.iter_mut().for_each(|point| point.target = moved[point.target]);
        visit.distances.iter_mut().for_each(|distance| distance.target = moved[distance.target]);
        visit.broken_beams.iter_mut().for_each(|beam| beam.target = moved[beam.target]);
    }
    order.names
}

/// The name of a target by its index, for writing.
pub(super) fn name_of(run: &Run, target: usize, folder: &Path) -> Result<String, WriteError> {
    run.target_names.get(target).cloned().ok_or_else(|| WriteError::Content {
        file: folder.join(FILE),
        message: format!("target {target} has no name; the run names {}", run.target_names.len()),
    })
}

/// points.csv's bytes; `None` for a run of distances alone.
pub(super) fn format(run: &Run, folder: &Path) -> Result<Option<Vec<u8>>, WriteError> {
    let only_distances = run.visits.iter().all(|visit| rows(visit).is_empty()) && distances::has_rows(run);
    if only_distances {
        return Ok(None);
    }
    let has = |what: fn(&Point) -> bool| run.visits.iter().flat_map(|visit| &visit.points).any(what);
    let has_orientation = has(|point| point.orientation.is_some());
    let has_sigma = has(|point| point.sigma_m.is_some());
    let mut header: Vec<String> = REQUIRED.map(str::to_owned).into();
    if has_orientation {
        header.extend(ORIENTATION.map(str::to_owned));
    }
    if has_sigma {
        header.push(SIGMA.to_owned());
    }
    let mut table = TableWriter::new(folder.join(FILE), &header)?;
    for visit in &run.visits {
        for row in rows(visit) {
            let (time_s, target, point) = match row {
                PointRow::Measured(point) => (point.time_s, point.target, Some(point)),
                PointRow::Broken(beam) => (beam.time_s, beam.target, None),
            };
            table.number(time_s)?;
            table.whole(visit.cycle.into());
            table.whole(visit.pose.into());
            table.name(&name_of(run, target, folder)?)?;
            table.optional_numbers(point.map(|point| point.position.as_slice()), 3)?;
            if has_orientation {
                let parts = point.and_then(|point| point.orientation).map(|turn| [turn.w, turn.i, turn.j, turn.k]);
                table.optional_numbers(parts.as_ref().map(<[f64; 4]>::as_slice), 4)?;
            }
            if has_sigma {
                let sigma = point.and_then(|point| point.sigma_m);
                table.optional_numbers(sigma.as_ref().map(std::slice::from_ref), 1)?;
            }
            table.end_row()?;
        }
    }
    table.finish().map(Some)
}
