//! The board's side of the window: the store of records that are not acknowledged yet.
//!
//! A full store thins itself: of its older half every second record goes, so that a long outage leaves an even, coarser
//! trace of its beginning and all of its end.

use core::num::NonZeroU64;

use heapless::Vec;

use crate::MAX_SENSORS;
use crate::message::{Acknowledgement, Batch, Reading, Record, Sensor};

/// The most bytes that one record takes in a message.
const MAX_RECORD_LENGTH: usize = 10 + 10 + 1 + MAX_SENSORS * 4;

/// A board's store, with room for a number of records.
///
/// It is plain data: a board that retains it over a reset (and checks it) hands it to the link of the next boot, and
/// nothing in it is lost.
#[derive(Debug, Clone)]
pub struct Outbox<const RECORDS: usize> {
    store: u32,
    next: u64,
    held: Vec<Held, RECORDS>,
    dropped: u32,
    resends: u32,
}

#[derive(Debug, Clone)]
struct Held {
    record: Record,
    boot: u32,
    sent: Sent,
}

/// When a record was last sent, on the board's clock of this boot, kept from zero so that it takes no tag.
type Sent = Option<NonZeroU64>;

/// The timing that decides what is due, from the link.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pace {
    /// The board's clock now.
    pub now_us: u64,
    /// How long to wait for an acknowledgement before a record is sent again.
    pub resend_after_us: u64,
}

impl<const RECORDS: usize> Outbox<RECORDS> {
    /// An empty store, named by the boot in which it begins.
    pub const fn new(boot: u32) -> Self {
        Self { store: boot, next: 0, held: Vec::new(), dropped: 0, resends: 0 }
    }

    /// The name of the store: the boot in which it began.
    pub fn store(&self) -> u32 {
        self.store
    }

    /// The sequence that the next record will have.
    pub fn next_sequence(&self) -> u64 {
        self.next
    }

    /// How many records it holds.
    pub fn len(&self) -> usize {
        self.held.len()
    }

    /// Whether everything is acknowledged.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }

    /// The sequences that it holds, in order.
    pub fn sequences(&self) -> impl Iterator<Item = u64> + '_ {
        self.held.iter().map(|held| held.record.sequence)
    }

    /// How many records were thinned out unacknowledged.
    pub fn dropped(&self) -> u32 {
        self.dropped
    }

    /// How many records were sent again.
    pub fn resends(&self) -> u32 {
        self.resends
    }

    /// Stores a record taken at a time of the given boot's clock; returns its sequence.
    pub fn push(&mut self, boot: u32, time_us: u64, readings: Vec<Reading, MAX_SENSORS>) -> u64 {
        if self.held.is_full() {
            self.thin();
        }
        let sequence = self.next;
        self.next += 1;
        let record = Record { sequence, time_us, readings };
        if self.held.push(Held { record, boot, sent: None }).is_err() {
            // Only a store without any room is still full after thinning.
            self.dropped = self.dropped.saturating_add(1);
        }
        sequence
    }

    /// Forgets what an acknowledgement of this store covers; returns how many records that freed.
    pub fn acknowledge(&mut self, acknowledgement: &Acknowledgement) -> usize {
        if acknowledgement.store != self.store {
            return 0;
        }
        let before = self.held.len();
        self.held.retain(|held| !acknowledgement.covers(held.record.sequence));
        before - self.held.len()
    }

    /// Makes all records unsent: their times of sending were on the clock of an earlier boot.
    pub(crate) fn resume(&mut self) {
        for held in &mut self.held {
            held.sent = None;
        }
    }

    /// How many of the newest records, one after another, were never sent.
    pub(crate) fn live(&self) -> usize {
        self.held.iter().rev().take_while(|held| held.sent.is_none()).count()
    }

    /// The time at which the oldest of the newest `count` records was taken, on the clock of its boot.
    pub(crate) fn live_since_us(&self, count: usize) -> Option<u64> {
        self.held.get(self.held.len() - count).map(|held| held.record.time_us)
    }

    /// How many records were sent and may still be acknowledged in time.
    pub(crate) fn in_flight(&self, pace: Pace) -> usize {
        self.held.iter().filter(|held| held.sent.is_some() && !held.is_due(pace)).count()
    }

    /// The oldest record that is due, live ones aside: never sent, or sent and not acknowledged in time.
    pub(crate) fn backlog(&self, pace: Pace) -> Option<usize> {
        let older = self.held.len() - self.live();
        self.held[..older].iter().position(|held| held.is_due(pace))
    }

    /// The earliest time at which a sent record becomes due again.
    pub(crate) fn next_due_us(&self, resend_after_us: u64) -> Option<u64> {
        self.held.iter().filter_map(|held| held.sent).min().map(|sent| sent.get().saturating_add(resend_after_us))
    }

    /// The batch that begins at an index of the store: as many records of one boot as fit the number of bytes, skipping
    /// those in flight at its end. They count as sent now. An index past the end gives the batch without records.
    pub(crate) fn batch(&mut self, index: usize, sensors: &[Sensor], bytes: usize, pace: Pace) -> Batch {
        let mut batch = Batch {
            store: self.store,
            boot: self.held.get(index).map_or(self.store, |held| held.boot),
            from: index.checked_sub(1).and_then(|i| self.held.get(i)).map_or(0, |held| held.record.sequence + 1),
            until: self.next,
            sensors: sensors.iter().copied().take(MAX_SENSORS).collect(),
            records: Vec::new(),
        };
        let mut left = bytes;
        for held in self.held.iter_mut().skip(index) {
            let mut scratch = [0; MAX_RECORD_LENGTH];
            let length = postcard::to_slice(&held.record, &mut scratch).map_or(MAX_RECORD_LENGTH, |bytes| bytes.len());
            let fits = length <= left && held.boot == batch.boot && held.is_due(pace);
            if !fits || batch.records.push(held.record.clone()).is_err() {
                batch.until = held.record.sequence;
                break;
            }
            left -= length;
            self.resends = self.resends.saturating_add(u32::from(held.sent.is_some()));
            held.sent = NonZeroU64::new(pace.now_us.max(1));
        }
        batch
    }

    /// The batch without records: it only claims what is not held.
    pub(crate) fn empty_batch(&self, sensors: &[Sensor]) -> Batch {
        Batch {
            store: self.store,
            boot: self.store,
            from: 0,
            until: self.held.first().map_or(self.next, |held| held.record.sequence),
            sensors: sensors.iter().copied().take(MAX_SENSORS).collect(),
            records: Vec::new(),
        }
    }

    /// Makes room: of the older half, every second record goes.
    fn thin(&mut self) {
        let before = self.held.len();
        let older = before / 2;
        let mut index = 0;
        self.held.retain(|_| {
            index += 1;
            index > older || index % 2 == 1
        });
        if self.held.len() == before && before > 0 {
            self.held.remove(0);
        }
        let gone = u32::try_from(before - self.held.len()).unwrap_or(u32::MAX);
        self.dropped = self.dropped.saturating_add(gone);
    }
}

impl Held {
    fn is_due(&self, pace: Pace) -> bool {
        self.sent.is_none_or(|sent| pace.now_us.saturating_sub(sent.get()) >= pace.resend_after_us)
    }
}
