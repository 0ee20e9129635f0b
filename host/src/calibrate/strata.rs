//! The least-squares problem weighed by all strata of noise, not by the instrument's alone.
//!
//! What a visit or a posture has to itself acts as an error of the joints (see `covariance`). Each such error becomes an
//! unknown with its own standard deviation as prior knowledge, and is eliminated at once by the orthogonal factor of its
//! visit, then of its posture: what remains of their rows is whitened by the whole covariance `s_t I + s_v K Kᵀ + s_p k kᵀ`,
//! and the inverse of the factor's square is the covariance of the estimate. Growth with temperature is so judged by what
//! changes at a posture, and not by what is wrong with the posture itself.

use nalgebra::DMatrix;

use super::campaign::Campaign;
use super::covariance::Noise;
use super::factor::OrthogonalFactor;
use super::problem::Problem;
use super::unknown::{State, Unknown};

/// Thermal coefficients found under all strata of noise.
#[derive(Debug, Clone, PartialEq)]
pub struct WeighedGrowth {
    /// Coefficients in the order of the campaign's growth terms; those that are no unknown stay as they were.
    pub coefficients: Vec<f64>,
    /// The covariance of those among the unknowns, in their order.
    pub covariance: DMatrix<f64>,
}

/// Finds the thermal coefficients that minimise the loss under all strata of noise, from a solution by least squares.
///
/// Only these are taken from here: what stays with a posture is as a rule not noise but something that the model does not
/// know, and geometry does best to leave the smallest errors of position. None where the search fails numerically, or
/// where no coefficient is unknown.
pub fn weighed_growth(
    campaign: &Campaign,
    unknowns: &[Unknown],
    start: &State,
    noise: &Noise,
) -> Option<WeighedGrowth> {
    let grown: Vec<usize> =
        (0..unknowns.len()).filter(|&column| matches!(unknowns[column], Unknown::Growth(_))).collect();
    if grown.is_empty() {
        return None;
    }
    let mut by_posture = campaign.clone();
    by_posture.visits.sort_by_key(|visit| visit.pose);
    let problem = Problem::new(&by_posture, unknowns.to_vec(), start);
    let mut state = start.clone();
    let mut factor = OrthogonalFactor::new(unknowns.len());
    const MOST: usize = 20;
    for _ in 0..MOST {
        linearise(&problem, &state, noise, &mut factor);
        state = state.moved(unknowns, &factor.solve());
        // In units of standard deviations: a step of a thousandth of one changes nothing that can be known.
        if factor.right_hand_side().iter().map(|value| value * value).sum::<f64>() < 1e-6 {
            let identity = DMatrix::identity(unknowns.len(), unknowns.len());
            let inverse = factor.matrix().solve_upper_triangular(&identity)?;
            let rows = inverse.select_rows(&grown);
            let covariance = &rows * rows.transpose();
            let finite = covariance.iter().all(|value| value.is_finite());
            return finite.then_some(WeighedGrowth { coefficients: state.growth, covariance });
        }
    }
    None
}

/// Pushes the whitened rows of a problem, whose visits must come posture by posture, into a cleared factor and folds it.
fn linearise(problem: &Problem<'_>, state: &State, noise: &Noise, factor: &mut OrthogonalFactor) {
    let unknowns = problem.unknowns().len();
    let joints = problem.campaign().chain.joint_count();
    let scale = if noise.point > 0.0 { 1.0 / noise.point } else { 1.0 };
    // Columns: a visit's own joint errors, its posture's, the unknowns.
    let most = joints + problem.campaign().visits.iter().map(|visit| visit.rows()).max().unwrap_or(0);
    let mut of_visit = OrthogonalFactor::with_capacity(2 * joints + unknowns, most);
    let mut of_posture = OrthogonalFactor::new(joints + unknowns);
    let mut posture = None;
    factor.clear();
    problem.each_visit_rows(state, |visit, part| {
        if posture != Some(visit.pose) {
            finish(&mut of_posture, joints, noise.posture, factor);
            posture = Some(visit.pose);
        }
        of_visit.clear();
        prior(&mut of_visit, joints, noise.visit);
        let mut rows = of_visit.push(part.residual.len());
        for row in 0..part.residual.len() {
            for joint in 0..joints {
                let entry = part.joints[(row, joint)] * scale;
                if noise.visit > 0.0 {
                    rows.set(row, joint, entry);
                }
                if noise.posture > 0.0 {
                    rows.set(row, joints + joint, entry);
                }
            }
            for column in 0..unknowns {
                rows.set(row, 2 * joints + column, part.jacobian[(row, column)] * scale);
            }
            rows.set(row, 2 * joints + unknowns, part.residual[row] * scale);
        }
        of_visit.fold();
        of_posture.push_rows_below(&of_visit, joints);
    });
    finish(&mut of_posture, joints, noise.posture, factor);
    factor.fold();
}

/// Prior knowledge of the first columns: each is zero with this standard deviation.
fn prior(factor: &mut OrthogonalFactor, joints: usize, sigma: f64) {
    if sigma > 0.0 {
        let mut rows = factor.push(joints);
        for joint in 0..joints {
            rows.set(joint, joint, 1.0 / sigma);
        }
    }
}

/// Eliminates a posture's own errors and hands its rows on.
fn finish(of_posture: &mut OrthogonalFactor, joints: usize, sigma: f64, factor: &mut OrthogonalFactor) {
    if of_posture.rows() > 0 {
        prior(of_posture, joints, sigma);
        of_posture.fold();
        factor.push_rows_below(of_posture, joints);
    }
    of_posture.clear();
}
