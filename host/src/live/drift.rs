//! How far the tool has drifted from where it is at the reference temperatures, as a model predicts it from temperatures now.

use nalgebra::Vector3;
use serde::Serialize;

use crate::compensate::{Arm, Conditions};
use crate::model::{Level, Model};
use crate::robot::JointKind;

/// A model that is asked again and again.
#[derive(Debug, Clone)]
pub struct Predictor {
    arm: Arm,
    /// The point of the tool that is looked at, in the flange frame: the middle of the targets.
    tool: Vector3<f64>,
    /// Whether each sensor of the model can move the arm.
    needed: Vec<bool>,
}

/// The predicted drift of the tool at a posture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Drift {
    /// Along the axes of the world frame, micrometres.
    pub um: [f64; 3],
    /// Its length, micrometres.
    pub length_um: f64,
    /// Sensors that move the arm and have not been read yet: they count as at their reference.
    pub missing: Vec<String>,
}

impl Predictor {
    /// A model with all that it holds, effects included where they act on the arm. What follows temperatures late is taken
    /// as having caught up.
    pub fn new(model: &Model) -> Self {
        let targets = &model.geometry(Level::Extended).targets;
        let tool = targets.iter().sum::<Vector3<f64>>() / targets.len().max(1) as f64;
        let arm = Arm::new(model, Level::Extended);
        let needed = arm.needed_sensors();
        Self { arm, tool, needed }
    }

    /// Which joints turn; the others slide.
    pub fn turning(&self) -> Vec<bool> {
        let joints = self.arm.model().robot.transforms.iter().filter_map(|transform| transform.joint.as_ref());
        joints.map(|joint| joint.kind == JointKind::Revolute).collect()
    }

    /// What of the model is not applied, and why.
    pub fn notes(&self) -> &[String] {
        self.arm.notes()
    }

    /// Where the point of the tool is at joint positions (radians, metres), given what each sensor reads; metres.
    fn at(&self, joints: &[f64], celsius: Vec<Option<f64>>) -> Vector3<f64> {
        self.arm.under(&Conditions { celsius, ..Conditions::default() }).forward(joints).point(&self.tool)
    }

    /// The drift at joint positions (radians, metres), given what each sensor reads now; none where the number of joints is
    /// another than the arm's.
    pub fn drift(&self, joints: &[f64], celsius: impl Fn(&str) -> Option<f64>) -> Option<Drift> {
        if joints.len() != self.turning().len() {
            return None;
        }
        let sensors = self.arm.model().sensors();
        let now: Vec<Option<f64>> = sensors.iter().map(|name| celsius(name)).collect();
        let unread = |place: &usize| now[*place].is_none() && self.needed[*place];
        let missing = (0..sensors.len()).filter(unread).map(|place| sensors[place].to_owned()).collect();
        let moved = 1e6 * (self.at(joints, now) - self.at(joints, Vec::new()));
        Some(Drift { um: moved.into(), length_um: moved.norm(), missing })
    }

    /// The sensors that can move the arm.
    pub fn needed(&self) -> impl Iterator<Item = &str> {
        self.arm.model().sensors().into_iter().zip(&self.needed).filter_map(|(name, needed)| needed.then_some(name))
    }
}
