//! A fault that was found: what it is called, how surely, and how the log looks without it.

use super::explained::Freedom;
use super::grid::Grid;
use super::motion::Motion;
use crate::run::TemperatureLog;

/// How many kinds of faults are looked for.
const FAMILIES: f64 = 6.0;

/// Logarithm of the chance that a run without faults is given one, by design: 0.2 %.
const LN_FALSE: f64 = -6.2;

/// A number with its interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The contract's name, unit included.
    pub name: &'static str,
    /// The value.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Estimate {
    pub(super) fn new(name: &'static str, value: f64, low: f64, high: f64) -> Self {
        Self { name, value, low, high }
    }
}

/// What all searches look at.
pub(super) struct Context<'a> {
    /// The log on common times.
    pub grid: &'a Grid,
    /// When the arm moved.
    pub motion: &'a Motion,
    /// The known times, s.
    pub times_s: Vec<f64>,
    /// In how many ways heat can differ from what mates tell.
    pub freedom: Freedom,
}

impl<'a> Context<'a> {
    pub fn new(grid: &'a Grid, motion: &'a Motion) -> Self {
        let times_s = grid.known_times();
        let context = Self { grid, motion, times_s, freedom: Freedom::of(0) };
        Self { freedom: Freedom::of(context.movements()), ..context }
    }

    /// How many movements the log holds whole.
    pub fn movements(&self) -> usize {
        let ends = (self.times_s.first(), self.times_s.last());
        let (Some(&from_s), Some(&to_s)) = ends else { return 0 };
        self.motion.within(from_s, to_s)
    }

    /// How many sensors there are.
    pub fn sensors(&self) -> f64 {
        self.grid.sensors.len() as f64
    }

    /// A `ln P` of one test above this cannot become a fault when `trials` are made at every sensor.
    pub fn hopeless(&self, trials: f64) -> f64 {
        LN_FALSE - (FAMILIES * trials * self.sensors()).ln()
    }
}

/// A possible fault.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    /// The contract's name.
    pub effect: &'static str,
    /// The sensors' places in the grid; none where it is all of them.
    pub sensors: Vec<usize>,
    /// Log evidence against no fault.
    pub score: f64,
    /// `ln P` over all searches of its kind.
    pub ln_p: f64,
    /// Its numbers.
    pub parameters: Vec<Estimate>,
    /// What speaks for it.
    pub evidence: String,
    /// How to undo it.
    pub undo: Undo,
}

impl Candidate {
    /// `ln P` over everything that is examined.
    pub fn ln_p_of_all(&self) -> f64 {
        (self.ln_p + FAMILIES.ln()).min(0.0)
    }

    /// Whether it is sure enough to be named.
    pub fn is_sure(&self) -> bool {
        self.ln_p_of_all() <= LN_FALSE
    }
}

/// What takes a fault out of a log.
#[derive(Debug, Clone)]
pub(super) enum Undo {
    Chill { sensor: usize, depth_k: f64, tau_s: f64 },
    Step { sensor: usize, time_s: f64, step_k: f64 },
    Drift { sensor: usize, start_s: f64, drift_k_per_h: f64 },
    Detached { sensor: usize, share: f64 },
    Swap { one: usize, other: usize },
    Clock { offset_s: f64 },
}

impl Undo {
    /// The log as it would be without the fault.
    pub fn applied(&self, log: &TemperatureLog, grid: &Grid, motion: &Motion, ambient: Option<&str>) -> TemperatureLog {
        let name = |sensor: usize| grid.sensors[sensor].name.as_str();
        match *self {
            Self::Chill { sensor, depth_k, tau_s } => changed(log, name(sensor), |times, celsius| {
                let moved = motion.followed(tau_s, times);
                celsius.iter().zip(moved).map(|(c, moved)| c + depth_k * moved).collect()
            }),
            Self::Step { sensor, time_s, step_k } => changed(log, name(sensor), |times, celsius| {
                celsius.iter().zip(times).map(|(c, &time)| if time >= time_s { c - step_k } else { *c }).collect()
            }),
            Self::Drift { sensor, start_s, drift_k_per_h } => changed(log, name(sensor), |times, celsius| {
                celsius.iter().zip(times).map(|(c, time)| c - drift_k_per_h * (time - start_s) / 3600.0).collect()
            }),
            Self::Detached { sensor, share } => {
                let Some(air) = ambient.and_then(|name| log.index_of(name)).map(|index| &log.series[index]) else {
                    return log.clone();
                };
                changed(log, name(sensor), |times, celsius| {
                    let air = times.iter().map(|&time| air.at(time, f64::INFINITY).celsius());
                    let body = |(c, air): (&f64, Option<f64>)| air.map_or(*c, |air| (c - share * air) / (1.0 - share));
                    celsius.iter().zip(air).map(body).collect()
                })
            }
            Self::Swap { one, other } => {
                let exchanged = |known: &str| match known {
                    known if known == name(one) => name(other).to_owned(),
                    known if known == name(other) => name(one).to_owned(),
                    known => known.to_owned(),
                };
                let sensors = log.sensors.iter().map(|known| exchanged(known)).collect();
                TemperatureLog { sensors, series: log.series.clone() }
            }
            Self::Clock { offset_s } => {
                TemperatureLog::from_readings(log.sensors.iter().zip(&log.series).flat_map(|(name, series)| {
                    let readings = series.times_s().iter().zip(series.celsius());
                    readings.map(move |(time, celsius)| (time - offset_s, name, *celsius))
                }))
            }
        }
    }
}

/// The log with one sensor's readings replaced by what `change` makes of its times and readings.
fn changed(log: &TemperatureLog, sensor: &str, change: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> TemperatureLog {
    TemperatureLog::from_readings(log.sensors.iter().zip(&log.series).flat_map(|(name, series)| {
        let celsius =
            if name == sensor { change(series.times_s(), series.celsius()) } else { series.celsius().to_vec() };
        series.times_s().iter().zip(celsius).map(move |(&time, celsius)| (time, name, celsius)).collect::<Vec<_>>()
    }))
}
