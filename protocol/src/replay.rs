//! Refusing what was received before: the newest epoch heard and a sliding window of its counters.

use crate::header::Header;
use crate::seal::Refused;

/// How many counters back from the newest can still be told apart.
const WINDOW: u64 = u128::BITS as u64;

/// What one end has heard of the other's authentic datagrams.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ReplayGuard {
    epoch: u32,
    /// The highest counter heard in this epoch, plus one; 0 before the first datagram.
    next: u64,
    /// Bit i: counter `next - 1 - i` was heard.
    heard: u128,
}

impl ReplayGuard {
    /// A guard that takes nothing from before the given epoch.
    pub const fn from_epoch(epoch: u32) -> Self {
        Self { epoch, next: 0, heard: 0 }
    }

    /// A guard as [`ReplayGuard::state`] told it.
    pub const fn from_state(epoch: u32, next: u64, heard: u128) -> Self {
        Self { epoch, next, heard }
    }

    /// What must be remembered of this guard: epoch, one past the highest counter, and the bits of the window, bit i for
    /// the counter i + 1 below that.
    pub const fn state(&self) -> (u32, u64, u128) {
        (self.epoch, self.next, self.heard)
    }

    /// The newest epoch heard.
    pub const fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Notes an authentic datagram, or says why it is not fresh.
    pub fn admit(&mut self, header: &Header) -> Result<(), Refused> {
        if header.epoch < self.epoch {
            return Err(Refused::Stale);
        }
        if header.epoch > self.epoch {
            *self = Self::from_epoch(header.epoch);
        }
        if header.counter >= self.next {
            let ahead = header.counter - self.next + 1;
            self.heard = if ahead < WINDOW { self.heard << ahead } else { 0 } | 1;
            self.next = header.counter + 1;
            return Ok(());
        }
        let back = self.next - 1 - header.counter;
        if back >= WINDOW || self.heard & (1 << back) != 0 {
            return Err(Refused::Replayed);
        }
        self.heard |= 1 << back;
        Ok(())
    }
}
