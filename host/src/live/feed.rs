//! Between the logger and those who watch: the newest state, and the history.

use std::collections::HashMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::{Value, json};

use super::history::History;
use crate::logger::civil;
use crate::logger::engine::{BoardEntry, Engine};
use crate::logger::serve::State;
use crate::logger::status::Status;
use crate::logger::watch::Trouble;

/// A reading that is older than this is shown as old, s; boards that send in bursts make it longer, see [`Feed::put`].
const OLD_S: f64 = 10.0;
/// So many of the newest words are shown.
const WORDS: usize = 12;
/// So many sensors, and so many boards, are shown: a page is for an arm or a few, and what it holds is bounded.
const MOST: usize = 256;

/// The newest value of a sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Newest {
    /// Degrees Celsius.
    pub celsius: f64,
    /// Whether it has been silent since.
    pub old: bool,
}

/// The state at one time.
#[derive(Debug)]
pub struct Shown {
    /// Its number: each state has a greater one than that before.
    pub number: u64,
    /// The state as the page takes it.
    pub state: Value,
    /// The newest value of every sensor that has been read, by name.
    pub newest: HashMap<String, Newest>,
}

/// The newest state and the history; the logger feeds it, servers read it.
#[derive(Debug)]
pub struct Feed {
    links: HashMap<String, usize>,
    inner: Mutex<Inner>,
    news: Condvar,
}

#[derive(Debug)]
struct Inner {
    newest: Arc<Shown>,
    /// The sensors in the order in which they were first seen: columns of the history.
    names: Vec<String>,
    history: History,
    over: bool,
}

impl Feed {
    /// A feed; `links` says on which link each sensor sits.
    pub fn new(links: HashMap<String, usize>) -> Self {
        let newest = Arc::new(Shown { number: 0, state: Value::Null, newest: HashMap::new() });
        let inner = Inner { newest, names: Vec::new(), history: History::default(), over: false };
        Self { links, inner: Mutex::new(inner), news: Condvar::new() }
    }

    /// A thread that panicked while it held the lock left whole values behind: they are only ever put in whole.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the logger's state.
    pub fn put(&self, engine: &Engine, state: &State, now_us: u64) {
        let mut sensors = Vec::new();
        let mut newest = HashMap::new();
        let read = engine.boards().iter().flat_map(|(number, board)| {
            board.labels().iter().zip(&board.gauges).map(move |(label, gauge)| (number, board, label, gauge))
        });
        for (number, board, label, gauge) in read {
            if sensors.len() == MOST {
                break;
            }
            let value = gauge.value();
            let age_s = value.map(|(at_us, _)| seconds(at_us, now_us));
            // A batch may be on its way for as long as it takes to fill.
            let settings = engine.settings();
            let batch_s = f64::from(settings.batch_length) * f64::from(settings.sampling_period_ms) / 1e3;
            let old = age_s.is_none_or(|age| age > OLD_S + 2.0 * batch_s);
            let silent = old && board.heard_us.is_some();
            sensors.push(json!({
                "name": label.name, "board": number, "link": self.links.get(&label.name),
                "celsius": value.map(|(_, celsius)| celsius), "age_s": age_s, "silent": silent,
                "k_per_min": gauge.trend_k_per_min().filter(|_| !old),
            }));
            if let Some((_, celsius)) = value {
                newest.insert(label.name.clone(), Newest { celsius, old });
            }
        }
        let all: usize = engine.boards().values().map(|board| board.labels().len()).sum();
        let status = Status::of(engine, now_us);
        let boards = engine.boards().iter().take(MOST);
        let boards: Vec<Value> = boards.map(|(number, entry)| board(engine, &status, *number, entry, now_us)).collect();
        let tally = engine.tally();
        let said = engine.watch().said().rev().take(WORDS);
        let words: Vec<Value> =
            said.map(|(at, text)| json!({"time": civil::utc(at / 1_000_000), "text": text})).collect();
        let shown = json!({
            "time_s": now_us as f64 / 1e6,
            "run": state.run.as_ref().map(|(name, since)| json!({"name": name, "for_s": seconds(*since, now_us)})),
            "listen": state.listen.to_string(), "store": state.store, "free": state.free,
            "readings": tally.readings, "records": tally.records, "lost": tally.lost, "refused": tally.refused,
            "troubles": troubles(engine),
            "sensors": sensors, "sensors_hidden": all.saturating_sub(sensors.len()),
            "boards": boards, "boards_hidden": engine.boards().len().saturating_sub(boards.len()), "words": words,
        });
        let mut inner = self.lock();
        for sensor in sensors.iter().filter_map(|sensor| sensor["name"].as_str()) {
            if inner.names.len() < MOST && !inner.names.iter().any(|name| name == sensor) {
                inner.names.push(sensor.to_owned());
            }
        }
        let fresh = |name: &String| newest.get(name).filter(|newest| !newest.old).map(|newest| newest.celsius);
        let row: Vec<Option<f64>> = inner.names.iter().map(fresh).collect();
        inner.history.take(now_us as f64 / 1e6, &row);
        inner.newest = Arc::new(Shown { number: inner.newest.number + 1, state: shown, newest });
        drop(inner);
        self.news.notify_all();
    }

    /// Says that nothing more will come.
    pub fn end(&self) {
        self.lock().over = true;
        self.news.notify_all();
    }

    /// The state that follows another, when there is one; none when the logger has ended. After a second without news the
    /// old one comes again, so that a watcher who is gone is noticed.
    pub fn after(&self, number: u64) -> Option<Arc<Shown>> {
        let quiet = |inner: &mut Inner| inner.newest.number <= number && !inner.over;
        let waited = self.news.wait_timeout_while(self.lock(), Duration::from_secs(1), quiet);
        let (inner, _) = waited.unwrap_or_else(PoisonError::into_inner);
        (!inner.over).then(|| inner.newest.clone())
    }

    /// The history and the names of its columns, copied: who sends it takes his time, and the logger does not wait.
    pub fn history(&self) -> (Vec<String>, History) {
        let inner = self.lock();
        (inner.names.clone(), inner.history.clone())
    }
}

fn seconds(from_us: u64, until_us: u64) -> f64 {
    until_us.saturating_sub(from_us) as f64 / 1e6
}

/// A board of the registry as the page takes it: what the logger's status says, where it has been heard, and more.
fn board(engine: &Engine, status: &Status, number: u32, entry: &BoardEntry, now_us: u64) -> Value {
    let mut told = status.board(number).map_or_else(|| json!({"board": number}), |board| json!(board));
    told["silent_s"] = json!(entry.heard_us.map(|heard| seconds(heard, now_us)));
    told["clock_ms"] = json!(entry.fit().and_then(|fit| fit.offset_uncertainty_us).map(|us| us / 1e3));
    told["state"] = json!(match entry.heard_us {
        None => "not heard yet",
        Some(_) if engine.watch().lasts(&Trouble::Silent(number)) => "silent",
        Some(_) => "heard",
    });
    if let Some(told) = told.as_object_mut() {
        // They are told once, with what else is known of them.
        told.remove("sensors");
    }
    told
}

/// What keeps the logger from storing what it hears, in words.
fn troubles(engine: &Engine) -> Vec<&'static str> {
    let watch = engine.watch();
    [
        (Trouble::NotStored, "Nothing can be stored now; boards keep their records."),
        (Trouble::Overrun, "More comes than the disk takes; boards keep the rest."),
        (Trouble::DiskNearlyFull, "The disk is nearly full."),
    ]
    .into_iter()
    .filter_map(|(trouble, words)| watch.lasts(&trouble).then_some(words))
    .collect()
}
