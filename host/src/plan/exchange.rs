//! The search for the best set: Mitchell's DETMAX (1974) on any index, then moves of single poses.
//!
//! From a set, an excursion adds the poses that raise the index most and removes those that lower it least (or removes
//! first), one at a time; where the set of the old size is then better, it is kept, else the next excursion goes further. No
//! step that lowers the index is ever kept. Poses of a set are different ones: to visit one twice would tell of noise what a
//! model's errors at another pose do not.

use nalgebra::DMatrix;

use super::index::{Criterion, Index, Information};

/// How a search is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Search {
    /// How many poses an excursion adds or removes, at most.
    pub farthest: usize,
    /// How many excursions are made, at most.
    pub excursions: usize,
}

impl Default for Search {
    fn default() -> Self {
        Self { farthest: 4, excursions: 2_000 }
    }
}

/// A set that excursions cannot make better.
#[derive(Debug, Clone)]
pub struct Exchange {
    /// Places of the poses, ascending.
    pub members: Vec<usize>,
    /// Its information.
    pub information: Information,
    /// The index at the start and after each excursion that was kept.
    pub history: Vec<f64>,
}

/// A gain below this is rounding: sums of some dozens of rows, each product to 1e-16.
const GAIN: f64 = 1e-9;

/// A small share of each unknown's mean information, by which the first poses of a set are chosen while it tells less than
/// all.
const BEFOREHAND: f64 = 1e-6;

/// Makes a set better, poses being chosen from `rows`. None where the set does not tell all unknowns.
pub fn exchange(index: &Index, rows: &[DMatrix<f64>], start: Vec<usize>, search: &Search) -> Option<Exchange> {
    let information = |members: &[usize]| index.of(members.iter().map(|&member| &rows[member]));
    let mut members = start;
    let mut own = information(&members)?;
    let mut history = vec![index.index(&own)];
    let (mut depth, mut made) = (1, 0);
    while depth <= search.farthest && made < search.excursions {
        made += 1;
        let kept = [true, false].into_iter().find_map(|up| {
            let set = excursion(index, rows, &members, depth, up)?;
            let after = information(&set)?;
            (after.value > own.value + GAIN).then_some((set, after))
        });
        match kept {
            Some((set, after)) => {
                (members, own, depth) = (set, after, 1);
                history.push(index.index(&own));
            }
            None => depth += 1,
        }
    }
    members.sort_unstable();
    Some(Exchange { members, information: own, history })
}

/// The set after `depth` poses are added and as many removed, or the other way round.
fn excursion(index: &Index, rows: &[DMatrix<f64>], members: &[usize], depth: usize, up: bool) -> Option<Vec<usize>> {
    let mut set = members.to_vec();
    for adds in [up, !up] {
        for _ in 0..depth {
            let own = index.of(set.iter().map(|&member| &rows[member]))?;
            if adds {
                let (pose, _) = index.best_to_add(&own, rows, (0..rows.len()).filter(|pose| !set.contains(pose)))?;
                set.push(pose);
            } else {
                let after =
                    (0..set.len()).filter_map(|place| Some((place, index.after(&own, &rows[set[place]], -1.0)?)));
                let (place, _) = after.max_by(|one, other| one.1.total_cmp(&other.1))?;
                set.remove(place);
            }
        }
    }
    Some(set)
}

/// A set to begin from: always the pose that raises the determinant most.
pub(super) fn greedy(rows: &[DMatrix<f64>], count: usize) -> Vec<usize> {
    let unknowns = rows.first().map_or(0, DMatrix::ncols);
    let mean = rows.iter().map(DMatrix::norm_squared).sum::<f64>() / (rows.len().max(1) * unknowns.max(1)) as f64;
    let mut matrix = DMatrix::identity(unknowns, unknowns) * (BEFOREHAND * mean);
    let determinant = Index::new(Criterion::D, unknowns, &[]);
    let mut set: Vec<usize> = Vec::with_capacity(count);
    while set.len() < count {
        let best = determinant
            .of_matrix(matrix.clone())
            .and_then(|own| determinant.best_to_add(&own, rows, (0..rows.len()).filter(|pose| !set.contains(pose))));
        let Some((pose, _)) = best else { break };
        matrix.gemm_tr(1.0, &rows[pose], &rows[pose], 1.0);
        set.push(pose);
    }
    set
}
