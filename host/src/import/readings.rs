//! Rows of temperatures: a row a reading, or a row a moment with a column a sensor.

use super::mapping::{Column, TemperatureSource};
use super::source::{Keys, Prepared, Source, Times, place};
use super::time::Moment;
use crate::input::InputError;
use crate::run::ABSOLUTE_ZERO_CELSIUS;
use crate::table::is_usable_name;

/// °C: no sensor on an arm lives to tell of more.
const HOTTEST_CELSIUS: f64 = 1e3;

/// When a reading is from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum When {
    At(Moment),
    /// A visit, or all visits of a cycle.
    During(u32, Option<u32>),
}

/// One reading.
#[derive(Debug, Clone)]
pub(super) struct Reading {
    /// Which `[[temperatures]]` of the mapping, and which file of it.
    pub(super) source: (usize, usize),
    pub(super) line: usize,
    pub(super) when: When,
    /// Index into [`Readings::sensors`].
    pub(super) sensor: usize,
    pub(super) celsius: f64,
}

/// The readings of all logs.
#[derive(Debug, Default)]
pub(super) struct Readings {
    pub(super) sensors: Vec<String>,
    pub(super) readings: Vec<Reading>,
    /// Cells without a reading.
    pub(super) empty: usize,
}

impl Readings {
    fn sensor(&mut self, name: &str) -> usize {
        self.sensors.iter().position(|known| known == name).unwrap_or_else(|| {
            self.sensors.push(name.to_owned());
            self.sensors.len() - 1
        })
    }

    /// Takes in the rows of one `[[temperatures]]`.
    pub(super) fn read(
        &mut self,
        log: &TemperatureSource,
        index: usize,
        sources: &[Source],
        notes: &mut Vec<String>,
    ) -> Result<(), InputError> {
        for (file, source) in sources.iter().enumerate() {
            let prepared = Prepared::new(source, &log.files.layout);
            let columns = &log.columns;
            let wide: Vec<(Column, &String)> =
                columns.sensors.iter().map(|(column, sensor)| (column_of(column), sensor)).collect();
            let mut named: Vec<&Column> = wide.iter().map(|(column, _)| column).collect();
            named.extend([&columns.sensor, &columns.value, &columns.cycle, &columns.pose].into_iter().flatten());
            named.extend(log.time.iter().flat_map(|time| time.column.as_slice()));
            let mut table = prepared.table(&named)?;
            let times = Times::new(&table, source, log.time.as_ref())?;
            let keys = Keys::new(&table, &log.names, columns.cycle.as_ref(), columns.pose.as_ref())?;
            let long = match (&columns.sensor, &columns.value) {
                (Some(sensor), Some(value)) => Some((place(&table, sensor)?, place(&table, value)?)),
                _ => None,
            };
            let mut cells = Vec::with_capacity(wide.len());
            for (column, sensor) in &wide {
                if !is_usable_name(sensor) {
                    return Err(table.header_error("the mapping names a sensor that is no name on one line"));
                }
                cells.push((place(&table, column)?, self.sensor(sensor)));
            }
            while let Some(row) = table.next_row()? {
                let when = match (&times, keys.cycle_and_pose(&row)?) {
                    (Some(times), _) => When::At(times.of(&row)?),
                    (None, Some((cycle, pose))) => When::During(cycle, pose),
                    (None, None) => return Err(row.error("says neither a time nor a cycle")),
                };
                if let Some((sensor, value)) = long {
                    let Some(name) = log.names.renamed(row.name(sensor, "a sensor's name")?) else { continue };
                    if !is_usable_name(&name) {
                        return Err(row.unexpected(sensor, "a sensor's name"));
                    }
                    cells.clear();
                    cells.push((value, self.sensor(&name)));
                }
                for &(column, sensor) in &cells {
                    let expected = "a temperature from absolute zero to 1000 °C (empty where the sensor gave none)";
                    let Some(value) = row.optional_number(column, expected)? else {
                        self.empty += 1;
                        continue;
                    };
                    let celsius = log.unit.celsius(value);
                    if !(ABSOLUTE_ZERO_CELSIUS..=HOTTEST_CELSIUS).contains(&celsius) {
                        return Err(row.unexpected(column, expected));
                    }
                    self.readings.push(Reading { source: (index, file), line: row.line(), when, sensor, celsius });
                }
            }
            table.note_decimal_comma(notes);
        }
        Ok(())
    }
}

/// A key of `sensors` is a column's name, or its number where it is nothing else: TOML has no keys that are numbers.
fn column_of(key: &str) -> Column {
    key.parse().map_or_else(|_| Column::Name(key.to_owned()), Column::Number)
}
