//! The host's side of the window: what of one board's records was received, and what of that is durable.

use heapless::Vec;

use crate::MAX_SEGMENTS;
use crate::message::{Acknowledgement, Batch, Record, Segment};
use crate::seal::Refused;
use crate::sequence_set::{Full, SequenceSet};

/// What a batch brought that was not there before, in the order of the sequences.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival<'a> {
    /// A record that is received for the first time.
    Record(&'a Record),
    /// Sequences that will never come.
    Gap(Gap),
}

/// Sequences of a store that will never come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gap {
    /// The store.
    pub store: u32,
    /// One past the last store that this says the same of.
    pub stores_until: u32,
    /// The first sequence.
    pub from: u64,
    /// One past the last sequence; none where nobody knows how many there were.
    pub until: Option<u64>,
    /// Why.
    pub reason: GapReason,
}

/// Why sequences will never come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GapReason {
    /// The board does not hold them: its full store thinned them out, or another log took them before this one began.
    NotHeld,
    /// The store that held them ended, with the board's power for instance.
    StoreEnded,
    /// Boots that nothing was heard of lie between two that were: if any of them began a store, it ended unheard.
    Unheard,
}

/// What one board's records have come to, on the host.
///
/// `SEGMENTS` bounds how scattered the records above the contiguous part may be (64 sequences a segment); records that
/// would exceed it are not taken and not acknowledged, so the board sends them again.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Inbox<const SEGMENTS: usize> {
    /// The first boot whose store this log should have; 0 if that is not known.
    first_boot: u32,
    received: Option<Progress<SEGMENTS>>,
    committing: Option<Progress<SEGMENTS>>,
    durable: Option<Progress<SEGMENTS>>,
    /// The segments that the next acknowledgement tells about.
    asked: Vec<u64, MAX_SEGMENTS>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Progress<const SEGMENTS: usize> {
    store: u32,
    /// The newest boot that it was heard in.
    boot: u32,
    set: SequenceSet<SEGMENTS>,
}

impl<const SEGMENTS: usize> Inbox<SEGMENTS> {
    /// An inbox to which nothing came yet, of a board that begins with a boot; what its boots from that one on take should
    /// come, and stores of boots that are never heard are told as gaps. 0 tells of none before the first store heard.
    pub fn from_boot(first_boot: u32) -> Self {
        Self { first_boot, ..Self::default() }
    }

    /// Takes a batch that a boot of the board sent, and calls `each` with what is new in it. None of that is durable yet.
    ///
    /// # Errors
    ///
    /// [`Refused::Malformed`] if the batch breaks its own rules, [`Refused::Stale`] if it is from a store that ended.
    pub fn accept(&mut self, boot: u32, batch: &Batch, mut each: impl FnMut(Arrival<'_>)) -> Result<(), Refused> {
        if !batch.is_well_formed() || batch.store > boot {
            return Err(Refused::Malformed);
        }
        let received = match &mut self.received {
            Some(progress) if progress.store > batch.store => return Err(Refused::Stale),
            Some(progress) if progress.store == batch.store => progress,
            other => {
                // A boot takes its records into the store that it found, or begins one under its own name. So a store
                // that nobody heard of is named by a boot that nobody heard of, after the last one heard.
                let mut unheard_from = self.first_boot;
                if let Some(ended) = other {
                    unheard_from = ended.boot.saturating_add(1);
                    let (store, stores_until, reason) =
                        (ended.store, ended.store.saturating_add(1), GapReason::StoreEnded);
                    let gap = |from, until| Gap { store, stores_until, from, until, reason };
                    let end = ended.set.end();
                    ended.set.missing(0, end, |from, until| each(Arrival::Gap(gap(from, Some(until)))));
                    each(Arrival::Gap(gap(end, None)));
                }
                if unheard_from > 0 && unheard_from < batch.store {
                    let (store, stores_until) = (unheard_from, batch.store);
                    each(Arrival::Gap(Gap { store, stores_until, from: 0, until: None, reason: GapReason::Unheard }));
                }
                self.asked.clear();
                other.insert(Progress { store: batch.store, boot, set: SequenceSet::default() })
            }
        };
        received.boot = received.boot.max(boot);
        let mut start = batch.from;
        for record in &batch.records {
            received.close(start, record.sequence, &mut each);
            start = record.sequence + 1;
            let fresh = !received.set.contains(record.sequence);
            if fresh && received.set.insert_range(record.sequence, start).is_ok() {
                each(Arrival::Record(record));
            }
            let segment = record.sequence & !63;
            if !self.asked.contains(&segment) {
                if self.asked.is_full() {
                    self.asked.remove(0);
                }
                // There is room: one was removed if there was none.
                let _ = self.asked.push(segment);
            }
        }
        received.close(start, batch.until, &mut each);
        Ok(())
    }

    /// What was received until now is being written: see [`Inbox::finish_commit`].
    pub fn begin_commit(&mut self) {
        self.committing.clone_from(&self.received);
    }

    /// What was received until [`Inbox::begin_commit`] is durable.
    pub fn finish_commit(&mut self) {
        self.durable.clone_from(&self.committing);
    }

    /// Forgets what was received and is not durable: writing it failed, the board shall send it again.
    pub fn roll_back(&mut self) {
        self.received.clone_from(&self.durable);
    }

    /// An inbox to which a log already holds part of a store, last heard in a boot: everything below a limit and a bitmap
    /// above it, as [`Inbox::boot`] and [`Inbox::received`] told them.
    ///
    /// # Errors
    ///
    /// [`Full`] if the bitmap has more segments than this inbox has room for.
    pub fn restore(boot: u32, store: u32, below: u64, segments: &[Segment]) -> Result<Self, Full> {
        let set = SequenceSet::restore(below, segments)?;
        let progress = Some(Progress { store, boot, set });
        let (received, committing) = (progress.clone(), progress.clone());
        Ok(Self { first_boot: 0, received, committing, durable: progress, asked: Vec::new() })
    }

    /// What was received: store, limit and bitmap above it; none before anything was.
    pub fn received(&self) -> Option<(u32, u64, &[Segment])> {
        self.received.as_ref().map(|progress| (progress.store, progress.set.below(), progress.set.segments()))
    }

    /// The durable part of it, likewise.
    pub fn durable(&self) -> Option<(u32, u64, &[Segment])> {
        self.durable.as_ref().map(|progress| (progress.store, progress.set.below(), progress.set.segments()))
    }

    /// The newest boot in which the store that is being received was heard.
    pub fn boot(&self) -> Option<u32> {
        self.received.as_ref().map(|progress| progress.boot)
    }

    /// The name of the store that is being received.
    pub fn store(&self) -> Option<u32> {
        self.received.as_ref().map(|progress| progress.store)
    }

    /// The acknowledgement to send now; none before anything was received.
    pub fn acknowledgement(&mut self) -> Option<Acknowledgement> {
        let received = self.received.as_ref()?;
        let mut acknowledgement = Acknowledgement { store: received.store, below: 0, segments: Vec::new() };
        let Some(durable) = self.durable.as_ref().filter(|durable| durable.store == received.store) else {
            return Some(acknowledgement);
        };
        acknowledgement.below = durable.set.below();
        acknowledgement.segments = self.asked.iter().filter_map(|&from| durable.set.segment_of(from)).collect();
        self.asked.retain(|&from| durable.set.segment_of(from) != received.set.segment_of(from));
        Some(acknowledgement)
    }
}

impl<const SEGMENTS: usize> Progress<SEGMENTS> {
    /// Turns what is missing in a claimed range into gaps. A claim for which there is no room is left: a later batch makes
    /// it again.
    fn close(&mut self, from: u64, until: u64, each: &mut impl FnMut(Arrival<'_>)) {
        if from >= until || until <= self.set.below() {
            return;
        }
        let before = self.set.clone();
        if self.set.insert_range(from, until).is_err() {
            self.set = before;
            return;
        }
        let store = self.store;
        before.missing(from, until, |from, until| {
            let stores_until = store.saturating_add(1);
            each(Arrival::Gap(Gap { store, stores_until, from, until: Some(until), reason: GapReason::NotHeld }));
        });
    }
}
