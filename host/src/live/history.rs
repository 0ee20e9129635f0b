//! Temperatures of all sensors over time, in two bounded buffers: the last quarter of an hour second by second, and the whole
//! time, at a step that doubles whenever the buffer is full.

use std::collections::VecDeque;

/// Rows of the last quarter of an hour.
const RECENT: usize = 900;
/// Rows of the whole; half of them are dropped when it is full.
const WHOLE: usize = 1440;

/// Temperatures at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Seconds since 1970.
    pub time_s: f64,
    /// Degrees Celsius, one a sensor; none where it was silent or unknown, as are sensors beyond the end.
    pub celsius: Vec<Option<f32>>,
}

/// The two buffers.
#[derive(Debug, Clone, PartialEq)]
pub struct History {
    recent: VecDeque<Row>,
    whole: VecDeque<Row>,
    step_s: f64,
}

impl Default for History {
    fn default() -> Self {
        Self { recent: VecDeque::new(), whole: VecDeque::new(), step_s: 1.0 }
    }
}

impl History {
    /// Takes the temperatures at a time, unless the rows before are close enough to it.
    pub fn take(&mut self, time_s: f64, celsius: &[Option<f64>]) {
        // A tick early is as good as on time: else a tick that comes late would cost a second.
        let due = |last: Option<&Row>, step_s: f64| last.is_none_or(|last| time_s - last.time_s >= step_s - 0.1);
        let row = || Row { time_s, celsius: celsius.iter().map(|value| value.map(|value| value as f32)).collect() };
        if due(self.recent.back(), 1.0) {
            if self.recent.len() == RECENT {
                self.recent.pop_front();
            }
            self.recent.push_back(row());
        }
        if due(self.whole.back(), self.step_s) {
            if self.whole.len() == WHOLE {
                let mut odd = false;
                self.whole.retain(|_| {
                    odd = !odd;
                    odd
                });
                self.step_s *= 2.0;
            }
            self.whole.push_back(row());
        }
    }

    /// The last quarter of an hour, oldest first.
    pub fn recent(&self) -> &VecDeque<Row> {
        &self.recent
    }

    /// The whole time, oldest first.
    pub fn whole(&self) -> &VecDeque<Row> {
        &self.whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_hours_stay_bounded_and_whole() {
        let mut history = History::default();
        let ticks = 8 * 3600 * 4;
        for tick in 0..ticks {
            let time_s = f64::from(tick) / 4.0;
            history.take(time_s, &[Some(20.0 + time_s / 1e4); 20]);
        }
        let (recent, whole) = (history.recent(), history.whole());
        assert!(recent.len() == RECENT && (WHOLE / 2..=WHOLE).contains(&whole.len()), "{}", whole.len());
        let end = 8.0 * 3600.0;
        assert!(whole[0].time_s == 0.0 && whole[whole.len() - 1].time_s > end - 2.0 * history.step_s);
        assert!(recent[0].time_s >= end - 1.2 * RECENT as f64, "{}", recent[0].time_s);
        // Evenly: no step is longer than another by more than a tick, but the last, which was not thinned yet.
        let steps: Vec<f64> = whole.iter().zip(whole.iter().skip(1)).map(|(a, b)| b.time_s - a.time_s).collect();
        assert!(steps.iter().all(|step| *step <= history.step_s + 0.5 && *step >= history.step_s - 0.5), "{steps:?}");
        assert!(whole.iter().all(|row| row.celsius == [Some((20.0 + row.time_s / 1e4) as f32); 20]));
    }
}
