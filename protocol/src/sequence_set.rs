//! A set of sequences in bounded memory: everything below a limit, and 64-bit segments of a bitmap above it.

use heapless::Vec;

use crate::Segment;

/// The set has no room for another segment of its bitmap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("too many separate pieces above the contiguous part")]
pub struct Full;

/// A set of sequences that fills up from below.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SequenceSet<const SEGMENTS: usize> {
    below: u64,
    /// In order; none is empty, none begins at or before a full lower part (`below` lies in or before the first).
    segments: Vec<Segment, SEGMENTS>,
}

impl<const SEGMENTS: usize> Default for SequenceSet<SEGMENTS> {
    fn default() -> Self {
        Self { below: 0, segments: Vec::new() }
    }
}

impl<const SEGMENTS: usize> SequenceSet<SEGMENTS> {
    /// The set of everything below a limit and of a bitmap above it, as another set told them.
    pub fn restore(below: u64, segments: &[Segment]) -> Result<Self, Full> {
        let mut set = Self { below, segments: Vec::new() };
        for segment in segments.iter().filter(|segment| segment.bits != 0) {
            set.set_bits(segment.from & !63, segment.bits)?;
        }
        set.normalise();
        Ok(set)
    }

    /// Every sequence below this one is in the set, and this one is not.
    pub fn below(&self) -> u64 {
        self.below
    }

    /// The bitmap above [`SequenceSet::below`], in order, without empty segments.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// One past the highest sequence in the set.
    pub fn end(&self) -> u64 {
        match self.segments.last() {
            Some(last) => last.from + (64 - u64::from(last.bits.leading_zeros())),
            None => self.below,
        }
    }

    /// Whether a sequence is in the set.
    pub fn contains(&self, sequence: u64) -> bool {
        sequence < self.below || self.segments.iter().any(|segment| segment.contains(sequence))
    }

    /// The segment of the bitmap that a sequence above [`SequenceSet::below`] lies in, if any of it is set.
    pub fn segment_of(&self, sequence: u64) -> Option<Segment> {
        self.segments.iter().copied().find(|segment| segment.from == sequence & !63)
    }

    /// Adds the sequences of `from..until`. When there is no room for all, as many as fit are added, from below.
    pub fn insert_range(&mut self, from: u64, until: u64) -> Result<(), Full> {
        if from <= self.below {
            self.below = self.below.max(until);
            self.normalise();
            return Ok(());
        }
        let mut start = from;
        while start < until {
            let base = start & !63;
            // A range that reaches the last segment of all sequences ends there without overflow.
            let end = base.checked_add(64).map_or(until, |next| until.min(next));
            let width = end - start;
            let ones = if width >= 64 { u64::MAX } else { (1 << width) - 1 };
            self.set_bits(base, ones << (start - base))?;
            start = end;
        }
        Ok(())
    }

    /// Calls `each` with every maximal part of `from..until` that is not in the set, in order.
    pub fn missing(&self, from: u64, until: u64, mut each: impl FnMut(u64, u64)) {
        let mut start = from.max(self.below);
        for segment in &self.segments {
            let mut bits = segment.bits;
            while bits != 0 {
                let first = u64::from(bits.trailing_zeros());
                let run = u64::from((bits >> first).trailing_ones());
                let (run_from, run_until) = (segment.from + first, segment.from + first + run);
                if run_from.min(until) > start {
                    each(start, run_from.min(until));
                }
                start = start.max(run_until);
                bits &= if first + run >= 64 { 0 } else { u64::MAX << (first + run) };
            }
        }
        if start < until {
            each(start, until);
        }
    }

    fn set_bits(&mut self, base: u64, bits: u64) -> Result<(), Full> {
        match self.segments.binary_search_by_key(&base, |segment| segment.from) {
            Ok(index) => self.segments[index].bits |= bits,
            Err(index) => self.segments.insert(index, Segment { from: base, bits }).map_err(|_| Full)?,
        }
        Ok(())
    }

    /// Moves what has become contiguous from the bitmap below the limit.
    fn normalise(&mut self) {
        let mut absorbed = 0;
        for segment in &mut self.segments {
            if segment.from > self.below {
                break;
            }
            let offset = self.below - segment.from;
            if offset < 64 {
                self.below += u64::from((segment.bits >> offset).trailing_ones());
            }
            let offset = self.below - segment.from;
            segment.bits = if offset >= 64 { 0 } else { segment.bits & (u64::MAX << offset) };
            absorbed += usize::from(segment.bits == 0);
            if segment.bits != 0 {
                break;
            }
        }
        if absorbed > 0 {
            self.segments.retain(|segment| segment.bits != 0);
        }
    }
}
