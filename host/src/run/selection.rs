//! Choosing visits: selections as the command line spells them, and folds that keep whole poses or cycles together.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::Visit;

/// Which visits to take. An index is a visit's position in order of time.
///
/// ```
/// use thermokin::run::Selection;
/// let selection: Selection = "every:100:3".parse()?;
/// assert_eq!(selection, Selection::Every { step: 100, offset: 3 });
/// assert_eq!(selection.to_string(), "every:100:3");
/// # Ok::<(), thermokin::run::SelectionError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Selection {
    /// `every:STEP` or `every:STEP:OFFSET`: the visits whose index leaves OFFSET when divided by STEP.
    Every {
        /// At least 1.
        step: usize,
        /// Below the step.
        offset: usize,
    },
    /// `first:COUNT`: so many visits from the first.
    First(usize),
    /// `last:COUNT`: so many visits up to the last.
    Last(usize),
    /// `cycles:0-11,14`: the visits of these cycles.
    Cycles(Vec<RangeInclusive<u32>>),
    /// `poses:0-7,9`: the visits of these poses.
    Poses(Vec<RangeInclusive<u32>>),
}

/// A selection that cannot be understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "cannot understand the selection \"{}\"; expected every:STEP, every:STEP:OFFSET with OFFSET below STEP, first:COUNT, \
     last:COUNT, cycles:0-11 or poses:0-7,9",
    found.escape_debug()
)]
pub struct SelectionError {
    /// What was found.
    pub found: String,
}

impl Selection {
    /// Whether the visit of this index, of so many visits in all, is taken.
    pub fn picks(&self, index: usize, count: usize, visit: &Visit) -> bool {
        let holds = |ranges: &[RangeInclusive<u32>], number| ranges.iter().any(|range| range.contains(&number));
        match self {
            Self::Every { step, offset } => index % step == *offset,
            Self::First(taken) => index < *taken,
            Self::Last(taken) => index >= count.saturating_sub(*taken),
            Self::Cycles(ranges) => holds(ranges, visit.cycle),
            Self::Poses(ranges) => holds(ranges, visit.pose),
        }
    }

    /// For each visit, in order of time, whether it is taken.
    pub fn mask(&self, visits: &[Visit]) -> Vec<bool> {
        visits.iter().enumerate().map(|(index, visit)| self.picks(index, visits.len(), visit)).collect()
    }
}

impl FromStr for Selection {
    type Err = SelectionError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        parse(text).ok_or_else(|| SelectionError { found: text.to_owned() })
    }
}

fn parse(text: &str) -> Option<Selection> {
    let (kind, rest) = text.trim().split_once(':')?;
    match kind {
        "every" => {
            let (step, offset) = rest.split_once(':').unwrap_or((rest, "0"));
            let (step, offset) = (step.parse().ok()?, offset.parse().ok()?);
            (offset < step).then_some(Selection::Every { step, offset })
        }
        "first" => count(rest).map(Selection::First),
        "last" => count(rest).map(Selection::Last),
        "cycles" => ranges(rest).map(Selection::Cycles),
        "poses" => ranges(rest).map(Selection::Poses),
        _ => None,
    }
}

fn count(text: &str) -> Option<usize> {
    text.parse().ok().filter(|&count| count > 0)
}

fn ranges(text: &str) -> Option<Vec<RangeInclusive<u32>>> {
    text.split(',')
        .map(|part| {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let (first, last) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
            (first <= last).then_some(first..=last)
        })
        .collect()
}

impl fmt::Display for Selection {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Every { step, offset: 0 } => write!(formatter, "every:{step}"),
            Self::Every { step, offset } => write!(formatter, "every:{step}:{offset}"),
            Self::First(count) => write!(formatter, "first:{count}"),
            Self::Last(count) => write!(formatter, "last:{count}"),
            Self::Cycles(ranges) => write!(formatter, "cycles:{}", Ranges(ranges)),
            Self::Poses(ranges) => write!(formatter, "poses:{}", Ranges(ranges)),
        }
    }
}

struct Ranges<'a>(&'a [RangeInclusive<u32>]);

impl fmt::Display for Ranges<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, range) in self.0.iter().enumerate() {
            let comma = if index == 0 { "" } else { "," };
            match (range.start(), range.end()) {
                (first, last) if first == last => write!(formatter, "{comma}{first}")?,
                (first, last) => write!(formatter, "{comma}{first}-{last}")?,
            }
        }
        Ok(())
    }
}

/// A number of folds that the visits cannot be split into.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("cannot split {groups} {} into {folds} folds; expected 2 to {groups}", if *.by_pose { "poses" } else { "cycles" })]
pub struct FoldError {
    /// How many folds were asked for.
    pub folds: usize,
    /// How many poses or cycles there are.
    pub groups: usize,
    /// Whether poses were to be split, or cycles.
    pub by_pose: bool,
}

/// The fold of each visit, 0 to `folds` - 1, where all visits of a pose are in one fold. Poses are dealt out in turn,
/// shuffled by a seed.
///
/// # Errors
/// Fewer than two folds, or more folds than poses.
pub fn folds_by_pose(visits: &[Visit], folds: usize, seed: u64) -> Result<Vec<usize>, FoldError> {
    deal(visits, folds, seed, |visit| visit.pose).map_err(|groups| FoldError { folds, groups, by_pose: true })
}

/// The fold of each visit, 0 to `folds` - 1, where all visits of a cycle are in one fold. Cycles are dealt out in turn,
/// shuffled by a seed.
///
/// # Errors
/// Fewer than two folds, or more folds than cycles.
pub fn folds_by_cycle(visits: &[Visit], folds: usize, seed: u64) -> Result<Vec<usize>, FoldError> {
    deal(visits, folds, seed, |visit| visit.cycle).map_err(|groups| FoldError { folds, groups, by_pose: false })
}

/// Deals the groups out to the folds; the error is how many groups there are.
fn deal(visits: &[Visit], folds: usize, seed: u64, group: impl Fn(&Visit) -> u32) -> Result<Vec<usize>, usize> {
    let mut groups: Vec<u32> = visits.iter().map(&group).collect();
    groups.sort_unstable();
    groups.dedup();
    if folds < 2 || folds > groups.len() {
        return Err(groups.len());
    }
    // Measuring orders have periods of their own (a grid, a sequence of approaches): a fold must not follow one.
    let mut order: Vec<usize> = (0..groups.len()).collect();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for last in (1..order.len()).rev() {
        let other = random.next_u64() % (last as u64 + 1);
        order.swap(last, other as usize);
    }
    let rank = |visit| order[groups.partition_point(|&known| known < group(visit))];
    Ok(visits.iter().map(|visit| rank(visit) % folds).collect())
}
