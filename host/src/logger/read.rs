//! The messages of a log, read back.

use std::fmt;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};

use super::group::MarkKind;
use super::store::{self, Logged, Scan, Topic};
use crate::input::InputError;

/// A JSON object as pairs, in its order.
#[derive(Debug, Clone, PartialEq)]
pub struct Pairs<T>(pub Vec<(String, T)>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Pairs<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Take<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Take<T> {
            type Value = Pairs<T>;
            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut pairs = Vec::new();
                while let Some(pair) = map.next_entry()? {
                    pairs.push(pair);
                }
                Ok(Pairs(pairs))
            }
        }
        deserializer.deserialize_map(Take(PhantomData))
    }
}

/// A record, from `/board/N/readings`.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
pub struct LoggedRecord {
    /// When the sensors were read, in seconds since 1970 on the host's clock as known on arrival.
    pub time_s: f64,
    /// The board.
    pub board: u32,
    /// The store that numbered it.
    pub store: u32,
    /// The boot on whose clock it was taken.
    pub boot: u32,
    /// Its number.
    pub sequence: u64,
    /// When the sensors were read, on the board's clock in microseconds.
    pub board_us: u64,
    /// Degrees Celsius by sensor.
    pub celsius: Pairs<f64>,
    /// Raw counts by sensor.
    pub counts: Pairs<i16>,
    /// Status by sensor.
    pub status: Pairs<String>,
}

/// What a report said of the clocks, from `/board/N/status`.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
pub struct LoggedReport {
    /// The board.
    pub board: u32,
    /// Its boot.
    pub boot: u32,
    /// When it came, on the host's clock in microseconds.
    pub arrived_us: u64,
    /// When it left, on the board's clock in microseconds.
    pub sent_us: u64,
    /// The answer that it echoes.
    pub echo: Option<LoggedEcho>,
}

/// The echo of an answer.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
pub struct LoggedEcho {
    /// When the answer left, on the host's clock in microseconds.
    pub host_us: u64,
    /// When it came, on the board's clock in microseconds.
    pub received_us: u64,
}

/// Records that will never come, from `/gaps`.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
pub struct LoggedGap {
    /// The board.
    pub board: u32,
    /// The store.
    pub store: u32,
    /// One past the last store that this says the same of; none in a log from before there was such a number.
    pub stores_until: Option<u32>,
    /// The first sequence.
    pub from: u64,
    /// One past the last; none where nobody knows how many there were.
    pub until: Option<u64>,
}

impl LoggedGap {
    /// Whether it says that a record will never come.
    pub fn tells(&self, store: u32, sequence: u64) -> bool {
        let stores = self.store..self.stores_until.unwrap_or(self.store.saturating_add(1));
        stores.contains(&store) && self.from <= sequence && self.until.is_none_or(|until| sequence < until)
    }
}

/// A run's start or stop, or a mark, from `/marks`.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
pub struct LoggedMark {
    /// When, in seconds since 1970 on the host's clock.
    pub time_s: f64,
    /// What it is.
    pub kind: MarkKind,
    /// The run's name or the mark's text.
    pub name: String,
}

/// A message of a log.
#[derive(Debug, Clone)]
pub enum LogMessage {
    /// A record.
    Record(LoggedRecord),
    /// A report.
    Report(LoggedReport),
    /// A gap.
    Gap(LoggedGap),
    /// A mark.
    Mark(LoggedMark),
}

/// How many bytes a log has: what one [`read`] of it steps through.
pub fn size(path: &Path) -> Result<u64, InputError> {
    let failed = |error: std::io::Error| InputError::of_file(path, error.to_string());
    let files = store::files(path).map_err(failed)?;
    files.iter().map(|file| Ok(file.metadata().map_err(failed)?.len())).sum()
}

/// Reads every log file of a folder, or one file, oldest first, and calls `each` with the file's place in the order and
/// those messages that `wanted` picks; `step` is called now and then with how many more bytes were read. Returns the
/// files with what their scans found.
pub fn read(
    path: &Path,
    step: &dyn Fn(u64),
    wanted: impl Fn(Topic) -> bool,
    mut each: impl FnMut(usize, LogMessage),
) -> Result<Vec<(PathBuf, Scan)>, InputError> {
    let files = store::files(path).map_err(|error| InputError::of_file(path, error.to_string()))?;
    if files.is_empty() {
        return Err(InputError::of_file(path, "holds no log: expected files ending in .mcap"));
    }
    let mut scans = Vec::new();
    for (index, file) in files.into_iter().enumerate() {
        let mut wrong = None;
        let scan = store::scan_stepwise(&file, step, |logged| {
            if logged.topic.is_some_and(&wanted) {
                match parse(&logged) {
                    Ok(Some(message)) => each(index, message),
                    Ok(None) => {}
                    Err(error) => wrong = wrong.take().or(Some(error)),
                }
            }
        })?;
        if let Some(error) = wrong {
            return Err(InputError::of_file(&file, format!("a message is not what this version writes: {error}")));
        }
        scans.push((file, scan));
    }
    Ok(scans)
}

fn parse(logged: &Logged<'_>) -> serde_json::Result<Option<LogMessage>> {
    Ok(match logged.topic {
        Some(Topic::Readings(_)) => Some(LogMessage::Record(serde_json::from_slice(logged.data)?)),
        Some(Topic::Status(_)) => Some(LogMessage::Report(serde_json::from_slice(logged.data)?)),
        Some(Topic::Gaps) => Some(LogMessage::Gap(serde_json::from_slice(logged.data)?)),
        Some(Topic::Marks) => Some(LogMessage::Mark(serde_json::from_slice(logged.data)?)),
        _ => None,
    })
}
