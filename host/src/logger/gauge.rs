//! What one sensor shows: its newest value, its trend, and whether it behaves.

use std::collections::VecDeque;

use thermokin_protocol::{Reading, SensorKind};

use super::group::status_name;

/// A step this large, in kelvin, between two readings at most [`JUMP_US`] apart is no body's temperature: a MAX30205 on
/// metal follows with a time constant of seconds, and arms warm by kelvins in minutes.
const JUMP_K: f64 = 2.0;
/// Readings further apart than this are not compared.
const JUMP_US: u64 = 5_000_000;
/// This long without a jump, and the sensor counts as steady again.
const STEADY_US: u64 = 60_000_000;
/// The same counts for this long: 1/256 °C is below the noise and the drift of any air or metal in a cell.
const STUCK_US: u64 = 600_000_000;
/// …and in at least this many readings, so that slow sampling alone does not look stuck.
const STUCK_READINGS: u32 = 60;
/// A point of the trend's history is kept this often, for [`HISTORY`] points.
const HISTORY_US: u64 = 5_000_000;
const HISTORY: usize = 24;

/// Something about a sensor that was not so before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Remark {
    /// It gives no reading; the status says why.
    Gone(&'static str),
    /// It gives readings again.
    Back,
    /// The same counts for long.
    Stuck {
        /// Which temperature, in degrees Celsius.
        celsius: f64,
        /// For how long.
        seconds: u64,
    },
    /// The counts change again.
    Moving,
    /// A step that no body makes.
    Jump {
        /// Before, in degrees Celsius.
        from: f64,
        /// After, in degrees Celsius.
        to: f64,
    },
    /// No such step for a while.
    Steady,
}

/// One sensor's newest value and history.
#[derive(Debug, Clone, Default)]
pub struct Gauge {
    last: Option<Reading>,
    value: Option<(u64, f64, i16)>,
    same_since_us: u64,
    same: u32,
    stuck: bool,
    jumped_us: Option<u64>,
    history: VecDeque<(u64, f64)>,
}

impl Gauge {
    /// The newest reading.
    pub fn reading(&self) -> Option<Reading> {
        self.last
    }

    /// The newest value: when it was read, on the host's clock in microseconds, and degrees Celsius.
    pub fn value(&self) -> Option<(u64, f64)> {
        self.value.map(|(at_us, celsius, _)| (at_us, celsius))
    }

    /// How fast the value rises, in kelvin a minute, over the last two minutes at most; none before 10 s.
    pub fn trend_k_per_min(&self) -> Option<f64> {
        let ((then_us, then), (now_us, now)) = (*self.history.front()?, self.value()?);
        let seconds = now_us.checked_sub(then_us)? as f64 / 1e6;
        (seconds >= 10.0).then(|| (now - then) / seconds * 60.0)
    }

    /// The values of the last two minutes, oldest first.
    pub fn history(&self) -> impl Iterator<Item = f64> + '_ {
        self.history.iter().map(|(_, celsius)| *celsius)
    }

    /// Takes a reading taken at `at_us` on the host's clock. Readings that are older than the newest are history.
    pub fn take(&mut self, reading: Reading, kind: SensorKind, at_us: u64) -> Option<Remark> {
        if self.value.is_some_and(|(newest, ..)| at_us <= newest) {
            return None;
        }
        let had = !matches!(self.last, Some(Reading::Absent | Reading::BusError));
        self.last = Some(reading);
        let (Reading::Ok(counts) | Reading::OutOfRange(counts)) = reading else {
            return had.then(|| Remark::Gone(status_name(reading)));
        };
        let celsius = kind.celsius(counts);
        if self.history.back().is_none_or(|(last, _)| at_us.saturating_sub(*last) >= HISTORY_US) {
            self.history.push_back((at_us, celsius));
            if self.history.len() > HISTORY {
                self.history.pop_front();
            }
        }
        let before = self.value.replace((at_us, celsius, counts));
        if !had {
            return Some(Remark::Back);
        }
        let (before_us, before_celsius, before_counts) = before?;
        if counts != before_counts {
            (self.same_since_us, self.same) = (at_us, 0);
            if std::mem::take(&mut self.stuck) {
                return Some(Remark::Moving);
            }
        } else {
            self.same += 1;
            if self.same_since_us == 0 {
                self.same_since_us = before_us;
            }
            let same_us = at_us.saturating_sub(self.same_since_us);
            if !self.stuck && same_us >= STUCK_US && self.same >= STUCK_READINGS {
                self.stuck = true;
                return Some(Remark::Stuck { celsius, seconds: same_us / 1_000_000 });
            }
        }
        if at_us - before_us <= JUMP_US && (celsius - before_celsius).abs() >= JUMP_K {
            self.jumped_us = Some(at_us);
            return Some(Remark::Jump { from: before_celsius, to: celsius });
        }
        self.jumped_us.take_if(|jumped| at_us.saturating_sub(*jumped) >= STEADY_US).map(|_| Remark::Steady)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(gauge: &mut Gauge, second: u64, reading: Reading) -> Option<Remark> {
        gauge.take(reading, SensorKind::Max30205, second * 1_000_000)
    }

    #[test]
    fn a_sensor_that_leaves_and_returns() {
        let mut gauge = Gauge::default();
        assert_eq!(take(&mut gauge, 1, Reading::Ok(5120)), None);
        assert_eq!(take(&mut gauge, 2, Reading::Absent), Some(Remark::Gone("absent")));
        assert_eq!(take(&mut gauge, 3, Reading::BusError), None);
        assert_eq!(take(&mut gauge, 4, Reading::Ok(5121)), Some(Remark::Back));
        assert_eq!(gauge.value(), Some((4_000_000, 5121.0 / 256.0)));
    }

    #[test]
    fn a_sensor_that_is_stuck_for_ten_minutes() {
        let mut gauge = Gauge::default();
        let remarks: Vec<_> =
            (1..=1000).filter_map(|second| take(&mut gauge, second, Reading::Ok(5120)).map(|r| (second, r))).collect();
        assert_eq!(remarks, [(601, Remark::Stuck { celsius: 20.0, seconds: 600 })]);
        assert_eq!(take(&mut gauge, 1001, Reading::Ok(5121)), Some(Remark::Moving));
    }

    #[test]
    fn a_sensor_that_jumps() {
        let mut gauge = Gauge::default();
        assert_eq!(take(&mut gauge, 1, Reading::Ok(5120)), None);
        assert_eq!(take(&mut gauge, 2, Reading::Ok(5120 + 511)), None);
        assert_eq!(take(&mut gauge, 3, Reading::Ok(5120)), None);
        assert_eq!(take(&mut gauge, 4, Reading::Ok(5120 + 512)), Some(Remark::Jump { from: 20.0, to: 22.0 }));
        // Ten seconds without readings may well warm a body by this much.
        assert_eq!(take(&mut gauge, 14, Reading::Ok(5120)), None);
        assert_eq!(take(&mut gauge, 64, Reading::Ok(5121)), Some(Remark::Steady));
    }

    #[test]
    fn the_trend_is_kelvin_a_minute() {
        let mut gauge = Gauge::default();
        for second in 0..=60 {
            take(&mut gauge, second + 1, Reading::Ok(5120 + 4 * second as i16));
        }
        let trend = gauge.trend_k_per_min().expect("a minute is enough");
        assert!((trend - 240.0 / 256.0).abs() < 1e-9, "{trend}");
    }
}
