//! Whether sampling and uplink both progress: the watchdog is fed only while they do.

use core::cell::Cell;

use embassy_time::{Duration, Instant};

/// The shortest time that sampling or uplink is given.
const PATIENCE: Duration = Duration::from_secs(10);

/// Which part of the firmware stands still.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Starving {
    /// No sample was taken in time, good or bad.
    Sampling,
    /// The uplink's loop did not come round. That no host answers is no fault of the board, and does not count.
    Uplink,
}

/// When sampling and uplink last progressed.
#[derive(Debug)]
pub struct Vigil {
    sampled: Cell<Instant>,
    came_round: Cell<Instant>,
}

impl Vigil {
    /// Both count as having just progressed.
    pub fn new(now: Instant) -> Self {
        Self { sampled: Cell::new(now), came_round: Cell::new(now) }
    }

    /// A sample was taken.
    pub fn sampled(&self, now: Instant) {
        self.sampled.set(now);
    }

    /// The uplink's loop came round.
    pub fn uplink_came_round(&self, now: Instant) {
        self.came_round.set(now);
    }

    /// What stands still at a sampling period: sampling may take three of them, both have ten seconds at least.
    pub fn starving(&self, now: Instant, period: Duration) -> Option<Starving> {
        let sampling = PATIENCE.max(period * 3);
        if now.saturating_duration_since(self.sampled.get()) > sampling {
            Some(Starving::Sampling)
        } else if now.saturating_duration_since(self.came_round.get()) > PATIENCE {
            Some(Starving::Uplink)
        } else {
            None
        }
    }
}
