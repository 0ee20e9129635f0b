//! Which temperatures a correction follows: those of the sensors as long as all that matter are alive and plausible, and
//! otherwise the last ones for which that was so.
//!
//! Whether a sensor is alive is told by a clock that never goes back, from when its readings arrive: the times that readings
//! carry come from clocks that can be set, and only say which of two readings is the later one.

use crate::model::{CorrectionBounds, ReferenceTemperature};
use crate::run::TemperatureSeries;

/// What a sensor read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Its place among the model's sensors.
    pub sensor: usize,
    /// When, by whatever clock the source goes by, s.
    pub stamp_s: f64,
    /// Degrees Celsius.
    pub celsius: f64,
}

/// What the temperatures of a correction rest on.
#[derive(Debug, Clone, PartialEq)]
pub enum Footing {
    /// All sensors that matter.
    Live,
    /// The last temperatures at which all was well; why, a sentence each.
    Held(Vec<String>),
    /// The reference temperatures, because all has never been well yet; why.
    Reference(Vec<String>),
}

impl Footing {
    /// Its name in answers.
    pub fn name(&self) -> &'static str {
        match self {
            Footing::Live => "live",
            Footing::Held(_) => "held",
            Footing::Reference(_) => "reference",
        }
    }

    /// Why it is not live.
    pub fn why(&self) -> &[String] {
        match self {
            Footing::Live => &[],
            Footing::Held(why) | Footing::Reference(why) => why,
        }
    }
}

/// The latest reading of a sensor, and one of an earlier time that may begin a new count.
#[derive(Debug, Clone, Copy, Default)]
struct Latest {
    reading: Option<(f64, f64)>,
    arrived_s: f64,
    /// Stamp and arrival of the first, stamp of the last of those readings that carry earlier times than `reading`.
    rewound: Option<(f64, f64)>,
}

/// How long temperatures are remembered for parameters that follow late, s: five of the longest lags that are looked for.
const REMEMBERED_S: f64 = 25_000.0;

/// A step is no longer than this for the rate of temperatures, s: a host that was suspended does not owe a jump.
const LONGEST_STEP_S: f64 = 2.0;

/// Follows the temperatures of an arm's sensors.
#[derive(Debug, Clone)]
pub struct Follower {
    references: Vec<ReferenceTemperature>,
    needed: Vec<bool>,
    bounds: CorrectionBounds,
    latest: Vec<Latest>,
    applied: Vec<f64>,
    history: Vec<TemperatureSeries>,
    footing: Footing,
    ever_live: bool,
    stepped_s: Option<f64>,
}

impl Follower {
    /// For a model's sensors, of which those that are `needed` can move the arm.
    pub fn new(references: Vec<ReferenceTemperature>, needed: Vec<bool>, bounds: CorrectionBounds) -> Self {
        Self {
            latest: vec![Latest::default(); references.len()],
            applied: references.iter().map(|reference| reference.celsius).collect(),
            history: vec![TemperatureSeries::default(); references.len()],
            footing: Footing::Reference(vec!["no temperatures yet".to_owned()]),
            ever_live: false,
            stepped_s: None,
            references,
            needed,
            bounds,
        }
    }

    /// Takes readings that arrived at `now_s`, on a clock that never goes back.
    pub fn take(&mut self, readings: &[Reading], now_s: f64) {
        for reading in readings {
            let Some(latest) = self.latest.get_mut(reading.sensor) else { continue };
            if !reading.stamp_s.is_finite() {
                continue;
            }
            let later = latest.reading.is_none_or(|(stamp, _)| reading.stamp_s > stamp);
            let adopted = !later && latest.reading.is_some_and(|(stamp, _)| reading.stamp_s < stamp) && {
                // A clock that was set back looks like readings from the past. Those stop; a clock goes on.
                let (last, since) = latest.rewound.unwrap_or((f64::NEG_INFINITY, now_s));
                let goes_on = reading.stamp_s > last;
                if goes_on {
                    latest.rewound = Some((reading.stamp_s, since));
                }
                goes_on && now_s - since >= self.bounds.stale_s
            };
            if later || adopted {
                *latest = Latest { reading: Some((reading.stamp_s, reading.celsius)), arrived_s: now_s, rewound: None };
            }
        }
    }

    /// What is wrong with a sensor at a time, in words; none where it is alive and plausible.
    fn fault(&self, sensor: usize, now_s: f64) -> Option<String> {
        let (reference, latest) = (&self.references[sensor], &self.latest[sensor]);
        let name = &reference.sensor;
        let Some((_, celsius)) = latest.reading else { return Some(format!("sensor {name} has not been heard")) };
        let silent = now_s - latest.arrived_s;
        if silent > self.bounds.stale_s {
            return Some(match latest.rewound {
                Some(_) => format!("sensor {name}: its readings carry times from before; was a clock set back?"),
                None => format!("sensor {name} has been silent for {silent:.0} s"),
            });
        }
        let (low, high) = (reference.lowest - self.bounds.margin_k, reference.highest + self.bounds.margin_k);
        let plausible = (low..=high).contains(&celsius);
        (!plausible).then(|| {
            format!("sensor {name} reads {celsius:.2} °C, outside {low:.2} to {high:.2} °C that calibration knows")
        })
    }

    /// Moves on to a time: follows the sensors as fast as the bounds allow, or holds. `first` is for the time before any
    /// answer has left: there is nothing yet that could jump.
    pub fn step(&mut self, now_s: f64, first: bool) {
        let elapsed = self.stepped_s.map_or(0.0, |before| (now_s - before).clamp(0.0, LONGEST_STEP_S));
        self.stepped_s = Some(now_s);
        let needed: Vec<usize> = (0..self.references.len()).filter(|&sensor| self.needed[sensor]).collect();
        let faults: Vec<String> = needed.iter().filter_map(|&sensor| self.fault(sensor, now_s)).collect();
        if !faults.is_empty() {
            self.footing = if self.ever_live { Footing::Held(faults) } else { Footing::Reference(faults) };
            return;
        }
        let most = self.bounds.rate_k_per_s * elapsed;
        for sensor in needed {
            let Some((_, celsius)) = self.latest[sensor].reading else { continue };
            let applied = &mut self.applied[sensor];
            *applied = if first { celsius } else { *applied + (celsius - *applied).clamp(-most, most) };
            self.history[sensor].follow(now_s, *applied, now_s - REMEMBERED_S);
        }
        self.ever_live = true;
        self.footing = Footing::Live;
    }

    /// The temperatures that a correction uses, in the order of the model's sensors; none for sensors that do not matter.
    pub fn celsius(&self) -> Vec<Option<f64>> {
        self.applied.iter().zip(&self.needed).map(|(&celsius, &needed)| needed.then_some(celsius)).collect()
    }

    /// The temperatures that corrections used before.
    pub fn history(&self) -> &[TemperatureSeries] {
        &self.history
    }

    /// What they rest on.
    pub fn footing(&self) -> &Footing {
        &self.footing
    }
}
