//! What a log holds, whether it is sound, whether it equals the truth, and saving what is whole of a damaged file.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use super::read::{LogMessage, LoggedGap, read};
use super::store::{self, Scan, Topic};
use super::virtual_board::Truth;
use crate::input::InputError;
use crate::logger::virtual_board::Fate;

/// So many faults are told one by one.
const TOLD: usize = 20;

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
pub fn contents(path: &Path) -> Result<Contents, InputError> {
    let mut boards: BTreeMap<u32, BoardContents> = BTreeMap::new();
    let files = read(
        path,
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
                boards.entry(gap.board).or_default().lost += gap.until.map_or(0, |until| until - gap.from);
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

struct Stored {
    boot: u32,
    board_us: u64,
    counts: Vec<i16>,
}

/// Checks a log: every file whole, no record twice, none both stored and told as lost; and against the truth.
pub fn verify(path: &Path, truth: Option<Vec<Truth>>) -> Result<Finding, InputError> {
    let mut stored: HashMap<(u32, u32, u64), Stored> = HashMap::new();
    let mut gaps: BTreeMap<(u32, u32), Vec<LoggedGap>> = BTreeMap::new();
    let mut twice = Vec::new();
    let mut records = 0;
    let files = read(
        path,
        |topic| matches!(topic, Topic::Readings(_) | Topic::Gaps),
        |_, message| match message {
            LogMessage::Record(record) => {
                records += 1;
                let name = (record.board, record.store, record.sequence);
                let counts = record.counts.0.into_iter().map(|(_, counts)| counts).collect();
                if stored.insert(name, Stored { boot: record.boot, board_us: record.board_us, counts }).is_some() {
                    twice.push(name);
                }
            }
            LogMessage::Gap(gap) => gaps.entry((gap.board, gap.store)).or_default().push(gap),
            LogMessage::Report(_) | LogMessage::Mark(_) => {}
        },
    )?;
    let mut finding =
        Finding { files, records, twice: twice.len() as u64, faults: Vec::new(), fault_count: 0, truth: None };
    for index in 0..finding.files.len() {
        let (path, scan) = &finding.files[index];
        if let Some(damage) = scan.damage.clone() {
            let words = format!("{}: {damage}", path.display());
            finding.fault(|| words);
        }
    }
    for (board, store, sequence) in twice {
        finding.fault(|| format!("board {board}, store {store}: record {sequence} stands there twice"));
    }
    for &(board, store, sequence) in stored.keys() {
        if told(&gaps, board, store, sequence) {
            finding.fault(|| format!("board {board}, store {store}: record {sequence} is stored and told as lost"));
        }
    }
    if let Some(truth) = truth {
        compare(&mut finding, stored, &gaps, &truth);
    }
    Ok(finding)
}

fn told(gaps: &BTreeMap<(u32, u32), Vec<LoggedGap>>, board: u32, store: u32, sequence: u64) -> bool {
    let covers = |gap: &LoggedGap| gap.from <= sequence && gap.until.is_none_or(|until| sequence < until);
    gaps.get(&(board, store)).is_some_and(|gaps| gaps.iter().any(covers))
}

fn compare(
    finding: &mut Finding,
    mut stored: HashMap<(u32, u32, u64), Stored>,
    gaps: &BTreeMap<(u32, u32), Vec<LoggedGap>>,
    truth: &[Truth],
) {
    let mut against = AgainstTruth { taken: truth.len() as u64, ..AgainstTruth::default() };
    let last_store: HashMap<u32, u32> = truth.iter().map(|record| (record.board, record.store)).collect();
    let heard: BTreeSet<(u32, u32)> =
        stored.keys().map(|(board, store, _)| (*board, *store)).chain(gaps.keys().copied()).collect();
    for record in truth {
        let (board, store, sequence) = (record.board, record.store, record.sequence);
        let words = || format!("board {board}, store {store}: record {sequence} ({})", record.fate.name());
        against.acknowledged += u64::from(record.fate == Fate::Acknowledged);
        match stored.remove(&(board, store, sequence)) {
            Some(found) => {
                let counts: Vec<i16> = record.counts.iter().copied().filter(|&counts| counts != i16::MIN).collect();
                if found.boot == record.boot && found.board_us == record.board_us && found.counts == counts {
                    against.stored += 1;
                } else {
                    against.wrong += 1;
                    finding.fault(|| format!("{} is stored otherwise than it was taken", words()));
                }
            }
            None if matches!(record.fate, Fate::Acknowledged | Fate::Held) => {
                against.missing += 1;
                finding.fault(|| format!("{} is not stored", words()));
            }
            // A store that ended before the host ever heard of it, or that the host has not heard the end of, is not told.
            None if told(gaps, board, store, sequence) || !heard.contains(&(board, store)) => against.told += 1,
            None if last_store.get(&board) == Some(&store) && record.fate == Fate::PoweredOff => against.told += 1,
            None => {
                against.untold += 1;
                finding.fault(|| format!("{} is not stored and no gap says so", words()));
            }
        }
    }
    for (board, store, sequence) in stored.into_keys() {
        against.wrong += 1;
        finding.fault(|| format!("board {board}, store {store}: record {sequence} is stored and was never taken"));
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
pub fn recover(from: &Path, scan: &Scan, to: &Path) -> io::Result<u64> {
    let mut out = File::options().write(true).create_new(true).open(to)?;
    let copied = io::copy(&mut File::open(from)?.take(scan.valid), &mut out)?;
    out.flush()?;
    drop(out);
    store::finish_in_place(to, scan.valid, &scan.summary)?;
    Ok(copied)
}
