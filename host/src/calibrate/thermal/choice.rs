//! Which parameters follow which sensors, chosen from the data: physical neighbours first, held-out cycles deciding.
//!
//! Around the geometric solution everything is linear. All candidate columns (a parameter's column times a sensor's rise)
//! are summed once into products, cycle by cycle; a forward search then adds the pair that lowers the error of held-out
//! cycles most, until none lowers it by more than its own uncertainty.

use nalgebra::{DMatrix, DVector};

use crate::calibrate::campaign::Campaign;
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
    /// Mean square of the whitened residuals of held-out cycles before the first and after each term; empty where
    /// robot.toml decided.
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

struct Search {
    /// Candidates with whether they are neighbours.
    candidates: Vec<(GrowthTerm, bool)>,
    geometric: usize,
    /// Products of `[geometry | candidates | e]` over each group of cycles.
    groups: Vec<DMatrix<f64>>,
    rows: Vec<f64>,
    total: DMatrix<f64>,
}

/// Rows that wait to be multiplied into the products of their group: many at once are cheaper.
struct Batch {
    rows: DMatrix<f64>,
    filled: usize,
}

impl Batch {
    const ROWS: usize = 512;

    fn new(width: usize) -> Self {
        Self { rows: DMatrix::zeros(Self::ROWS, width), filled: 0 }
    }

    /// Adds a row to those that wait.
    fn push(&mut self, group: &mut DMatrix<f64>, entry: impl Fn(usize) -> f64) {
        if self.filled == Self::ROWS {
            self.add_to(group);
        }
        for column in 0..self.rows.ncols() {
            self.rows[(self.filled, column)] = entry(column);
        }
        self.filled += 1;
    }

    /// Takes what waits into the products.
    fn add_to(&mut self, group: &mut DMatrix<f64>) {
        let rows = self.rows.rows(0, self.filled);
        group.gemm_tr(1.0, &rows, &rows, 1.0);
        self.filled = 0;
    }
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
        let link = |sensor: usize| robot.sensor(&campaign.sensors[sensor]).map(|place| robot.sensors[place].link);
        let mut candidates = Vec::new();
        let mut sources = Vec::new();
        for (column, unknown) in unknowns.iter().enumerate() {
            let &Unknown::Parameter(parameter) = unknown else { continue };
            let ParameterId { transform, .. } = campaign.chain.parameters()[parameter];
            if transform == 0 {
                continue;
            }
            for &sensor in &rising {
                let near = link(sensor).is_some_and(|link| link + 1 == transform || link == transform);
                candidates.push((GrowthTerm { parameter, sensor }, near));
                sources.push((column, sensor));
            }
        }
        let mut cycles: Vec<u32> = campaign.visits.iter().map(|visit| visit.cycle).collect();
        cycles.sort_unstable();
        cycles.dedup();
        let count = cycles.len().clamp(1, MOST_GROUPS);
        // Neighbouring cycles are alike: a group is a stretch of cycles, so that what is held out is new.
        let group_of = |cycle: u32| cycles.binary_search(&cycle).unwrap_or(0) * count / cycles.len();
        let geometric = unknowns.len();
        let width = geometric + candidates.len() + 1;
        let mut groups = vec![DMatrix::zeros(width, width); count];
        let mut rows = vec![0.0; count];
        let plain = Campaign { growth: Vec::new(), ..campaign.clone() };
        let start = State { growth: Vec::new(), ..state.clone() };
        let problem = Problem::new(&plain, unknowns.to_vec(), &start);
        let mut waiting: Vec<Batch> = (0..count).map(|_| Batch::new(width)).collect();
        problem.each_visit_rows(&start, |visit, part| {
            let group = group_of(visit.cycle);
            let batch = &mut waiting[group];
            for row in 0..part.residual.len() {
                batch.push(&mut groups[group], |column| match column {
                    _ if column < geometric => part.jacobian[(row, column)],
                    _ if column == width - 1 => part.residual[row],
                    _ => {
                        let (source, sensor) = sources[column - geometric];
                        part.jacobian[(row, source)] * visit.rises[sensor]
                    }
                });
            }
            rows[group] += part.residual.len() as f64;
        });
        for (batch, group) in waiting.iter_mut().zip(&mut groups) {
            batch.add_to(group);
        }
        let total = groups.iter().fold(DMatrix::zeros(width, width), |sum, group| sum + group);
        Self { candidates, geometric, groups, rows, total }
    }

    fn run(&self) -> Choice {
        let mut chosen: Vec<usize> = Vec::new();
        let Some(mut errors) = self.held_out(&chosen) else {
            return Choice { terms: Vec::new(), by: ChosenBy::HeldOutCycles, held_out: Vec::new() };
        };
        let mut history = vec![mean(&errors)];
        loop {
            let step = self.best(&chosen, &errors, true, 1.0).or_else(|| self.best(&chosen, &errors, false, 2.0));
            let Some((candidate, next)) = step else { break };
            chosen.push(candidate);
            history.push(mean(&next));
            errors = next;
        }
        Choice {
            terms: chosen.iter().map(|&candidate| self.candidates[candidate].0).collect(),
            by: ChosenBy::HeldOutCycles,
            held_out: history,
        }
    }

    /// The columns of geometry and of chosen candidates.
    fn columns(&self, chosen: &[usize]) -> Vec<usize> {
        (0..self.geometric).chain(chosen.iter().map(|candidate| self.geometric + candidate)).collect()
    }

    /// Mean squared residual of each group when it is predicted from the others; none where the others do not suffice.
    fn held_out(&self, chosen: &[usize]) -> Option<Vec<f64>> {
        if self.groups.len() < 2 {
            return None;
        }
        let columns = self.columns(chosen);
        let right = self.total.ncols() - 1;
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

    /// The candidate that lowers the held-out error most, if it does by more than `sureness` standard errors.
    fn best(&self, chosen: &[usize], errors: &[f64], near: bool, sureness: f64) -> Option<(usize, Vec<f64>)> {
        let mut ranked: Vec<(usize, f64)> = self.promises(chosen, near);
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
        ranked.truncate(TRIED);
        ranked
            .into_iter()
            .filter_map(|(candidate, _)| {
                let mut more = chosen.to_vec();
                more.push(candidate);
                Some((candidate, self.held_out(&more)?))
            })
            .filter(|(_, next)| {
                let gains: Vec<f64> = errors.iter().zip(next).map(|(before, after)| before - after).collect();
                let count = gains.len() as f64;
                let gain = mean(&gains);
                let spread = gains.iter().map(|g| (g - gain).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
                gain > sureness * (spread / count).sqrt() && gain > 1e-3 * mean(errors)
            })
            .min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1)))
    }

    /// What each unused candidate would take off the sum of squares of all cycles.
    fn promises(&self, chosen: &[usize], near: bool) -> Vec<(usize, f64)> {
        let columns = self.columns(chosen);
        let right = self.total.ncols() - 1;
        let scale: Vec<f64> = columns.iter().map(|&c| 1.0 / self.total[(c, c)].max(f64::MIN_POSITIVE).sqrt()).collect();
        let normal = DMatrix::from_fn(columns.len(), columns.len(), |i, j| {
            self.total[(columns[i], columns[j])] * scale[i] * scale[j]
        });
        let Some(cholesky) = normal.cholesky() else { return Vec::new() };
        let slope = DVector::from_fn(columns.len(), |i, _| self.total[(columns[i], right)] * scale[i]);
        let solved = cholesky.solve(&slope);
        (0..self.candidates.len())
            .filter(|candidate| self.candidates[*candidate].1 == near && !chosen.contains(candidate))
            .filter_map(|candidate| {
                let column = self.geometric + candidate;
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
