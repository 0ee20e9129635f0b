//! URDF: a chain with the values of its parameters as origins of joints, and back.

use nalgebra::{Matrix3, Vector3};
use urdf_rs::JointType;

use super::description::{Joint, JointKind, Robot};
use super::frame::Frame;
use super::parametrise::Axes;

/// Why a text is no arm.
#[derive(Debug, thiserror::Error)]
pub enum UrdfError {
    /// It is no URDF.
    #[error("is no URDF: {0}")]
    Urdf(#[from] urdf_rs::UrdfError),
    /// A chain cannot be told from it.
    #[error("{0}")]
    Chain(String),
}

/// Joint limits of a URDF are required; this stands for none.
const NO_LIMIT: f64 = 1e3;

/// The URDF of a robot with these values of its parameters: links `world`, `base`, `link1` to `linkN` (the flange).
///
/// # Errors
/// None that a robot can cause.
pub fn urdf(robot: &Robot, values: &[f64]) -> Result<String, UrdfError> {
    let Axes { joints: axes, flange } = robot.axes(values);
    let mut links = Vec::new();
    let mut link = |name: &str| {
        links.push(urdf_rs::Link {
            name: name.to_owned(),
            inertial: Default::default(),
            visual: Vec::new(),
            collision: Vec::new(),
        });
        urdf_rs::LinkName { link: name.to_owned() }
    };
    let mut joints = Vec::new();
    let mut parent = link("world");
    let mut at = Frame::identity();
    for (number, (frame, joint)) in axes.iter().enumerate() {
        let child = link(&format!("link{}", number + 1));
        let (low, high) = (joint.min.unwrap_or(-NO_LIMIT), joint.max.unwrap_or(NO_LIMIT));
        let joint_type = match (joint.kind, joint.min.or(joint.max)) {
            (JointKind::Prismatic, _) => JointType::Prismatic,
            (JointKind::Revolute, Some(_)) => JointType::Revolute,
            (JointKind::Revolute, None) => JointType::Continuous,
        };
        joints.push(urdf_rs::Joint {
            limit: urdf_rs::JointLimit { lower: low, upper: high, ..Default::default() },
            axis: urdf_rs::Axis { xyz: urdf_rs::Vec3([0.0, 0.0, 1.0]) },
            ..connection(&format!("joint{}", number + 1), joint_type, &at.inverse().then(frame), &parent, &child)
        });
        (parent, at) = (child, *frame);
    }
    let child = link("flange");
    joints.push(connection("flange", JointType::Fixed, &at.inverse().then(&flange), &parent, &child));
    let content = urdf_rs::Robot { name: robot.name.clone(), version: None, links, joints, materials: Vec::new() };
    Ok(urdf_rs::write_to_string(&content)?)
}

fn connection(
    name: &str,
    joint_type: JointType,
    origin: &Frame,
    parent: &urdf_rs::LinkName,
    child: &urdf_rs::LinkName,
) -> urdf_rs::Joint {
    urdf_rs::Joint {
        name: name.to_owned(),
        joint_type,
        origin: pose(origin),
        parent: parent.clone(),
        child: child.clone(),
        axis: Default::default(),
        limit: Default::default(),
        calibration: None,
        dynamics: None,
        mimic: None,
        safety_controller: None,
    }
}

/// Roll, pitch and yaw of a frame: `Rz(yaw) Ry(pitch) Rx(roll)`. Roll is taken from what is left after yaw: where pitch is a
/// quarter turn both turn about one line, and their sum stays exact.
fn pose(frame: &Frame) -> urdf_rs::Pose {
    let r = &frame.rotation;
    let level = libm::hypot(r[(0, 0)], r[(1, 0)]);
    let yaw = if level > 1e-9 { libm::atan2(r[(1, 0)], r[(0, 0)]) } else { 0.0 };
    let (s, c) = libm::sincos(yaw);
    let second = [0, 1, 2].map(|column| c * r[(1, column)] - s * r[(0, column)]);
    let pitch = libm::atan2(-r[(2, 0)], c * r[(0, 0)] + s * r[(1, 0)]);
    let roll = libm::atan2(-second[2], second[1]);
    urdf_rs::Pose { xyz: urdf_rs::Vec3(frame.origin.into()), rpy: urdf_rs::Vec3([roll, pitch, yaw]) }
}

fn frame(pose: &urdf_rs::Pose) -> Frame {
    let [(sr, cr), (sp, cp), (sy, cy)] = pose.rpy.0.map(libm::sincos);
    let rotation = Matrix3::new(
        cy * cp,
        cy * sp * sr - sy * cr,
        cy * sp * cr + sy * sr,
        sy * cp,
        sy * sp * sr + cy * cr,
        sy * sp * cr - cy * sr,
        -sp,
        cp * sr,
        cp * cr,
    );
    Frame { rotation, origin: Vector3::from(pose.xyz.0) }
}

/// A frame whose z is along an axis of another.
fn along(axis: [f64; 3]) -> Option<Frame> {
    let z = Vector3::from(axis).try_normalize(1e-9)?;
    // The direction that is farthest from the axis, made square with it.
    let far = Vector3::ith(z.iamin(), 1.0);
    let x = if z.x == 0.0 && z.y == 0.0 { Vector3::x() } else { far.cross(&z).normalize() };
    Some(Frame { rotation: Matrix3::from_columns(&[x, z.cross(&x), z]), origin: Vector3::zeros() })
}

/// The name and the axes of a URDF's one chain, from its root to `tip`, or to its only leaf: what
/// [`crate::robot::parametrise`] takes.
///
/// # Errors
/// A text that is no URDF, has no such link, several leaves, or joints that a chain cannot have.
pub fn from_urdf(text: &str, tip: Option<&str>) -> Result<(String, Axes), UrdfError> {
    let content = urdf_rs::read_from_string(text)?;
    let no = |message: String| UrdfError::Chain(message);
    let leaves: Vec<&str> = content
        .links
        .iter()
        .map(|link| link.name.as_str())
        .filter(|name| content.joints.iter().all(|joint| joint.parent.link != *name))
        .collect();
    let tip = match (tip, leaves.as_slice()) {
        (Some(tip), _) if content.links.iter().any(|link| link.name == tip) => tip,
        (Some(tip), _) => return Err(no(format!("has no link '{tip}'; it ends in {}", leaves.join(", ")))),
        (None, [one]) => one,
        (None, _) => return Err(no(format!("ends in several links: name one of {} as --tip", leaves.join(", ")))),
    };
    let mut path = Vec::new();
    let mut at = tip;
    while let Some(joint) = content.joints.iter().find(|joint| joint.child.link == at) {
        if path.len() > content.joints.len() {
            return Err(no(format!("link '{at}' is its own parent")));
        }
        path.push(joint);
        at = &joint.parent.link;
    }
    let mut place = Frame::identity();
    let mut axes = Vec::new();
    for joint in path.into_iter().rev() {
        place = place.then(&frame(&joint.origin));
        let limits = Some((joint.limit.lower, joint.limit.upper)).filter(|(low, high)| low < high);
        let (kind, limits) = match joint.joint_type {
            JointType::Fixed => continue,
            JointType::Revolute => (JointKind::Revolute, limits),
            JointType::Continuous => (JointKind::Revolute, None),
            JointType::Prismatic => (JointKind::Prismatic, limits),
            _ => return Err(no(format!("joint '{}' neither turns about nor slides along one axis", joint.name))),
        };
        if joint.mimic.is_some() {
            return Err(no(format!("joint '{}' mimics another; expected joints of their own", joint.name)));
        }
        let axis = along(joint.axis.xyz.0).ok_or_else(|| no(format!("joint '{}' has no axis", joint.name)))?;
        let (min, max) = limits.unzip();
        axes.push((place.then(&axis), Joint { kind, min, max, gear_ratio: None }));
    }
    Ok((content.name, Axes { joints: axes, flange: place }))
}
