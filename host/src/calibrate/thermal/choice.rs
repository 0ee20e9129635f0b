//! Which parameters follow which sensors, chosen from the data: physical neighbours first, held-out cycles deciding.
//!
//! Where postures are visited again and again, changes of the residuals from their posture's mean are looked at: what is
//! wrong with a posture itself, which no temperature causes, then drops out. Around the geometric solution everything is
//! linear, and a candidate's column is a parameter's column times a sensor's rise, which is one number a visit: with a
//! visit's products `G` of parameters and its rises `w`, the products of all candidates are `G ⊗ w wᵀ`. They are summed
//! once, group of cycles by group of cycles; a forward search then adds the pair that lowers the error of held-out cycles
//! most, until none lowers it by more than its own uncertainty.

use std::collections::HashMap;

use nalgebra::{DMatrix, DVector};

use crate::calibrate::campaign::{Campaign, ObservedVisit};
use crate::calibrate::problem::Problem;
use crate::calibrate::unknown::{GrowthTerm, State, Unknown};
use crate::robot::{ParameterId, Robot};

/// Why a term is part of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChosenBy {
    /// robot.toml names it.
    Description,
    /// It lowers the error of held-out cycles.
    HeldOutCycles,
}

/// Chosen growth terms, and what each step of the search gained.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The terms, in the order in which they were chosen.
    pub terms: Vec<GrowthTerm>,
    /// Why.
    pub by: ChosenBy,
    /// Mean square of the whitened residuals of held-out cycles before the first and after each step (terms added, then
    /// needless ones dropped); empty where robot.toml decided.
    pub held_out: Vec<f64>,
}

/// Groups of cycles that are held out in turn.
const MOST_GROUPS: usize = 8;

/// Candidates that a step tries on held-out cycles, by what they promise on all.
const TRIED: usize = 8;

/// A sensor whose rise spans less than this, kelvin, tells nothing: a sensor's counts are 1/256.
const LEAST_RISE: f64 = 0.1;

/// Chooses growth terms. `unknowns` are the geometric unknowns that were found, `state` their solution.
///
/// Where robot.toml has `[[thermal]]` tables, they decide. Otherwise parameter N may follow sensors on links N-1 and N,
/// and others only where they gain twice as surely.
pub fn choose(robot: &Robot, campaign: &Campaign, unknowns: &[Unknown], state: &State) -> Choice {
    if !robot.thermal.is_empty() {
        let terms = robot.thermal.iter().flat_map(|choice| {
            let parameter = campaign.chain.place(choice.parameter);
            choice.sensors.iter().filter_map(move |name| {
                let sensor = campaign.sensors.iter().position(|own| own == name)?;
                Some(GrowthTerm { parameter: parameter?, sensor })
            })
        });
        return Choice { terms: terms.collect(), by: ChosenBy::Description, held_out: Vec::new() };
    }
    Search::new(robot, campaign, unknowns, state).run()
}

/// What a candidate must gain on held-out cycles to be chosen.
struct Asked {
    /// Whether its sensor must be a neighbour.
    near: bool,
    /// Standard errors of the gain.
    sureness: f64,
    /// Share of the error.
    share: f64,
}

impl Asked {
    /// Whether errors on held-out cycles fall by what is asked for.
    fn is_met(&self, before: &[f64], after: &[f64]) -> bool {
        let gains: Vec<f64> = before.iter().zip(after).map(|(before, after)| before - after).collect();
        let count = gains.len() as f64;
        let gain = mean(&gains);
        let spread = gains.iter().map(|one| (one - gain).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
        gain > self.sureness * (spread / count).sqrt() && gain > self.share * mean(before)
    }
}

const NEAR: Asked = Asked { near: true, sureness: 1.0, share: 0.005 };
/// A sensor that is no neighbour is physically implausible: it must gain twice as surely, and what can be seen.
const FAR: Asked = Asked { near: false, sureness: 2.0, share: 0.05 };

struct Search {
    /// Pairs that may be chosen.
    candidates: Vec<Candidate>,
    /// Columns of the geometric unknowns among the products.
    geometric: Vec<usize>,
    /// The column of the residual.
    right: usize,
    /// Products of all columns over each group of cycles.
    groups: Vec<DMatrix<f64>>,
    rows: Vec<f64>,
    total: DMatrix<f64>,
}

/// Means over all visits of a posture: of each target's residual, and of each sensor's rise.
///
/// Only what changes at a posture tells growth from errors of the posture. The mean of all its visits is subtracted, not
/// what was seen in the reference cycle: noise of that one cycle would be in every other's change, held out or not, and
/// look like growth.
struct Means {
    residuals: HashMap<(u32, usize), [f64; 3]>,
    rises: HashMap<u32, Vec<f64>>,
}

/// A sum and the number of its parts.
struct Sum<T> {
    sum: T,
    count: f64,
}

impl Means {
    /// None where fewer than half of the positions were measured at a posture and target that was measured again.
    fn new(problem: &Problem<'_>, state: &State) -> Option<Self> {
        let mut residuals: HashMap<(u32, usize), Sum<[f64; 3]>> = HashMap::new();
        let mut rises: HashMap<u32, Sum<Vec<f64>>> = HashMap::new();
        problem.each_visit_rows(state, |visit, part| {
            let own = rises.entry(visit.pose).or_insert_with(|| Sum { sum: vec![0.0; visit.rises.len()], count: 0.0 });
            own.count += 1.0;
            own.sum.iter_mut().zip(&visit.rises).for_each(|(sum, rise)| *sum += rise);
            for (place, position) in visit.positions.iter().enumerate() {
                let own = residuals.entry((visit.pose, position.target)).or_insert(Sum { sum: [0.0; 3], count: 0.0 });
                own.count += 1.0;
                for (axis, sum) in own.sum.iter_mut().enumerate() {
                    *sum += part.residual[3 * place + axis];
                }
            }
        });
        let all: f64 = residuals.values().map(|own| own.count).sum();
        residuals.retain(|_, own| own.count > 1.0);
        let again: f64 = residuals.values().map(|own| own.count).sum();
        (again > 0.0 && 2.0 * again >= all).then(|| Self {
            residuals: residuals.into_iter().map(|(key, own)| (key, own.sum.map(|sum| sum / own.count))).collect(),
            rises: rises
                .into_iter()
                .map(|(pose, own)| (pose, own.sum.into_iter().map(|sum| sum / own.count).collect()))
                .collect(),
        })
    }

    /// Turns a visit's residuals into changes from its posture's mean; rows without a counterpart become zero. Returns
    /// the number of those that have one.
    fn subtract(&self, visit: &ObservedVisit, rows: &mut DMatrix<f64>) -> usize {
        let last = rows.ncols() - 1;
        let mut changed = 0;
        for place in 0..rows.nrows().div_ceil(3) {
            let mean =
                visit.positions.get(place).and_then(|position| self.residuals.get(&(visit.pose, position.target)));
            for axis in 0..3.min(rows.nrows() - 3 * place) {
                match mean {
                    Some(mean) => {
                        rows[(3 * place + axis, last)] -= mean[axis];
                        changed += 1;
                    }
                    None => rows.row_mut(3 * place + axis).fill(0.0),
                }
            }
        }
        changed
    }
}

/// A pair that may be chosen.
struct Candidate {
    term: GrowthTerm,
    /// Whether the sensor sits on a link that the parameter belongs to.
    near: bool,
    /// Its column among the products.
    column: usize,
}

impl Search {
    fn new(robot: &Robot, campaign: &Campaign, unknowns: &[Unknown], state: &State) -> Self {
        let rising: Vec<usize> = (0..campaign.sensors.len())
            .filter(|&sensor| {
                let rises = campaign.visits.iter().map(|visit| visit.rises[sensor]);
                let (low, high) = rises.fold((0.0_f64, 0.0_f64), |(low, high), rise| (low.min(rise), high.max(rise)));
                high - low > LEAST_RISE
            })
            .collect();
        // Columns: unknown by unknown, the residual last; for each the plain column first, then times each rise.
        let block = 1 + rising.len();
        let plain_columns = unknowns.len() + 1;
        let link = |sensor: usize| robot.sensor(&campaign.sensors[sensor]).map(|place| robot.sensors[place].link);
        let mut candidates = Vec::new();
        for (place, unknown) in unknowns.iter().enumerate() {
            let &Unknown::Parameter(parameter) = unknown else { continue };
            let ParameterId { transform, .. } = campaign.chain.parameters()[parameter];
            if transform == 0 {
                continue;
            }
            for (rank, &sensor) in rising.iter().enumerate() {
                let near = link(sensor).is_some_and(|link| link + 1 == transform || link == transform);
                let term = GrowthTerm { parameter, sensor };
                candidates.push(Candidate { term, near, column: place * block + 1 + rank });
            }
        }
        let mut cycles: Vec<u32> = campaign.visits.iter().map(|visit| visit.cycle).collect();
        cycles.sort_unstable();
        cycles.dedup();
        let count = cycles.len().clamp(1, MOST_GROUPS);
        // Neighbouring cycles are alike: a group is a stretch of cycles, so that what is held out is new.
        let group_of = |cycle: u32| cycles.binary_search(&cycle).unwrap_or(0) * count / cycles.len();
        let width = plain_columns * block;
        let mut groups = vec![DMatrix::zeros(width, width); count];
        let mut rows = vec![0.0; count];
        let plain = Campaign { growth: Vec::new(), ..campaign.clone() };
        let start = State { growth: Vec::new(), ..state.clone() };
        let problem = Problem::new(&plain, unknowns.to_vec(), &start);
        let means = Means::new(&problem, &start);
        let mut weights = vec![1.0; block];
        problem.each_visit_rows(&start, |visit, part| {
            let group = group_of(visit.cycle);
            let mut visit_rows = part.jacobian.insert_column(unknowns.len(), 0.0);
            visit_rows.set_column(unknowns.len(), &part.residual);
            for (weight, &sensor) in weights[1..].iter_mut().zip(&rising) {
                let mean = means.as_ref().map_or(0.0, |means| means.rises[&visit.pose][sensor]);
                *weight = visit.rises[sensor] - mean;
            }
            rows[group] += match &means {
                None => part.residual.len() as f64,
                Some(means) => means.subtract(visit, &mut visit_rows) as f64,
            };
            let products = visit_rows.tr_mul(&visit_rows);
            let sums = groups[group].as_mut_slice();
            // The upper half of the blocks is enough; it is mirrored below.
            for j in 0..plain_columns {
                for i in 0..=j {
                    let product = products[(i, j)];
                    for (t, weight) in weights.iter().enumerate() {
                        let start = (j * block + t) * width + i * block;
                        for (sum, other) in sums[start..start + block].iter_mut().zip(&weights) {
                            *sum += product * weight * other;
                        }
                    }
                }
            }
        });
        for group in &mut groups {
            group.fill_lower_triangle_with_upper_triangle();
        }
        let total = groups.iter().fold(DMatrix::zeros(width, width), |sum, group| sum + group);
        // Changes from a posture's mean have no part that geometry could explain.
        let geometric = match &means {
            Some(_) => Vec::new(),
            None => (0..unknowns.len()).map(|place| place * block).collect(),
        };
        Self { candidates, geometric, right: unknowns.len() * block, groups, rows, total }
    }

    fn run(&self) -> Choice {
        let mut chosen: Vec<usize> = Vec::new();
        let Some(mut errors) = self.held_out(&chosen) else {
            return Choice { terms: Vec::new(), by: ChosenBy::HeldOutCycles, held_out: Vec::new() };
        };
        let mut history = vec![mean(&errors)];
        loop {
            let step = self.best(&chosen, &errors, &NEAR).or_else(|| self.best(&chosen, &errors, &FAR));
            let Some((candidate, next)) = step else { break };
            chosen.push(candidate);
            history.push(mean(&next));
            errors = next;
        }
        // What was chosen early may be needless by what came later.
        while let Some((place, next)) = self.needless(&chosen, &errors) {
            chosen.remove(place);
            history.push(mean(&next));
            errors = next;
        }
        Choice {
            terms: chosen.iter().map(|&candidate| self.candidates[candidate].term).collect(),
            by: ChosenBy::HeldOutCycles,
            held_out: history,
        }
    }

    /// The columns of geometry and of chosen candidates.
    fn columns(&self, chosen: &[usize]) -> Vec<usize> {
        self.geometric
            .iter()
            .copied()
            .chain(chosen.iter().map(|&candidate| self.candidates[candidate].column))
            .collect()
    }

    /// Mean squared residual of each group when it is predicted from the others; none where the others do not suffice.
    fn held_out(&self, chosen: &[usize]) -> Option<Vec<f64>> {
        if self.groups.len() < 2 || self.rows.contains(&0.0) {
            return None;
        }
        let columns = self.columns(chosen);
        let right = self.right;
        self.groups
            .iter()
            .zip(&self.rows)
            .map(|(group, rows)| {
                let product = |i: usize, j: usize| self.total[(i, j)] - group[(i, j)];
                // Scaled to a unit diagonal: parameters and coefficients differ by powers of ten.
                let scale: Vec<f64> =
                    columns.iter().map(|&c| 1.0 / product(c, c).max(f64::MIN_POSITIVE).sqrt()).collect();
                let normal = DMatrix::from_fn(columns.len(), columns.len(), |i, j| {
                    product(columns[i], columns[j]) * scale[i] * scale[j]
                });
                let slope = DVector::from_fn(columns.len(), |i, _| product(columns[i], right) * scale[i]);
                let solved = normal.cholesky()?.solve(&slope);
                let x: Vec<f64> = solved.iter().zip(&scale).map(|(value, scale)| value * scale).collect();
                let mut square = group[(right, right)];
                for (i, &column) in columns.iter().enumerate() {
                    let row: f64 = columns.iter().zip(&x).map(|(&other, x)| group[(column, other)] * x).sum();
                    square += x[i] * (row - 2.0 * group[(column, right)]);
                }
                Some(square / rows)
            })
            .collect()
    }

    /// The candidate that lowers the held-out error most, if it gains as much as is asked for.
    fn best(&self, chosen: &[usize], errors: &[f64], asked: &Asked) -> Option<(usize, Vec<f64>)> {
        let mut ranked: Vec<(usize, f64)> = self.promises(chosen, asked.near);
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
        ranked.truncate(TRIED);
        ranked
            .into_iter()
            .filter_map(|(candidate, _)| {
                let mut more = chosen.to_vec();
                more.push(candidate);
                Some((candidate, self.held_out(&more)?))
            })
            .filter(|(_, next)| asked.is_met(errors, next))
            .min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1)))
    }

    /// The chosen candidate that is missed least, if less surely than it would have to gain to be chosen.
    fn needless(&self, chosen: &[usize], errors: &[f64]) -> Option<(usize, Vec<f64>)> {
        (0..chosen.len())
            .filter_map(|place| {
                let mut fewer = chosen.to_vec();
                let dropped = fewer.remove(place);
                let without = self.held_out(&fewer)?;
                let asked = if self.candidates[dropped].near { &NEAR } else { &FAR };
                (!asked.is_met(&without, errors)).then_some((place, without))
            })
            .min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1)))
    }

    /// What each unused candidate would take off the sum of squares of all cycles.
    fn promises(&self, chosen: &[usize], near: bool) -> Vec<(usize, f64)> {
        let columns = self.columns(chosen);
        let right = self.right;
        let scale: Vec<f64> = columns.iter().map(|&c| 1.0 / self.total[(c, c)].max(f64::MIN_POSITIVE).sqrt()).collect();
        let normal = DMatrix::from_fn(columns.len(), columns.len(), |i, j| {
            self.total[(columns[i], columns[j])] * scale[i] * scale[j]
        });
        let Some(cholesky) = normal.cholesky() else { return Vec::new() };
        let slope = DVector::from_fn(columns.len(), |i, _| self.total[(columns[i], right)] * scale[i]);
        let solved = cholesky.solve(&slope);
        (0..self.candidates.len())
            .filter(|candidate| self.candidates[*candidate].near == near && !chosen.contains(candidate))
            .filter_map(|candidate| {
                let column = self.candidates[candidate].column;
                let cross = DVector::from_fn(columns.len(), |i, _| self.total[(columns[i], column)] * scale[i]);
                let own = self.total[(column, column)] - cross.dot(&cholesky.solve(&cross));
                let response = self.total[(column, right)] - cross.dot(&solved);
                (own > 1e-9 * self.total[(column, column)]).then(|| (candidate, response * response / own))
            })
            .collect()
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
