//! What a logger tells other processes of the boards that it hears: `status.json` beside the log files, written anew every
//! few seconds. It is for people and for the compensation of a robot that moves; nothing in the logger reads it.

use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thermokin_protocol::{Battery, ResetReason, Signal};

use super::engine::{BoardEntry, Engine};
use super::update::Job;

/// The state of a logger.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Status {
    /// The form of this file, 1.
    pub format: u32,
    /// When it was written, in microseconds since 1970.
    pub written_us: u64,
    /// The boards that were heard since the logger started, or that are to get a new program.
    pub boards: Vec<BoardStatus>,
}

/// The state of one board.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct BoardStatus {
    /// Its number.
    pub board: u32,
    /// When it was last heard, in microseconds since 1970.
    pub heard_us: Option<u64>,
    /// From where.
    pub address: Option<String>,
    /// The boot that it was last heard in.
    pub boot: u32,
    /// The version of its firmware.
    pub firmware: Option<String>,
    /// Why it last started.
    pub reset: Option<String>,
    /// Its battery's voltage.
    pub battery_mv: Option<u16>,
    /// How strong it receives the network.
    pub signal_dbm: Option<i8>,
    /// Reads of sensors that failed since its boot.
    pub reads_failed: u32,
    /// Times that its bus was set up anew since its boot.
    pub bus_recoveries: u32,
    /// Records that it thinned out since its boot.
    pub records_dropped: u32,
    /// Records told as lost since the logger started.
    pub lost: u64,
    /// The newest value of each sensor that has given one since the logger started.
    #[serde(default)]
    pub sensors: Vec<SensorStatus>,
    /// The new program that is on its way to it, or was.
    pub update: Option<UpdateStatus>,
}

/// The newest value of a sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorStatus {
    /// Its name in robot.toml.
    pub sensor: String,
    /// When it was read, in microseconds since 1970.
    pub at_us: u64,
    /// Degrees Celsius.
    pub celsius: f64,
}

/// How far a board is with a new program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UpdateStatus {
    /// The number of the offer.
    pub order: u32,
    /// How far, in words.
    pub state: String,
    /// Whether nothing more will come of it.
    pub over: bool,
    /// Whether the program is installed.
    pub installed: bool,
}

/// Where a logger's state lies in its store.
pub fn status_path(store: &Path) -> PathBuf {
    store.join("status.json")
}

/// How long after the last time the state is to be written again, in microseconds: a big fleet's takes a moment.
pub fn interval_us(boards: usize) -> u64 {
    1_000_000 + 1_000 * boards as u64
}

impl Status {
    /// The state of a logger's engine.
    pub fn of(engine: &Engine, now_us: u64) -> Self {
        let told = engine.boards().iter().filter_map(|(&number, board)| {
            let job = engine.updates().of(number);
            (board.heard_us.is_some() || job.is_some()).then(|| BoardStatus::of(number, board, job))
        });
        Self { format: 1, written_us: now_us, boards: told.collect() }
    }

    /// Writes it in place of the last one.
    ///
    /// # Errors
    ///
    /// When the store cannot be written.
    pub fn write(&self, store: &Path) -> io::Result<()> {
        let new = store.join("status.json.new");
        std::fs::write(&new, serde_json::to_vec(self)?)?;
        std::fs::rename(new, status_path(store))
    }

    /// Reads the state that a store's logger wrote last; none if there is none.
    ///
    /// # Errors
    ///
    /// When it is there and cannot be read.
    pub fn read(store: &Path) -> io::Result<Option<Self>> {
        match std::fs::read(status_path(store)) {
            Ok(bytes) => Ok(Some(serde_json::from_slice(&bytes)?)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// The state of a board.
    pub fn board(&self, number: u32) -> Option<&BoardStatus> {
        self.boards.iter().find(|board| board.board == number)
    }
}

impl BoardStatus {
    fn of(number: u32, board: &BoardEntry, job: Option<&Job>) -> Self {
        let health = board.report.map(|report| report.health);
        let counters = health.map(|health| health.counters).unwrap_or_default();
        let version = |identity: thermokin_protocol::Identity| {
            let version = identity.firmware;
            format!("{}.{}.{}", version.major, version.minor, version.patch)
        };
        Self {
            board: number,
            heard_us: board.heard_us,
            address: board.address().map(|address| address.to_string()),
            boot: board.boot(),
            firmware: board.identity.map(version),
            reset: board.identity.map(|identity| reset_words(identity.reset).to_owned()),
            battery_mv: health.and_then(|health| match health.battery {
                Battery::Millivolts(millivolts) => Some(millivolts),
                Battery::NotMeasured => None,
            }),
            signal_dbm: health.and_then(|health| match health.signal {
                Signal::Dbm(dbm) => Some(dbm),
                Signal::NotMeasured => None,
            }),
            reads_failed: counters.reads_failed,
            bus_recoveries: counters.bus_recoveries,
            records_dropped: counters.records_dropped,
            lost: board.lost,
            sensors: board
                .labels()
                .iter()
                .zip(&board.gauges)
                .filter_map(|(label, gauge)| {
                    let (at_us, celsius) = gauge.value()?;
                    Some(SensorStatus { sensor: label.name.clone(), at_us, celsius })
                })
                .collect(),
            update: job.map(|job| UpdateStatus {
                order: job.order,
                state: job.words(),
                over: job.is_over(),
                installed: job.state == Some(thermokin_protocol::update::UpdateState::Installed),
            }),
        }
    }
}

/// Why a board started, as people say it.
fn reset_words(reason: ResetReason) -> &'static str {
    match reason {
        ResetReason::Unknown => "unknown",
        ResetReason::PowerOn => "power on",
        ResetReason::Brownout => "brownout",
        ResetReason::Watchdog => "watchdog",
        ResetReason::Software => "restart",
        ResetReason::Panic => "panic",
        ResetReason::External => "reset pin",
        ResetReason::Wake => "deep sleep",
    }
}
