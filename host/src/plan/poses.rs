//! A plan of poses: the best set of a pool, moved to where it is better still; what sets of poses are worth.

use nalgebra::DMatrix;

use super::exchange::{Exchange, Search, exchange, greedy};
use super::index::{Criterion, Index, Information};
use super::space::{Space, SpaceError};
use super::telling::{Setup, Telling};
use crate::simulate::random::{Purpose, Stream};

/// Why there is no plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// Too little room.
    #[error(transparent)]
    Space(#[from] SpaceError),
    /// Too few poses for the unknowns.
    #[error("{count} poses do not tell {unknowns} unknowns; expected {least} poses or more")]
    TooFew {
        /// How many are asked for.
        count: usize,
        /// What is to be told.
        unknowns: usize,
        /// How many might do.
        least: usize,
    },
    /// The pool is smaller than the set.
    #[error("{count} poses cannot be chosen from {pool}")]
    SmallPool {
        /// How many are asked for.
        count: usize,
        /// How many there are.
        pool: usize,
    },
    /// Nothing can be told.
    #[error("these poses tell nothing of the arm: the unknowns move no target")]
    Nothing,
}

/// Median and worst of some standard deviations, m or rad.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// The median.
    pub median: f64,
    /// The largest.
    pub worst: f64,
    /// Whose it is.
    pub of: String,
}

/// What a set of poses is worth.
#[derive(Debug, Clone, PartialEq)]
pub struct Worth {
    /// How many poses.
    pub poses: usize,
    /// The index.
    pub index: f64,
    /// Standard deviations of lengths, m; none where none is unknown.
    pub lengths: Option<Spread>,
    /// Of angles, rad.
    pub angles: Option<Spread>,
    /// Of predicted positions where the plan is judged, m: median and largest.
    pub position: [f64; 2],
}

/// A plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Joint positions of each pose, rad or m.
    pub joints: Vec<Vec<f64>>,
    /// Their places in the pool, where they were not moved.
    pub members: Option<Vec<usize>>,
    /// What it is worth.
    pub worth: Worth,
    /// The index at the start, after each excursion and each round of moves that was kept.
    pub history: Vec<f64>,
    /// For the criterion D: no set of as many poses of the pool has an index more than `1 / efficiency` times as large.
    pub efficiency: Option<f64>,
}

/// Plans poses of one arm in one space.
#[derive(Debug, Clone)]
pub struct Planner {
    telling: Telling,
    pool: Vec<Vec<f64>>,
    rows: Vec<DMatrix<f64>>,
    judged: Vec<DMatrix<f64>>,
    index: Index,
}

/// Random sets that a search begins from, besides the greedy one.
const STARTS: usize = 2;

/// Widths of the moves of single poses, as shares of the joints' windows: by rounds that get finer.
const MOVES: [f64; 6] = [0.15, 0.1, 0.06, 0.04, 0.02, 0.01];

/// Tries of a move.
const TRIES: usize = 12;

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match (values.len(), values.len() / 2) {
        (0, _) => f64::NAN,
        (length, middle) if length % 2 == 1 => values[middle],
        (_, middle) => 0.5 * (values[middle - 1] + values[middle]),
    }
}

impl Planner {
    /// A planner that chooses from `pool` and judges predictions at `judged`.
    ///
    /// # Errors
    /// A pool that tells nothing.
    pub fn new(
        setup: Setup,
        pool: Vec<Vec<f64>>,
        judged: &[Vec<f64>],
        criterion: Criterion,
    ) -> Result<Self, PlanError> {
        let telling = Telling::new(setup, &pool);
        if telling.unknowns().is_empty() {
            return Err(PlanError::Nothing);
        }
        let rows = telling.rows(&pool);
        let judged = telling.positions(judged);
        let index = Index::new(criterion, telling.unknowns().len(), &judged);
        Ok(Self { telling, pool, rows, judged, index })
    }

    /// The same unknowns, criterion and judgement, with another pool to choose from.
    pub fn among(&self, pool: Vec<Vec<f64>>) -> Self {
        Self { rows: self.telling.rows(&pool), pool, ..self.clone() }
    }

    /// What poses tell, of which unknowns.
    pub fn telling(&self) -> &Telling {
        &self.telling
    }

    /// What best means.
    pub fn criterion(&self) -> Criterion {
        self.index.criterion()
    }

    /// The poses that are chosen from.
    pub fn pool(&self) -> &[Vec<f64>] {
        &self.pool
    }

    /// The fewest poses that could tell all unknowns, by counting rows.
    pub fn least(&self) -> usize {
        let most = self.rows.iter().map(DMatrix::nrows).max().unwrap_or(1).max(1);
        self.telling.unknowns().len().div_ceil(most)
    }

    /// The best `count` poses; where a space is given, moved within it to where they are better than any of the pool.
    ///
    /// # Errors
    /// Too few poses for the unknowns, or in the pool.
    pub fn plan(&self, count: usize, space: Option<&Space>, seed: u64) -> Result<Planned, PlanError> {
        let too_few =
            PlanError::TooFew { count, unknowns: self.telling.unknowns().len(), least: self.least().max(count + 1) };
        if count < self.least() {
            return Err(PlanError::TooFew { count, unknowns: self.telling.unknowns().len(), least: self.least() });
        }
        if count > self.pool.len() {
            return Err(PlanError::SmallPool { count, pool: self.pool.len() });
        }
        let found = self.search(count, seed).ok_or(too_few)?;
        let mut joints: Vec<Vec<f64>> = found.members.iter().map(|&member| self.pool[member].clone()).collect();
        let mut history = found.history;
        let mut information = found.information;
        if let Some(space) = space {
            self.refine(space, &mut joints, &mut information, &mut history, seed);
        }
        Ok(Planned {
            members: space.is_none().then_some(found.members),
            worth: self.worth_of(&joints, &information),
            efficiency: self.index.least_efficiency(&information, count, &self.rows),
            joints,
            history,
        })
    }

    /// The best of some searches.
    fn search(&self, count: usize, seed: u64) -> Option<Exchange> {
        let mut stream = Stream::new(seed, Purpose::Starts);
        let mut starts = vec![greedy(&self.rows, count)];
        for _ in 0..STARTS {
            let mut places: Vec<usize> = (0..self.pool.len()).collect();
            for place in 0..count {
                let other = place + (stream.uniform() * (places.len() - place) as f64) as usize;
                places.swap(place, other);
            }
            places.truncate(count);
            starts.push(places);
        }
        starts
            .into_iter()
            .filter_map(|start| exchange(&self.index, &self.rows, start, &Search::default()))
            .max_by(|one, other| one.information.value.total_cmp(&other.information.value))
    }

    /// Moves single poses, round by round less far, wherever that raises the index.
    fn refine(
        &self,
        space: &Space,
        joints: &mut [Vec<f64>],
        information: &mut Information,
        history: &mut Vec<f64>,
        seed: u64,
    ) {
        let mut stream = Stream::new(seed, Purpose::Refinement);
        let arm = self.telling.setup().prepared();
        let targets = &self.telling.setup().state.geometry.targets;
        let mut rows = self.telling.rows(joints);
        for width in MOVES {
            for place in 0..joints.len() {
                let others = rows.iter().enumerate().filter(|(other, _)| *other != place).map(|(_, rows)| rows);
                // Without this pose the others may not tell all: then it stays where it is.
                let Some(others) = self.index.of(others) else { continue };
                let tries: Vec<Vec<f64>> = (0..TRIES)
                    .map(|_| {
                        let move_one = |(joint, [low, high]): (&f64, &[f64; 2])| {
                            (joint + width * (high - low) * stream.normal()).clamp(*low, *high)
                        };
                        joints[place].iter().zip(&space.joints).map(move_one).collect::<Vec<f64>>()
                    })
                    .filter(|moved| space.admits(&arm, targets, moved).is_ok())
                    .collect();
                let told = self.telling.rows(&tries);
                let Some((best, _)) = self.index.best_to_add(&others, &told, 0..tries.len()) else { continue };
                let kept = std::mem::replace(&mut rows[place], told[best].clone());
                match self.index.of(rows.iter()) {
                    Some(after) if after.value > information.value => {
                        *information = after;
                        joints[place].clone_from(&tries[best]);
                    }
                    _ => rows[place] = kept,
                }
            }
            history.push(self.index.index(information));
        }
    }

    /// What postures are worth, wherever they come from; none where they do not tell all unknowns.
    pub fn worth(&self, postures: &[Vec<f64>]) -> Option<Worth> {
        let rows = self.telling.rows(postures);
        Some(self.worth_of(postures, &self.index.of(rows.iter())?))
    }

    fn worth_of(&self, postures: &[Vec<f64>], information: &Information) -> Worth {
        let covariance = information.covariance();
        let names = self.telling.names();
        let angles = self.telling.angles();
        let spread = |of_angles: bool| {
            let own = (0..names.len()).filter(|&column| angles[column] == of_angles);
            let sigma = |column: usize| self.telling.scale()[column] * covariance[(column, column)].sqrt();
            let worst = own.clone().max_by(|&one, &other| sigma(one).total_cmp(&sigma(other)))?;
            let mut all: Vec<f64> = own.map(sigma).collect();
            Some(Spread { median: median(&mut all), worst: sigma(worst), of: names[worst].clone() })
        };
        let mut positions: Vec<f64> = self
            .judged
            .iter()
            .flat_map(|own| {
                let variances = (own * covariance).component_mul(own).column_sum();
                (0..own.nrows() / 3).map(move |target| variances.rows(3 * target, 3).sum().sqrt()).collect::<Vec<_>>()
            })
            .collect();
        let middle = median(&mut positions);
        Worth {
            poses: postures.len(),
            index: self.index.index(information),
            lengths: spread(false),
            angles: spread(true),
            position: [middle, positions.last().copied().unwrap_or(f64::NAN)],
        }
    }
}

/// Postures in an order that makes the way from each to the next short: always on to the nearest, by the joint that moves
/// farthest.
pub fn in_order(mut postures: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    for place in 1..postures.len() {
        let last = postures[place - 1].clone();
        let way = |other: &Vec<f64>| other.iter().zip(&last).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let nearest = (place..postures.len()).min_by(|&a, &b| way(&postures[a]).total_cmp(&way(&postures[b])));
        postures.swap(place, nearest.unwrap_or(place));
    }
    postures
}
