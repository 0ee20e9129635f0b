//! Where present temperatures come from: the state that a logger leaves in its store, or a temperatures.csv that grows.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::follower::Reading;
use crate::logger::status::{Status, status_path};
use crate::model::Model;

/// Why there are no new readings: said, and looked for again later.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The file cannot be read.
    #[error("{}: {error}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// There is none yet.
    #[error("{}: not there; expected the state of a running `thermokin log`", .0.display())]
    NoLogger(PathBuf),
    /// A temperatures.csv without its columns.
    #[error("{}:1: expected the columns time_s, sensor, celsius", .0.display())]
    NoColumns(PathBuf),
}

/// Follows temperatures.
#[derive(Debug)]
pub enum Source {
    /// The newest values in a logger's store.
    Store(PathBuf),
    /// The rows that are added to a temperatures.csv.
    Table(Tail),
}

/// A growing file: how far it was read, and its columns.
#[derive(Debug)]
pub struct Tail {
    file: PathBuf,
    read: u64,
    /// The places of time_s, sensor and celsius.
    columns: Option<[usize; 3]>,
}

/// The most that is read of a growing file at once: what is older than that is not present.
const MOST_BYTES: u64 = 1 << 22;

impl Source {
    /// The store of a logger.
    pub fn store(folder: &Path) -> Self {
        Self::Store(folder.to_owned())
    }

    /// A temperatures.csv.
    pub fn table(file: &Path) -> Self {
        Self::Table(Tail { file: file.to_owned(), read: 0, columns: None })
    }

    /// The readings of the model's sensors that are new since the last call, or all newest ones.
    ///
    /// # Errors
    /// A file that cannot be read now; the next call tries again.
    pub fn poll(&mut self, model: &Model) -> Result<Vec<Reading>, SourceError> {
        let place = |name: &str| model.temperatures.iter().position(|reference| reference.sensor == name);
        match self {
            Self::Store(folder) => {
                let file = status_path(folder);
                let status = Status::read(folder).map_err(|error| SourceError::Io { file: file.clone(), error })?;
                let status = status.ok_or(SourceError::NoLogger(file))?;
                let values = status.boards.iter().flat_map(|board| &board.sensors);
                Ok(values
                    .filter_map(|value| {
                        let sensor = place(&value.sensor)?;
                        Some(Reading { sensor, stamp_s: value.at_us as f64 / 1e6, celsius: value.celsius })
                    })
                    .collect())
            }
            Self::Table(tail) => tail.poll(place),
        }
    }
}

impl Tail {
    fn poll(&mut self, place: impl Fn(&str) -> Option<usize>) -> Result<Vec<Reading>, SourceError> {
        let fail = |error| SourceError::Io { file: self.file.clone(), error };
        let mut file = File::open(&self.file).map_err(fail)?;
        let length = file.metadata().map_err(fail)?.len();
        if length < self.read {
            // Another file in its place, or cut: begun anew.
            (self.read, self.columns) = (0, None);
        }
        if self.columns.is_some() && length - self.read > MOST_BYTES {
            self.read = length - MOST_BYTES;
        }
        file.seek(SeekFrom::Start(self.read)).map_err(fail)?;
        let mut bytes = Vec::new();
        file.take(2 * MOST_BYTES).read_to_end(&mut bytes).map_err(fail)?;
        // A line that is still being written is read with the next call.
        let Some(whole) = bytes.iter().rposition(|&byte| byte == b'\n') else { return Ok(Vec::new()) };
        let text = String::from_utf8_lossy(&bytes[..=whole]);
        let mut lines = text.lines();
        let columns = match self.columns {
            Some(columns) => columns,
            None => {
                let header: Vec<&str> =
                    lines.next().unwrap_or_default().trim_start_matches('\u{feff}').split(',').map(str::trim).collect();
                let find = |name| header.iter().position(|column| *column == name);
                let (Some(time), Some(sensor), Some(celsius)) = (find("time_s"), find("sensor"), find("celsius"))
                else {
                    return Err(SourceError::NoColumns(self.file.clone()));
                };
                [time, sensor, celsius]
            }
        };
        self.columns = Some(columns);
        self.read += whole as u64 + 1;
        // A row that is none (cut off by a crash, half overwritten) says nothing about any sensor, which then falls silent.
        Ok(lines
            .filter_map(|line| {
                let cells: Vec<&str> = line.split(',').map(|cell| cell.trim().trim_matches('"')).collect();
                let [time, sensor, celsius] = columns.map(|column| cells.get(column).copied().unwrap_or_default());
                Some(Reading { sensor: place(sensor)?, stamp_s: time.parse().ok()?, celsius: celsius.parse().ok()? })
            })
            .collect())
    }
}
