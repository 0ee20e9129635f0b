//! The thesis's comparison of methods (sections 5.1.2 and 5.2.2): steepest descent, Newton-Raphson with the exact Hessian,
//! Gauss-Newton and Levenberg-Marquardt, from the same start to the same loss.

use std::time::{Duration, Instant};

use nalgebra::{DMatrix, DVector};

use super::factor::OrthogonalFactor;
use super::problem::{Problem, Scratch};
use super::solve::{Stopping, solve};
use super::unknown::State;

/// A method of minimisation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Along the gradient of unknowns scaled to columns of norm one, by the step that minimises the linearised problem.
    SteepestDescent,
    /// With the exact Hessian; where it is not positive definite, it is damped until it is.
    NewtonRaphson,
    /// With the Hessian of the linearised problem.
    GaussNewton,
    /// The same, damped from the first step.
    LevenbergMarquardt,
}

impl Method {
    /// All methods in the thesis's order.
    pub const ALL: [Method; 4] =
        [Method::SteepestDescent, Method::NewtonRaphson, Method::GaussNewton, Method::LevenbergMarquardt];

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Method::SteepestDescent => "steepest descent",
            Method::NewtonRaphson => "Newton-Raphson",
            Method::GaussNewton => "Gauss-Newton",
            Method::LevenbergMarquardt => "Levenberg-Marquardt",
        }
    }
}

/// How a method fared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trial {
    /// The method.
    pub method: Method,
    /// Steps taken.
    pub steps: usize,
    /// Time taken.
    pub time: Duration,
    /// The loss reached.
    pub loss: f64,
    /// Whether that is the loss of the minimum, to a millionth.
    pub reached: bool,
}

/// The loss counts as reached within this share of the minimum's.
const SAME_LOSS: f64 = 1e-6;

/// Runs every method from a start until it has the loss of the minimum, or for `most` steps.
pub fn compare(problem: &Problem<'_>, start: &State, most: usize) -> Vec<Trial> {
    let minimum = solve(problem, start.clone(), &Stopping::default()).loss;
    let goal = minimum * (1.0 + SAME_LOSS);
    Method::ALL.iter().map(|&method| trial(problem, start, method, goal, most)).collect()
}

/// The linearised problem at a state.
struct Linear {
    loss: f64,
    factor: OrthogonalFactor,
    scratch: Scratch,
}

impl Linear {
    fn at(&mut self, problem: &Problem<'_>, state: &State) {
        self.loss = problem.linearise(state, &mut self.scratch, &mut self.factor);
    }

    /// `Jᵀe`, downhill.
    fn downhill(&self) -> DVector<f64> {
        let r = self.factor.matrix();
        r.tr_mul(&DVector::from_vec(self.factor.right_hand_side()))
    }
}

fn trial(problem: &Problem<'_>, start: &State, method: Method, goal: f64, most: usize) -> Trial {
    let begun = Instant::now();
    let unknowns = problem.unknowns().len();
    let mut now = Linear { loss: 0.0, factor: OrthogonalFactor::new(unknowns), scratch: problem.scratch() };
    let mut state = start.clone();
    now.at(problem, &state);
    let mut mu = match method {
        Method::LevenbergMarquardt => 1e-3,
        _ => 0.0,
    };
    let mut steps = 0;
    while now.loss > goal && steps < most {
        let step: Vec<f64> = match method {
            Method::GaussNewton => now.factor.solve(),
            Method::LevenbergMarquardt => now.factor.solve_damped(mu),
            Method::SteepestDescent => descent(&now),
            Method::NewtonRaphson => newton(problem, &state, &now),
        };
        // Every method must descend: a step that does not is halved, or damped where the method has a damping.
        let mut share = 1.0;
        let next = loop {
            let scaled: Vec<f64> = step.iter().map(|value| value * share).collect();
            let next = state.moved(problem.unknowns(), &scaled);
            if problem.loss(&next) < now.loss || share < 1e-9 {
                break next;
            }
            share *= 0.5;
        };
        steps += 1;
        mu = if share < 1.0 { mu * 10.0 } else { mu * 0.1 };
        let before = now.loss;
        state = next;
        now.at(problem, &state);
        if now.loss >= before {
            break;
        }
    }
    Trial { method, steps, time: begun.elapsed(), loss: now.loss, reached: now.loss <= goal }
}

/// The step along the scaled gradient that minimises the linearised problem.
fn descent(now: &Linear) -> Vec<f64> {
    let r = now.factor.matrix();
    let norms = now.factor.column_norms();
    // In unknowns y = D x the gradient is D⁻¹ Jᵀe; the step in x is D⁻¹ of that again.
    let downhill = now.downhill();
    let direction = DVector::from_fn(norms.len(), |i, _| downhill[i] / (norms[i] * norms[i]));
    let along = &r * &direction;
    let length = direction.dot(&downhill) / along.norm_squared();
    (direction * length).as_slice().to_vec()
}

/// The step of Newton and Raphson.
fn newton(problem: &Problem<'_>, state: &State, now: &Linear) -> Vec<f64> {
    let r = now.factor.matrix();
    let norms = now.factor.column_norms();
    let hessian = r.tr_mul(&r) + problem.curvature(state);
    let scaled = DMatrix::from_fn(norms.len(), norms.len(), |i, j| hessian[(i, j)] / (norms[i] * norms[j]));
    let downhill = now.downhill();
    let slope = DVector::from_fn(norms.len(), |i, _| downhill[i] / norms[i]);
    let mut damping = 0.0;
    loop {
        let damped = &scaled + DMatrix::identity(norms.len(), norms.len()) * damping;
        if let Some(cholesky) = damped.cholesky() {
            let step = cholesky.solve(&slope);
            return step.iter().zip(&norms).map(|(value, norm)| value / norm).collect();
        }
        damping = if damping == 0.0 { 1e-6 } else { damping * 10.0 };
    }
}
