//! A progress bar for what takes more than a second; none where standard error is no terminal.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Steps of a work, counted; shown only once a second has passed.
pub struct Steps {
    bar: ProgressBar,
    begun: Instant,
}

impl Steps {
    /// A work of `count` steps.
    pub fn new(count: u64, what: &'static str) -> Self {
        let bar = ProgressBar::with_draw_target(Some(count), ProgressDrawTarget::hidden());
        // The template is fixed text; were it wrong, the default style would do.
        if let Ok(style) = ProgressStyle::with_template("{msg} {bar:40} {pos}/{len} {eta}") {
            bar.set_style(style);
        }
        bar.set_message(what);
        Self { bar, begun: Instant::now() }
    }

    /// A work of reading so many bytes.
    pub fn of_bytes(count: u64, what: &'static str) -> Self {
        let steps = Self::new(count, what);
        if let Ok(style) = ProgressStyle::with_template("{msg} {bar:40} {bytes}/{total_bytes} {eta}") {
            steps.bar.set_style(style);
        }
        steps
    }

    /// One step is done.
    pub fn done(&self) {
        self.advance(1);
    }

    /// So many steps are done.
    pub fn advance(&self, steps: u64) {
        if self.bar.is_hidden() && self.begun.elapsed() > Duration::from_secs(1) && std::io::stderr().is_terminal() {
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
        }
        self.bar.inc(steps);
    }
}

impl Drop for Steps {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
