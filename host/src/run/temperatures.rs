//! temperatures.csv: the log of every sensor, and what each sensor read when the arm stood at a visit.

use std::path::Path;

use super::points::Names;
use super::{Run, WriteError};
use crate::input::InputError;
use crate::table::{Table, TableWriter};

/// The name of the file in its folder.
pub(super) const FILE: &str = "temperatures.csv";

const COLUMNS: [&str; 3] = ["time_s", "sensor", "celsius"];

/// No gap shorter than this is a gap, s: bodies of metal keep their temperature longer.
const SHORTEST_MAX_GAP_S: f64 = 120.0;

/// How many periods of a sensor may pass before its readings have a gap.
const MAX_GAP_PERIODS: f64 = 5.0;

/// °C.
pub(crate) const ABSOLUTE_ZERO_CELSIUS: f64 = -273.15;

/// The readings of all sensors of a run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TemperatureLog {
    /// The sensors' names, in the order of their first readings.
    pub sensors: Vec<String>,
    /// The readings of each sensor, in the order of `sensors`.
    pub series: Vec<TemperatureSeries>,
}

/// The readings of one sensor: times ascending without repetition, as many temperatures as times, at least one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TemperatureSeries {
    times_s: Vec<f64>,
    celsius: Vec<f64>,
}

/// How readings are joined to times.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct JoinOptions {
    /// The longest gap that is interpolated across, and the longest time that a reading is held, s. Absent: five times
    /// the sensor's median period, at least 120 s.
    pub max_gap_s: Option<f64>,
}

/// What a sensor read at a time, °C, and how that is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Joined {
    /// Read at that very time, or interpolated linearly between two readings that are no gap apart.
    Interpolated(f64),
    /// The nearest reading, no longer away than a gap: in a gap, before the first reading or after the last.
    Held(f64),
    /// No reading is near enough.
    Missing,
}

impl Joined {
    /// The temperature, °C, where there is one.
    pub fn celsius(self) -> Option<f64> {
        match self {
            Self::Interpolated(celsius) | Self::Held(celsius) => Some(celsius),
            Self::Missing => None,
        }
    }
}

impl TemperatureLog {
    /// A log of readings (s, sensor, °C) in any order. Readings of one sensor at one time become their mean.
    ///
    /// The values are taken as they are: finite numbers are the caller's business, and [`super::write`] checks them.
    pub fn from_readings<S: AsRef<str>>(readings: impl IntoIterator<Item = (f64, S, f64)>) -> Self {
        let mut collector = Collector::default();
        for (time_s, sensor, celsius) in readings {
            collector.add(time_s, sensor.as_ref(), celsius);
        }
        collector.finish().0
    }

    /// Reads a file of the form of temperatures.csv, wherever it lies; what is odd but usable is said in `notes`.
    ///
    /// # Errors
    /// What is wrong with it, with its line; a file that cannot be read.
    pub fn read(file: &Path, notes: &mut Vec<String>) -> Result<Self, InputError> {
        let bytes =
            std::fs::read(file).map_err(|error| InputError::of_file(file, format!("cannot be read: {error}")))?;
        parse_file(file, &bytes, notes)
    }

    /// The index of a sensor.
    pub fn index_of(&self, sensor: &str) -> Option<usize> {
        self.sensors.iter().position(|known| known == sensor)
    }

    /// What a sensor read at a time, °C; `None` where no reading is near enough or the sensor is unknown.
    pub fn at(&self, sensor: usize, time_s: f64) -> Option<f64> {
        let series = self.series.get(sensor)?;
        series.at(time_s, series.max_gap_s(&JoinOptions::default())).celsius()
    }
}

impl TemperatureSeries {
    /// One reading, which stands for a temperature that has always been so.
    pub fn constant(time_s: f64, celsius: f64) -> Self {
        Self { times_s: vec![time_s], celsius: vec![celsius] }
    }

    /// The readings up to a time.
    pub fn until(&self, time_s: f64) -> Self {
        let count = self.times_s.partition_point(|&time| time <= time_s);
        Self { times_s: self.times_s[..count].to_vec(), celsius: self.celsius[..count].to_vec() }
    }

    /// Takes in a later reading, and forgets those from before `since_s`; a time that is not later is not taken.
    pub fn follow(&mut self, time_s: f64, celsius: f64, since_s: f64) {
        if self.times_s.last().is_some_and(|&last| time_s <= last) {
            return;
        }
        self.times_s.push(time_s);
        self.celsius.push(celsius);
        let past = self.times_s.partition_point(|&time| time < since_s);
        self.times_s.drain(..past);
        self.celsius.drain(..past);
    }

    /// When the sensor was read, s, ascending.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// What it read, °C, at each time.
    pub fn celsius(&self) -> &[f64] {
        &self.celsius
    }

    /// The highest reading less the lowest, K. A sensor whose spread is next to nothing teaches nothing.
    pub fn spread(&self) -> f64 {
        let highest = self.celsius.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let lowest = self.celsius.iter().copied().fold(f64::INFINITY, f64::min);
        (highest - lowest).max(0.0)
    }

    /// The median time between readings, s; `None` for fewer than two.
    pub fn median_period_s(&self) -> Option<f64> {
        let mut periods: Vec<f64> = self.times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        if periods.is_empty() {
            return None;
        }
        let middle = periods.len() / 2;
        let (_, &mut median, _) = periods.select_nth_unstable_by(middle, f64::total_cmp);
        Some(median)
    }

    /// The longest gap that is interpolated across, s.
    pub fn max_gap_s(&self, options: &JoinOptions) -> f64 {
        options.max_gap_s.unwrap_or_else(|| {
            self.median_period_s()
                .map_or(SHORTEST_MAX_GAP_S, |period| (MAX_GAP_PERIODS * period).max(SHORTEST_MAX_GAP_S))
        })
    }

    /// What the sensor read at a time, given the longest gap, s.
    pub fn at(&self, time_s: f64, max_gap_s: f64) -> Joined {
        let after = self.times_s.partition_point(|&time| time < time_s);
        let reading = |index: usize| Some((*self.times_s.get(index)?, *self.celsius.get(index)?));
        let before = after.checked_sub(1).and_then(reading);
        match (before, reading(after)) {
            (_, Some((time, celsius))) if time == time_s => Joined::Interpolated(celsius),
            (Some((t0, c0)), Some((t1, c1))) if t1 - t0 <= max_gap_s => {
                let share = (time_s - t0) / (t1 - t0);
                Joined::Interpolated(c0 + share * (c1 - c0))
            }
            (before, after) => [before, after]
                .into_iter()
                .flatten()
                .map(|(time, celsius)| ((time_s - time).abs(), celsius))
                .filter(|&(distance, _)| distance <= max_gap_s)
                .min_by(|left, right| left.0.total_cmp(&right.0))
                .map_or(Joined::Missing, |(_, celsius)| Joined::Held(celsius)),
        }
    }
}

/// What every sensor read at every visit.
#[derive(Debug, Clone, PartialEq)]
pub struct TemperatureTable {
    /// The sensors' names, one a column.
    pub sensors: Vec<String>,
    /// How each sensor's column came about.
    pub report: Vec<SensorJoin>,
    values: Vec<Option<f64>>,
}

/// How a sensor's temperatures at the visits came about: the three counts add up to the visits.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorJoin {
    /// The sensor's name.
    pub sensor: String,
    /// The longest gap that was interpolated across, and the longest time that a reading was held, s.
    pub max_gap_s: f64,
    /// Visits with a reading at their time or on both sides of it.
    pub interpolated: usize,
    /// Visits that took the nearest reading.
    pub held: usize,
    /// Visits without a temperature.
    pub missing: usize,
    /// The highest temperature at a visit less the lowest, K.
    pub spread_k: f64,
}

impl TemperatureTable {
    /// The temperatures at a visit, °C, one a sensor in the order of `sensors`.
    ///
    /// # Panics
    /// If there is no such visit.
    pub fn at_visit(&self, visit: usize) -> &[Option<f64>] {
        let columns = self.sensors.len();
        &self.values[visit * columns..(visit + 1) * columns]
    }

    /// What was not simply interpolated, in words; empty where nothing is to be said.
    pub fn notes(&self) -> Vec<String> {
        self.report
            .iter()
            .filter(|join| join.held + join.missing > 0)
            .map(|join| {
                let visits = join.interpolated + join.held + join.missing;
                format!(
                    "{FILE}: {}: of {visits} visits {} hold the nearest reading and {} have none (gaps above {:.0} s)",
                    join.sensor, join.held, join.missing, join.max_gap_s
                )
            })
            .collect()
    }
}

impl Run {
    /// What every sensor read when the arm stood at each visit; without columns in a run without temperatures.
    ///
    /// Readings on both sides of a visit are interpolated linearly unless they lie further apart than the longest gap;
    /// in a gap and beyond the ends of the log the nearest reading is held if it is within the longest gap, and else
    /// the temperature is missing.
    pub fn temperatures_at_visits(&self, options: &JoinOptions) -> TemperatureTable {
        let no_log = TemperatureLog::default();
        let log = self.temperatures.as_ref().unwrap_or(&no_log);
        let columns = log.sensors.len();
        let mut values = vec![None; columns * self.visits.len()];
        let mut report = Vec::with_capacity(columns);
        for (column, (sensor, series)) in log.sensors.iter().zip(&log.series).enumerate() {
            let max_gap_s = series.max_gap_s(options);
            let mut join =
                SensorJoin { sensor: sensor.clone(), max_gap_s, interpolated: 0, held: 0, missing: 0, spread_k: 0.0 };
            let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
            for (index, visit) in self.visits.iter().enumerate() {
                let joined = series.at(visit.time_s, max_gap_s);
                match joined {
                    Joined::Interpolated(_) => join.interpolated += 1,
                    Joined::Held(_) => join.held += 1,
                    Joined::Missing => join.missing += 1,
                }
                if let Some(celsius) = joined.celsius() {
                    lowest = lowest.min(celsius);
                    highest = highest.max(celsius);
                }
                values[index * columns + column] = joined.celsius();
            }
            join.spread_k = (highest - lowest).max(0.0);
            report.push(join);
        }
        TemperatureTable { sensors: log.sensors.clone(), report, values }
    }
}

/// Readings as they come, and what becomes of them.
#[derive(Default)]
struct Collector {
    names: Names,
    readings: Vec<Vec<(f64, f64)>>,
}

impl Collector {
    fn add(&mut self, time_s: f64, sensor: &str, celsius: f64) {
        let index = self.names.index_of(sensor);
        if index == self.readings.len() {
            self.readings.push(Vec::new());
        }
        self.readings[index].push((time_s, celsius));
    }

    /// The log, and how many readings were merged into others of the same sensor and time.
    fn finish(self) -> (TemperatureLog, usize) {
        let mut merged = 0;
        let mut sensors: Vec<(String, TemperatureSeries)> = Vec::with_capacity(self.readings.len());
        for (name, mut readings) in self.names.names.into_iter().zip(self.readings) {
            readings.sort_by(|left, right| left.0.total_cmp(&right.0));
            let mut series = TemperatureSeries::default();
            for same_time in readings.chunk_by(|left, right| left.0 == right.0) {
                // The mean about the first reading: equal readings stay equal to the last bit.
                let (time_s, first) = same_time[0];
                let above: f64 = same_time.iter().map(|&(_, celsius)| celsius - first).sum();
                series.times_s.push(time_s);
                series.celsius.push(first + above / same_time.len() as f64);
                merged += same_time.len() - 1;
            }
            sensors.push((name, series));
        }
        // By first reading, as the written file will name them.
        sensors.sort_by(|left, right| left.1.times_s[0].total_cmp(&right.1.times_s[0]));
        let (sensors, series) = sensors.into_iter().unzip();
        (TemperatureLog { sensors, series }, merged)
    }
}

/// Reads temperatures.csv.
pub(super) fn parse(folder: &Path, bytes: &[u8], notes: &mut Vec<String>) -> Result<TemperatureLog, InputError> {
    parse_file(&folder.join(FILE), bytes, notes)
}

fn parse_file(file: &Path, bytes: &[u8], notes: &mut Vec<String>) -> Result<TemperatureLog, InputError> {
    let mut table = Table::open(file, bytes, &COLUMNS)?;
    table.note_form(|name| COLUMNS.contains(&name), notes);
    let [time, sensor, celsius] = [table.required("time_s")?, table.required("sensor")?, table.required("celsius")?];
    let mut collector = Collector::default();
    let mut empty = 0_usize;
    while let Some(row) = table.next_row()? {
        let time_s = row.number(time, "a time in seconds")?;
        let name = row.name(sensor, "a sensor's name")?;
        let expected = "degrees Celsius from -273.15 (empty where the sensor gave none)";
        match row.optional_number(celsius, expected)? {
            None => empty += 1,
            Some(value) if value >= ABSOLUTE_ZERO_CELSIUS => collector.add(time_s, name, value),
            Some(_) => return Err(row.unexpected(celsius, expected)),
        }
    }
    table.note_decimal_comma(notes);
    let (log, merged) = collector.finish();
    if empty > 0 {
        notes.push(format!("{FILE}: {empty} row{} without a reading left out", if empty == 1 { "" } else { "s" }));
    }
    if merged > 0 {
        notes.push(format!(
            "{FILE}: {merged} reading{} of a sensor and time that stood before averaged with it",
            if merged == 1 { "" } else { "s" }
        ));
    }
    if log.sensors.is_empty() {
        notes.push(format!("{FILE}: holds no reading"));
    }
    Ok(log)
}

/// temperatures.csv's bytes, in order of time; `None` for a purely geometric run.
pub(super) fn format(run: &Run, folder: &Path) -> Result<Option<Vec<u8>>, WriteError> {
    let Some(log) = &run.temperatures else { return Ok(None) };
    let mut rows: Vec<(f64, usize, f64)> = Vec::new();
    for (sensor, series) in log.series.iter().enumerate() {
        rows.extend(series.times_s.iter().zip(&series.celsius).map(|(&time_s, &celsius)| (time_s, sensor, celsius)));
    }
    rows.sort_by(|left, right| left.0.total_cmp(&right.0).then(left.1.cmp(&right.1)));
    let mut table = TableWriter::new(folder.join(FILE), &COLUMNS.map(str::to_owned))?;
    for (time_s, sensor, celsius) in rows {
        let name = log.sensors.get(sensor).ok_or_else(|| WriteError::Content {
            file: folder.join(FILE),
            message: format!("sensor {sensor} has no name; the log names {}", log.sensors.len()),
        })?;
        table.number(time_s)?;
        table.name(name)?;
        table.number(celsius)?;
        table.end_row()?;
    }
    table.finish().map(Some)
}
