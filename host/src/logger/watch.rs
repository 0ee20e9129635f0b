//! The warnings that matter, each said once when it begins and once when it is over.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, VecDeque};
use std::hash::Hash;

/// What a warning is about. While it lasts it is not said again.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Trouble {
    /// A board says nothing.
    Silent(u32),
    /// A sensor does not answer, or its transfers fail.
    NoReading(u32, u8),
    /// A sensor gives the same counts for long.
    Stuck(u32, u8),
    /// A sensor jumped.
    Jump(u32, u8),
    /// robot.toml has no name for a sensor.
    Unnamed(u32, u8),
    /// The registry has no such board.
    UnknownBoard(u32),
    /// Datagrams for a board are not sealed with its key.
    Forged(u32),
    /// A board speaks another schema version.
    Version(u32),
    /// A board's clock does not settle.
    Clock(u32),
    /// The disk is nearly full.
    DiskNearlyFull,
    /// Nothing can be stored.
    NotStored,
    /// More comes than can be stored.
    Overrun,
}

/// What was said and is not over.
#[derive(Debug, Default)]
pub struct Watch {
    active: HashMap<Trouble, u64>,
    said: VecDeque<(u64, String)>,
    unsaid: Vec<String>,
}

/// The number of warnings that a view can show.
const REMEMBERED: usize = 50;

impl Watch {
    /// Says a warning, unless it lasts already.
    pub fn raise(&mut self, trouble: Trouble, now_us: u64, text: impl FnOnce() -> String) {
        if let Entry::Vacant(new) = self.active.entry(trouble) {
            new.insert(now_us);
            self.say(now_us, text());
        }
    }

    /// Says that a trouble is over, if it was said to be there; `text` is given how long it lasted, in microseconds.
    pub fn clear(&mut self, trouble: &Trouble, now_us: u64, text: impl FnOnce(u64) -> String) {
        if let Some(since) = self.active.remove(trouble) {
            self.say(now_us, text(now_us.saturating_sub(since)));
        }
    }

    /// Says something that is no trouble.
    pub fn note(&mut self, now_us: u64, text: String) {
        self.say(now_us, text);
    }

    /// Whether a trouble lasts.
    pub fn lasts(&self, trouble: &Trouble) -> bool {
        self.active.contains_key(trouble)
    }

    /// What was said since the last call.
    pub fn take_unsaid(&mut self) -> Vec<String> {
        std::mem::take(&mut self.unsaid)
    }

    /// The latest words, oldest first, with their times on the host's clock in microseconds.
    pub fn said(&self) -> impl DoubleEndedIterator<Item = &(u64, String)> {
        self.said.iter()
    }

    fn say(&mut self, now_us: u64, text: String) {
        self.unsaid.push(text.clone());
        self.said.push_back((now_us, text));
        if self.said.len() > REMEMBERED {
            self.said.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warning_is_said_once_until_it_is_over() {
        let mut watch = Watch::default();
        watch.raise(Trouble::Silent(3), 10, || "board 3 is silent".to_owned());
        watch.raise(Trouble::Silent(3), 20, || "board 3 is silent".to_owned());
        watch.raise(Trouble::Silent(4), 20, || "board 4 is silent".to_owned());
        assert_eq!(watch.take_unsaid(), ["board 3 is silent", "board 4 is silent"]);
        watch.clear(&Trouble::Silent(3), 50, |lasted| format!("board 3 is back after {lasted} us"));
        watch.clear(&Trouble::Silent(3), 60, |_| "again".to_owned());
        assert_eq!(watch.take_unsaid(), ["board 3 is back after 40 us"]);
        watch.raise(Trouble::Silent(3), 70, || "board 3 is silent".to_owned());
        assert_eq!(watch.take_unsaid(), ["board 3 is silent"]);
    }
}
