//! Rows of joints: visits as a program listed them, or the standstills of a continuous log.

use super::mapping::{Column, JointRows, JointsSource, StillToml};
use super::source::{Key, Keys, Prepared, Source, Text, Times, place};
use super::time::Moment;
use crate::input::InputError;

/// No joint of an arm goes further than this, rad or m.
const FURTHEST: f64 = 1e4;

/// One row.
#[derive(Debug, Clone)]
pub(super) struct JointRow {
    /// Which `[[joints]]` of the mapping, and which file of it.
    pub(super) source: (usize, usize),
    pub(super) line: usize,
    pub(super) moment: Option<Moment>,
    pub(super) key: Option<Key>,
    /// rad or m.
    pub(super) joints: Vec<f64>,
    pub(super) commanded: Option<Vec<f64>>,
    pub(super) payload_kg: Option<f64>,
}

/// The arm at rest in one posture.
#[derive(Debug, Clone)]
pub(super) struct Stand {
    /// The row, or the first of the standstill's rows.
    pub(super) row: JointRow,
    /// From when to when, s since the run began; none where the rows say no time.
    pub(super) span_s: Option<(f64, f64)>,
}

impl Stand {
    /// The middle of its time, s since the run began.
    pub(super) fn time_s(&self) -> Option<f64> {
        self.span_s.map(|(from, to)| 0.5 * (from + to))
    }
}

/// The rows of one `[[joints]]`.
pub(super) fn read(
    joints: &JointsSource,
    index: usize,
    sources: &[Source],
    notes: &mut Vec<String>,
) -> Result<Vec<JointRow>, InputError> {
    let mut rows = Vec::new();
    for (file, source) in sources.iter().enumerate() {
        let prepared = Prepared::new(source, &joints.files.layout);
        let columns = &joints.columns;
        let mut named: Vec<&Column> = columns.joints.iter().collect();
        named.extend(columns.commanded.iter().flatten());
        named.extend(columns.visit.iter().flat_map(|visit| visit.as_slice()));
        named.extend([&columns.payload_kg, &columns.cycle, &columns.pose].into_iter().flatten());
        named.extend(joints.time.iter().flat_map(|time| time.column.as_slice()));
        let mut table = prepared.table(&named)?;
        let places =
            |columns: &[Column]| columns.iter().map(|column| place(&table, column)).collect::<Result<Vec<_>, _>>();
        let logged = places(&columns.joints)?;
        let commanded = columns.commanded.as_deref().map(places).transpose()?.unwrap_or_default();
        let payload = columns.payload_kg.as_ref().map(|column| place(&table, column)).transpose()?;
        let visit = columns.visit.as_ref().map(|visit| Text::new(&table, source, visit, "::")).transpose()?;
        let keys = Keys::new(&table, &joints.names, columns.cycle.as_ref(), columns.pose.as_ref())?;
        let times = Times::new(&table, source, joints.time.as_ref())?;
        while let Some(row) = table.next_row()? {
            let expected = "a joint's position within 10000 rad or m";
            let si = |values: Vec<f64>, columns: &[usize]| -> Result<Vec<f64>, InputError> {
                let values = values.iter().zip(&joints.scales).map(|(value, (factor, offset))| value * factor + offset);
                let checked = values.zip(columns).map(|(value, &column)| match value.abs() <= FURTHEST {
                    true => Ok(value),
                    false => Err(row.unexpected(column, expected)),
                });
                checked.collect()
            };
            let read = logged.iter().map(|&column| row.number(column, expected)).collect::<Result<_, _>>()?;
            let ordered = row.optional_numbers(&commanded, expected)?;
            let key = match (&visit, &joints.names.pattern) {
                (Some(visit), Some(_)) => match joints.names.parts(&visit.of(&row)) {
                    Some((_, key)) => key,
                    None => return Err(visit.unexpected(&row, "a visit as visit_pattern has it")),
                },
                _ => keys.of(&row)?,
            };
            rows.push(JointRow {
                source: (index, file),
                line: row.line(),
                moment: times.as_ref().map(|times| times.of(&row)).transpose()?,
                key,
                joints: si(read, &logged)?,
                commanded: ordered.map(|read| si(read, &commanded)).transpose()?,
                payload_kg: payload.map(|column| row.optional_number(column, "kilograms")).transpose()?.flatten(),
            });
        }
        table.note_decimal_comma(notes);
    }
    Ok(rows)
}

/// Where the arm stood: every row of a list of visits, or the standstills of a log. `start_ns` is when the run began.
pub(super) fn stands(joints: &JointsSource, rows: Vec<JointRow>, start_ns: i128) -> Vec<Stand> {
    let timed = rows.into_iter().map(|row| (row.moment.map(|moment| moment.since(start_ns)), row));
    match joints.rows {
        JointRows::Visits => {
            timed.map(|(time_s, row)| Stand { row, span_s: time_s.map(|time| (time, time)) }).collect()
        }
        JointRows::Log => {
            let mut moments: Vec<(f64, JointRow)> = timed.filter_map(|(time_s, row)| Some((time_s?, row))).collect();
            moments.sort_by(|left, right| left.0.total_cmp(&right.0));
            standstills(&moments, &joints.still)
        }
    }
}

/// The longest stretches, from the first row on, in which every joint stays near to where it was at their beginning.
fn standstills(moments: &[(f64, JointRow)], still: &StillToml) -> Vec<Stand> {
    let mut stands = Vec::new();
    let mut first = 0;
    while first < moments.len() {
        let (from, begin) = &moments[first];
        let near = |row: &JointRow| {
            row.key == begin.key
                && row.joints.iter().zip(&begin.joints).all(|(now, then)| (now - then).abs() <= still.within)
        };
        let count = moments[first..].iter().take_while(|(_, row)| near(row)).count().max(1);
        let stretch = &moments[first..first + count];
        let to = stretch.last().map_or(*from, |(time, _)| *time);
        if to - from < still.seconds {
            first += 1;
            continue;
        }
        let mean = |of: &dyn Fn(&JointRow) -> Option<Vec<f64>>| -> Option<Vec<f64>> {
            let values: Vec<Vec<f64>> = stretch.iter().filter_map(|(_, row)| of(row)).collect();
            let zero = values.first()?.clone();
            // About the first row: equal rows give it to the last bit.
            let mut sum = vec![0.0; zero.len()];
            for value in &values {
                sum.iter_mut().zip(value.iter().zip(&zero)).for_each(|(sum, (value, zero))| *sum += value - zero);
            }
            Some(zero.iter().zip(&sum).map(|(zero, sum)| zero + sum / values.len() as f64).collect())
        };
        let joints = mean(&|row| Some(row.joints.clone())).unwrap_or_else(|| begin.joints.clone());
        let commanded = mean(&|row| row.commanded.clone());
        stands.push(Stand { row: JointRow { joints, commanded, ..begin.clone() }, span_s: Some((*from, to)) });
        first += count;
    }
    stands
}

/// Gives numbers to visits that have none, in their order: postures are numbered as they first come, and a cycle ends where a
/// posture comes that it had already.
pub(super) fn number<'s>(postures: impl Iterator<Item = &'s [f64]>, same: f64) -> Vec<Key> {
    let mut known: Vec<&[f64]> = Vec::new();
    let mut last_cycle: Vec<Option<u32>> = Vec::new();
    let mut cycle = 0;
    postures
        .map(|joints| {
            let is_same = |other: &&[f64]| other.iter().zip(joints).all(|(a, b)| (a - b).abs() <= same);
            let pose = known.iter().position(is_same).unwrap_or_else(|| {
                known.push(joints);
                last_cycle.push(None);
                known.len() - 1
            });
            if last_cycle[pose] == Some(cycle) {
                cycle += 1;
            }
            last_cycle[pose] = Some(cycle);
            (cycle, pose as u32)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn postures_are_numbered_as_they_come_and_cycles_by_their_return() {
        let [a, b, c] = [[0.0, 1.0], [0.5, 1.0], [0.5, -1.0]];
        let again = [0.0004, 0.9996];
        let visits = [&a[..], &b, &c, &again, &c, &b, &a];
        assert_eq!(
            number(visits.into_iter(), 1e-3),
            [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2), (1, 1), (2, 0)],
            "the order of postures may change from cycle to cycle"
        );
    }

    #[test]
    fn standstills_are_found_in_a_log() {
        let row = |time: f64, joint: f64| {
            let row = JointRow {
                source: (0, 0),
                line: 1,
                moment: None,
                key: None,
                joints: vec![joint],
                commanded: None,
                payload_kg: None,
            };
            (time, row)
        };
        // Rest, a move, a rest that is too short, a move, a rest with an encoder's last digit flickering.
        let mut moments: Vec<_> = (0..10).map(|index| row(f64::from(index) * 0.1, 0.5)).collect();
        moments.extend((0..5).map(|index| row(1.0 + f64::from(index) * 0.1, 0.5 + 0.1 * f64::from(index + 1))));
        moments.extend((0..3).map(|index| row(1.5 + f64::from(index) * 0.1, 1.0)));
        moments.extend((0..10).map(|index| row(2.0 + f64::from(index) * 0.1, 2.0 + f64::from(index % 2) * 2e-5)));
        let stands = standstills(&moments, &StillToml { within: 1e-4, seconds: 0.5 });
        let spans: Vec<_> = stands.iter().map(|stand| stand.span_s.expect("timed")).collect();
        assert_eq!(spans.len(), 2, "{spans:?}");
        assert_eq!(spans[0], (0.0, 0.9));
        assert!((spans[1].0 - 2.0).abs() < 1e-12 && (spans[1].1 - 2.9).abs() < 1e-12);
        assert_eq!(stands[0].row.joints, [0.5]);
        assert!((stands[1].row.joints[0] - 2.00001).abs() < 1e-12);
    }
}
