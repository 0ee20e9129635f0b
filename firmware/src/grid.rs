//! The fixed grid of sampling times on the board's clock.

use embassy_time::{Duration, Instant, Timer};

/// Sampling times: the whole multiples of a period, counted from the clock's zero, whatever a sample takes.
#[derive(Debug)]
pub struct Grid {
    period: Duration,
    next: Instant,
    missed: u32,
    worst_lateness: Duration,
}

impl Grid {
    /// The grid of a period (at least a millisecond), from the next of its points on.
    pub fn new(period: Duration, now: Instant) -> Self {
        let period = period.max(Duration::from_millis(1));
        Self { period, next: next_point(period, now), missed: 0, worst_lateness: Duration::from_ticks(0) }
    }

    /// The period.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// The next point, which [`Grid::tick`] waits for.
    pub fn next(&self) -> Instant {
        self.next
    }

    /// How many points passed while the sampler was still busy with an earlier one.
    pub fn missed(&self) -> u32 {
        self.missed
    }

    /// The most that [`Grid::tick`] ever returned after its point.
    pub fn worst_lateness(&self) -> Duration {
        self.worst_lateness
    }

    /// Changes the period; what was counted goes on counting.
    pub fn set_period(&mut self, period: Duration, now: Instant) {
        let counted = (self.missed, self.worst_lateness);
        *self = Self::new(period, now);
        (self.missed, self.worst_lateness) = counted;
    }

    /// Waits for the next point. Points that have already passed are counted and skipped, never caught up in a rush.
    ///
    /// # Cancellation safety
    ///
    /// A wait that is dropped leaves the grid as it was.
    pub async fn tick(&mut self) {
        let now = Instant::now();
        if now >= self.next + self.period {
            let behind = (now - self.next).as_ticks() / self.period.as_ticks() + 1;
            self.missed = self.missed.saturating_add(u32::try_from(behind).unwrap_or(u32::MAX));
            self.next = next_point(self.period, now);
        }
        Timer::at(self.next).await;
        self.worst_lateness = self.worst_lateness.max(Instant::now() - self.next);
        self.next += self.period;
    }
}

fn next_point(period: Duration, now: Instant) -> Instant {
    Instant::from_ticks((now.as_ticks() / period.as_ticks() + 1) * period.as_ticks())
}
