//! What a log holds, whether it is sound, whether it equals the truth, and saving what is whole of a damaged file.
//!
//! A log is read chunk by chunk and may be larger than the memory: of its records only their sequences are kept, as ranges.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use super::read::{LogMessage, LoggedGap, LoggedRecord, read};
use super::store::{self, Scan, Topic};
use super::virtual_board::Truth;
use crate::input::InputError;
use crate::logger::virtual_board::Fate;

/// So many faults are told one by one.
const TOLD: usize = 20;
/// So many bytes are copied between two steps of a recovery.
const COPIED_AT_ONCE: u64 = 16 << 20;

/// What a log holds.
#[derive(Debug)]
pub struct Contents {
    /// The files, oldest first, with what their scans found.
    pub files: Vec<(PathBuf, Scan)>,
    /// What each board gave.
    pub boards: BTreeMap<u32, BoardContents>,
}

/// What one board gave.
#[derive(Debug, Default)]
pub struct BoardContents {
    /// Records.
    pub records: u64,
    /// Records told as lost.
    pub lost: u64,
    /// Gaps of which nobody knows how many records they are: stores that ended, or were never heard of.
    pub open_gaps: u64,
    /// Boots.
    pub boots: usize,
    /// Sensors, by name.
    pub sensors: BTreeSet<String>,
    seen: BTreeSet<u32>,
}

impl Contents {
    /// The first and the last moment, in seconds since 1970.
    pub fn times_s(&self) -> Option<(f64, f64)> {
        let times = || self.files.iter().filter_map(|(_, scan)| scan.summary.times_ns());
        let start = times().map(|times| times.0).min()?;
        let end = times().map(|times| times.1).max()?;
        Some((start as f64 / 1e9, end as f64 / 1e9))
    }
}

/// Reads what a log holds.
pub fn contents(path: &Path, step: &dyn Fn(u64)) -> Result<Contents, InputError> {
    let mut boards: BTreeMap<u32, BoardContents> = BTreeMap::new();
    let files = read(
        path,
        step,
        |topic| matches!(topic, Topic::Readings(_) | Topic::Gaps),
        |_, message| match message {
            LogMessage::Record(record) => {
                let board = boards.entry(record.board).or_default();
                board.records += 1;
                if board.seen.insert(record.boot) {
                    board.boots += 1;
                }
                for (name, _) in record.status.0 {
                    if !board.sensors.contains(&name) {
                        board.sensors.insert(name);
                    }
                }
            }
            LogMessage::Gap(gap) => {
                let board = boards.entry(gap.board).or_default();
                match gap.until {
                    Some(until) => board.lost += until - gap.from,
                    None => board.open_gaps += 1,
                }
            }
            LogMessage::Report(_) | LogMessage::Mark(_) => {}
        },
    )?;
    Ok(Contents { files, boards })
}

/// Whether a log is sound.
#[derive(Debug)]
pub struct Finding {
    /// The files, oldest first, with what their scans found.
    pub files: Vec<(PathBuf, Scan)>,
    /// Records.
    pub records: u64,
    /// Records that stand there twice.
    pub twice: u64,
    /// What is wrong, in words; the first of many.
    pub faults: Vec<String>,
    /// How many things are wrong.
    pub fault_count: u64,
    /// How the log compares with the truth, if it was given.
    pub truth: Option<AgainstTruth>,
}

/// How a log compares with what virtual boards took.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct AgainstTruth {
    /// Records taken.
    pub taken: u64,
    /// Records that the boards saw acknowledged.
    pub acknowledged: u64,
    /// Records stored exactly as they were taken.
    pub stored: u64,
    /// Records not stored, thinned out or lost with power, and told as such.
    pub told: u64,
    /// Records that are stored otherwise than they were taken, or were never taken.
    pub wrong: u64,
    /// Records that were acknowledged, or never lost, and are not stored.
    pub missing: u64,
    /// Records that were lost without a gap that says so.
    pub untold: u64,
}

impl Finding {
    /// Whether nothing is wrong.
    pub fn is_sound(&self) -> bool {
        self.fault_count == 0
    }

    /// What is wrong, in a line.
    pub fn in_a_line(&self) -> String {
        format!("the log is not sound: {} faults", self.fault_count)
    }

    fn fault(&mut self, words: impl FnOnce() -> String) {
        self.fault_count += 1;
        if self.faults.len() < TOLD {
            self.faults.push(words());
        }
    }
}

/// A set of sequences as ranges, by their starts.
#[derive(Debug, Default)]
struct Sequences(BTreeMap<u64, u64>);

impl Sequences {
    /// Adds one; false if it was there.
    fn insert(&mut self, sequence: u64) -> bool {
        let (mut start, mut end) = (sequence, sequence + 1);
        if let Some((&before, &until)) = self.0.range(..=sequence).next_back() {
            if until > sequence {
                return false;
            }
            if until == sequence {
                start = before;
            }
        }
        if let Some(until) = self.0.remove(&end) {
            end = until;
        }
        self.0.insert(start, end);
        true
    }

    /// The first one in `from..until`.
    fn first_within(&self, from: u64, until: u64) -> Option<u64> {
        let before = self.0.range(..=from).next_back().filter(|(_, end)| **end > from).map(|_| from);
        before.or_else(|| self.0.range(from..).next().map(|(&start, _)| start)).filter(|&first| first < until)
    }
}

/// The truth, in the order of its records' names, and which of them were found in the log as they were taken.
struct Sought {
    truth: Vec<Truth>,
    stored: Vec<bool>,
}

impl Sought {
    fn new(mut truth: Vec<Truth>) -> Self {
        truth.sort_unstable_by_key(name_of);
        Self { stored: vec![false; truth.len()], truth }
    }

    /// Notes a record of the log; says what is wrong with it.
    fn find(&mut self, record: &LoggedRecord) -> Option<&'static str> {
        let name = (record.board, record.store, record.sequence);
        let Ok(index) = self.truth.binary_search_by_key(&name, name_of) else {
            return Some("is stored and was never taken");
        };
        let taken = &self.truth[index];
        let counts = taken.counts.iter().copied().filter(|&counts| counts != i16::MIN);
        let same = taken.boot == record.boot
            && taken.board_us == record.board_us
            && counts.eq(record.counts.0.iter().map(|(_, counts)| *counts));
        self.stored[index] |= same;
        (!same).then_some("is stored otherwise than it was taken")
    }
}

fn name_of(truth: &Truth) -> (u32, u32, u64) {
    (truth.board, truth.store, truth.sequence)
}

/// Checks a log: every file whole, no record twice, none both stored and told as lost; and against the truth. `step` is
/// called now and then with how many more bytes were read.
pub fn verify(path: &Path, truth: Option<Vec<Truth>>, step: &dyn Fn(u64)) -> Result<Finding, InputError> {
    let mut stored: BTreeMap<(u32, u32), Sequences> = BTreeMap::new();
    let mut gaps: BTreeMap<u32, Vec<LoggedGap>> = BTreeMap::new();
    let mut finding =
        Finding { files: Vec::new(), records: 0, twice: 0, faults: Vec::new(), fault_count: 0, truth: None };
    let mut sought = truth.map(Sought::new);
    let mut wrong = 0;
    let files = read(
        path,
        step,
        |topic| matches!(topic, Topic::Readings(_) | Topic::Gaps),
        |_, message| match message {
            LogMessage::Record(record) => {
                finding.records += 1;
                let (board, store, sequence) = (record.board, record.store, record.sequence);
                let words = |what: &str| format!("board {board}, store {store}: record {sequence} {what}");
                if !stored.entry((board, store)).or_default().insert(sequence) {
                    finding.twice += 1;
                    finding.fault(|| words("stands there twice"));
                } else if let Some(what) = sought.as_mut().and_then(|sought| sought.find(&record)) {
                    wrong += 1;
                    finding.fault(|| words(what));
                }
            }
            LogMessage::Gap(gap) => gaps.entry(gap.board).or_default().push(gap),
            LogMessage::Report(_) | LogMessage::Mark(_) => {}
        },
    )?;
    for (path, scan) in &files {
        if let Some(damage) = &scan.damage {
            finding.fault(|| format!("{}: {damage}", path.display()));
        }
    }
    for (&(board, store), sequences) in &stored {
        for gap in gaps.get(&board).into_iter().flatten().filter(|gap| gap.tells(store, gap.from)) {
            if let Some(sequence) = sequences.first_within(gap.from, gap.until.unwrap_or(u64::MAX)) {
                finding.fault(|| format!("board {board}, store {store}: record {sequence} is stored and told as lost"));
            }
        }
    }
    if let Some(sought) = sought {
        compare(&mut finding, &sought, &gaps, wrong);
    }
    finding.files = files;
    Ok(finding)
}

/// Judges what of the truth is not stored.
fn compare(finding: &mut Finding, sought: &Sought, gaps: &BTreeMap<u32, Vec<LoggedGap>>, wrong: u64) {
    let mut against = AgainstTruth { taken: sought.truth.len() as u64, wrong, ..AgainstTruth::default() };
    // In the order of names the last record of a board is of its last store.
    let last_store: BTreeMap<u32, u32> = sought.truth.iter().map(|record| (record.board, record.store)).collect();
    for (record, stored) in sought.truth.iter().zip(&sought.stored) {
        let (board, store, sequence) = name_of(record);
        let words = || format!("board {board}, store {store}: record {sequence} ({})", record.fate.name());
        let told = || gaps.get(&board).into_iter().flatten().any(|gap| gap.tells(store, sequence));
        against.acknowledged += u64::from(record.fate == Fate::Acknowledged);
        if *stored {
            against.stored += 1;
        } else if matches!(record.fate, Fate::Acknowledged | Fate::Held) {
            against.missing += 1;
            finding.fault(|| format!("{} is not stored", words()));
        } else if told() || (last_store[&board] == store && record.fate == Fate::PoweredOff) {
            // The end of a board's last store is not told before a later one is heard.
            against.told += 1;
        } else {
            against.untold += 1;
            finding.fault(|| format!("{} is not stored and no gap says so", words()));
        }
    }
    finding.truth = Some(against);
}

/// Reads a truth file, as [`super::virtual_board::write_truth`] writes it.
pub fn read_truth(path: &Path) -> Result<Vec<Truth>, InputError> {
    let text = std::fs::read_to_string(path).map_err(|error| InputError::of_file(path, error.to_string()))?;
    let parse = |line: &str| -> Option<Truth> {
        let fields: Vec<&str> = line.split(',').collect();
        let [board, store, sequence, boot, board_us, host_us, fate, counts] = fields[..] else {
            return None;
        };
        let fate = [Fate::Acknowledged, Fate::Thinned, Fate::PoweredOff, Fate::Held]
            .into_iter()
            .find(|known| known.name() == fate)?;
        Some(Truth {
            board: board.parse().ok()?,
            store: store.parse().ok()?,
            sequence: sequence.parse().ok()?,
            boot: boot.parse().ok()?,
            board_us: board_us.parse().ok()?,
            host_us: host_us.parse().ok()?,
            fate,
            counts: counts.split_whitespace().map(|counts| counts.parse().ok()).collect::<Option<_>>()?,
        })
    };
    text.lines()
        .enumerate()
        .skip(1)
        .map(|(index, line)| {
            parse(line).ok_or_else(|| {
                let expected = "expected board,store,sequence,boot,board_us,host_us,fate,counts";
                InputError::at_line(path, index + 1, expected)
            })
        })
        .collect()
}

/// Copies the whole part of a file into a new one that must not exist, and finishes that; returns the bytes copied.
/// `step` is called now and then with how many more there are.
pub fn recover(from: &Path, scan: &Scan, to: &Path, step: &dyn Fn(u64)) -> io::Result<u64> {
    let mut out = File::options().write(true).create_new(true).open(to)?;
    let (mut from, mut copied) = (File::open(from)?, 0);
    while copied < scan.valid {
        let part = io::copy(&mut (&mut from).take((scan.valid - copied).min(COPIED_AT_ONCE)), &mut out)?;
        if part == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        copied += part;
        step(part);
    }
    out.flush()?;
    drop(out);
    store::finish_in_place(to, scan.valid, &scan.summary)?;
    Ok(copied)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequences_are_kept_as_ranges_and_known_again() {
        let mut set = Sequences::default();
        let (mut reference, mut random) = (BTreeSet::new(), 7_u64);
        for _ in 0..2000 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let sequence = (random >> 33) % 700;
            assert_eq!(set.insert(sequence), reference.insert(sequence), "{sequence}");
            let (from, until) = (sequence.saturating_sub(5), sequence + 9);
            assert_eq!(set.first_within(from, until), reference.range(from..until).next().copied());
            assert_eq!(set.first_within(until, until), None);
        }
        // Ranges that touch are one.
        let starts = reference.iter().filter(|&&sequence| sequence == 0 || !reference.contains(&(sequence - 1)));
        assert_eq!(set.0.len(), starts.count());
    }
}
