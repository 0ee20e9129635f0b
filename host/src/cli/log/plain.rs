//! The logger's words where there is no terminal: a line when something happens, and one every minute.

use crate::logger::civil;
use crate::logger::engine::Engine;
use crate::logger::serve::{State, View, Wish};

/// How often the state is said, in microseconds.
const EVERY_US: u64 = 60_000_000;

/// A line log on standard error.
#[derive(Debug, Default)]
pub struct Plain {
    said_us: u64,
}

impl View for Plain {
    fn say(&mut self, time_us: u64, text: &str) {
        eprintln!("{}Z {text}", civil::utc(time_us / 1_000_000));
    }

    fn show(&mut self, engine: &Engine, _state: &State, now_us: u64) -> Vec<Wish> {
        if self.said_us == 0 {
            self.said_us = now_us;
        }
        if now_us - self.said_us >= EVERY_US {
            self.said_us = now_us;
            let heard = engine.boards().values().filter(|board| board.heard_us.is_some()).count();
            let tally = engine.tally();
            let text = format!(
                "{heard} of {} boards heard, {} readings stored, {} records lost, {} datagrams refused",
                engine.boards().len(),
                tally.readings,
                tally.lost,
                tally.refused
            );
            self.say(now_us, &text);
        }
        Vec::new()
    }
}
