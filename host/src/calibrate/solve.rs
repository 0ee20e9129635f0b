//! Gauss-Newton as in the thesis (section 4.4.1), safeguarded by Levenberg and Marquardt's damping where a step fails.

use super::factor::OrthogonalFactor;
use super::problem::Problem;
use super::robust::{self, Loss};
use super::unknown::State;

/// When an identification stops (thesis section 5.1.2): `|ΔL| ≤ max(δ, ε|L|)` or `‖∇L‖ ≤ γ`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stopping {
    /// δ, in units of the loss (half the sum of squared whitened residuals).
    pub loss_absolute: f64,
    /// ε.
    pub loss_relative: f64,
    /// γ, on the gradient with respect to unknowns scaled to columns of norm one.
    pub gradient: f64,
    /// At most so many steps.
    pub steps: usize,
}

impl Default for Stopping {
    /// δ and ε at the rounding of a sum of squares, γ a millionth of one standard deviation.
    fn default() -> Self {
        Self { loss_absolute: 1e-9, loss_relative: 1e-12, gradient: 1e-6, steps: 100 }
    }
}

/// Why an identification stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// `|ΔL| ≤ max(δ, ε|L|)`.
    LossSettled,
    /// `‖∇L‖ ≤ γ`.
    GradientVanished,
    /// The number of steps ran out.
    StepsExhausted,
    /// No step, however damped, lowers the loss.
    NoDescent,
}

impl Stop {
    /// Whether a minimum was reached.
    pub fn converged(self) -> bool {
        matches!(self, Stop::LossSettled | Stop::GradientVanished)
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Stop::LossSettled => "converged: the loss has settled",
            Stop::GradientVanished => "converged: the gradient has vanished",
            Stop::StepsExhausted => "not converged: the number of steps ran out",
            Stop::NoDescent => "not converged: no step lowers the loss",
        }
    }
}

/// What an identification came to.
#[derive(Debug, Clone)]
pub struct Solution {
    /// The state found.
    pub state: State,
    /// The factor at the last linearisation, from which the last steps were near enough not to make it anew.
    pub factor: OrthogonalFactor,
    /// The loss at the start.
    pub initial_loss: f64,
    /// The loss before the last step, which does not change it any more.
    pub loss: f64,
    /// Steps taken.
    pub steps: usize,
    /// Steps among them that had to be damped.
    pub damped: usize,
    /// Why it stopped.
    pub stop: Stop,
}

/// The norm of the gradient `Jᵀe = Rᵀz` with every column of `J` scaled to norm one.
fn scaled_gradient(factor: &OrthogonalFactor) -> f64 {
    let unknowns = factor.unknowns();
    let mut gradient = vec![0.0; unknowns];
    let mut squares = vec![0.0; unknowns];
    for i in 0..unknowns {
        let row = factor.row(i);
        let z = row[unknowns - i];
        for (k, entry) in row[..unknowns - i].iter().enumerate() {
            gradient[i + k] += entry * z;
            squares[i + k] += entry * entry;
        }
    }
    gradient
        .iter()
        .zip(&squares)
        .map(|(slope, square)| if *square > 0.0 { slope * slope / square } else { 0.0 })
        .sum::<f64>()
        .sqrt()
}

/// Half the squared norm of `z`: what one Gauss-Newton step takes off the loss of the linearised problem.
fn decrement(factor: &OrthogonalFactor) -> f64 {
    let unknowns = factor.unknowns();
    0.5 * (0..unknowns).map(|i| factor.row(i)[unknowns - i].powi(2)).sum::<f64>()
}

/// What a step takes off the loss of the linearised problem: `½(‖z‖² - ‖z - R x‖²)`.
fn promise(factor: &OrthogonalFactor, step: &[f64]) -> f64 {
    let unknowns = factor.unknowns();
    (0..unknowns)
        .map(|i| {
            let row = factor.row(i);
            let reached: f64 = row[..unknowns - i].iter().zip(&step[i..]).map(|(entry, x)| entry * x).sum();
            reached * (row[unknowns - i] - 0.5 * reached)
        })
        .sum()
}

/// A step that keeps less than this share of its promise is refused.
const LEAST_GAIN: f64 = 1e-4;

/// Levenberg and Marquardt's damping, by the rule of Nielsen (1999).
#[derive(Debug, Clone, Copy)]
struct Damping {
    mu: f64,
    growth: f64,
}

impl Damping {
    const FIRST: Damping = Damping { mu: 1e-6, growth: 10.0 };

    fn tightened(self) -> Self {
        Self { mu: self.mu * self.growth, growth: 2.0 * self.growth }
    }

    /// The damping after a step that kept `gain` of its promise; none where Gauss-Newton can take over again.
    fn relaxed(self, gain: f64) -> Option<Self> {
        let mu = self.mu * (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0);
        (mu >= 1e-12).then_some(Self { mu, growth: 2.0 })
    }
}

/// A step that promises no more than this, half a millionth of a standard deviation squared, and does not keep it, is
/// at the minimum: with residuals of many standard deviations, rounding decides whether the loss still falls.
const NEGLIGIBLE: f64 = 5e-7;

/// A factor is kept as long as each step leaves at most this share of what the step before it promised.
const FAITHFUL: f64 = 0.01;

/// Finds the state that minimises a problem's loss, from a start. All unknowns must be identifiable.
pub fn solve(problem: &Problem<'_>, start: State, stopping: &Stopping) -> Solution {
    let mut factor = OrthogonalFactor::new(problem.unknowns().len());
    let loss = problem.linearise(&start, &mut problem.scratch(), &mut factor);
    solve_from(problem, start, loss, factor, stopping)
}

/// Finds the state that minimises a problem's loss, from a start at which the problem is linearised already.
///
/// The change of the loss by the coming step is known beforehand from the factor, so that the step after which it would
/// settle is the last, without evaluating once more to see it. A model as mildly nonlinear as an arm's hardly changes its
/// Jacobian over a step: the next step then needs the exact gradient, but no new factor. The factor is made anew when a
/// step does worse than that.
pub fn solve_from(
    problem: &Problem<'_>,
    start: State,
    loss: f64,
    factor: OrthogonalFactor,
    stopping: &Stopping,
) -> Solution {
    let initial_loss = loss;
    let (mut state, mut loss, mut factor) = (start, loss, factor);
    let mut scratch = problem.scratch();
    let mut next: Option<OrthogonalFactor> = None;
    let mut gradient = Vec::new();
    let cheap = problem.has_gradient();
    let (mut steps, mut damped) = (0, 0);
    let mut damping: Option<Damping> = None;
    let stop = loop {
        if steps == stopping.steps {
            break Stop::StepsExhausted;
        }
        let tolerance = stopping.loss_absolute.max(stopping.loss_relative * loss);
        let before = decrement(&factor);
        let settled = before <= tolerance;
        if settled || scaled_gradient(&factor) <= stopping.gradient {
            // The last step: it is taken unless it lies beyond the numbers.
            let trial = state.moved(problem.unknowns(), &factor.solve());
            if trial.geometry.parameters.iter().all(|value| value.is_finite()) {
                state = trial;
                steps += 1;
            }
            break if settled { Stop::LossSettled } else { Stop::GradientVanished };
        }
        if let (true, None) = (cheap, damping) {
            let trial = state.moved(problem.unknowns(), &factor.solve());
            let trial_loss = problem.gradient(&trial, &mut scratch, &mut gradient);
            let here = factor.right_hand_side();
            factor.set_gradient(&gradient);
            if trial_loss < loss && decrement(&factor) <= FAITHFUL * before {
                (state, loss) = (trial, trial_loss);
                steps += 1;
                continue;
            }
            factor.set_right_hand_side(&here);
        }
        let (step, promised) = match &damping {
            None => (factor.solve(), before),
            Some(damping) => {
                let step = factor.solve_damped(damping.mu);
                let promised = promise(&factor, &step);
                (step, promised)
            }
        };
        let trial = state.moved(problem.unknowns(), &step);
        let into = next.get_or_insert_with(|| OrthogonalFactor::new(problem.unknowns().len()));
        let trial_loss = problem.linearise(&trial, &mut scratch, into);
        let gain = (loss - trial_loss) / promised;
        if gain.is_finite() && gain > LEAST_GAIN {
            state = trial;
            loss = trial_loss;
            std::mem::swap(&mut factor, into);
            steps += 1;
            damped += usize::from(damping.is_some());
            damping = damping.and_then(|damping| damping.relaxed(gain));
        } else {
            let harder = damping.map_or(Damping::FIRST, Damping::tightened);
            if harder.mu > 1e12 {
                break Stop::NoDescent;
            }
            if damping.is_none() {
                // A factor from elsewhere may be to blame: the damped steps get their own.
                loss = problem.linearise(&state, &mut scratch, &mut factor);
                if decrement(&factor) <= NEGLIGIBLE {
                    state = state.moved(problem.unknowns(), &factor.solve());
                    steps += 1;
                    break Stop::LossSettled;
                }
            }
            damping = Some(harder);
        }
    };
    Solution { state, factor, initial_loss, loss, steps, damped, stop }
}

/// Finds the state that minimises a robust loss by iteratively reweighted least squares: points far from the rest count
/// less, none is deleted. `first` is the solution by least squares.
pub(super) fn solve_robust(problem: &mut Problem<'_>, first: Solution, stopping: &Stopping, loss: Loss) -> Solution {
    let mut solution = first;
    if loss == Loss::Squares {
        return solution;
    }
    let mut scale = None;
    for round in 0..stopping.steps {
        let residuals = problem.whitened(&solution.state);
        // The scale must stand still for the weights to settle.
        let spread = match scale {
            Some(spread) if round > 4 => spread,
            _ => robust::spread(problem.campaign(), &residuals),
        };
        scale = Some(spread);
        problem.set_weights(robust::weights(problem.campaign(), &residuals, spread, loss), &solution.state);
        let before = solution.state.clone();
        let next = solve(problem, solution.state, stopping);
        let steps = solution.steps + next.steps;
        solution =
            Solution { initial_loss: solution.initial_loss, steps, damped: solution.damped + next.damped, ..next };
        if round > 4 && settled(problem, &before, &solution) {
            break;
        }
    }
    solution
}

/// Whether a round of reweighting moved every unknown by less than a thousandth of its standard deviation.
fn settled(problem: &Problem<'_>, before: &State, solution: &Solution) -> bool {
    let step: Vec<f64> =
        problem.unknowns().iter().map(|&unknown| solution.state.value(unknown) - before.value(unknown)).collect();
    // ‖R Δx‖ is the move in units of standard deviations, over all directions at once.
    let norm: f64 = (0..step.len())
        .map(|i| solution.factor.row(i).iter().zip(&step[i..]).map(|(entry, x)| entry * x).sum::<f64>().powi(2))
        .sum();
    norm.sqrt() <= 1e-3
}
