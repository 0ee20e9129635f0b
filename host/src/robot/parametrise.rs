//! From where a chain's axes lie to the parameters of its transforms: a complete, minimal and proportional description by the
//! thesis's rules (section 3.3.1): Denavit-Hartenberg between axes that are not nearly parallel, Hayati-Mirmirani where they
//! are, all six parameters at the end.

use nalgebra::{Matrix3, Vector3};

use super::convention::{Convention, Symbol};
use super::description::{Joint, Transform};
use super::frame::Frame;

/// Two axes closer to parallel than this, as the sine of their angle, have no common normal worth the name: it moves by 20
/// times any error of alignment.
pub(super) const NEARLY_PARALLEL: f64 = 0.05;

/// Which conventions a description may use between axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Between {
    /// Hayati-Mirmirani between nearly parallel axes, Denavit-Hartenberg elsewhere.
    Proportional,
    /// Denavit-Hartenberg everywhere, for whoever knows nothing else.
    DhAlone,
}

/// Why axes have no Denavit-Hartenberg parameters that are worth anything.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "the axes of joints {joint} and {} are {:.4}° from parallel: their common normal is not defined, and d of joint {joint} would \
     be {d_m:.3} m; 'hayati' parameters suit this pair",
    .joint + 1,
    .angle_rad.to_degrees()
)]
pub struct NearlyParallel {
    /// The first joint of the pair, counted from 1.
    pub joint: usize,
    /// The angle between the axes, rad.
    pub angle_rad: f64,
    /// What the common normal would make of d, m.
    pub d_m: f64,
}

/// Where a chain's axes lie with all joints at zero, seen from the world.
#[derive(Debug, Clone, PartialEq)]
pub struct Axes {
    /// A frame a joint, with z along the joint's axis (its motion's direction for a sliding one), in the chain's order.
    pub joints: Vec<(Frame, Joint)>,
    /// What the chain ends at.
    pub flange: Frame,
}

/// The transforms of a chain, from where its axes lie. A transform keeps to the next axis and places x by its convention; with
/// Denavit-Hartenberg alone the first one has all six parameters.
///
/// # Errors
/// A nearly parallel pair where only Denavit-Hartenberg is allowed.
pub fn parametrise(axes: &Axes, between: Between) -> Result<Vec<Transform>, NearlyParallel> {
    let Axes { joints: axes, flange } = axes;
    let Some((first, _)) = axes.first() else { return Ok(vec![full(flange, None)]) };
    // What moves from one axis to the next; nothing does before the first.
    let joints = axes.iter().map(|(_, joint)| Some(joint.clone()));
    let (mut at, mut transforms, skipped) = match between {
        Between::Proportional => (Frame::identity(), Vec::new(), 0),
        Between::DhAlone => (*first, vec![full(first, None)], 1),
    };
    let links = std::iter::once(None).chain(joints).zip(axes).enumerate().skip(skipped);
    for (number, (joint, (frame, _))) in links {
        let next = at.inverse().then(frame);
        let (point, axis) = (next.origin, next.rotation.column(2).into_owned());
        let sine = libm::hypot(axis.x, axis.y);
        let transform = if sine >= NEARLY_PARALLEL {
            dh(&point, &axis, joint)
        } else if between == Between::Proportional {
            hayati(&point, &axis, joint)
        } else {
            let d_m = if sine > 0.0 { dh(&point, &axis, None).value(Symbol::D) } else { f64::INFINITY };
            return Err(NearlyParallel { joint: number, angle_rad: libm::asin(sine.min(1.0)), d_m });
        };
        at = at.then(&frame_of(&transform));
        transforms.push(transform);
    }
    let last = axes.last().map(|(_, joint)| joint.clone());
    transforms.push(full(&at.inverse().then(flange), last));
    Ok(transforms)
}

/// The frame that a transform leads to with its joint at zero.
pub fn frame_of(transform: &Transform) -> Frame {
    let of = |symbol| transform.value(symbol);
    let turned = |rotation| Frame { rotation, origin: Vector3::zeros() };
    let moved = |x, y, z| Frame { rotation: Matrix3::identity(), origin: Vector3::new(x, y, z) };
    moved(0.0, 0.0, of(Symbol::D))
        .then(&turned(about_z(of(Symbol::Theta))))
        .then(&moved(of(Symbol::A), 0.0, 0.0))
        .then(&turned(about_x(of(Symbol::Alpha))))
        .then(&moved(0.0, of(Symbol::B), 0.0))
        .then(&turned(about_y(of(Symbol::Beta))))
}

fn about_z(angle: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle);
    Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}

fn about_x(angle: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle);
    Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c)
}

fn about_y(angle: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle);
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

/// `Tz(d) Rz(theta) Tx(a) Rx(alpha)` to a line through `point` along `axis`: x is the common normal, of the two directions the
/// one that keeps theta within a quarter turn.
fn dh(point: &Vector3<f64>, axis: &Vector3<f64>, joint: Option<Joint>) -> Transform {
    let mut normal = Vector3::z().cross(axis).normalize();
    // Half a roundoff short of a quarter turn belongs to the positive side, as it would without roundoff.
    if normal.x < -1e-12 || (normal.x.abs() <= 1e-12 && normal.y < 0.0) {
        normal = -normal;
    }
    let theta = libm::atan2(normal.y, normal.x);
    let alpha = libm::atan2(Vector3::z().cross(axis).dot(&normal), axis.z);
    let a = normal.dot(point);
    // Where the line comes nearest to z: the point of it that lies along the normal.
    let across = normal.cross(&Vector3::z());
    let along = -across.dot(point) / across.dot(axis);
    let d = point.z + along * axis.z;
    Transform { convention: Convention::Dh, joint, values: vec![d, theta, a, alpha] }
}

/// `Rz(theta) Tx(a) Rx(alpha) Ry(beta)` to a line through `point` along `axis`: x leads to where the line meets the plane z = 0.
fn hayati(point: &Vector3<f64>, axis: &Vector3<f64>, joint: Option<Joint>) -> Transform {
    let meets = point - axis * (point.z / axis.z);
    let a = libm::hypot(meets.x, meets.y);
    // Axes on top of each other leave theta free.
    let theta = if a > 1e-12 { libm::atan2(meets.y, meets.x) } else { 0.0 };
    let seen = about_z(-theta) * axis;
    let beta = libm::atan2(seen.x, libm::hypot(seen.y, seen.z));
    let alpha = libm::atan2(-seen.y, seen.z);
    Transform { convention: Convention::Hayati, joint, values: vec![theta, a, alpha, beta] }
}

/// All six parameters of a frame.
fn full(frame: &Frame, joint: Option<Joint>) -> Transform {
    let r = &frame.rotation;
    // Rz Rx Ry: the third row is (-cos α sin β, sin α, cos α cos β), the second column (-sin θ cos α, cos θ cos α, sin α).
    let alpha = libm::atan2(r[(2, 1)], libm::hypot(r[(0, 1)], r[(1, 1)]));
    let theta = libm::atan2(-r[(0, 1)], r[(1, 1)]);
    // From the frame without theta: near a quarter turn of alpha, theta and beta turn about one line, and this keeps their sum.
    let rest = about_x(-alpha) * about_z(-theta) * r;
    let beta = libm::atan2(rest[(0, 2)], rest[(0, 0)]);
    let seen = about_z(-theta) * frame.origin;
    let (sine, cosine) = libm::sincos(alpha);
    // y is b cos α and z is d + b sin α; where α is a quarter turn b and d are one, and y is zero or theta takes it up.
    let (b, theta, a) = match cosine.abs() > 1e-9 {
        true => (seen.y / cosine, theta, seen.x),
        false => (0.0, theta, seen.x),
    };
    let d = seen.z - b * sine;
    Transform { convention: Convention::Full, joint, values: vec![d, theta, a, alpha, b, beta] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Chain, Posture, Robot, SHIPPED, shipped};

    #[test]
    fn every_shipped_arm_comes_back_from_where_its_axes_lie() {
        for (name, _) in SHIPPED {
            let robot = shipped(name).expect("shipped");
            let transforms = parametrise(&robot.axes(&robot.nominal()), Between::Proportional).expect("proportional");
            let other = Robot { transforms, ..robot.clone() };
            // A transform with another convention between the same axes is the same arm only if every posture says so.
            for turn in [-0.9, 0.0, 0.4, 1.3] {
                let joints: Vec<f64> =
                    (0..robot.joint_count()).map(|joint| turn * (1.0 + 0.1 * joint as f64)).collect();
                let flange = |robot: &Robot| Chain::new(robot).prepare(&robot.nominal()).flange(&Posture::new(&joints));
                let (one, two) = (flange(&robot), flange(&other));
                // Some fifty products of numbers below ten, each rounded.
                assert!((one.origin - two.origin).norm() < 1e-12, "{name} at {turn}");
                assert!((one.rotation - two.rotation).norm() < 1e-12, "{name} at {turn}");
            }
            assert!(other.remarks().is_empty(), "{name}: {:?}", other.remarks());
        }
    }

    #[test]
    fn dh_alone_is_refused_where_axes_are_parallel_with_what_d_would_be() {
        let robot = shipped("comau-nj-130-2.0").expect("shipped");
        let mut values = robot.nominal();
        let place = robot.chain().place("beta2".parse().expect("a parameter")).expect("there");
        values[place] += 5e-4;
        let refused = parametrise(&robot.axes(&values), Between::DhAlone).expect_err("axes 2 and 3 are parallel");
        assert_eq!(refused.joint, 2);
        assert!((refused.angle_rad - 5e-4).abs() < 1e-9, "{refused}");
        // 0.86 m of a link at half a milliradian.
        assert!(refused.d_m.abs() > 100.0, "{refused}");
    }
}
