//! From a log to a run folder's `temperatures.csv`.
//!
//! While logging, a reading's time is what the clock's bounds say at that moment. Here all bounds of a boot are known, so
//! each reading is mapped anew with those around it, earlier and later ones. So readings from before a clock had settled,
//! which the log has with a wide uncertainty or none, come out as well known as those that follow.
//!
//! A log may be larger than the memory: its rows are sorted by `sort`, and of its clocks only the tightest bound
//! of every five seconds is kept.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::{self, Write};
use std::path::Path;

use super::clock::{self, Bound, ClockFit};
use super::group::MarkKind;
use super::read::{LogMessage, LoggedRecord, LoggedReport, read};
use super::sort::Rows;
use super::store::{Topic, epoch_of_name, files};
use crate::input::InputError;

/// Bounds are thinned to the tightest of this much board time.
const BIN_US: u64 = 5_000_000;
/// So many bounds of each direction are used on either side of a reading.
const AROUND: usize = 48;
/// One mapping serves this much board time.
const SLOT_US: u64 = 10_000_000;
/// So many mappings are kept at a time.
const FITS: usize = 1 << 16;
/// So many rows are sorted in memory at a time, 24 bytes each.
const ROWS_IN_MEMORY: usize = 1 << 20;

/// A run within a log.
#[derive(Debug, Clone, PartialEq)]
pub struct LoggedRun {
    /// Its name.
    pub name: String,
    /// When it began, in seconds since 1970 on the host's clock.
    pub start_s: f64,
    /// When it ended; none if the log ends first.
    pub stop_s: Option<f64>,
}

/// What an export came to.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize)]
pub struct Exported {
    /// Readings written.
    pub readings: u64,
    /// Readings left out because they have a status instead of a value.
    pub missing: u64,
    /// Readings left out because they were beyond their sensor's range.
    pub out_of_range: u64,
    /// The sensors, in order of name.
    pub sensors: BTreeSet<String>,
    /// The greatest uncertainty of a time, in seconds, of those readings that have one.
    pub time_uncertainty_s: f64,
    /// Readings whose time has no uncertainty, because in their boot the clock was heard in one direction only: they were
    /// read at that time or before.
    pub times_unbounded: u64,
}

/// The runs that the marks of a log tell of, in order.
pub fn runs(path: &Path, step: &dyn Fn(u64)) -> Result<Vec<LoggedRun>, InputError> {
    let mut runs: Vec<LoggedRun> = Vec::new();
    read(
        path,
        step,
        |topic| topic == Topic::Marks,
        |_, message| {
            let LogMessage::Mark(mark) = message else {
                return;
            };
            let open = runs.last_mut().filter(|run| run.stop_s.is_none());
            match mark.kind {
                MarkKind::RunStart => {
                    if let Some(run) = open {
                        run.stop_s = Some(mark.time_s);
                    }
                    runs.push(LoggedRun { name: mark.name, start_s: mark.time_s, stop_s: None });
                }
                MarkKind::RunStop => {
                    if let Some(run) = open {
                        run.stop_s = Some(mark.time_s);
                    }
                }
                MarkKind::Mark => {}
            }
        },
    )?;
    Ok(runs)
}

/// Writes the readings of a run, or of the whole log, as `time_s,sensor,celsius` with times since the run's start (or the
/// first reading). The log is read twice; `step` is called now and then with how many more bytes were read.
pub fn export(
    path: &Path,
    run: Option<&LoggedRun>,
    step: &dyn Fn(u64),
    out: &mut impl Write,
) -> Result<Exported, ExportError> {
    let clocks = Clocks::read(path, step)?;
    let mut exported = Exported::default();
    let mut rows = Rows::new(ROWS_IN_MEMORY);
    let mut spilled = Ok(());
    let epochs = epochs(path)?;
    let mut fits = HashMap::new();
    read(
        path,
        step,
        |topic| matches!(topic, Topic::Readings(_)),
        |file, message| {
            let LogMessage::Record(record) = message else {
                return;
            };
            let (time_s, uncertainty_us) = clocks.time(&mut fits, epochs[file], &record);
            let inside = run.is_none_or(|run| time_s >= run.start_s && run.stop_s.is_none_or(|stop| time_s <= stop));
            if !inside {
                return;
            }
            let out_of_range: BTreeSet<&str> = record
                .status
                .0
                .iter()
                .filter(|(_, status)| status == "out_of_range")
                .map(|(name, _)| name.as_str())
                .collect();
            exported.out_of_range += out_of_range.len() as u64;
            exported.missing += (record.status.0.len() - record.celsius.0.len()) as u64;
            for (name, celsius) in &record.celsius.0 {
                if !out_of_range.contains(name.as_str()) {
                    exported.times_unbounded += u64::from(uncertainty_us.is_none());
                    if spilled.is_ok() {
                        spilled = rows.push(time_s, name, *celsius);
                    }
                }
            }
            if let Some(us) = uncertainty_us {
                exported.time_uncertainty_s = exported.time_uncertainty_s.max(us / 1e6);
            }
        },
    )?;
    spilled?;
    writeln!(out, "time_s,sensor,celsius")?;
    let mut zero_s = run.map(|run| run.start_s);
    exported.sensors = rows.names().map(str::to_owned).collect();
    rows.in_order(|time_s, name, celsius| {
        let zero_s = *zero_s.get_or_insert(time_s);
        exported.readings += 1;
        writeln!(out, "{:.6},{},{celsius}", time_s - zero_s, quoted(name))
    })?;
    Ok(exported)
}

/// Why an export failed.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The log.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The file that is written.
    #[error("{0}")]
    Output(#[from] io::Error),
}

fn epochs(path: &Path) -> Result<Vec<u32>, InputError> {
    let files = files(path).map_err(|error| InputError::of_file(path, error.to_string()))?;
    Ok(files.iter().map(|file| epoch_of_name(file).unwrap_or(0)).collect())
}

/// A field of a CSV file, quoted where it must be.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

/// The bounds of every boot's clock, against each of the host's clocks (it may be set between two starts).
#[derive(Debug, Default)]
struct Clocks {
    /// By board and boot, then by the host's epoch: upper and lower bounds by bin.
    bounds: BTreeMap<(u32, u32), BTreeMap<u32, Bounds>>,
}

type Fits = HashMap<(u32, u32, u32, u64), Option<ClockFit>>;

#[derive(Debug, Default)]
struct Bounds {
    upper: BTreeMap<u64, Bound>,
    lower: BTreeMap<u64, Bound>,
}

impl Clocks {
    fn read(path: &Path, step: &dyn Fn(u64)) -> Result<Self, InputError> {
        let mut clocks = Self::default();
        let epochs = epochs(path)?;
        read(
            path,
            step,
            |topic| matches!(topic, Topic::Status(_)),
            |file, message| {
                if let LogMessage::Report(report) = message {
                    clocks.hear(epochs[file], &report);
                }
            },
        )?;
        Ok(clocks)
    }

    fn hear(&mut self, epoch: u32, report: &LoggedReport) {
        let bounds = self.bounds.entry((report.board, report.boot)).or_default().entry(epoch).or_default();
        let offset = |bound: &Bound| i128::from(bound.host_us) - i128::from(bound.board_us);
        let upper = Bound { board_us: report.sent_us, host_us: report.arrived_us };
        let kept = bounds.upper.entry(upper.board_us / BIN_US).or_insert(upper);
        if offset(&upper) < offset(kept) {
            *kept = upper;
        }
        if let Some(echo) = report.echo.filter(|echo| echo.host_us / 1_000_000 >= u64::from(epoch)) {
            let lower = Bound { board_us: echo.received_us, host_us: echo.host_us };
            let kept = bounds.lower.entry(lower.board_us / BIN_US).or_insert(lower);
            if offset(&lower) > offset(kept) {
                *kept = lower;
            }
        }
    }

    /// A record's time in seconds since 1970 and its uncertainty in microseconds.
    fn time(&self, fits: &mut Fits, epoch: u32, record: &LoggedRecord) -> (f64, Option<f64>) {
        let Some(of_boot) = self.bounds.get(&(record.board, record.boot)) else {
            return (record.time_s, None);
        };
        // A record of a boot that this start of the host never heard is mapped with the start that did.
        let Some((&epoch, bounds)) = of_boot.get_key_value(&epoch).or_else(|| of_boot.last_key_value()) else {
            return (record.time_s, None);
        };
        let slot = record.board_us / SLOT_US;
        if fits.len() >= FITS {
            fits.clear();
        }
        let fit = fits
            .entry((record.board, record.boot, epoch, slot))
            .or_insert_with(|| bounds.fit(slot * SLOT_US + SLOT_US / 2));
        match fit {
            Some(fit) => (fit.host_us(record.board_us) / 1e6, fit.uncertainty_us(record.board_us)),
            None => (record.time_s, None),
        }
    }
}

impl Bounds {
    /// The mapping around a board time, with fewer bounds where more contradict each other.
    fn fit(&self, around_us: u64) -> Option<ClockFit> {
        let near = |bounds: &BTreeMap<u64, Bound>, count: usize| -> Vec<Bound> {
            let bin = around_us / BIN_US;
            let before = bounds.range(..bin).rev().take(count).map(|(_, bound)| *bound);
            before.chain(bounds.range(bin..).take(count).map(|(_, bound)| *bound)).collect()
        };
        let mut count = AROUND;
        while count > 0 {
            if let Some(fit) = clock::fit(&near(&self.upper, count), &near(&self.lower, count), around_us) {
                return Some(fit);
            }
            count /= 2;
        }
        None
    }
}
