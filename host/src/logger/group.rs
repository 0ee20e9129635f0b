//! What the logger hands to a sink: decoded entries, and what must be remembered of the boards they came from.
//!
//! The JSON of each entry is written by hand: a hundred thousand records a second have no time for a serialiser's
//! intermediate tree, and the bytes are read back with serde in [`super::read`].

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::sync::Arc;

use serde::Deserialize;
use thermokin_protocol::{Battery, GapReason, Identity, Reading, Record, Report, Segment, SensorKind, Signal};

use super::clock::ClockFit;
use super::digits;
use super::store::{LogFile, Topic};

/// Entries that become durable together.
#[derive(Debug, Clone, Default)]
pub struct Group {
    /// What happened, in order.
    pub entries: Vec<Entry>,
    /// The boards that were touched, as they are after these entries.
    pub states: Vec<BoardState>,
    /// When the group was closed, on the host's clock in microseconds.
    pub closed_us: u64,
}

/// One thing that happened.
#[derive(Debug, Clone)]
pub enum Entry {
    /// A datagram as it came, accepted.
    Datagram {
        /// The board.
        board: u32,
        /// When it came, on the host's clock in microseconds.
        arrived_us: u64,
        /// Its bytes.
        bytes: Box<[u8]>,
    },
    /// A report's health and times.
    Report(Box<ReportEntry>),
    /// New records of one board and boot.
    Records {
        /// The board.
        board: u32,
        /// The store that numbers them.
        store: u32,
        /// The boot whose clock stamps them.
        boot: u32,
        /// The mapping of that clock as known now; none for an earlier boot whose clock is gone.
        fit: Option<ClockFit>,
        /// When they came, on the host's clock in microseconds.
        arrived_us: u64,
        /// The names of the sensors, in the records' order.
        sensors: Arc<[SensorLabel]>,
        /// The records.
        records: Vec<Record>,
    },
    /// Records that will never come.
    Gap {
        /// The board.
        board: u32,
        /// When that was learnt, on the host's clock in microseconds.
        arrived_us: u64,
        /// Which.
        gap: thermokin_protocol::Gap,
    },
    /// A run's start or stop, or a mark.
    Mark {
        /// When, on the host's clock in microseconds.
        time_us: u64,
        /// `run_start`, `run_stop` or `mark`.
        kind: MarkKind,
        /// The run's name or the mark's text.
        name: String,
    },
    /// A warning as it was told.
    Warning {
        /// When, on the host's clock in microseconds.
        time_us: u64,
        /// Its words.
        text: String,
    },
}

impl Entry {
    /// The board that it is of.
    fn board(&self) -> Option<u32> {
        match self {
            Entry::Datagram { board, .. } | Entry::Records { board, .. } | Entry::Gap { board, .. } => Some(*board),
            Entry::Report(entry) => Some(entry.board),
            Entry::Mark { .. } | Entry::Warning { .. } => None,
        }
    }
}

/// A report's health and times.
#[derive(Debug, Clone)]
pub struct ReportEntry {
    /// The board.
    pub board: u32,
    /// Its boot.
    pub boot: u32,
    /// The number of the datagram within that boot.
    pub counter: u64,
    /// When it came, on the host's clock in microseconds.
    pub arrived_us: u64,
    /// What was said; the batch is left out.
    pub report: ReportWords,
    /// The mapping of the clock with this report.
    pub fit: Option<ClockFit>,
}

/// What a report says, its batch aside.
#[derive(Debug, Clone, Copy)]
pub struct ReportWords {
    /// The board's clock at its sending.
    pub sent_us: u64,
    /// The echo of an answer.
    pub echo: Option<thermokin_protocol::TimeEcho>,
    /// Who the board is.
    pub identity: Option<Identity>,
    /// How it is.
    pub health: thermokin_protocol::Health,
    /// The settings in force.
    pub settings_revision: u32,
}

impl From<&Report> for ReportWords {
    fn from(report: &Report) -> Self {
        Self {
            sent_us: report.sent_us,
            echo: report.echo,
            identity: report.identity,
            health: report.health,
            settings_revision: report.settings_revision,
        }
    }
}

/// A sensor's name and what its counts mean.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SensorLabel {
    /// Its name in robot.toml, or `boardN/0xAA` where that does not know it.
    pub name: String,
    /// The name as a JSON string.
    json: String,
    /// What its counts mean.
    pub kind: SensorKind,
}

impl SensorLabel {
    /// A label.
    pub fn new(name: String, kind: SensorKind) -> Self {
        let json = serde_json::Value::from(name.as_str()).to_string();
        Self { name, json, kind }
    }
}

/// What kind of mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MarkKind {
    /// A run began.
    RunStart,
    /// A run ended.
    RunStop,
    /// A step within a run.
    Mark,
}

impl MarkKind {
    fn name(self) -> &'static str {
        match self {
            MarkKind::RunStart => "run_start",
            MarkKind::RunStop => "run_stop",
            MarkKind::Mark => "mark",
        }
    }
}

/// What the host must remember of a board: which datagrams it heard, and which records it has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BoardState {
    /// The board.
    pub board: u32,
    /// Its newest boot, one past the highest datagram counter of that boot, and the window of those heard.
    pub guard: (u32, u64, u128),
    /// The newest boot in which what follows was heard; that of `guard`, unless writing failed since.
    pub boot: u32,
    /// The store, the limit below which everything is stored or known as lost, and the bitmap above.
    pub inbox: Option<(u32, u64, Vec<Segment>)>,
}

#[derive(Deserialize)]
struct StateJson {
    board: u32,
    boot: u32,
    next: u64,
    heard: String,
    /// As `boot`, in a log from before there was such a number.
    store_boot: Option<u32>,
    store: Option<u32>,
    below: u64,
    segments: Vec<(u64, String)>,
}

/// Reads a board's state back; none if it is not one.
pub fn read_state(json: &[u8]) -> Option<BoardState> {
    let state: StateJson = serde_json::from_slice(json).ok()?;
    let heard = u128::from_str_radix(&state.heard, 16).ok()?;
    let segments = state
        .segments
        .iter()
        .map(|(from, bits)| Some(Segment { from: *from, bits: u64::from_str_radix(bits, 16).ok()? }))
        .collect::<Option<Vec<_>>>()?;
    Some(BoardState {
        board: state.board,
        guard: (state.boot, state.next, heard),
        boot: state.store_boot.unwrap_or(state.boot),
        inbox: state.store.map(|store| (store, state.below, segments)),
    })
}

/// Adds a group to a file, to be committed.
///
/// A board's entries stand together, with what must be remembered of it behind them, and only there may a chunk end: so
/// what is remembered is never behind what is stored, whichever chunks of a group a loss of power leaves.
pub fn encode_group(group: &Group, file: &mut LogFile) -> io::Result<()> {
    let entries = group.entries.iter().map(Entry::board);
    let states = group.states.iter().map(|state| Some(state.board));
    let mut order: Vec<(Option<u32>, usize)> = entries.chain(states).zip(0..).collect();
    order.sort_unstable();
    for of_board in order.chunk_by(|a, b| a.0 == b.0) {
        for &(_, index) in of_board {
            match index.checked_sub(group.entries.len()) {
                None => encode_entry(&group.entries[index], file)?,
                Some(index) => encode_state(&group.states[index], group.closed_us, file)?,
            }
        }
        file.may_end_chunk()?;
    }
    Ok(())
}

/// Adds to a file what must be remembered of all boards, in one chunk.
pub fn encode_states<'a>(
    states: impl IntoIterator<Item = &'a BoardState>,
    closed_us: u64,
    file: &mut LogFile,
) -> io::Result<()> {
    states.into_iter().try_for_each(|state| encode_state(state, closed_us, file))
}

fn encode_state(state: &BoardState, closed_us: u64, file: &mut LogFile) -> io::Result<()> {
    file.message(Topic::Delivery, 0, closed_us * 1000, |out| {
        let (boot, next, heard) = state.guard;
        let store = state.inbox.as_ref().map_or("null".to_owned(), |inbox| inbox.0.to_string());
        let below = state.inbox.as_ref().map_or(0, |inbox| inbox.1);
        put(
            out,
            format_args!(
                r#"{{"board":{},"boot":{boot},"next":{next},"heard":"{heard:x}","store_boot":{},"store":{store},"below":{below},"segments":["#,
                state.board, state.boot
            ),
        );
        for (index, segment) in state.inbox.iter().flat_map(|inbox| &inbox.2).enumerate() {
            let comma = if index > 0 { "," } else { "" };
            put(out, format_args!(r#"{comma}[{},"{:x}"]"#, segment.from, segment.bits));
        }
        out.extend_from_slice(b"]}");
    })
}

fn encode_entry(entry: &Entry, file: &mut LogFile) -> io::Result<()> {
    match entry {
        Entry::Datagram { arrived_us, bytes, .. } => {
            file.message(Topic::Datagrams, 0, arrived_us * 1000, |out| out.extend_from_slice(bytes))
        }
        Entry::Report(entry) => {
            let (sequence, time_ns) = (entry.counter as u32, entry.arrived_us * 1000);
            file.message(Topic::Status(entry.board), sequence, time_ns, |out| encode_report(out, entry))
        }
        Entry::Records { board, store, boot, fit, arrived_us, sensors, records } => {
            for record in records {
                let host_us = fit.as_ref().map_or(*arrived_us as f64, |fit| fit.host_us(record.time_us)).max(0.0);
                let uncertainty = fit.as_ref().and_then(|fit| fit.uncertainty_us(record.time_us));
                let place = (*board, *store, *boot);
                let time_ns = (host_us * 1000.0) as u64;
                file.message(Topic::Readings(*board), record.sequence as u32, time_ns, |out| {
                    encode_record(out, place, host_us as u64, uncertainty, sensors, record);
                })?;
            }
            Ok(())
        }
        Entry::Gap { board, arrived_us, gap } => file.message(Topic::Gaps, 0, arrived_us * 1000, |out| {
            let until = gap.until.map_or("null".to_owned(), |until| until.to_string());
            let reason = match gap.reason {
                GapReason::NotHeld => "not_held",
                GapReason::StoreEnded => "store_ended",
                GapReason::Unheard => "unheard",
            };
            put(
                out,
                format_args!(
                    r#"{{"board":{board},"store":{},"stores_until":{},"from":{},"until":{until},"reason":"{reason}"}}"#,
                    gap.store, gap.stores_until, gap.from
                ),
            );
        }),
        Entry::Mark { time_us, kind, name } => file.message(Topic::Marks, 0, time_us * 1000, |out| {
            let (kind, name) = (kind.name(), serde_json::Value::from(name.as_str()));
            put(out, format_args!(r#"{{"time_s":{},"kind":"{kind}","name":{name}}}"#, Seconds(*time_us)));
        }),
        Entry::Warning { time_us, text } => file.message(Topic::Warnings, 0, time_us * 1000, |out| {
            let text = serde_json::Value::from(text.as_str());
            put(out, format_args!(r#"{{"time_s":{},"text":{text}}}"#, Seconds(*time_us)));
        }),
    }
}

fn encode_record(
    out: &mut Vec<u8>,
    (board, store, boot): (u32, u32, u32),
    host_us: u64,
    uncertainty_us: Option<f64>,
    sensors: &[SensorLabel],
    record: &Record,
) {
    out.extend_from_slice(br#"{"time_s":"#);
    digits::seconds(out, host_us);
    out.extend_from_slice(br#","uncertainty_s":"#);
    match uncertainty_us {
        Some(us) => digits::seconds(out, us.ceil() as u64),
        None => out.extend_from_slice(b"null"),
    }
    let numbers = [
        (&br#","board":"#[..], u64::from(board)),
        (br#","store":"#, u64::from(store)),
        (br#","boot":"#, u64::from(boot)),
        (br#","sequence":"#, record.sequence),
        (br#","board_us":"#, record.time_us),
    ];
    for (name, number) in numbers {
        out.extend_from_slice(name);
        digits::unsigned(out, number);
    }
    let mut each = |name: &[u8], value: &dyn Fn(&mut Vec<u8>, SensorKind, Reading) -> bool| {
        out.extend_from_slice(name);
        let empty = out.len();
        for (sensor, reading) in sensors.iter().zip(&record.readings) {
            let start = out.len();
            out.extend_from_slice(if start > empty { b"," } else { b"" });
            out.extend_from_slice(sensor.json.as_bytes());
            out.push(b':');
            if !value(out, sensor.kind, *reading) {
                out.truncate(start);
            }
        }
    };
    each(br#","celsius":{"#, &|out, kind, reading| {
        counts_of(reading).map(|counts| digits::celsius(out, kind, counts)).is_some()
    });
    each(br#"},"counts":{"#, &|out, _, reading| {
        counts_of(reading).map(|counts| digits::signed(out, counts.into())).is_some()
    });
    each(br#"},"status":{"#, &|out, _, reading| {
        for part in ["\"", status_name(reading), "\""] {
            out.extend_from_slice(part.as_bytes());
        }
        true
    });
    out.extend_from_slice(b"}}");
}

fn counts_of(reading: Reading) -> Option<i16> {
    match reading {
        Reading::Ok(counts) | Reading::OutOfRange(counts) => Some(counts),
        Reading::Absent | Reading::BusError => None,
    }
}

/// The name of a reading's status in the log.
pub fn status_name(reading: Reading) -> &'static str {
    match reading {
        Reading::Ok(_) => "ok",
        Reading::Absent => "absent",
        Reading::BusError => "bus_error",
        Reading::OutOfRange(_) => "out_of_range",
    }
}

fn encode_report(out: &mut Vec<u8>, entry: &ReportEntry) {
    let words = &entry.report;
    let or_null = |number: Option<String>| number.unwrap_or_else(|| "null".to_owned());
    let battery = match words.health.battery {
        Battery::NotMeasured => None,
        Battery::Millivolts(millivolts) => Some(millivolts.to_string()),
    };
    let signal = match words.health.signal {
        Signal::NotMeasured => None,
        Signal::Dbm(dbm) => Some(dbm.to_string()),
    };
    let echo = words.echo.map(|echo| format!(r#"{{"host_us":{},"received_us":{}}}"#, echo.host_us, echo.received_us));
    let clock = entry.fit.map(|fit| {
        let mut text = String::new();
        let uncertainty = or_null(fit.offset_uncertainty_us.map(|us| format!("{us:.1}")));
        let _ = write!(
            text,
            r#"{{"reference_us":{},"offset_us":{:.1},"drift":{:e},"uncertainty_us":{uncertainty}}}"#,
            fit.reference_us, fit.offset_us, fit.drift
        );
        text
    });
    let identity = words.identity.map(|identity| {
        let firmware = identity.firmware;
        format!(
            r#"{{"firmware":"{}.{}.{}","reset":"{:?}","capacity":{}}}"#,
            firmware.major, firmware.minor, firmware.patch, identity.reset, identity.capacity
        )
    });
    let counters = words.health.counters;
    put(
        out,
        format_args!(
            concat!(
                r#"{{"board":{},"boot":{},"datagram":{},"arrived_us":{},"sent_us":{},"echo":{},"battery_mv":{},"signal_dbm":{},"#,
                r#""reads_failed":{},"bus_recoveries":{},"records_dropped":{},"resends":{},"datagrams_refused":{},"#,
                r#""settings_revision":{},"clock":{},"identity":{}}}"#
            ),
            entry.board,
            entry.boot,
            entry.counter,
            entry.arrived_us,
            words.sent_us,
            or_null(echo),
            or_null(battery),
            or_null(signal),
            counters.reads_failed,
            counters.bus_recoveries,
            counters.records_dropped,
            counters.resends,
            counters.datagrams_refused,
            words.settings_revision,
            or_null(clock),
            or_null(identity)
        ),
    );
}

/// Microseconds, shown as seconds with six decimals: exact, where a floating-point number would not be.
struct Seconds(u64);

impl std::fmt::Display for Seconds {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{}.{:06}", self.0 / 1_000_000, self.0 % 1_000_000)
    }
}

fn put(out: &mut Vec<u8>, text: std::fmt::Arguments<'_>) {
    out.write_fmt(text).expect("a Vec takes everything");
}
