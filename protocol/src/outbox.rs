//! The board's side of the window: the store of records that are not acknowledged yet.
//!
//! A full store thins itself: of its older half every second record goes, so that a long outage leaves an even, coarser
//! trace of its beginning and all of its end.

use core::num::NonZeroU32;

use heapless::Vec;

use crate::MAX_SENSORS;
use crate::message::{Acknowledgement, Batch, Reading, Record, Sensor};

/// The most bytes that one record takes in a message.
const MAX_RECORD_LENGTH: usize = 10 + 10 + 1 + MAX_SENSORS * 4;

/// A board's store, with room for a number of records of up to `SENSORS` sensors each.
///
/// It is plain data: a board that retains it over a reset (and checks it) hands it to the link of the next boot, and
/// nothing in it is lost. A record of four sensors takes 28 bytes.
#[derive(Debug, Clone)]
pub struct Outbox<const RECORDS: usize, const SENSORS: usize = MAX_SENSORS> {
    store: u32,
    next: u64,
    held: Vec<Held<SENSORS>, RECORDS>,
    dropped: u32,
    resends: u32,
}

/// A record as it is held: RAM decides how long a board outlives its host, so what follows from elsewhere is left out.
#[derive(Debug, Clone)]
struct Held<const SENSORS: usize> {
    /// The low half of its sequence; a store never spans 2^32 of them.
    sequence: u32,
    /// When it was last sent, in [`SENT_UNIT_US`] on the clock of this boot, rounded up and kept from zero so that it
    /// takes no tag.
    sent: Option<NonZeroU32>,
    /// The low 48 bits of its time: nine years.
    time: [u16; 3],
    /// The low half of its boot; a store never spans 2^16 of them.
    boot: u16,
    /// Two bits a reading, the first in the lowest: its variant.
    variants: u16,
    /// How many readings it has, and [`SENT_TWICE`].
    readings: u8,
    /// The counts of each reading; zero where it has none.
    counts: [i16; SENSORS],
}

/// The bit that a record has once it was sent more often than once: its acknowledgement then tells no latency.
const SENT_TWICE: u8 = 0x80;

/// About a millisecond, so that 32 bits last for 50 days.
const SENT_UNIT_US: u64 = 1 << 10;

/// The timing that decides what is due, from the link.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pace {
    /// The board's clock now.
    pub now_us: u64,
    /// How long to wait for an acknowledgement before a record is sent again.
    pub resend_after_us: u64,
}

impl<const RECORDS: usize, const SENSORS: usize> Outbox<RECORDS, SENSORS> {
    const FITS: () = assert!(SENSORS <= MAX_SENSORS, "no message has room for so many sensors");

    /// An empty store, named by the boot in which it begins.
    pub const fn new(boot: u32) -> Self {
        const { Self::FITS };
        Self { store: boot, next: 0, held: Vec::new(), dropped: 0, resends: 0 }
    }

    /// Empties the store and names it anew: for one that lies where it was made before the boot was known.
    pub fn begin(&mut self, boot: u32) {
        (self.store, self.next, self.dropped, self.resends) = (boot, 0, 0, 0);
        self.held.clear();
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
        self.held.iter().map(|held| self.sequence(held))
    }

    /// How many records were thinned out unacknowledged.
    pub fn dropped(&self) -> u32 {
        self.dropped
    }

    /// How many records were sent again.
    pub fn resends(&self) -> u32 {
        self.resends
    }

    /// Stores a record taken at a time of the given boot's clock; returns its sequence. Readings beyond `SENSORS` are
    /// ignored.
    pub fn push(&mut self, boot: u32, time_us: u64, readings: Vec<Reading, MAX_SENSORS>) -> u64 {
        if self.held.is_full() {
            self.thin();
        }
        let sequence = self.next;
        self.next += 1;
        if self.held.push(Held::new(sequence, boot, time_us, &readings)).is_err() {
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
        let next = self.next;
        self.held.retain(|held| !acknowledgement.covers(held.sequence(next)));
        before - self.held.len()
    }

    /// Makes all records unsent: their times of sending were on the clock of an earlier boot.
    pub(crate) fn resume(&mut self) {
        for held in &mut self.held {
            held.note_resend();
            held.sent = None;
        }
    }

    /// Calls `each` with the latency, in microseconds, of every datagram whose records an acknowledgement covers and that
    /// were sent in no other: how long ago it was sent.
    pub(crate) fn latencies(&self, acknowledgement: &Acknowledgement, now_us: u64, mut each: impl FnMut(u64)) {
        if acknowledgement.store != self.store {
            return;
        }
        let mut last = None;
        for held in self.held.iter().filter(|held| held.readings & SENT_TWICE == 0) {
            // Records that were sent together have one time, and lie together.
            if held.sent.is_some() && held.sent != last && acknowledgement.covers(self.sequence(held)) {
                last = held.sent;
                each(now_us.saturating_sub(held.sent_us().unwrap_or(now_us)));
            }
        }
    }

    /// How many of the newest records, one after another, were never sent.
    pub(crate) fn live(&self) -> usize {
        self.held.iter().rev().take_while(|held| held.sent.is_none()).count()
    }

    /// The time at which the oldest of the newest `count` records was taken, on the clock of its boot.
    pub(crate) fn live_since_us(&self, count: usize) -> Option<u64> {
        self.held.get(self.held.len() - count).map(Held::time_us)
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
        self.held.iter().filter_map(Held::sent_us).min().map(|sent| sent.saturating_add(resend_after_us))
    }

    /// The batch that begins at an index of the store: as many records of one boot as fit the number of bytes, skipping
    /// those in flight at its end. They count as sent now. An index past the end gives the batch without records.
    pub(crate) fn batch(&mut self, index: usize, sensors: &[Sensor], bytes: usize, pace: Pace) -> Batch {
        let mut batch = Batch {
            store: self.store,
            boot: self.held.get(index).map_or(self.store, |held| held.boot(self.store)),
            from: index.checked_sub(1).and_then(|i| self.held.get(i)).map_or(0, |held| self.sequence(held) + 1),
            until: self.next,
            sensors: sensors.iter().copied().take(MAX_SENSORS).collect(),
            records: Vec::new(),
        };
        let mut left = bytes;
        for held in self.held.iter_mut().skip(index) {
            let mut scratch = [0; MAX_RECORD_LENGTH];
            let record = held.record(self.next);
            let length = postcard::to_slice(&record, &mut scratch).map_or(MAX_RECORD_LENGTH, |bytes| bytes.len());
            let fits = length <= left && held.boot(self.store) == batch.boot && held.is_due(pace);
            let sequence = record.sequence;
            if !fits || batch.records.push(record).is_err() {
                batch.until = sequence;
                break;
            }
            left -= length;
            self.resends = self.resends.saturating_add(u32::from(held.sent.is_some()));
            held.send(pace.now_us);
        }
        batch
    }

    /// The batch without records: it only claims what is not held.
    pub(crate) fn empty_batch(&self, sensors: &[Sensor]) -> Batch {
        Batch {
            store: self.store,
            boot: self.store,
            from: 0,
            until: self.held.first().map_or(self.next, |held| self.sequence(held)),
            sensors: sensors.iter().copied().take(MAX_SENSORS).collect(),
            records: Vec::new(),
        }
    }

    fn sequence(&self, held: &Held<SENSORS>) -> u64 {
        held.sequence(self.next)
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

impl<const SENSORS: usize> Held<SENSORS> {
    fn new(sequence: u64, boot: u32, time_us: u64, readings: &[Reading]) -> Self {
        let (mut variants, mut counts) = (0, [0; SENSORS]);
        for (index, (place, reading)) in counts.iter_mut().zip(readings).enumerate() {
            let (variant, value) = match *reading {
                Reading::Ok(counts) => (0, counts),
                Reading::Absent => (1, 0),
                Reading::BusError => (2, 0),
                Reading::OutOfRange(counts) => (3, counts),
            };
            variants |= variant << (2 * index);
            *place = value;
        }
        Self {
            sequence: sequence as u32,
            sent: None,
            time: [time_us as u16, (time_us >> 16) as u16, (time_us >> 32) as u16],
            boot: boot as u16,
            variants,
            readings: readings.len().min(SENSORS) as u8,
            counts,
        }
    }

    fn sequence(&self, next: u64) -> u64 {
        next - u64::from((next as u32).wrapping_sub(self.sequence))
    }

    /// Its boot, at or after the one in which the store began.
    fn boot(&self, store: u32) -> u32 {
        store.wrapping_add(u32::from(self.boot.wrapping_sub(store as u16)))
    }

    fn time_us(&self) -> u64 {
        let [low, middle, high] = self.time.map(u64::from);
        low | middle << 16 | high << 32
    }

    fn record(&self, next: u64) -> Record {
        let counts = self.counts.iter().take(usize::from(self.readings & !SENT_TWICE)).enumerate();
        let readings = counts.map(|(index, &counts)| match self.variants >> (2 * index) & 3 {
            0 => Reading::Ok(counts),
            1 => Reading::Absent,
            2 => Reading::BusError,
            _ => Reading::OutOfRange(counts),
        });
        Record { sequence: self.sequence(next), time_us: self.time_us(), readings: readings.collect() }
    }

    fn sent_us(&self) -> Option<u64> {
        self.sent.map(|sent| u64::from(sent.get()) * SENT_UNIT_US)
    }

    fn note_resend(&mut self) {
        if self.sent.is_some() {
            self.readings |= SENT_TWICE;
        }
    }

    fn send(&mut self, now_us: u64) {
        self.note_resend();
        self.sent = NonZeroU32::new((now_us.div_ceil(SENT_UNIT_US) as u32).max(1));
    }

    fn is_due(&self, pace: Pace) -> bool {
        self.sent_us().is_none_or(|sent| pace.now_us.saturating_sub(sent) >= pace.resend_after_us)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn reading() -> impl Strategy<Value = Reading> {
        prop_oneof![
            any::<i16>().prop_map(Reading::Ok),
            Just(Reading::Absent),
            Just(Reading::BusError),
            any::<i16>().prop_map(Reading::OutOfRange),
        ]
    }

    proptest! {
        /// What is left out of a held record follows from the store, wherever the low halves wrap.
        #[test]
        fn a_held_record_is_given_back_as_it_was(
            sequence in 0u64..1 << 62,
            behind in 1u64..1 << 32,
            store in any::<u32>(),
            boots_later in 0u32..1 << 16,
            time_us in 0u64..1 << 48,
            readings in proptest::collection::vec(reading(), 0..=4),
        ) {
            let boot = store.saturating_add(boots_later);
            let held = Held::<4>::new(sequence, boot, time_us, &readings);
            prop_assert_eq!(held.boot(store), boot);
            let record = held.record(sequence + behind);
            prop_assert_eq!(record, Record { sequence, time_us, readings: readings.into_iter().collect() });
        }
    }

    #[test]
    fn four_sensors_take_28_bytes_a_record() {
        assert_eq!(size_of::<Held<4>>(), 28);
    }
}
