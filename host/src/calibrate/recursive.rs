//! Identification as poses come in: a square-root information filter that ends where the batch ends.
//!
//! Each visit is folded into the orthogonal factor at a point of linearisation, in a time that does not depend on how many
//! came before. When the estimate has moved so far from that point that the neglected second order could show, the
//! visits are swept once more from the estimate; [`Recursive::settle`] sweeps until nothing moves, which is the batch.

use super::campaign::{Campaign, ObservedVisit};
use super::factor::OrthogonalFactor;
use super::problem::Problem;
use super::rank;
use super::unknown::{State, Unknown};

/// How far, metres or radians, an estimate may move before the visits are swept again: over an arm of 3 m the second
/// order of such a step is 0.3 µm.
const REACH: f64 = 3e-4;

/// Poses folded in one by one.
#[derive(Debug, Clone)]
pub struct Recursive {
    campaign: Campaign,
    unknowns: Vec<Unknown>,
    /// Where the factor is linearised.
    point: State,
    factor: OrthogonalFactor,
}

impl Recursive {
    /// Begins with no visits. `campaign` gives the arm, the names and the growth terms; its visits are not used.
    pub fn new(campaign: &Campaign, unknowns: Vec<Unknown>, start: State) -> Self {
        let factor = OrthogonalFactor::new(unknowns.len());
        Self { campaign: campaign.select(|_| false), unknowns, point: start, factor }
    }

    /// The visits folded in.
    pub fn visits(&self) -> usize {
        self.campaign.visits.len()
    }

    /// Folds in one visit.
    pub fn push(&mut self, visit: ObservedVisit) {
        let alone = Campaign { visits: vec![visit], ..self.campaign.select(|_| false) };
        let problem = Problem::new(&alone, self.unknowns.clone(), &self.point);
        let mut own = OrthogonalFactor::new(self.unknowns.len());
        problem.linearise(&self.point, &mut problem.scratch(), &mut own);
        self.factor.merge(&own);
        self.campaign.visits.extend(alone.visits);
        if self.step().is_some_and(|step| step.iter().any(|part| part.abs() > REACH)) {
            self.sweep();
        }
    }

    /// The step from the point of linearisation to the estimate; none while the visits do not determine all unknowns.
    fn step(&self) -> Option<Vec<f64>> {
        let (kept, _) = rank::split(&self.factor, &self.unknowns);
        (kept.len() == self.unknowns.len()).then(|| self.factor.solve())
    }

    /// The present estimate; none while the visits do not determine all unknowns.
    pub fn estimate(&self) -> Option<State> {
        Some(self.point.moved(&self.unknowns, &self.step()?))
    }

    /// The square-root information of the unknowns: `RᵀR` is the inverse of their covariance under the instrument's noise.
    pub fn information(&self) -> &OrthogonalFactor {
        &self.factor
    }

    /// Linearises all visits at the estimate. Returns the largest step, metres or radians.
    fn sweep(&mut self) -> f64 {
        let Some(step) = self.step() else { return 0.0 };
        self.point = self.point.moved(&self.unknowns, &step);
        let problem = Problem::new(&self.campaign, self.unknowns.clone(), &self.point);
        problem.linearise(&self.point, &mut problem.scratch(), &mut self.factor);
        step.iter().fold(0.0, |most, part| part.abs().max(most))
    }

    /// Sweeps until nothing moves by more than rounding, and gives the estimate: the batch result.
    pub fn settle(&mut self) -> Option<State> {
        const MOST: usize = 50;
        for _ in 0..MOST {
            if self.sweep() < 1e-12 {
                break;
            }
        }
        self.estimate()
    }
}
