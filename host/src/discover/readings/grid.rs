//! The log on common times: all sensors of the arm and the air at one period, and the rows where all of them are known.

use crate::robot::Robot;
use crate::run::{Run, TemperatureLog, TemperatureSeries};

/// Fewer common rows than this teach nothing.
const FEWEST_ROWS: usize = 200;

/// More rows than this only cost time: heat is slow.
const MOST_ROWS: f64 = 4000.0;

/// A sensor that misses more than this share of the rows is left out, lest it take the rows of all others.
const MOST_MISSING: f64 = 0.1;

/// A sensor that moves less than this, K, over the run is dead or was never warmed.
const LEAST_SPREAD_K: f64 = 0.2;

/// Rows on each side of a row over which the air is averaged: its noise as a regressor would dilute its weight.
const AIR_REACH: usize = 3;

/// A sensor of the arm on the common times.
pub(super) struct Aligned {
    /// Its name.
    pub name: String,
    /// The link it is glued to.
    pub link: usize,
    /// What it read at each time, °C; drawn straight across gaps.
    pub celsius: Vec<f64>,
}

/// The log on common times.
pub(super) struct Grid {
    /// Common times, s, equally spaced.
    pub times_s: Vec<f64>,
    /// Their spacing, s.
    pub period_s: f64,
    /// The arm's sensors that are usable.
    pub sensors: Vec<Aligned>,
    /// The air of the cell, °C, smoothed; none where the run does not say what reads it.
    pub air: Option<Vec<f64>>,
    /// The times at which everything above was really read.
    pub rows: Vec<usize>,
}

impl Grid {
    /// Lays a log on common times; none where too little of it is common.
    pub fn new(robot: &Robot, run: &Run, log: &TemperatureLog) -> Option<Self> {
        let of_arm: Vec<(&str, usize, &TemperatureSeries)> = robot
            .sensors
            .iter()
            .filter(|sensor| run.description.ambient.as_deref() != Some(sensor.name.as_str()))
            .filter_map(|sensor| {
                let series = &log.series[log.index_of(&sensor.name)?];
                Some((sensor.name.as_str(), sensor.link, series))
            })
            .filter(|(_, _, series)| series.spread() >= LEAST_SPREAD_K)
            .collect();
        let mut periods: Vec<f64> = of_arm.iter().filter_map(|(_, _, series)| series.median_period_s()).collect();
        periods.sort_by(f64::total_cmp);
        let median = *periods.get(periods.len() / 2)?;
        let ends =
            |end: fn(&[f64]) -> Option<&f64>| of_arm.iter().filter_map(move |(_, _, s)| end(s.times_s()).copied());
        let start_s = ends(<[f64]>::first).fold(f64::INFINITY, f64::min);
        let end_s = ends(<[f64]>::last).fold(f64::NEG_INFINITY, f64::max);
        let period_s = median.max((end_s - start_s) / MOST_ROWS);
        if !(period_s > 0.0 && period_s.is_finite()) {
            return None;
        }
        let count = ((end_s - start_s) / period_s) as usize + 1;
        let times_s: Vec<f64> = (0..count).map(|row| start_s + row as f64 * period_s).collect();

        let mut known = vec![true; count];
        let mut lay = |series: &TemperatureSeries| -> Option<Vec<f64>> {
            let (celsius, read) = on_times(series, &times_s, period_s);
            let missing = read.iter().filter(|read| !**read).count();
            if missing as f64 > MOST_MISSING * count as f64 {
                return None;
            }
            known.iter_mut().zip(read).for_each(|(known, read)| *known &= read);
            Some(celsius)
        };
        let sensors: Vec<Aligned> = of_arm
            .into_iter()
            .filter_map(|(name, link, series)| Some(Aligned { name: name.to_owned(), link, celsius: lay(series)? }))
            .collect();
        let air = run
            .description
            .ambient
            .as_deref()
            .and_then(|name| lay(&log.series[log.index_of(name)?]))
            .map(|celsius| smoothed(&celsius));
        let rows: Vec<usize> = (0..count).filter(|&row| known[row]).collect();
        (rows.len() >= FEWEST_ROWS && sensors.len() >= 3).then_some(Self { times_s, period_s, sensors, air, rows })
    }

    /// The known rows of a column over all common times.
    pub fn take(&self, column: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|&row| column[row]).collect()
    }

    /// The known times, s.
    pub fn known_times(&self) -> Vec<f64> {
        self.take(&self.times_s)
    }

    /// A column over all common times as a first-order lag follows it.
    pub fn lagged(&self, column: &[f64], tau_s: f64) -> Vec<f64> {
        let share = -(-self.period_s / tau_s).exp_m1();
        // The first few readings rather than the first: the noise of one would take a lag to fade.
        let few = column.len().min(5);
        let mut state = column[..few].iter().sum::<f64>() / few as f64;
        column
            .iter()
            .map(|value| {
                state += share * (value - state);
                state
            })
            .collect()
    }
}

/// A series at given times, and whether it was really read there: the mean of the readings around a time where there are
/// many, else the line between neighbours.
fn on_times(series: &TemperatureSeries, times_s: &[f64], period_s: f64) -> (Vec<f64>, Vec<bool>) {
    let max_gap_s = series.max_gap_s(&Default::default());
    let dense = series.median_period_s().is_some_and(|own| own < 0.7 * period_s);
    let (all_times, all) = (series.times_s(), series.celsius());
    times_s
        .iter()
        .map(|&time| {
            if dense {
                let from = all_times.partition_point(|&at| at < time - 0.5 * period_s);
                let to = all_times.partition_point(|&at| at < time + 0.5 * period_s);
                if to > from {
                    return (all[from..to].iter().sum::<f64>() / (to - from) as f64, true);
                }
            }
            let read = series.at(time, max_gap_s).celsius().is_some();
            (series.at(time, f64::INFINITY).celsius().unwrap_or(0.0), read)
        })
        .unzip()
}

fn smoothed(column: &[f64]) -> Vec<f64> {
    (0..column.len())
        .map(|row| {
            let around = &column[row.saturating_sub(AIR_REACH)..(row + AIR_REACH + 1).min(column.len())];
            around.iter().sum::<f64>() / around.len() as f64
        })
        .collect()
}
