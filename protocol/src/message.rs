//! The messages: plain types, serialised with postcard.
//!
//! Enums are append-only and structs change only with [`crate::SCHEMA_VERSION`]; `tests/golden.rs` pins the bytes.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{MAX_BATCH, MAX_SEGMENTS, MAX_SENSORS, MAX_SEQUENCE};

/// What a board says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BoardMessage {
    /// Everything it has to say now.
    Report(Report),
}

/// What the host says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HostMessage {
    /// The answer to one or several reports.
    Answer(Answer),
}

/// A board's report: the time of its sending, how the board is, and a batch of records, which may be empty.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Report {
    /// The board's clock at the sending of this report, in microseconds (t3 of the time exchange).
    pub sent_us: u64,
    /// The last answer heard that was not echoed before.
    pub echo: Option<TimeEcho>,
    /// Who the board is; repeated until an answer says that it is known.
    pub identity: Option<Identity>,
    /// Battery, signal and counters at the time of sending.
    pub health: Health,
    /// The revision of the settings in force on the board.
    pub settings_revision: u32,
    /// Records, and the claim of what is not held any more.
    pub batch: Batch,
}

/// Two of the four timestamps of a time exchange, as the board returns them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TimeEcho {
    /// The answer's time of sending on the host's clock, in microseconds (t1).
    pub host_us: u64,
    /// The board's clock when the answer came, in microseconds (t2).
    pub received_us: u64,
}

/// Who a board is. Its number and boot are in the header.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity {
    /// The version of its firmware.
    pub firmware: Firmware,
    /// Why it started.
    pub reset: ResetReason,
    /// How many records its store has room for.
    pub capacity: u32,
}

/// A firmware's version.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Firmware {
    /// Incompatible changes.
    pub major: u16,
    /// Additions.
    pub minor: u16,
    /// Corrections.
    pub patch: u16,
}

/// Why a board started. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetReason {
    /// The chip does not tell.
    Unknown,
    /// Power came.
    PowerOn,
    /// The supply sagged.
    Brownout,
    /// The watchdog was not fed.
    Watchdog,
    /// The firmware asked for it, after an update for instance.
    Software,
    /// The firmware panicked.
    Panic,
    /// The reset pin.
    External,
    /// Deep sleep ended.
    Wake,
}

/// How a board is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Health {
    /// The battery's voltage.
    pub battery: Battery,
    /// The radio's signal.
    pub signal: Signal,
    /// What has gone wrong since the boot.
    pub counters: Counters,
}

/// A battery's voltage. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Battery {
    /// The board does not measure it.
    NotMeasured,
    /// In millivolts.
    Millivolts(u16),
}

/// The strength of the signal that a board receives. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Signal {
    /// The board has no radio, or it does not tell.
    NotMeasured,
    /// In dBm.
    Dbm(i8),
}

/// What has gone wrong on a board since its boot; each counter stays at its highest value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Reads of sensors that failed.
    pub reads_failed: u32,
    /// Times that the bus had to be set up anew or cleared.
    pub bus_recoveries: u32,
    /// Records that a full store thinned out unacknowledged.
    pub records_dropped: u32,
    /// Records sent again.
    pub resends: u32,
    /// Datagrams refused: forged, replayed, foreign or malformed.
    pub datagrams_refused: u32,
}

/// Records that lie one after another in the board's store, and what that says about those between them.
///
/// It claims: of all the sequences in `from..until` the board holds only these records, and will never hold another.
/// All records were taken in one boot. Sequences increase, lie within `from..until` and below [`MAX_SEQUENCE`]; each
/// record has a reading for each sensor.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Batch {
    /// The name of the store: the boot in which it began empty.
    pub store: u32,
    /// The boot on whose clock the records were taken.
    pub boot: u32,
    /// The first sequence that the claim covers.
    pub from: u64,
    /// One past the last sequence that the claim covers.
    pub until: u64,
    /// The board's sensors, in the order of a record's readings.
    pub sensors: Vec<Sensor, MAX_SENSORS>,
    /// The records.
    pub records: Vec<Record, MAX_BATCH>,
}

impl Batch {
    /// Whether it keeps what the type's documentation promises.
    pub fn is_well_formed(&self) -> bool {
        let mut lowest = self.from;
        self.from <= self.until
            && self.until <= MAX_SEQUENCE
            && self.records.iter().all(|record| {
                let in_order = record.sequence >= lowest && record.sequence < self.until;
                lowest = record.sequence.saturating_add(1);
                in_order && record.readings.len() == self.sensors.len()
            })
    }
}

/// One of a board's sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sensor {
    /// Its 7-bit I2C address.
    pub address: u8,
    /// What its counts mean.
    pub kind: SensorKind,
}

/// What a sensor's counts mean. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SensorKind {
    /// MAX30205 in its normal data format: 1/256 °C a count.
    Max30205,
    /// LM75 and its family (TMP105 and others), left-justified: 1/256 °C a count.
    Lm75,
}

impl SensorKind {
    /// The temperature in degrees Celsius that a number of counts stands for.
    pub fn celsius(self, counts: i16) -> f64 {
        match self {
            SensorKind::Max30205 | SensorKind::Lm75 => f64::from(counts) / 256.0,
        }
    }
}

/// What all sensors of a board read at one time.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Record {
    /// Its number in the store.
    pub sequence: u64,
    /// The board's clock, in microseconds, in the batch's boot.
    pub time_us: u64,
    /// One reading a sensor, in the batch's order.
    pub readings: Vec<Reading, MAX_SENSORS>,
}

/// What one sensor gave: raw counts, or the reason why there are none. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Reading {
    /// Raw counts within the sensor's range.
    Ok(i16),
    /// No sensor answers at the address.
    Absent,
    /// The sensor answered before, or answers, but the transfer failed.
    BusError,
    /// Raw counts beyond the sensor's operating range.
    OutOfRange(i16),
}

/// The host's answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Answer {
    /// The boot that it answers; any other boot refuses it.
    pub boot: u32,
    /// The host's clock at the sending of this answer: microseconds since 1970 (t1 of the time exchange).
    pub host_us: u64,
    /// Whether the host, since it started, has heard who the board is.
    pub identity_known: bool,
    /// What is durable.
    pub acknowledgement: Acknowledgement,
    /// The settings that the board shall have.
    pub settings: Settings,
}

/// Which records of a store are durable on the host: all below a limit, and those whose bits are set above it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Acknowledgement {
    /// The store.
    pub store: u32,
    /// Every sequence below this one is durable, or known to be lost.
    pub below: u64,
    /// Parts of the bitmap above: those that changed or were asked about lately.
    pub segments: Vec<Segment, MAX_SEGMENTS>,
}

impl Acknowledgement {
    /// Whether it covers a sequence.
    pub fn covers(&self, sequence: u64) -> bool {
        sequence < self.below || self.segments.iter().any(|segment| segment.contains(sequence))
    }
}

/// 64 bits of a bitmap of sequences.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Segment {
    /// The sequence of bit 0, a multiple of 64.
    pub from: u64,
    /// Bit i stands for the sequence `from + i`.
    pub bits: u64,
}

impl Segment {
    /// Whether the bit of a sequence is set.
    pub fn contains(&self, sequence: u64) -> bool {
        sequence.checked_sub(self.from).is_some_and(|bit| bit < 64 && self.bits >> bit & 1 == 1)
    }
}

/// How a board shall work. Absolute: each states all of them; a board takes those of the highest revision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Settings {
    /// Greater with every change.
    pub revision: u32,
    /// The time between two records, in milliseconds.
    pub sampling_period_ms: u32,
    /// How many records are sent together.
    pub batch_length: u16,
    /// How the radio is used.
    pub power: PowerMode,
}

impl Default for Settings {
    /// What a board does before it has heard a host: revision 0, a record a second, each sent at once, live.
    fn default() -> Self {
        Self { revision: 0, sampling_period_ms: 1000, batch_length: 1, power: PowerMode::Live }
    }
}

/// How a board uses its radio. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PowerMode {
    /// Up all the time, in modem sleep.
    Live,
    /// Down but to send a batch and to fetch the answer.
    Burst,
}
