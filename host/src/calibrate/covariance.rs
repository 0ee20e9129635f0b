//! How sure the identified values are, with the pose visit as the unit of noise.
//!
//! The targets of a visit are measured with the instrument's noise each, but stand on one flange: what the arm's
//! repeatability, or an error that the model does not know, does to it moves them together. Three strata of noise are
//! estimated from the residuals of a least-squares fit: of a *point* (each scalar alone), of a *visit* and of a *posture*
//! (the same at every visit of it), the latter two acting as errors of the joints. With `V = s_t I + s_v K Kᵀ + s_p k kᵀ`
//! (K a visit's derivative by the joints, k the same over all visits of a posture) the covariance of the estimate is
//! `(JᵀJ)⁻¹ Jᵀ V J (JᵀJ)⁻¹`; the components follow from three quadratic forms of the residuals whose expectations are
//! exact (Rao's MINQUE), projected at zero.

use std::collections::HashMap;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::factor::OrthogonalFactor;
use super::problem::Problem;
use super::unknown::State;

/// Standard deviations of the three strata.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Of one scalar, in units of the instrument's stated standard deviation.
    pub point: f64,
    /// Whether `point` was estimated; otherwise the instrument's word is taken.
    pub point_estimated: bool,
    /// Of each joint at each visit, radians (metres).
    pub visit: f64,
    /// Of each joint at each posture, the same at every visit of it; zero where no posture was visited twice.
    pub posture: f64,
}

/// Covariance of identified unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    /// The strata of noise.
    pub noise: Noise,
    /// The covariance of the unknowns, in their order.
    pub covariance: DMatrix<f64>,
    /// Degrees of freedom of the noise estimate.
    pub freedom: f64,
}

impl Uncertainty {
    /// Standard deviation of each unknown.
    pub fn sigmas(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect()
    }

    /// Factor on a standard deviation that gives half the width of a 95 % interval (Student's t).
    pub fn coverage_factor(&self) -> f64 {
        match StudentsT::new(0.0, 1.0, self.freedom) {
            Ok(distribution) => distribution.inverse_cdf(0.975),
            Err(_) => f64::INFINITY,
        }
    }

    /// The correlation of two unknowns.
    pub fn correlation(&self, i: usize, j: usize) -> f64 {
        self.covariance[(i, j)] / (self.covariance[(i, i)] * self.covariance[(j, j)]).sqrt()
    }
}

/// The uncertainty of geometry and growth together, where growth was found first and geometry with growth held: geometry's
/// own, and what an error of growth does to it. `problem` has the geometric unknowns first, then growth.
pub fn with_growth(
    geometry: Uncertainty,
    growth: &DMatrix<f64>,
    problem: &Problem<'_>,
    state: &State,
) -> Option<Uncertainty> {
    let (own, all) = (geometry.covariance.ncols(), problem.unknowns().len());
    let mut factor = OrthogonalFactor::new(all);
    problem.linearise(state, &mut problem.scratch(), &mut factor);
    let r = factor.matrix();
    // From R₁₁ k + R₁₂ γ = z: a change of γ moves k by -R₁₁⁻¹ R₁₂.
    let slope = -r.view((0, 0), (own, own)).solve_upper_triangular(&r.view((0, own), (own, all - own)).into_owned())?;
    let cross = &slope * growth;
    let mut covariance = DMatrix::zeros(all, all);
    covariance.view_mut((0, 0), (own, own)).copy_from(&(&geometry.covariance + &cross * slope.transpose()));
    covariance.view_mut((0, own), (own, all - own)).copy_from(&cross);
    covariance.view_mut((own, 0), (all - own, own)).copy_from(&cross.transpose());
    covariance.view_mut((own, own), (all - own, all - own)).copy_from(growth);
    Some(Uncertainty { covariance, ..geometry })
}

/// Sums over the visits of one posture.
struct PostureSums {
    visits: f64,
    /// Σ Qᵢᵀ Kᵢ, unknowns by joints.
    reach: DMatrix<f64>,
    /// Σ Kᵢᵀ Kᵢ.
    gram: DMatrix<f64>,
    /// Σ ‖Kᵢᵀ Kᵢ‖².
    own: f64,
    /// Σ Kᵢᵀ rᵢ.
    response: DVector<f64>,
    /// Σ Kᵢᵀ Kᵢ Kᵢᵀ Qᵢ, joints by unknowns.
    cross: DMatrix<f64>,
}

/// Estimates the strata of noise and the covariance of the unknowns of a problem at its solution.
pub fn uncertainty(problem: &Problem<'_>, state: &State) -> Uncertainty {
    let unknowns = problem.unknowns().len();
    let mut factor = OrthogonalFactor::new(unknowns);
    problem.linearise(state, &mut problem.scratch(), &mut factor);
    let r_inverse = factor
        .matrix()
        .solve_upper_triangular(&DMatrix::identity(unknowns, unknowns))
        .unwrap_or_else(|| DMatrix::from_element(unknowns, unknowns, f64::INFINITY));

    let (mut rows, mut visits) = (0.0, 0.0);
    // Of the part of each visit that no motion of joints explains: its dimension, its sum of squares, Q' A Q.
    let (mut alone_rows, mut alone_squares) = (0.0, 0.0);
    let mut alone = DMatrix::zeros(unknowns, unknowns);
    // Of the visits: Q' V_v Q, tr V_v V_v, tr V_v Q Q' V_v, r' V_v r.
    let mut visit_reach = DMatrix::zeros(unknowns, unknowns);
    let (mut visit_trace, mut visit_leverage, mut visit_squares) = (0.0, 0.0, 0.0);
    let mut visit_fourth = 0.0;
    let mut visit_gram_trace = 0.0;
    let mut visit_gram_leverage = 0.0;
    let mut postures: HashMap<u32, PostureSums> = HashMap::new();

    problem.each_visit_rows(state, |visit, part| {
        let m = part.residual.len();
        let q = &part.jacobian * &r_inverse;
        let k = &part.joints;
        rows += m as f64;
        visits += 1.0;
        let gram = k.tr_mul(k);
        let reach = q.tr_mul(k);
        let response = k.tr_mul(&part.residual);
        // A basis of what joint errors can do at this visit.
        let svd = k.clone().svd(true, false);
        let largest = svd.singular_values.max();
        if let Some(u) = &svd.u {
            let rank = svd.singular_values.iter().filter(|&&value| value > 1e-9 * largest).count();
            if m > rank && rank > 0 {
                let order: Vec<usize> =
                    (0..svd.singular_values.len()).filter(|&i| svd.singular_values[i] > 1e-9 * largest).collect();
                let basis = u.select_columns(&order);
                let rest = &part.residual - &basis * basis.tr_mul(&part.residual);
                alone_rows += (m - rank) as f64;
                alone_squares += rest.norm_squared();
                let q_rest = &q - &basis * basis.tr_mul(&q);
                alone += q_rest.tr_mul(&q_rest);
            }
        }
        visit_reach += &reach * reach.transpose();
        visit_trace += gram.norm_squared();
        visit_fourth += (&gram * &gram).norm_squared();
        visit_gram_trace += gram.trace();
        visit_leverage += (reach.transpose() * &reach * &gram).trace();
        visit_gram_leverage += reach.norm_squared();
        visit_squares += response.norm_squared();
        let cross = &gram * reach.transpose();
        let joints = k.ncols();
        let sums = postures.entry(visit.pose).or_insert_with(|| PostureSums {
            visits: 0.0,
            reach: DMatrix::zeros(unknowns, joints),
            gram: DMatrix::zeros(joints, joints),
            own: 0.0,
            response: DVector::zeros(joints),
            cross: DMatrix::zeros(joints, unknowns),
        });
        sums.visits += 1.0;
        sums.own += gram.norm_squared();
        sums.reach += &reach;
        sums.gram += &gram;
        sums.response += response;
        sums.cross += cross;
    });

    // The form of the postures' means, D = Σ k kᵀ / n, and the matrix of the postures' noise, V_p = Σ k kᵀ.
    let mut mean_reach = DMatrix::zeros(unknowns, unknowns);
    let mut posture_reach = DMatrix::zeros(unknowns, unknowns);
    let mut mean_squares = 0.0;
    let (mut mean_by_posture, mut mean_by_visit, mut visit_by_posture) = (0.0, 0.0, 0.0);
    let (mut lev_mean_posture, mut lev_mean_visit, mut lev_visit_posture) = (0.0, 0.0, 0.0);
    let (mut mean_trace, mut mean_gram_leverage) = (0.0, 0.0);
    let mut mean_fourth = 0.0;
    // In the order of the postures' numbers: sums must not depend on a hash.
    let mut numbers: Vec<u32> = postures.keys().copied().collect();
    numbers.sort_unstable();
    for number in &numbers {
        let sums = &postures[number];
        let n = sums.visits;
        let square = &sums.reach * sums.reach.transpose();
        mean_reach += &square / n;
        posture_reach += &square;
        mean_squares += sums.response.norm_squared() / n;
        mean_by_visit += sums.own / n;
        visit_by_posture += sums.own;
        mean_by_posture += sums.gram.norm_squared() / n;
        mean_fourth += (&sums.gram * &sums.gram).norm_squared() / (n * n);
        lev_mean_posture += (sums.reach.transpose() * &sums.reach * &sums.gram).trace() / n;
        lev_mean_visit += (&sums.cross * &sums.reach).trace() / n;
        lev_visit_posture += (&sums.cross * &sums.reach).trace();
        mean_trace += sums.gram.trace() / n;
        mean_gram_leverage += sums.reach.norm_squared() / n;
    }
    // Expectations tr(A P V P) with P = I - Q Qᵀ: tr(A V) - 2 tr(A Q Qᵀ V) + tr(QᵀAQ QᵀVQ).
    let inner = |a: &DMatrix<f64>, b: &DMatrix<f64>| a.dot(b);
    let point_estimated = alone_rows - alone.trace() > 0.5;
    let repeated = postures.values().any(|sums| sums.visits > 1.0) && numbers.len() < visits as usize;
    // Rows: the parts alone, the visits about their posture's mean, the postures' means. Columns: point, visit, posture.
    let mut expectation = Matrix3::zeros();
    let mut observed = Vector3::new(alone_squares, visit_squares - mean_squares, mean_squares);
    expectation[(0, 0)] = alone_rows - alone.trace();
    expectation[(0, 1)] = inner(&alone, &visit_reach);
    expectation[(0, 2)] = inner(&alone, &posture_reach);
    let visit_point = visit_gram_trace - visit_gram_leverage;
    let mean_point = mean_trace - mean_gram_leverage;
    let visit_visit = visit_trace - 2.0 * visit_leverage + inner(&visit_reach, &visit_reach);
    let mean_visit = mean_by_visit - 2.0 * lev_mean_visit + inner(&mean_reach, &visit_reach);
    let visit_posture = visit_by_posture - 2.0 * lev_visit_posture + inner(&visit_reach, &posture_reach);
    let mean_posture = mean_by_posture - 2.0 * lev_mean_posture + inner(&mean_reach, &posture_reach);
    expectation[(1, 0)] = visit_point - mean_point;
    expectation[(1, 1)] = visit_visit - mean_visit;
    expectation[(1, 2)] = visit_posture - mean_posture;
    expectation[(2, 0)] = mean_point;
    expectation[(2, 1)] = mean_visit;
    expectation[(2, 2)] = mean_posture;
    let mut active = [point_estimated, true, repeated];
    if !repeated {
        // Every posture stands for its one visit.
        observed[1] = visit_squares;
        for column in 0..3 {
            expectation[(1, column)] += expectation[(2, column)];
        }
    }
    let variances = components(&expectation, &observed, &mut active, point_estimated);
    let noise =
        Noise { point: variances[0].sqrt(), point_estimated, visit: variances[1].sqrt(), posture: variances[2].sqrt() };
    // Each stratum's part of the covariance, and how many independent numbers its variance was estimated from: as many as
    // a χ² of the same spread has (Satterthwaite), less what the fit has taken up. Joint 1 moves the targets by metres,
    // joint 6 by centimetres: a visit is worth fewer than its six joints.
    let part = |middle: DMatrix<f64>| &r_inverse * middle * r_inverse.transpose();
    let parts = [
        part(DMatrix::identity(unknowns, unknowns) * variances[0]),
        part(visit_reach * variances[1]),
        part(posture_reach * variances[2]),
    ];
    let worth = |trace: f64, fourth: f64, left: f64| if fourth > 0.0 { trace * left / fourth } else { 0.0 };
    let worths = [
        if point_estimated { alone_rows - alone.trace() } else { f64::INFINITY },
        worth(visit_trace, visit_fourth, visit_visit),
        worth(mean_by_posture, mean_fourth, mean_posture),
    ];
    let covariance = parts.iter().fold(DMatrix::zeros(unknowns, unknowns), |sum, part| sum + part);
    let freedom = combined_freedom(&parts, &worths, &covariance).min(rows - unknowns as f64);
    Uncertainty { noise, covariance: (&covariance + covariance.transpose()) * 0.5, freedom: freedom.max(1.0) }
}

/// Degrees of freedom of a sum of estimated variances (Welch and Satterthwaite), with the strata's mean shares in the
/// unknowns' variances.
fn combined_freedom(parts: &[DMatrix<f64>; 3], worths: &[f64; 3], covariance: &DMatrix<f64>) -> f64 {
    let variances = covariance.diagonal();
    let count = variances.iter().filter(|variance| **variance > 0.0).count() as f64;
    let spread: f64 = parts
        .iter()
        .zip(worths)
        .map(|(part, worth)| {
            let shares = part
                .diagonal()
                .iter()
                .zip(&variances)
                .map(|(own, all)| if *all > 0.0 { own / all } else { 0.0 })
                .sum::<f64>();
            let share = shares / count;
            if share > 0.0 { share * share / worth.max(1.0) } else { 0.0 }
        })
        .sum();
    1.0 / spread
}

/// Solves for the variances, dropping one that comes out negative and solving again.
fn components(
    expectation: &Matrix3<f64>,
    observed: &Vector3<f64>,
    active: &mut [bool; 3],
    point_estimated: bool,
) -> [f64; 3] {
    loop {
        let mut variances = [if point_estimated { 0.0 } else { 1.0 }, 0.0, 0.0];
        let places: Vec<usize> = (0..3).filter(|&place| active[place]).collect();
        let matrix = DMatrix::from_fn(places.len(), places.len(), |i, j| expectation[(places[i], places[j])]);
        let fixed = if point_estimated { 0.0 } else { 1.0 };
        let right = DVector::from_fn(places.len(), |i, _| observed[places[i]] - fixed * expectation[(places[i], 0)]);
        let Some(solved) = matrix.lu().solve(&right).filter(|solved| solved.iter().all(|value| value.is_finite()))
        else {
            // Nothing is left over to tell noise by: the instrument's word stands.
            return [1.0, 0.0, 0.0];
        };
        match (0..places.len()).min_by(|&a, &b| solved[a].total_cmp(&solved[b])).filter(|&worst| solved[worst] < 0.0) {
            Some(worst) => active[places[worst]] = false,
            None => {
                for (&place, &variance) in places.iter().zip(&solved) {
                    variances[place] = variance;
                }
                return variances;
            }
        }
    }
}
