//! Times as programs write them: seconds of some clock, or dates in any of their spellings.

use jiff::civil::DateTime;
use jiff::fmt::strtime::BrokenDownTime;
use jiff::tz::TimeZone;
use serde::Deserialize;

use super::mapping::{Column, OneOrMany};

/// How the time of a row is written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TimeToml {
    /// One column, or several whose cells are joined by a space (a date and a time of day).
    pub(super) column: OneOrMany<Column>,
    /// Of a number; absent beside `format`.
    #[serde(default)]
    pub(super) unit: TimeUnit,
    /// Of a date, as `strftime` has it.
    pub(super) format: Option<String>,
    /// Added to every time, s: what this clock lacks.
    #[serde(default)]
    pub(super) offset_s: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum TimeUnit {
    #[default]
    S,
    Ms,
    Us,
    Min,
    H,
    /// Seconds since 1970.
    UnixS,
    /// Milliseconds since 1970.
    UnixMs,
}

/// Beyond this, s, a number is no time: a thousand years since 1970.
const LONGEST_S: f64 = 3.2e10;

/// A moment before it is known when the run began.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Moment {
    /// Seconds since the run began.
    Seconds(f64),
    /// Nanoseconds since 1970; dates without a zone are taken as if they were UTC. And what is added, s.
    Date(i128, f64),
}

impl Moment {
    /// Seconds since the run began, at `start_ns`.
    pub(super) fn since(self, start_ns: i128) -> f64 {
        match self {
            Self::Seconds(seconds) => seconds,
            Self::Date(ns, offset_s) => (ns - start_ns) as f64 * 1e-9 + offset_s,
        }
    }
}

impl TimeToml {
    /// The moment that a text says, or what was expected instead.
    pub(super) fn moment(&self, text: &str) -> Result<Moment, String> {
        if let Some(format) = &self.format {
            return match parse_date(format, text) {
                Some(ns) => Ok(Moment::Date(ns, self.offset_s)),
                None => Err(format!("a time of the form {format:?}")),
            };
        }
        // Where a comma splits no columns, it may stand for the decimal point.
        let number = text.parse().or_else(|_| text.replacen(',', ".", 1).parse()).ok();
        let number = number.filter(|number: &f64| number.is_finite()).ok_or("a time as a number")?;
        let seconds = |factor: f64| match number * factor + self.offset_s {
            seconds if seconds.abs() <= LONGEST_S => Ok(Moment::Seconds(seconds)),
            _ => Err("a time of this age".to_owned()),
        };
        match self.unit {
            TimeUnit::S => seconds(1.0),
            TimeUnit::Ms => seconds(1e-3),
            TimeUnit::Us => seconds(1e-6),
            TimeUnit::Min => seconds(60.0),
            TimeUnit::H => seconds(3600.0),
            TimeUnit::UnixS => Ok(Moment::Date((number * 1e9).round() as i128, self.offset_s)),
            TimeUnit::UnixMs => Ok(Moment::Date((number * 1e6).round() as i128, self.offset_s)),
        }
    }
}

/// Nanoseconds since 1970 of a date and time of the usual spelling.
pub(super) fn date_of(text: &str) -> Option<i128> {
    civil_ns(text.trim().parse::<DateTime>().ok()?)
}

fn parse_date(format: &str, text: &str) -> Option<i128> {
    let parts = BrokenDownTime::parse(format, text).ok()?;
    if parts.offset().is_some() {
        return Some(parts.to_timestamp().ok()?.as_nanosecond());
    }
    civil_ns(parts.to_datetime().ok()?)
}

fn civil_ns(date: DateTime) -> Option<i128> {
    Some(date.to_zoned(TimeZone::UTC).ok()?.timestamp().as_nanosecond())
}
