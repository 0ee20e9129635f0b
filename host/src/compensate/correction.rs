//! Corrections of joints, and the bounds that none may leave.
//!
//! A controller that knows the nominal arm alone sends it to joints `q` and believes that the flange stands where the nominal
//! arm's would. The correction is what has to be added to `q` so that it does: the nominal arm, its base aligned to the
//! measurements, says where, and the arm with everything that the model knows is brought there from `q`.

use super::arm::{Arm, Conditions, Present, joints_of};
use super::inverse::InverseError;
use crate::model::{CorrectionBounds, Level, Model};
use crate::robot::{Frame, JointKind};

/// Joints with their correction.
#[derive(Debug, Clone, PartialEq)]
pub struct Corrected {
    /// What to command, rad or m.
    pub joints: Vec<f64>,
    /// What was added, rad or m.
    pub correction: Vec<f64>,
    /// Whether the correction was made smaller so that it stays within its bounds.
    pub bounded: bool,
}

/// Makes corrections within the model's bounds on their size.
#[derive(Debug, Clone)]
pub struct Corrector {
    nominal: Present,
    sizes: Vec<f64>,
    rates: Vec<f64>,
}

impl Corrector {
    /// For the arm of a model.
    pub fn new(model: &Model) -> Self {
        let bounds: &CorrectionBounds = &model.correction_bounds;
        let per_joint = |turning: f64, sliding: f64| {
            let of = |kind| if kind == JointKind::Revolute { turning } else { sliding };
            joints_of(&model.robot).map(|joint| of(joint.kind)).collect()
        };
        Self {
            nominal: Arm::new(model, Level::Nominal).under(&Conditions::default()),
            sizes: per_joint(bounds.size_rad, bounds.size_m),
            rates: per_joint(bounds.rate_rad_per_s, bounds.rate_m_per_s),
        }
    }

    /// A guard of the rate for a stream of these corrections.
    pub fn guard(&self) -> Guard {
        Guard { rates: self.rates.clone(), last: None }
    }

    /// Where the controller believes that the flange stands at joints `joints`.
    pub fn believed(&mut self, joints: &[f64]) -> Frame {
        self.nominal.forward(joints)
    }

    /// The joints that bring the arm where the nominal one would stand at `joints`. A correction beyond its bound is made
    /// smaller as a whole, so that it keeps its direction.
    ///
    /// # Errors
    /// A place that the arm does not reach from there.
    pub fn correct(&mut self, arm: &mut Present, joints: &[f64]) -> Result<Corrected, InverseError> {
        let goal = self.believed(joints);
        let solution = arm.inverse_near(&goal, joints)?;
        let correction: Vec<f64> = solution.joints.iter().zip(joints).map(|(to, from)| to - from).collect();
        Ok(self.within_size(joints, correction))
    }

    /// A correction of `joints` made as small as its bound asks.
    fn within_size(&self, joints: &[f64], mut correction: Vec<f64>) -> Corrected {
        let excess = excess(&correction, &self.sizes);
        if excess > 1.0 {
            shrink(&mut correction, excess, &self.sizes);
        }
        Corrected { joints: sum(joints, &correction), correction, bounded: excess > 1.0 }
    }

    /// By which the joints of a solution differ from those of the nominal arm for the same place, where that is within the
    /// bounds; none where the nominal arm does not reach it or the difference is larger than any correction may be.
    pub fn against_nominal(&mut self, goal: &Frame, joints: &[f64]) -> Option<Vec<f64>> {
        let nominal = self.nominal.inverse_near(goal, joints).ok()?;
        let correction: Vec<f64> = joints.iter().zip(&nominal.joints).map(|(to, from)| to - from).collect();
        (excess(&correction, &self.sizes) <= 1.0).then_some(correction)
    }
}

/// How many times its bound the worst joint takes.
fn excess(change: &[f64], bounds: &[f64]) -> f64 {
    change.iter().zip(bounds).fold(0.0, |worst, (change, bound)| {
        let ratio = change.abs() / bound;
        // What is no number is beyond any bound.
        if ratio.is_nan() { f64::INFINITY } else { f64::max(worst, ratio) }
    })
}

/// Divides a change so that it meets its bounds, the last digits included.
fn shrink(change: &mut [f64], excess: f64, bounds: &[f64]) {
    for (change, bound) in change.iter_mut().zip(bounds) {
        let less = *change / excess;
        *change = if less.is_finite() { less.clamp(-bound, *bound) } else { 0.0 };
    }
}

fn sum(joints: &[f64], correction: &[f64]) -> Vec<f64> {
    joints.iter().zip(correction).map(|(joint, more)| joint + more).collect()
}

/// Bounds how fast the corrections of one arm change. Whatever leaves has gone through it: after a silence, after a sensor is
/// back, between two postures far apart.
#[derive(Debug, Clone)]
pub struct Guard {
    rates: Vec<f64>,
    last: Option<(f64, Vec<f64>)>,
}

impl Guard {
    /// Lets a correction of `joints` pass, as far as the time since the last one allows; `now_s` is a clock that never goes
    /// back. The first one passes whole.
    pub fn pass(&mut self, joints: &[f64], wanted: Corrected, now_s: f64) -> Corrected {
        let Some((before_s, before)) = &self.last else {
            self.last = Some((now_s, wanted.correction.clone()));
            return wanted;
        };
        let elapsed = (now_s - before_s).max(0.0);
        let allowed: Vec<f64> = self.rates.iter().map(|rate| rate * elapsed).collect();
        let mut change: Vec<f64> = wanted.correction.iter().zip(before).map(|(to, from)| to - from).collect();
        let still = change.iter().all(|change| *change == 0.0);
        let excess = if still { 0.0 } else { excess(&change, &allowed) };
        let corrected = match excess > 1.0 {
            false => wanted,
            true => {
                shrink(&mut change, excess, &allowed);
                let correction = sum(before, &change);
                Corrected { joints: sum(joints, &correction), correction, bounded: true }
            }
        };
        self.last = Some((now_s, corrected.correction.clone()));
        corrected
    }

    /// The last correction that passed, for joints for which there is none of their own; zero before the first.
    pub fn hold(&self, joints: &[f64]) -> Corrected {
        let correction = self.last.as_ref().map_or_else(|| vec![0.0; joints.len()], |(_, last)| last.clone());
        Corrected { joints: sum(joints, &correction), correction, bounded: true }
    }
}
