//! Corrections out of thermokin: a model as what controllers and other programs read. Every export is read back, and its
//! forward kinematics compared with the model's.
//!
//! [`Portable`] is the part of a model that can be said in a few lines of any language; each file beside it says it in one.

mod c_header;
mod dh;
mod matlab;
mod portable;
mod python;

pub use c_header::c_header;
pub use dh::{DhError, dh_table, from_dh_table};
pub use matlab::matlab;
pub use portable::{NotPortable, Portable};
pub use python::python;

use crate::robot::{Chain, Posture, Robot, Transform};

/// Postures at which an export is held against the model.
const POSTURES: usize = 64;

/// By how much the flange of these transforms is elsewhere than the robot's with these values, over many postures: the
/// largest difference of any coordinate of its place and of its axes.
pub fn apart(robot: &Robot, values: &[f64], transforms: &[Transform]) -> f64 {
    let other = Robot { transforms: transforms.to_vec(), ..robot.clone() };
    if other.joint_count() != robot.joint_count() {
        return f64::INFINITY;
    }
    let (one, other) = (robot.chain().prepare(values), Chain::new(&other).prepare(&other.nominal()));
    let difference = |number: usize| {
        let angle = |joint: usize| 2.5 * libm::sin((1 + number) as f64 * (1.0 + 0.37 * joint as f64));
        let posture = Posture::new(&(0..robot.joint_count()).map(angle).collect::<Vec<_>>());
        let (one, other) = (one.flange(&posture), other.flange(&posture));
        (one.origin - other.origin).amax().max((one.rotation - other.rotation).amax())
    };
    // What is no number is no agreement.
    (0..POSTURES).map(difference).fold(0.0, |worst, one| if one > worst || one.is_nan() { one.abs() } else { worst })
}
