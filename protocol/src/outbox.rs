//! The board's side of the window: the store of records that are not acknowledged yet.
//!
//! A full store thins itself: of its older half every second record goes, so that a long outage leaves an even, coarser
//! trace of its beginning and all of its end. With an archive, what waits longer than the newest few is coded by its
//! differences there (`crate::archive`), and the archive is what is thinned.

use core::num::NonZeroU32;

use heapless::Vec;

use crate::MAX_SENSORS;
use crate::archive::{self, BLOCK_RECORDS, Block};
use crate::message::{Acknowledgement, Batch, Reading, Record, Sensor};

/// The most bytes that one record takes in a message.
const MAX_RECORD_LENGTH: usize = 10 + 10 + 1 + MAX_SENSORS * 4;

/// A board's store, with room for a number of records of up to `SENSORS` sensors each.
///
/// It is plain data: a board that retains it over a reset (and checks it) hands it to the link of the next boot, and
/// nothing in it is lost. A record of four sensors takes 28 bytes; of those that wait longer, `BLOCKS` blocks of 228 bytes
/// hold up to 32 each.
#[derive(Debug, Clone)]
pub struct Outbox<const RECORDS: usize, const SENSORS: usize = MAX_SENSORS, const BLOCKS: usize = 0> {
    store: u32,
    next: u64,
    /// All older than what is held in full; no block is empty.
    archive: Vec<Block, BLOCKS>,
    held: Vec<Held<SENSORS>, RECORDS>,
    dropped: u32,
    resends: u32,
}

/// A record as it is held: RAM decides how long a board outlives its host, so what follows from elsewhere is left out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Held<const SENSORS: usize> {
    /// The low half of its sequence; a store never spans 2^32 of them.
    pub sequence: u32,
    /// When it was last sent, in [`SENT_UNIT_US`] on the clock of this boot, rounded up and kept from zero so that it
    /// takes no tag.
    pub sent: Option<NonZeroU32>,
    /// The low 48 bits of its time: nine years.
    pub time: [u16; 3],
    /// The low half of its boot; a store never spans 2^16 of them.
    pub boot: u16,
    /// Two bits a reading, the first in the lowest: its variant.
    pub variants: u16,
    /// How many readings it has, and [`SENT_TWICE`].
    readings: u8,
    /// The counts of each reading; zero where it has none.
    pub counts: [i16; SENSORS],
}

/// The bit that a record has once it was sent more often than once: its acknowledgement then tells no latency.
const SENT_TWICE: u8 = 0x80;

/// About a millisecond, so that 32 bits last for 50 days.
const SENT_UNIT_US: u64 = 1 << 10;

/// A time of sending on the clock of this boot, as records hold it.
pub(crate) fn sent_at(now_us: u64) -> NonZeroU32 {
    NonZeroU32::new(now_us.div_ceil(SENT_UNIT_US) as u32).unwrap_or(NonZeroU32::MIN)
}

/// The same in microseconds.
pub(crate) fn sent_us(sent: NonZeroU32) -> u64 {
    u64::from(sent.get()) * SENT_UNIT_US
}

/// The timing that decides what is due, from the link.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pace {
    /// The board's clock now.
    pub now_us: u64,
    /// How long to wait for an acknowledgement before a record is sent again.
    pub resend_after_us: u64,
}

impl<const RECORDS: usize, const SENSORS: usize, const BLOCKS: usize> Outbox<RECORDS, SENSORS, BLOCKS> {
    const FITS: () = assert!(SENSORS <= MAX_SENSORS, "no message has room for so many sensors");

    /// An empty store, named by the boot in which it begins.
    pub const fn new(boot: u32) -> Self {
        const { Self::FITS };
        Self { store: boot, next: 0, archive: Vec::new(), held: Vec::new(), dropped: 0, resends: 0 }
    }

    /// Empties the store and names it anew: for one that lies where it was made before the boot was known.
    pub fn begin(&mut self, boot: u32) {
        (self.store, self.next, self.dropped, self.resends) = (boot, 0, 0, 0);
        self.archive.clear();
        self.held.clear();
    }

    /// How many records it has room for, if those that wait change as little from one to the next as temperatures do.
    pub const fn capacity() -> usize {
        RECORDS + BLOCKS * BLOCK_RECORDS
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
        self.archived() + self.held.len()
    }

    /// Whether everything is acknowledged.
    pub fn is_empty(&self) -> bool {
        self.archive.is_empty() && self.held.is_empty()
    }

    /// The sequences that it holds, in order.
    pub fn sequences(&self) -> impl Iterator<Item = u64> + '_ {
        let archived = self.archive.iter().flat_map(|block| block.records()).map(|(_, held)| self.sequence(&held));
        archived.chain(self.held.iter().map(|held| self.sequence(held)))
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
            if BLOCKS > 0 { self.put_by() } else { self.thin() }
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
        let before = self.len();
        let next = self.next;
        self.archive.retain_mut(|block| {
            block.acknowledge::<SENSORS>(acknowledgement, |sequence| whole_sequence(sequence, next));
            block.len() > 0
        });
        self.held.retain(|held| !acknowledgement.covers(held.sequence(next)));
        before - self.len()
    }

    /// Makes all records unsent: their times of sending were on the clock of an earlier boot.
    pub(crate) fn resume(&mut self) {
        self.archive.iter_mut().for_each(Block::resume);
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
        let next = self.next;
        for block in &self.archive {
            let sent = block.tells_latency::<SENSORS>(acknowledgement, |sequence| whole_sequence(sequence, next));
            sent.map(|sent| now_us.saturating_sub(sent)).into_iter().for_each(&mut each);
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

    /// How many of the newest records, one after another, were never sent; those that were put by aside.
    pub(crate) fn live(&self) -> usize {
        self.held.iter().rev().take_while(|held| held.sent.is_none()).count()
    }

    /// The time at which the oldest of the newest `count` records was taken, on the clock of its boot.
    pub(crate) fn live_since_us(&self, count: usize) -> Option<u64> {
        self.held.get(self.held.len() - count).map(Held::time_us)
    }

    /// How many records were sent and may still be acknowledged in time.
    pub(crate) fn in_flight(&self, pace: Pace) -> usize {
        let archived: usize = self.archive.iter().map(|block| block.in_flight(pace)).sum();
        archived + self.held.iter().filter(|held| held.sent.is_some() && !held.is_due(pace)).count()
    }

    /// The oldest record that is due, live ones aside: never sent, or sent and not acknowledged in time.
    pub(crate) fn backlog(&self, pace: Pace) -> Option<usize> {
        let mut before = 0;
        for block in &self.archive {
            let due = block.due(pace);
            if due != 0 {
                return Some(before + block.held_before(due.trailing_zeros()));
            }
            before += block.len();
        }
        let older = self.held.len() - self.live();
        self.held[..older].iter().position(|held| held.is_due(pace)).map(|index| before + index)
    }

    /// The earliest time at which a sent record becomes due again.
    pub(crate) fn next_due_us(&self, resend_after_us: u64) -> Option<u64> {
        let archived = self.archive.iter().filter_map(Block::sent_us);
        let sent = archived.chain(self.held.iter().filter_map(Held::sent_us)).min();
        sent.map(|sent| sent.saturating_add(resend_after_us))
    }

    /// The batch that begins at an index of the store: as many records of one boot as fit the number of bytes, skipping
    /// those in flight at its end. They count as sent now. An index past the end gives the batch without records.
    pub(crate) fn batch(&mut self, index: usize, sensors: &[Sensor], bytes: usize, pace: Pace) -> Batch {
        let (store, next) = (self.store, self.next);
        let batch = Batch {
            store,
            boot: store,
            from: 0,
            until: next,
            sensors: sensors.iter().copied().take(MAX_SENSORS).collect(),
            records: Vec::new(),
        };
        let mut filling = Filling { batch, left: bytes };
        let mut before = index;
        for block in &mut self.archive {
            if before > block.len() {
                before -= block.len();
                continue;
            }
            let coded = *block;
            for (index, held) in coded.records::<SENSORS>() {
                if before > 0 {
                    before -= 1;
                    filling.batch.from = held.sequence(next) + 1;
                } else if filling.take(&held, coded.due(pace) >> index & 1 == 1, store, next) {
                    self.resends = self.resends.saturating_add(u32::from(block.send(index, pace.now_us)));
                } else {
                    return filling.batch;
                }
            }
        }
        if let Some(last) = before.checked_sub(1).and_then(|last| self.held.get(last)) {
            filling.batch.from = last.sequence(next) + 1;
        }
        for held in self.held.iter_mut().skip(before) {
            if !filling.take(held, held.is_due(pace), store, next) {
                break;
            }
            self.resends = self.resends.saturating_add(u32::from(held.sent.is_some()));
            held.send(pace.now_us);
        }
        filling.batch
    }

    /// The batch without records: it only claims what is not held.
    pub(crate) fn empty_batch(&self, sensors: &[Sensor]) -> Batch {
        Batch {
            store: self.store,
            boot: self.store,
            from: 0,
            until: self.sequences().next().unwrap_or(self.next),
            sensors: sensors.iter().copied().take(MAX_SENSORS).collect(),
            records: Vec::new(),
        }
    }

    fn sequence(&self, held: &Held<SENSORS>) -> u64 {
        held.sequence(self.next)
    }

    fn archived(&self) -> usize {
        self.archive.iter().map(Block::len).sum()
    }

    /// Makes room in what is held in full: the oldest go into the archive, coded. A full archive is thinned first, where
    /// its older half is finest.
    fn put_by(&mut self) {
        if self.archive.is_full() {
            let gone = archive::thin::<SENSORS, BLOCKS>(&mut self.archive);
            self.dropped = self.dropped.saturating_add(u32::try_from(gone).unwrap_or(u32::MAX));
        }
        if let Some((block, count)) = Block::of(&self.held) {
            if self.archive.push(block).is_err() {
                self.dropped = self.dropped.saturating_add(u32::try_from(count).unwrap_or(u32::MAX));
            }
            self.held.copy_within(count.., 0);
            self.held.truncate(self.held.len() - count);
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

/// A batch that is being filled.
struct Filling {
    batch: Batch,
    /// The bytes that are left for records.
    left: usize,
}

impl Filling {
    /// Takes a record, the next of the store, if it belongs into this batch; otherwise the batch ends before it.
    fn take<const SENSORS: usize>(&mut self, held: &Held<SENSORS>, is_due: bool, store: u32, next: u64) -> bool {
        if self.batch.records.is_empty() {
            self.batch.boot = held.boot(store);
        }
        let mut scratch = [0; MAX_RECORD_LENGTH];
        let record = held.record(next);
        let length = postcard::to_slice(&record, &mut scratch).map_or(MAX_RECORD_LENGTH, |bytes| bytes.len());
        let sequence = record.sequence;
        let fits = is_due && length <= self.left && held.boot(store) == self.batch.boot;
        if !fits || self.batch.records.push(record).is_err() {
            self.batch.until = sequence;
            return false;
        }
        self.left -= length;
        true
    }
}

/// The sequence of which the low half is known, in a store that has come so far.
fn whole_sequence(low: u32, next: u64) -> u64 {
    next - u64::from((next as u32).wrapping_sub(low))
}

impl<const SENSORS: usize> Held<SENSORS> {
    /// A record as the archive had it.
    #[expect(clippy::too_many_arguments, reason = "all that a record is")]
    pub fn restored(
        sequence: u32,
        sent: Option<NonZeroU32>,
        time_us: u64,
        boot: u16,
        variants: u16,
        readings: u8,
        sent_twice: bool,
        counts: [i16; SENSORS],
    ) -> Self {
        let readings = if sent_twice { readings | SENT_TWICE } else { readings };
        Self { sequence, sent, time: time_words(time_us), boot, variants, readings, counts }
    }

    /// How many readings it has.
    pub fn readings(&self) -> u8 {
        self.readings & !SENT_TWICE
    }

    /// Whether it was sent more often than once.
    pub fn was_sent_twice(&self) -> bool {
        self.readings & SENT_TWICE != 0
    }

    pub fn new(sequence: u64, boot: u32, time_us: u64, readings: &[Reading]) -> Self {
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
            time: time_words(time_us),
            boot: boot as u16,
            variants,
            readings: readings.len().min(SENSORS) as u8,
            counts,
        }
    }

    fn sequence(&self, next: u64) -> u64 {
        whole_sequence(self.sequence, next)
    }

    /// Its boot, at or after the one in which the store began.
    fn boot(&self, store: u32) -> u32 {
        store.wrapping_add(u32::from(self.boot.wrapping_sub(store as u16)))
    }

    pub fn time_us(&self) -> u64 {
        Self::time_of(self.time)
    }

    /// The time that three words stand for.
    pub fn time_of(words: [u16; 3]) -> u64 {
        let [low, middle, high] = words.map(u64::from);
        low | middle << 16 | high << 32
    }

    fn record(&self, next: u64) -> Record {
        let counts = self.counts.iter().take(usize::from(self.readings())).enumerate();
        let readings = counts.map(|(index, &counts)| match self.variants >> (2 * index) & 3 {
            0 => Reading::Ok(counts),
            1 => Reading::Absent,
            2 => Reading::BusError,
            _ => Reading::OutOfRange(counts),
        });
        Record { sequence: self.sequence(next), time_us: self.time_us(), readings: readings.collect() }
    }

    fn sent_us(&self) -> Option<u64> {
        self.sent.map(sent_us)
    }

    fn note_resend(&mut self) {
        if self.sent.is_some() {
            self.readings |= SENT_TWICE;
        }
    }

    pub fn send(&mut self, now_us: u64) {
        self.note_resend();
        self.sent = Some(sent_at(now_us));
    }

    fn is_due(&self, pace: Pace) -> bool {
        self.sent_us().is_none_or(|sent| pace.now_us.saturating_sub(sent) >= pace.resend_after_us)
    }
}

fn time_words(time_us: u64) -> [u16; 3] {
    [time_us as u16, (time_us >> 16) as u16, (time_us >> 32) as u16]
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

    /// What can be done with a store.
    #[derive(Debug, Clone)]
    enum Step {
        Push(i16, bool),
        /// A batch from that index on, of so many bytes.
        Send(prop::sample::Index, usize),
        Backlog,
        /// Below that sequence, and a segment at that one.
        Acknowledge(prop::sample::Index, prop::sample::Index, u64),
        Resume,
        Wait,
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            12 => (-200i16..200, prop::bool::weighted(0.1)).prop_map(|(counts, missing)| Step::Push(counts, missing)),
            2 => (any::<prop::sample::Index>(), 40usize..1000).prop_map(|(index, bytes)| Step::Send(index, bytes)),
            2 => Just(Step::Backlog),
            1 => (any::<prop::sample::Index>(), any::<prop::sample::Index>(), any::<u64>())
                .prop_map(|(below, from, bits)| Step::Acknowledge(below, from, bits)),
            1 => Just(Step::Resume),
            1 => Just(Step::Wait),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

        /// A store with an archive, against all that was ever put into it.
        #[test]
        fn an_archive_changes_nothing_but_the_room(steps in proptest::collection::vec(step(), 1..900)) {
            let mut store: Outbox<40, 2, 4> = Outbox::new(3);
            let mut taken: std::vec::Vec<Record> = std::vec::Vec::new();
            let (mut now_us, mut released) = (0, 0);
            for step in steps {
                let pace = Pace { now_us, resend_after_us: 5_000_000 };
                match step {
                    Step::Push(counts, missing) => {
                        now_us += 1_000_000;
                        let last = if missing { Reading::Absent } else { Reading::Ok(counts / 2) };
                        let readings: Vec<Reading, MAX_SENSORS> = [Reading::Ok(counts), last].into_iter().collect();
                        let sequence = store.push(3, now_us, readings.clone());
                        prop_assert_eq!(sequence, taken.len() as u64);
                        taken.push(Record { sequence, time_us: now_us, readings });
                    }
                    Step::Send(index, bytes) => {
                        let index = index.index(store.len() + 1);
                        check(&mut store, index, bytes, pace, &taken)?;
                    }
                    Step::Backlog => {
                        if let Some(index) = store.backlog(pace) {
                            let sent = check(&mut store, index, 1000, pace, &taken)?;
                            prop_assert!(sent > 0, "what is due is sent");
                        }
                    }
                    Step::Acknowledge(below, from, bits) => {
                        let sequence = |index: prop::sample::Index| index.index(taken.len() + 1) as u64;
                        // Most acknowledgements free a few records only.
                        let acknowledgement = Acknowledgement {
                            store: 3,
                            below: sequence(below) / 2,
                            segments: Vec::from_iter([crate::Segment { from: sequence(from) & !63, bits }]),
                        };
                        let covered = store.sequences().filter(|&sequence| acknowledgement.covers(sequence)).count();
                        store.latencies(&acknowledgement, now_us, |latency| assert!(latency <= now_us));
                        prop_assert_eq!(store.acknowledge(&acknowledgement), covered);
                        released += covered;
                    }
                    Step::Resume => {
                        store.resume();
                        prop_assert_eq!(store.in_flight(pace), 0);
                        prop_assert_eq!(store.next_due_us(0), None);
                    }
                    Step::Wait => now_us += 6_000_000,
                }
                let held: std::vec::Vec<u64> = store.sequences().collect();
                prop_assert_eq!(held.len(), store.len());
                prop_assert!(held.windows(2).all(|pair| pair[0] < pair[1]));
                prop_assert_eq!(held.len() + released + store.dropped() as usize, taken.len());
                prop_assert_eq!(store.is_empty(), held.is_empty());
            }
        }
    }

    /// A batch claims what is true, and its records are those that were taken; gives how many it has.
    fn check(
        store: &mut Outbox<40, 2, 4>,
        index: usize,
        bytes: usize,
        pace: Pace,
        taken: &[Record],
    ) -> Result<usize, TestCaseError> {
        let held: std::vec::Vec<u64> = store.sequences().collect();
        let sensors = [Sensor { address: 0x48, kind: crate::SensorKind::Lm75 }; 2];
        let batch = store.batch(index, &sensors, bytes, pace);
        prop_assert!(batch.is_well_formed(), "{batch:?}");
        prop_assert!(batch.records.iter().all(|record| taken[record.sequence as usize] == *record), "{batch:?}");
        let claimed: std::vec::Vec<u64> =
            held.iter().copied().filter(|sequence| (batch.from..batch.until).contains(sequence)).collect();
        let sent: std::vec::Vec<u64> = batch.records.iter().map(|record| record.sequence).collect();
        prop_assert_eq!(&claimed, &sent);
        prop_assert_eq!(sent.first(), held.get(index).filter(|_| !sent.is_empty()));
        Ok(sent.len())
    }
}
