//! Records that wait for long, coded by their differences: a temperature hardly moves in a second, and a board's clock
//! keeps its grid, so what takes 28 bytes in full takes 6 here.
//!
//! A block holds up to 32 records of one boot that follow each other. Of each record it holds, as numbers of 7 bits a
//! byte: how much its distance from the record before differs from that one's, doubled, with a bit that says whether
//! sequence or variants go on otherwise than before; if so, the step of the sequence and the variants; and the
//! difference of each count that there is from the last that the same sensor gave. What was acknowledged or sent is kept
//! in two bit sets beside that, so a block is written once.

use core::num::NonZeroU32;

use heapless::Vec;

use crate::message::Acknowledgement;
use crate::outbox::{Held, Pace};

/// The most records of a block; the bit sets have a bit for each.
pub(crate) const BLOCK_RECORDS: usize = 32;
/// The bytes for them: 32 records of four sensors that hardly move.
const BLOCK_BYTES: usize = 196;
/// The bit of [`Block::readings`] of a block of which some record was sent more often than once.
const SENT_TWICE: u8 = 0x80;

/// Records that follow each other in a store, coded.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block {
    /// The low halves of the sequences of the first record and the last.
    first: u32,
    last: u32,
    /// When any of its records was last sent.
    sent: Option<NonZeroU32>,
    /// A bit for each record that is not held any more.
    gone: u32,
    /// A bit for each record that was sent.
    was_sent: u32,
    /// The first record's time, as in [`Held`].
    time: [u16; 3],
    /// The low half of their boot.
    boot: u16,
    /// How many readings each has, and [`SENT_TWICE`].
    readings: u8,
    count: u8,
    length: u8,
    bytes: [u8; BLOCK_BYTES],
}

/// What the next record of a block is told by its difference from.
#[derive(Debug, Clone, Copy)]
struct Before<const SENSORS: usize> {
    sequence: u32,
    step: u32,
    time_us: u64,
    distance_us: u64,
    variants: u16,
    counts: [i16; SENSORS],
}

impl<const SENSORS: usize> Before<SENSORS> {
    fn first(sequence: u32, time_us: u64) -> Self {
        Self { sequence, step: 1, time_us, distance_us: 0, variants: 0, counts: [0; SENSORS] }
    }
}

impl Block {
    /// A block of the first of some records, and how many of them it holds: at least one, if there is one.
    pub fn of<const SENSORS: usize>(records: &[Held<SENSORS>]) -> Option<(Self, usize)> {
        let mut writer = Writer::begin(records.first()?);
        let taken = records.iter().take_while(|record| writer.push(record)).count();
        Some((writer.block, taken))
    }

    /// How many records it holds.
    pub fn len(&self) -> usize {
        usize::from(self.count) - self.gone.count_ones() as usize
    }

    /// Every record that is held, with its index among all that were written.
    pub fn records<const SENSORS: usize>(&self) -> impl Iterator<Item = (u32, Held<SENSORS>)> + '_ {
        let mut reader =
            Reader { block: self, at: 0, before: Before::first(self.first, Held::<SENSORS>::time_of(self.time)) };
        (0..u32::from(self.count)).filter_map(move |index| {
            let record = reader.next(index)?;
            (self.gone >> index & 1 == 0).then_some((index, record))
        })
    }

    /// Forgets what an acknowledgement covers; `sequence` makes a whole one of a low half.
    pub fn acknowledge<const SENSORS: usize>(
        &mut self,
        acknowledgement: &Acknowledgement,
        sequence: impl Fn(u32) -> u64,
    ) {
        self.gone |= self.covered::<SENSORS>(acknowledgement, sequence);
    }

    /// Whether an acknowledgement covers records that were sent, all of them but once: then it tells a latency.
    pub fn tells_latency<const SENSORS: usize>(
        &self,
        acknowledgement: &Acknowledgement,
        sequence: impl Fn(u32) -> u64,
    ) -> Option<u64> {
        let told = self.readings & SENT_TWICE == 0
            && self.was_sent & self.covered::<SENSORS>(acknowledgement, sequence) & !self.gone != 0;
        self.sent_us().filter(|_| told)
    }

    fn covered<const SENSORS: usize>(&self, acknowledgement: &Acknowledgement, sequence: impl Fn(u32) -> u64) -> u32 {
        let (first, last) = (sequence(self.first), sequence(self.last));
        if last < acknowledgement.below {
            return self.all();
        }
        let above = |from: u64| from <= last && first < from.saturating_add(64);
        if first >= acknowledgement.below && !acknowledgement.segments.iter().any(|segment| above(segment.from)) {
            return 0;
        }
        self.records::<SENSORS>()
            .filter(|(_, record)| acknowledgement.covers(sequence(record.sequence)))
            .fold(0, |bits, (index, _)| bits | 1 << index)
    }

    /// Whether records of another block can follow its own in one.
    fn is_like(&self, other: &Self) -> bool {
        self.boot == other.boot && (self.readings ^ other.readings) & !SENT_TWICE == 0
    }

    /// How far its records were apart when it was written, in sequences: to the nearest power of two, its logarithm.
    fn coarseness(&self) -> u32 {
        let between = u32::from(self.count).saturating_sub(1).max(1);
        (self.last.wrapping_sub(self.first) / between).saturating_mul(3).max(2).ilog2() - 1
    }

    fn all(&self) -> u32 {
        u32::MAX >> (BLOCK_RECORDS - usize::from(self.count))
    }

    /// Makes all records unsent.
    pub fn resume(&mut self) {
        if self.was_sent != 0 {
            self.readings |= SENT_TWICE;
        }
        (self.sent, self.was_sent) = (None, 0);
    }

    /// A bit for each record that is to be sent.
    pub fn due(&self, pace: Pace) -> u32 {
        let waiting = if self.is_waiting(pace) { self.was_sent } else { 0 };
        self.all() & !self.gone & !waiting
    }

    /// How many records were sent and may still be acknowledged in time.
    pub fn in_flight(&self, pace: Pace) -> usize {
        if self.is_waiting(pace) { (self.was_sent & !self.gone).count_ones() as usize } else { 0 }
    }

    /// How many records are held before an index among all that were written.
    pub fn held_before(&self, index: u32) -> usize {
        let before = u32::MAX.checked_shr(u32::BITS - index).unwrap_or(0);
        (self.all() & !self.gone & before).count_ones() as usize
    }

    /// When records that wait for an acknowledgement were last sent.
    pub fn sent_us(&self) -> Option<u64> {
        self.sent.filter(|_| self.was_sent & !self.gone != 0).map(crate::outbox::sent_us)
    }

    fn is_waiting(&self, pace: Pace) -> bool {
        self.sent_us().is_some_and(|sent| pace.now_us.saturating_sub(sent) < pace.resend_after_us)
    }

    /// Notes that a record is sent; whether it was sent before.
    pub fn send(&mut self, index: u32, now_us: u64) -> bool {
        let again = self.was_sent >> index & 1 == 1;
        if again {
            self.readings |= SENT_TWICE;
        }
        self.was_sent |= 1 << index;
        self.sent = Some(crate::outbox::sent_at(now_us));
        again
    }
}

/// Writes a block.
struct Writer<const SENSORS: usize> {
    block: Block,
    before: Before<SENSORS>,
}

impl<const SENSORS: usize> Writer<SENSORS> {
    fn begin(first: &Held<SENSORS>) -> Self {
        let block = Block {
            first: first.sequence,
            last: first.sequence,
            sent: None,
            gone: 0,
            was_sent: 0,
            time: first.time,
            boot: first.boot,
            readings: first.readings(),
            count: 0,
            length: 0,
            bytes: [0; BLOCK_BYTES],
        };
        Self { block, before: Before::first(first.sequence, first.time_us()) }
    }

    /// Adds a record, if it is of the block's boot and there is room.
    fn push(&mut self, record: &Held<SENSORS>) -> bool {
        let (block, before) = (&mut self.block, &self.before);
        let count = usize::from(block.count);
        let alike = block.boot == record.boot && block.readings & !SENT_TWICE == record.readings();
        if !alike || count == BLOCK_RECORDS {
            return false;
        }
        let first = count == 0;
        let step = record.sequence.wrapping_sub(before.sequence);
        let distance_us = record.time_us().wrapping_sub(before.time_us);
        let changed = record.variants != before.variants || !first && step != before.step;
        let residual = if first { 0 } else { zigzag(distance_us.wrapping_sub(before.distance_us) as i64) };
        let mut bytes: Vec<u8, 64> = Vec::new();
        append(&mut bytes, residual << 1 | u64::from(changed));
        if changed {
            append(&mut bytes, u64::from(step));
            append(&mut bytes, u64::from(record.variants));
        }
        let mut next = Before {
            sequence: record.sequence,
            step: if first { before.step } else { step },
            time_us: record.time_us(),
            distance_us: if first { 0 } else { distance_us },
            variants: record.variants,
            counts: before.counts,
        };
        for (index, last) in next.counts.iter_mut().enumerate().take(usize::from(record.readings())) {
            if has_counts(record.variants, index) {
                append(&mut bytes, zigzag(i64::from(record.counts[index]) - i64::from(*last)));
                *last = record.counts[index];
            }
        }
        let at = usize::from(block.length);
        let Some(place) = block.bytes.get_mut(at..at + bytes.len()) else {
            return false;
        };
        place.copy_from_slice(&bytes);
        block.length += bytes.len() as u8;
        if let Some(sent) = record.sent {
            block.was_sent |= 1 << count;
            block.sent = Some(block.sent.map_or(sent, |other| other.max(sent)));
        }
        if record.was_sent_twice() {
            block.readings |= SENT_TWICE;
        }
        block.count += 1;
        block.last = record.sequence;
        self.before = next;
        true
    }
}

/// Reads a block, record by record.
struct Reader<'a, const SENSORS: usize> {
    block: &'a Block,
    at: usize,
    before: Before<SENSORS>,
}

impl<const SENSORS: usize> Reader<'_, SENSORS> {
    fn next(&mut self, index: u32) -> Option<Held<SENSORS>> {
        let head = self.number()?;
        let (step, variants) = match head & 1 {
            0 => (None, self.before.variants),
            _ => (Some(self.number()? as u32), self.number()? as u16),
        };
        let before = &mut self.before;
        before.variants = variants;
        if index > 0 {
            before.step = step.unwrap_or(before.step);
            before.sequence = before.sequence.wrapping_add(before.step);
            before.distance_us = before.distance_us.wrapping_add(unzigzag(head >> 1) as u64);
            before.time_us = before.time_us.wrapping_add(before.distance_us);
        }
        let readings = self.block.readings & !SENT_TWICE;
        let mut counts = [0; SENSORS];
        for (index, place) in counts.iter_mut().enumerate().take(usize::from(readings)) {
            if has_counts(variants, index) {
                let difference = unzigzag(self.number()?);
                let last = &mut self.before.counts[index];
                *last = last.wrapping_add(difference as i16);
                *place = *last;
            }
        }
        let sent = self.block.sent.filter(|_| self.block.was_sent >> index & 1 == 1);
        let twice = self.block.readings & SENT_TWICE != 0;
        let Before { sequence, time_us, .. } = self.before;
        Some(Held::restored(sequence, sent, time_us, self.block.boot, variants, readings, twice, counts))
    }

    fn number(&mut self) -> Option<u64> {
        let mut number = 0;
        for shift in (0..64).step_by(7) {
            let byte = *self.block.bytes[..usize::from(self.block.length)].get(self.at)?;
            self.at += 1;
            number |= u64::from(byte & 0x7F) << shift;
            if byte & 0x80 == 0 {
                return Some(number);
            }
        }
        None
    }
}

/// Makes room for a block where the trace is finest, the oldest first: two neighbours become one of every second of
/// their records. So what is held gets evenly coarser, and never much coarser at its beginning than it must. Where no two
/// neighbours can become one, the oldest goes. Gives how many records went.
pub(crate) fn thin<const SENSORS: usize, const BLOCKS: usize>(blocks: &mut Vec<Block, BLOCKS>) -> usize {
    let before: usize = blocks.iter().map(Block::len).sum();
    let finest = (1..blocks.len().div_ceil(2))
        .filter_map(|later| {
            let (first, second) = (&blocks[later - 1], &blocks[later]);
            first.is_like(second).then(|| (first.coarseness().max(second.coarseness()), later))
        })
        .min();
    let one = finest.and_then(|(_, later)| Some((later, halves::<SENSORS>(&blocks[later - 1], &blocks[later])?)));
    match one {
        Some((later, block)) => {
            blocks[later - 1] = block;
            blocks.remove(later);
        }
        None if blocks.is_empty() => {}
        None => drop(blocks.remove(0)),
    }
    before - blocks.iter().map(Block::len).sum::<usize>()
}

/// Every second record of two blocks, or evenly as many fewer as one block holds.
fn halves<const SENSORS: usize>(first: &Block, second: &Block) -> Option<Block> {
    const OF: usize = 16;
    let records = || first.records::<SENSORS>().chain(second.records::<SENSORS>()).map(|(_, record)| record);
    (1..=OF / 2).rev().find_map(|kept| {
        let mut writer = Writer::begin(&records().next()?);
        let mut left = records().enumerate().filter(|(index, _)| index * kept % OF < kept);
        left.all(|(_, record)| writer.push(&record)).then_some(writer.block)
    })
}

/// Whether a reading of a variant has counts.
fn has_counts(variants: u16, index: usize) -> bool {
    matches!(variants >> (2 * index) & 3, 0 | 3)
}

fn zigzag(number: i64) -> u64 {
    (number << 1 ^ number >> 63) as u64
}

fn unzigzag(number: u64) -> i64 {
    (number >> 1) as i64 ^ -((number & 1) as i64)
}

fn append<const CAPACITY: usize>(bytes: &mut Vec<u8, CAPACITY>, mut number: u64) {
    loop {
        let low = (number & 0x7F) as u8;
        number >>= 7;
        // The longest record takes 8 + 5 + 3 bytes and 3 for each sensor: less than there is.
        let _ = bytes.push(if number == 0 { low } else { low | 0x80 });
        if number == 0 {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::message::Reading;

    #[test]
    fn a_block_takes_228_bytes() {
        assert_eq!(size_of::<Block>(), 228);
    }

    fn reading() -> impl Strategy<Value = Reading> {
        prop_oneof![
            6 => (-300i16..300).prop_map(Reading::Ok),
            2 => any::<i16>().prop_map(Reading::Ok),
            1 => Just(Reading::Absent),
            1 => Just(Reading::BusError),
            1 => any::<i16>().prop_map(Reading::OutOfRange),
        ]
    }

    /// Records of a store: sequences and times that go up by anything, now and then another boot.
    fn records() -> impl Strategy<Value = std::vec::Vec<Held<4>>> {
        let step = prop_oneof![4 => Just(1u64), 1 => 1u64..5000];
        let distance = prop_oneof![4 => 999_000u64..1_001_000, 1 => 0u64..1 << 46];
        let record = (step, distance, proptest::collection::vec(reading(), 4), 0u32..20, any::<Option<u16>>());
        (0u64..1 << 62, 0u64..1 << 47, proptest::collection::vec(record, 1..80)).prop_map(
            |(sequence, time_us, records)| {
                let (mut sequence, mut time_us, mut boot) = (sequence, time_us, 7);
                let mut made = std::vec::Vec::new();
                for (step, distance, readings, boots, sent) in records {
                    sequence += step;
                    time_us = (time_us + distance) & ((1 << 48) - 1);
                    boot += u32::from(boots == 0);
                    let mut held = Held::new(sequence, boot, time_us, &readings);
                    if let Some(sent) = sent {
                        held.send(u64::from(sent) << 10);
                    }
                    made.push(held);
                }
                made
            },
        )
    }

    fn key(held: &Held<4>) -> (u32, u64, u16, u16, u8, [i16; 4], bool) {
        (held.sequence, held.time_us(), held.boot, held.variants, held.readings(), held.counts, held.sent.is_some())
    }

    proptest! {
        #[test]
        fn records_are_given_back_as_they_were(records in records()) {
            let mut rest = &records[..];
            while let Some((block, taken)) = Block::of(rest) {
                prop_assert!(taken >= 1 && block.len() == taken);
                let read: std::vec::Vec<_> = block.records::<4>().map(|(_, held)| key(&held)).collect();
                let written: std::vec::Vec<_> = rest[..taken].iter().map(key).collect();
                prop_assert_eq!(read, written);
                rest = &rest[taken..];
            }
        }

        #[test]
        fn thinning_makes_one_of_two_blocks_and_changes_no_record_that_is_left(records in records()) {
            let (mut blocks, mut rest) = (Vec::<Block, 80>::new(), &records[..]);
            while let Some((block, taken)) = Block::of(rest) {
                prop_assert!(blocks.push(block).is_ok());
                rest = &rest[taken..];
            }
            let mut left: std::vec::Vec<_> = records.iter().map(key).collect();
            while !blocks.is_empty() {
                let before = blocks.len();
                let gone = thin::<4, 80>(&mut blocks);
                prop_assert_eq!(blocks.len(), before - 1);
                let now: std::vec::Vec<_> =
                    blocks.iter().flat_map(|block| block.records::<4>()).map(|(_, held)| key(&held)).collect();
                prop_assert_eq!(now.len() + gone, left.len());
                // Each that is left comes once, in its order, as it was.
                let mut earlier = left.iter();
                prop_assert!(now.iter().all(|one| earlier.any(|other| other == one)));
                left = now;
            }
        }
    }

    #[test]
    fn the_trace_of_a_long_outage_gets_evenly_coarser_from_its_beginning() {
        const BLOCKS: usize = 16;
        let mut blocks = Vec::<Block, BLOCKS>::new();
        for first in (0..100 * BLOCK_RECORDS as u64).step_by(BLOCK_RECORDS) {
            if blocks.is_full() {
                thin::<4, BLOCKS>(&mut blocks);
            }
            let record = |sequence| Held::new(sequence, 7, sequence * 1_000_000, &[Reading::Ok(5); 4]);
            let records: std::vec::Vec<Held<4>> = (first..first + BLOCK_RECORDS as u64).map(record).collect();
            let (block, taken) = Block::of(&records).expect("there are records");
            assert!(taken == records.len() && blocks.push(block).is_ok());
        }
        let coarseness: std::vec::Vec<u32> = blocks.iter().map(Block::coarseness).collect();
        assert!(coarseness.windows(2).all(|pair| pair[0] >= pair[1]), "{coarseness:?}");
        // 92 blocks' time in eight is 12 to one: 2^4 must be there, and 2^5 where the younger ones are finer.
        assert!(coarseness[0] <= 5 && coarseness[8..].iter().all(|&fine| fine == 0), "{coarseness:?}");
        assert_eq!(blocks[0].first, 0);
    }
}
