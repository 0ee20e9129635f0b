//! Geometric identification: which unknowns the data can tell apart, and their values.

use nalgebra::DMatrix;

use super::align::target_unknowns;
use super::campaign::Campaign;
use super::factor::OrthogonalFactor;
use super::problem::Problem;
use super::rank::{self, Held, Observability};
use super::robust::Loss;
use super::solve::{Solution, Stopping, solve_from, solve_robust};
use super::unknown::{State, Unknown, keep_order};
use crate::robot::Symbol;

/// Everything that describes geometry: all parameters of the chain that are not fixed by name, unknown targets (with
/// their turns where orientations were measured) and unknown anchors.
pub fn geometric_unknowns(
    campaign: &Campaign,
    unknown_targets: &[usize],
    unknown_anchors: &[usize],
    fixed: &[usize],
) -> Vec<Unknown> {
    let mut unknowns: Vec<Unknown> = (0..campaign.chain.parameters().len())
        .filter(|place| !fixed.contains(place))
        .map(Unknown::Parameter)
        .chain(target_unknowns(unknown_targets))
        .collect();
    let mut turned: Vec<usize> =
        campaign.visits.iter().flat_map(|visit| visit.turns.iter().map(|turn| turn.target)).collect();
    turned.sort_unstable();
    turned.dedup();
    for target in turned {
        unknowns.extend((0..3).map(|axis| Unknown::Turn { target, axis }));
    }
    for &anchor in unknown_anchors {
        unknowns.extend((0..3).map(|axis| Unknown::Anchor { anchor, axis }));
    }
    keep_order(&campaign.chain, &mut unknowns);
    unknowns
}

/// Splits unknowns into those that a campaign can tell apart at a state and those that must be held.
pub fn identifiable(campaign: &Campaign, mut unknowns: Vec<Unknown>, state: &State) -> (Vec<Unknown>, Vec<Held>) {
    keep_order(&campaign.chain, &mut unknowns);
    let problem = Problem::new(campaign, unknowns, state);
    let mut factor = OrthogonalFactor::new(problem.unknowns().len());
    problem.linearise(state, &mut problem.scratch(), &mut factor);
    let (kept, held) = rank::split(&factor, problem.unknowns());
    (kept.into_iter().map(|column| problem.unknowns()[column]).collect(), held)
}

/// A parameter of the arm that is known no better than this, metres or radians, is not known at all: no arm is built so
/// badly, and a value from such data would serve to fit noise.
const PLAUSIBLE_ERROR: f64 = 0.01;

/// An identification: the unknowns that were found, those that were held, and the solution.
#[derive(Debug, Clone)]
pub struct Identification {
    /// The unknowns found, one a column of the solution's factor.
    pub unknowns: Vec<Unknown>,
    /// The unknowns that the data could not tell from others.
    pub held: Vec<Held>,
    /// The unknowns that the data tell so weakly that they are held as well.
    pub weak: Vec<Weak>,
    /// `R` of all unknowns that are not `held`, at the start: what observability is judged by.
    pub sensitivity: DMatrix<f64>,
    /// The state and how it was reached.
    pub solution: Solution,
}

/// An unknown that is identifiable in principle, but not from these data with their noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Weak {
    /// The unknown, held where it was.
    pub unknown: Unknown,
    /// The standard deviation that it would have had.
    pub sigma: f64,
    /// The unknowns that its effect is nearly that of, with their shares.
    pub moves_with: Vec<(Unknown, f64)>,
}

/// How an identification is made.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Manner {
    /// When to stop.
    pub stopping: Stopping,
    /// The loss of a residual.
    pub loss: Loss,
    /// Whether weakly determined parameters are estimated nevertheless.
    pub keep_weak: bool,
}

/// Identifies unknowns from a campaign: what these data cannot tell apart is held where it is, the rest is found.
pub fn identify(campaign: &Campaign, mut unknowns: Vec<Unknown>, start: State, manner: &Manner) -> Identification {
    keep_order(&campaign.chain, &mut unknowns);
    let mut problem = Problem::new(campaign, unknowns, &start);
    let mut factor = OrthogonalFactor::new(problem.unknowns().len());
    let loss = problem.linearise(&start, &mut problem.scratch(), &mut factor);
    let (kept, held) = rank::split(&factor, problem.unknowns());
    let mut unknowns = problem.unknowns().to_vec();
    if !held.is_empty() {
        factor = factor.columns(&kept);
        unknowns = kept.into_iter().map(|column| unknowns[column]).collect();
    }
    let sensitivity = factor.matrix();
    let mut weak = Vec::new();
    while let Some((column, sigma)) = (!manner.keep_weak).then(|| weakest(campaign, &factor, &unknowns)).flatten() {
        let rest: Vec<usize> = (0..unknowns.len()).filter(|&other| other != column).collect();
        let moves_with = rank::nearly(&factor, column, &rest, &unknowns);
        weak.push(Weak { unknown: unknowns.remove(column), sigma, moves_with });
        factor = factor.columns(&rest);
    }
    if unknowns.len() < problem.unknowns().len() {
        problem = Problem::new(campaign, unknowns.clone(), &start);
    }
    let first = solve_from(&problem, start, loss, factor, &manner.stopping);
    let solution = solve_robust(&mut problem, first, &manner.stopping, manner.loss);
    Identification { unknowns, held, weak, sensitivity, solution }
}

/// The unknown among the arm's own parameters whose standard deviation is furthest beyond the plausible, by its column, with
/// that standard deviation. Noise is judged by what one step would leave of the residuals.
fn weakest(campaign: &Campaign, factor: &OrthogonalFactor, unknowns: &[Unknown]) -> Option<(usize, f64)> {
    let own = |column: usize| match unknowns[column] {
        Unknown::Parameter(place) => {
            let id = campaign.chain.parameters()[place];
            let places_base = id.transform == 1 && matches!(id.symbol, Symbol::D | Symbol::Theta);
            id.transform > 0 && !places_base
        }
        _ => false,
    };
    let freedom = factor.rows().saturating_sub(unknowns.len()).max(1) as f64;
    // What is beyond the reach of the unknowns; noise is never less than the instrument's.
    let noise = (factor.remainder().powi(2) / freedom).max(1.0).sqrt();
    let deviations = factor.inverse_row_norms();
    (0..unknowns.len())
        .filter(|&column| own(column))
        .map(|column| (column, noise * deviations[column]))
        .filter(|(_, sigma)| *sigma > PLAUSIBLE_ERROR)
        .max_by(|a, b| a.1.total_cmp(&b.1))
}

impl Identification {
    /// The observability of the unknowns that are not held, weakly determined ones included.
    pub fn observability(&self, campaign: &Campaign) -> Observability {
        let sigma = campaign.visits.first().map_or(1.0, |visit| visit.sigma);
        rank::observability(&self.sensitivity, sigma, campaign.visits.len())
    }
}
