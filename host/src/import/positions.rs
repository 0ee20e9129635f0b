//! Rows of positions: a tracker's samples or points, or what a coordinate measuring machine probed.

use nalgebra::Vector3;

use super::mapping::{Column, PointsSource};
use super::source::{Key, Keys, Prepared, Source, Text, Times, place};
use super::time::Moment;
use crate::input::InputError;
use crate::table::is_usable_name;

/// No instrument measures further than this, m.
const FURTHEST_M: f64 = 1e4;

/// One row.
#[derive(Debug, Clone)]
pub(super) struct Sample {
    /// Which `[[tracker]]` of the mapping, and which file of it.
    pub(super) source: (usize, usize),
    pub(super) line: usize,
    pub(super) moment: Option<Moment>,
    pub(super) key: Option<Key>,
    pub(super) target: String,
    /// m, in the world (or the frame of the holders); none: the instrument did not see its target.
    pub(super) seen: Option<Vector3<f64>>,
    /// 1-sigma of one coordinate as the file states it, m.
    pub(super) sigma_m: Option<f64>,
}

/// The rows of one `[[tracker]]`, and how many were passed over because of their names.
pub(super) fn read(
    points: &PointsSource,
    index: usize,
    sources: &[Source],
    notes: &mut Vec<String>,
) -> Result<(Vec<Sample>, usize), InputError> {
    let (mut samples, mut passed) = (Vec::new(), 0);
    for (file, source) in sources.iter().enumerate() {
        let prepared = Prepared::new(source, &points.files.layout);
        let columns = &points.columns;
        let mut named: Vec<&Column> = vec![&columns.x, &columns.y, &columns.z];
        named.extend(columns.target.as_slice());
        named.extend([&columns.cycle, &columns.pose, &columns.status, &columns.sigma].into_iter().flatten());
        named.extend(points.time.iter().flat_map(|time| time.column.as_slice()));
        let mut table = prepared.table(&named)?;
        let at = [place(&table, &columns.x)?, place(&table, &columns.y)?, place(&table, &columns.z)?];
        let target = Text::new(&table, source, &columns.target, "::")?;
        let keys = Keys::new(&table, &points.names, columns.cycle.as_ref(), columns.pose.as_ref())?;
        let times = Times::new(&table, source, points.time.as_ref())?;
        let status = columns.status.as_ref().map(|column| place(&table, column)).transpose()?;
        let sigma = columns.sigma.as_ref().map(|column| place(&table, column)).transpose()?;
        while let Some(row) = table.next_row()? {
            let Some((name, by_name)) = points.names.parts(&target.of(&row)) else {
                passed += 1;
                continue;
            };
            if !is_usable_name(&name) {
                return Err(target.unexpected(&row, "the name of a target"));
            }
            let moment = times.as_ref().map(|times| times.of(&row)).transpose()?;
            let expected = "a coordinate (x, y and z all empty for a broken beam)";
            let read = row.optional_numbers(&at, expected)?;
            let good = status.is_none_or(|status| points.good.iter().any(|good| *good == row.text(status)));
            // No instrument can measure its own origin: programs write zeros where they have nothing.
            let seen = read.filter(|read| good && read.iter().any(|&coordinate| coordinate != 0.0));
            let seen = seen.map(|read| points.frame.point(&(Vector3::new(read[0], read[1], read[2]) * points.metres)));
            if seen.is_some_and(|seen| seen.iter().any(|coordinate| coordinate.abs() > FURTHEST_M)) {
                return Err(row.unexpected(at[0], "a place within 10 km (is the unit right?)"));
            }
            let sigma_m = match sigma {
                None => None,
                Some(column) => {
                    let expected = "a deviation from 0 to 10 km";
                    let sigma = row.optional_number(column, expected)?.map(|sigma| sigma * points.metres);
                    if sigma.is_some_and(|sigma| !(0.0..=FURTHEST_M).contains(&sigma)) {
                        return Err(row.unexpected(column, expected));
                    }
                    sigma
                }
            };
            samples.push(Sample {
                source: (index, file),
                line: row.line(),
                moment,
                key: keys.of(&row)?.or(by_name),
                target: name,
                seen,
                sigma_m,
            });
        }
        table.note_decimal_comma(notes);
    }
    Ok((samples, passed))
}
