//! The torque of gravity about each joint.

use nalgebra::Vector3;

use super::chain::{Posture, Prepared};
use super::description::{JointKind, Robot};
use super::frame::Frame;

/// A mass carried by the flange.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Payload {
    /// Kilograms.
    pub mass_kg: f64,
    /// Its centre in the flange frame, metres.
    pub center: Vector3<f64>,
}

/// The generalised force of gravity at each joint: positive where gravity pushes the joint's position up. N·m for
/// revolute joints, N for prismatic ones.
///
/// It is the derivative of the work of gravity with respect to the joint: `z · (r - o) × m g` summed over the masses that
/// the joint moves, for a revolute joint with axis `z` through `o`.
pub fn gravity_torques(robot: &Robot, chain: &Prepared, posture: &Posture, payload: Option<Payload>) -> Vec<f64> {
    let frames = chain.frames(posture);
    let masses: Vec<(usize, f64, Vector3<f64>)> = robot
        .bodies
        .iter()
        .map(|body| (body.transform, body.mass_kg, frames[body.transform].point(&body.center)))
        .chain(payload.map(|load| (frames.len() - 1, load.mass_kg, frames[frames.len() - 1].point(&load.center))))
        .collect();
    let base = Frame::identity();
    robot
        .transforms
        .iter()
        .enumerate()
        .filter_map(|(number, transform)| transform.joint.as_ref().map(|joint| (number, joint.kind)))
        .map(|(number, kind)| {
            let before = if number == 0 { &base } else { &frames[number - 1] };
            let axis = before.rotation.column(2).into_owned();
            masses
                .iter()
                .filter(|(transform, ..)| *transform >= number)
                .map(|(_, mass, center)| {
                    let weight = robot.gravity * *mass;
                    match kind {
                        JointKind::Revolute => axis.dot(&(center - before.origin).cross(&weight)),
                        JointKind::Prismatic => axis.dot(&weight),
                    }
                })
                .sum()
        })
        .collect()
}
