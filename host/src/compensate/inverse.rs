//! Joints that put the flange at a given place, for the arm with everything its model knows.
//!
//! Gauss-Newton on the flange's error, seen from the flange as a twist, with damping that follows the error (Levenberg and
//! Marquardt, as Sugihara 2011 chooses it): it converges as fast as Newton where the arm moves freely, keeps its steps
//! bounded at a singular posture, and comes to rest at the nearest posture where a place cannot be reached. Residuals are
//! always those of the full model; how effects change with the joints is left out of the derivatives alone, which slows the
//! last steps and moves no solution.

use std::f64::consts::{PI, TAU};

use nalgebra::{Cholesky, Matrix6, Rotation3, Vector6};

use super::arm::Present;
use super::seeds::{even, mirrored, nearest_turn};
use crate::robot::{Frame, Joint, JointKind};

/// Nearer than this, metres and radians, and a search is over: a hundredth of what is promised.
const REACHED: f64 = 1e-11;

/// A search that can come no nearer has reached its goal within this: a tenth of what is promised.
const REACHED_AT_REST: f64 = 1e-10;

/// Steps of one search; those near singular postures, where each step halves the error, take some forty.
const MOST_STEPS: usize = 120;

/// The longest step of a joint, rad or m: beyond it the straight line that a step follows says nothing.
const LONGEST_STEP: f64 = 0.6;

/// Seeds of a search that was given none, after which a place counts as unreachable.
const MOST_SEEDS: usize = 96;

/// Seeds of a search for all branches: after each new branch as many more.
const SEEDS_PER_BRANCH: usize = 64;

/// The most branches that are listed: an arm of six joints has up to 16, a singular place has a continuum.
const MOST_BRANCHES: usize = 32;

/// Two solutions nearer than this in every joint, rad or m, are one branch.
const SAME_BRANCH: f64 = 1e-4;

/// Beyond a limit by less than this, rad or m, is at the limit: the last digits of a solution.
const AT_LIMIT: f64 = 1e-9;

/// How far a joint goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    /// Whether it turns: whole turns then lead to the same place.
    pub turns: bool,
    /// Lowest position, rad or m.
    pub min: f64,
    /// Highest position, rad or m.
    pub max: f64,
}

impl Limit {
    /// The limits of a joint; infinite where robot.toml gives none.
    pub fn of(joint: &Joint) -> Self {
        Self {
            turns: joint.kind == JointKind::Revolute,
            min: joint.min.unwrap_or(f64::NEG_INFINITY),
            max: joint.max.unwrap_or(f64::INFINITY),
        }
    }

    /// The range that seeds fill: the limits, a turn or a metre on each side where there are none.
    pub fn range(&self) -> (f64, f64) {
        let wide = if self.turns { PI } else { 1.0 };
        let low = if self.min.is_finite() { self.min } else { -wide };
        let high = if self.max.is_finite() { self.max } else { wide };
        // More than one turn reaches nothing that one turn does not.
        if self.turns && high - low > TAU { (0.5 * (low + high) - PI, 0.5 * (low + high) + PI) } else { (low, high) }
    }

    /// Whether a position is within the limits.
    pub fn holds(&self, position: f64) -> bool {
        (self.min - AT_LIMIT..=self.max + AT_LIMIT).contains(&position)
    }

    /// The position, or one a whole number of turns away, that is within the limits and nearest to `near`; none where none is.
    fn within(&self, position: f64, near: f64) -> Option<f64> {
        if !self.turns {
            return self.holds(position).then_some(position);
        }
        let nearest = nearest_turn(position, near);
        let candidates = [0.0, -1.0, 1.0, -2.0, 2.0].map(|turns| nearest + turns * TAU);
        let mut held: Vec<f64> = candidates.into_iter().filter(|&candidate| self.holds(candidate)).collect();
        held.sort_by(|a, b| (a - near).abs().total_cmp(&(b - near).abs()));
        held.first().copied()
    }
}

/// Where one search ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Attempt {
    /// The joints, rad or m.
    pub joints: Vec<f64>,
    /// How far the flange's origin is from its goal, m.
    pub distance_m: f64,
    /// By which angle the flange is turned from its goal, rad.
    pub angle_rad: f64,
    /// Steps taken, over all seeds that were tried.
    pub steps: usize,
}

impl Attempt {
    /// Whether it is a solution.
    fn arrived(&self) -> bool {
        self.distance_m <= REACHED_AT_REST && self.angle_rad <= REACHED_AT_REST
    }
}

/// Joints that reach a place to 1e-10 m and rad: a solution.
pub type Solution = Attempt;

/// Why there are no joints for a place.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InverseError {
    /// Beyond the arm's reach or its joint limits.
    #[error(
        "unreachable{}: the nearest pose found is {:.6} m and {:.6} rad away",
        if *.from_seed { " from this seed" } else { "" },
        .nearest.distance_m,
        .nearest.angle_rad
    )]
    Unreachable {
        /// The nearest pose that was found, within the limits.
        nearest: Box<Attempt>,
        /// Whether only one seed was tried, because it was asked for.
        from_seed: bool,
    },
}

/// All solutions that were found for a place.
#[derive(Debug, Clone, PartialEq)]
pub struct Branches {
    /// The solutions, in ascending order of their joints.
    pub solutions: Vec<Solution>,
    /// Whether there are more than are listed: the place is singular, and solutions make a continuum.
    pub more: bool,
}

/// The twist that leads from where the flange is to its goal, seen from the flange: metres first, then radians.
fn error(at: &Frame, goal: &Frame) -> Vector6<f64> {
    let linear = at.rotation.tr_mul(&(goal.origin - at.origin));
    let angular = Rotation3::from_matrix_unchecked(at.rotation.tr_mul(&goal.rotation)).scaled_axis_exact();
    Vector6::new(linear.x, linear.y, linear.z, angular[0], angular[1], angular[2])
}

/// The rotation vector of a rotation, exact to the last digits for small angles and near half a turn.
trait ScaledAxis {
    fn scaled_axis_exact(&self) -> [f64; 3];
}

impl ScaledAxis for Rotation3<f64> {
    fn scaled_axis_exact(&self) -> [f64; 3] {
        let m = self.matrix();
        let double_sine = nalgebra::Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]);
        let (sine, cosine) = (0.5 * double_sine.norm(), 0.5 * (m.trace() - 1.0));
        let angle = libm::atan2(sine, cosine);
        if sine > 1e-3 || cosine > 0.0 {
            // For angles below the square root of the roundoff, sine and angle are the same number.
            let factor = if sine > 1e-9 { 0.5 * angle / sine } else { 0.5 };
            return [factor * double_sine.x, factor * double_sine.y, factor * double_sine.z];
        }
        // Near half a turn the sine has lost the axis; the quaternion has it.
        let axis = nalgebra::UnitQuaternion::from_rotation_matrix(self).scaled_axis();
        [axis.x, axis.y, axis.z]
    }
}

fn distances(error: &Vector6<f64>) -> (f64, f64) {
    (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm())
}

fn reached(error: &Vector6<f64>, within: f64) -> bool {
    let (distance, angle) = distances(error);
    distance <= within && angle <= within
}

impl Present {
    /// One search from a seed. With `limited`, joints stay within their limits at every step.
    fn search(&mut self, goal: &Frame, seed: &[f64], limited: bool) -> Attempt {
        let joints = self.joint_count();
        let mut q = seed.to_vec();
        if limited {
            q.iter_mut().zip(&self.limits).for_each(|(q, limit)| *q = q.clamp(limit.min, limit.max));
        }
        let mut trial = q.clone();
        let mut step = vec![0.0; joints];
        let mut damping = 1e-2;
        let mut at = self.forward_with_twists(&q);
        let mut e = error(&at, goal);
        let mut steps = 0;
        let mut idle = 0;
        while steps < MOST_STEPS && !reached(&e, REACHED) {
            steps += 1;
            let square = 0.5 * e.norm_squared();
            let mut stuck = 0_u64;
            // A joint that is at its limit and would leave it is taken out, and the others find their step without it.
            loop {
                self.damped_step(&e, damping * square, stuck, &mut step);
                let longest = step.iter().fold(0.0_f64, |longest, step| longest.max(step.abs()));
                let shorten = if longest > LONGEST_STEP { LONGEST_STEP / longest } else { 1.0 };
                let before = stuck;
                for joint in 0..joints {
                    trial[joint] = q[joint] + shorten * step[joint];
                    if limited {
                        let limit = &self.limits[joint];
                        let leaves = (q[joint] <= limit.min && step[joint] < 0.0)
                            || (q[joint] >= limit.max && step[joint] > 0.0);
                        stuck |= u64::from(leaves) << joint;
                        trial[joint] = trial[joint].clamp(limit.min, limit.max);
                    }
                }
                if stuck == before {
                    break;
                }
            }
            // The twists are of the trial from here on; where it is no better, they are those of `q` again.
            at = self.forward_with_twists(&trial);
            let new = error(&at, goal);
            let gain = e.norm() - new.norm();
            if gain > 0.0 {
                idle = if gain < 1e-3 * e.norm() { idle + 1 } else { 0 };
                std::mem::swap(&mut q, &mut trial);
                e = new;
                damping = (0.25 * damping).max(1e-6);
            } else {
                if reached(&e, REACHED_AT_REST) {
                    break;
                }
                idle += 1;
                damping *= 10.0;
                self.forward_with_twists(&q);
            }
            // At rest: nothing that is tried changes anything any more.
            if idle >= 12 {
                break;
            }
        }
        let (distance_m, angle_rad) = distances(&e);
        Attempt { joints: q, distance_m, angle_rad, steps }
    }

    /// The damped step `Jᵀ (J Jᵀ + λ)⁻¹ e` of the joints that are not stuck. The square of J costs digits of the step, not of
    /// the solution: the next residual is exact again.
    fn damped_step(&self, e: &Vector6<f64>, damping: f64, stuck: u64, step: &mut [f64]) {
        let mut gram = Matrix6::zeros();
        for (joint, twist) in self.joint_twists.iter().enumerate() {
            if stuck >> joint & 1 == 1 {
                continue;
            }
            let ([a, b, c], [d, f, g]) = (twist.linear, twist.angular);
            let column = Vector6::new(a, b, c, d, f, g);
            gram.ger(1.0, &column, &column, 1.0);
        }
        let mut floor = 1e-14 * gram.trace();
        let solved = loop {
            let damped = gram + Matrix6::identity() * (damping + floor);
            if let Some(factor) = Cholesky::new(damped) {
                break factor.solve(e);
            }
            // Without any joint to move there is nothing to solve; with some, roundoff is outgrown in a few rounds.
            floor = if floor > 0.0 { 10.0 * floor } else { 1.0 };
        };
        for (joint, (own, twist)) in step.iter_mut().zip(&self.joint_twists).enumerate() {
            let ([a, b, c], [d, f, g]) = (twist.linear, twist.angular);
            *own = match stuck >> joint & 1 {
                1 => 0.0,
                _ => Vector6::new(a, b, c, d, f, g).dot(&solved),
            };
        }
    }

    /// The joints by whole turns within the limits and nearest to `near`; none where a joint cannot be.
    fn within_limits(&self, joints: &[f64], near: &[f64]) -> Option<Vec<f64>> {
        let held = joints.iter().zip(near).zip(&self.limits);
        held.map(|((&position, &near), limit)| limit.within(position, near)).collect()
    }

    /// One search from a seed: freely first, and where that leaves the limits, within them.
    fn attempt(&mut self, goal: &Frame, seed: &[f64]) -> (Attempt, bool) {
        let mut free = self.search(goal, seed, false);
        let arrived = free.arrived();
        if let Some(held) = self.within_limits(&free.joints, seed).filter(|_| arrived) {
            if held == free.joints {
                return (free, true);
            }
            // A whole turn leads to the same place but for effects that count turns, such as a gain or a coupling.
            let steps = free.steps;
            free = self.search(goal, &held, false);
            free.steps += steps;
            let arrived = free.arrived();
            if arrived && free.joints.iter().zip(&self.limits).all(|(joint, limit)| limit.holds(*joint)) {
                return (free, true);
            }
        }
        let steps = free.steps;
        let mut bound = self.search(goal, seed, true);
        bound.steps += steps;
        let arrived = bound.arrived();
        (bound, arrived)
    }

    /// Joints for a place of the flange (world frame), within the joint limits that robot.toml gives, by iteration from
    /// `seed`: the solution of that branch or none.
    ///
    /// # Errors
    /// A place that cannot be reached from there, with the nearest pose.
    pub fn inverse_near(&mut self, goal: &Frame, seed: &[f64]) -> Result<Solution, InverseError> {
        match self.attempt(goal, seed) {
            (solution, true) => Ok(solution),
            (nearest, false) => Err(InverseError::Unreachable { nearest: Box::new(nearest), from_seed: true }),
        }
    }

    /// Joints for a place of the flange (world frame) from seeds that fill the joints' ranges: the first solution that is
    /// found.
    ///
    /// # Errors
    /// A place that cannot be reached from any of them, with the nearest pose.
    pub fn inverse(&mut self, goal: &Frame) -> Result<Solution, InverseError> {
        let limits = self.limits.clone();
        let mut nearest: Option<Attempt> = None;
        let mut steps = 0;
        for seed in even(&limits).take(MOST_SEEDS) {
            let (mut found, arrived) = self.attempt(goal, &seed);
            steps += found.steps;
            found.steps = steps;
            if arrived {
                return Ok(found);
            }
            let error = |attempt: &Attempt| attempt.distance_m.hypot(attempt.angle_rad);
            if nearest.as_ref().is_none_or(|nearest| error(&found) < error(nearest)) {
                nearest = Some(found);
            }
        }
        // There is at least one seed, so there is a nearest.
        let nearest = nearest.unwrap_or_else(|| self.search(goal, &vec![0.0; limits.len()], true));
        Err(InverseError::Unreachable { nearest: Box::new(nearest), from_seed: false })
    }

    /// The solutions of all branches that are found from seeds that fill the joints' ranges and from mirror images of the
    /// solutions: one of each branch, within the limits. The search ends when many seeds in a row found
    /// nothing new.
    ///
    /// # Errors
    /// A place that cannot be reached, with the nearest pose.
    pub fn branches(&mut self, goal: &Frame) -> Result<Branches, InverseError> {
        let limits = self.limits.clone();
        let first = self.inverse(goal)?;
        let mut seeds = even(&limits);
        let mut images = mirrored(&first.joints, &limits);
        let mut solutions = vec![first];
        let mut left = SEEDS_PER_BRANCH;
        while solutions.len() <= MOST_BRANCHES {
            let seed = match images.pop() {
                Some(image) => image,
                None if left > 0 => {
                    left -= 1;
                    seeds.next().unwrap_or_default()
                }
                None => break,
            };
            let (found, true) = self.attempt(goal, &seed) else { continue };
            let same = |other: &Solution| {
                let pairs = found.joints.iter().zip(&other.joints).zip(&limits);
                pairs.into_iter().all(|((a, b), limit)| {
                    let b = if limit.turns { nearest_turn(*b, *a) } else { *b };
                    (a - b).abs() <= SAME_BRANCH
                })
            };
            if !solutions.iter().any(same) {
                images.extend(mirrored(&found.joints, &limits));
                solutions.push(found);
                left = SEEDS_PER_BRANCH;
            }
        }
        let more = solutions.len() > MOST_BRANCHES;
        solutions.truncate(MOST_BRANCHES);
        solutions.sort_by(|a, b| a.joints.partial_cmp(&b.joints).unwrap_or(std::cmp::Ordering::Equal));
        Ok(Branches { solutions, more })
    }
}
