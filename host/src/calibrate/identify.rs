//! Geometric identification: which unknowns the data can tell apart, and their values.

use super::align::target_unknowns;
use super::campaign::Campaign;
use super::factor::OrthogonalFactor;
use super::problem::Problem;
use super::rank::{self, Held, Observability};
use super::robust::Loss;
use super::solve::{Solution, Stopping, solve_robust};
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
    /// The observability of all unknowns that are not `held`, at the start.
    pub observability: Observability,
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
    let problem = Problem::new(campaign, unknowns, &start);
    let mut factor = OrthogonalFactor::new(problem.unknowns().len());
    problem.linearise(&start, &mut problem.scratch(), &mut factor);
    let (mut kept, held) = rank::split(&factor, problem.unknowns());
    let sigma = campaign.visits.first().map_or(1.0, |visit| visit.sigma);
    let observability = rank::observability(&factor, &kept, sigma, campaign.visits.len());
    let mut weak = Vec::new();
    if !manner.keep_weak {
        while let Some((column, sigma)) = weakest(campaign, &factor, problem.unknowns(), &kept) {
            kept.retain(|&other| other != column);
            let moves_with = rank::nearly(&factor, column, &kept, problem.unknowns());
            weak.push(Weak { unknown: problem.unknowns()[column], sigma, moves_with });
        }
    }
    let unknowns: Vec<Unknown> = kept.into_iter().map(|column| problem.unknowns()[column]).collect();
    let mut problem = Problem::new(campaign, unknowns.clone(), &start);
    let solution = solve_robust(&mut problem, start, &manner.stopping, manner.loss);
    Identification { unknowns, held, weak, observability, solution }
}

/// The kept column of the arm's own parameters whose standard deviation is furthest beyond the plausible, with that
/// standard deviation. Noise is judged by what one step would leave of the residuals.
fn weakest(
    campaign: &Campaign,
    factor: &OrthogonalFactor,
    unknowns: &[Unknown],
    kept: &[usize],
) -> Option<(usize, f64)> {
    let own = |column: usize| match unknowns[column] {
        Unknown::Parameter(place) => {
            let id = campaign.chain.parameters()[place];
            let places_base = id.transform == 1 && matches!(id.symbol, Symbol::D | Symbol::Theta);
            id.transform > 0 && !places_base
        }
        _ => false,
    };
    let part = factor.columns(kept);
    let freedom = part.rows().saturating_sub(kept.len()).max(1) as f64;
    // Residual of the campaign beyond the reach of the kept columns; noise is never less than the instrument's.
    let noise = (part.remainder().powi(2) / freedom).max(1.0).sqrt();
    let identity = nalgebra::DMatrix::identity(kept.len(), kept.len());
    let inverse = part.matrix().solve_upper_triangular(&identity)?;
    kept.iter()
        .enumerate()
        .filter(|(_, column)| own(**column))
        .map(|(row, &column)| (column, noise * inverse.row(row).norm()))
        .filter(|(_, sigma)| *sigma > PLAUSIBLE_ERROR)
        .max_by(|a, b| a.1.total_cmp(&b.1))
}
