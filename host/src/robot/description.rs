//! What a robot is: its chain with nominal values, the tool's targets, its masses and where its sensors sit.

use nalgebra::Vector3;

use super::chain::{Chain, Posture};
use super::convention::{Convention, Symbol};
use super::frame::Frame;
use super::parameter::ParameterId;
use super::parametrise::Axes;

/// An arm as `robot.toml` describes it (contract `robot.md`).
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// The arm's type.
    pub name: String,
    /// The acceleration of gravity in the world frame, m/s².
    pub gravity: Vector3<f64>,
    /// World to base first, the transform that ends at the flange last.
    pub transforms: Vec<Transform>,
    /// What the instrument measures on the flange.
    pub targets: Vec<Target>,
    /// Names of the targets that stand still beside the base.
    pub monuments: Vec<String>,
    /// Masses that gravity pulls at.
    pub bodies: Vec<Body>,
    /// Temperature sensors.
    pub sensors: Vec<Sensor>,
    /// Which parameters follow which sensors; empty: chosen from the data.
    pub thermal: Vec<ThermalChoice>,
}

/// One transform of the chain with its nominal values.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    /// How it is parametrised.
    pub convention: Convention,
    /// The joint that moves it; none for a fixed transform.
    pub joint: Option<Joint>,
    /// Nominal values in the order of the convention's symbols, metres and radians.
    pub values: Vec<f64>,
}

impl Transform {
    /// The nominal value of a symbol; zero where the convention has no such parameter.
    pub fn value(&self, symbol: Symbol) -> f64 {
        self.convention.symbols().iter().position(|&own| own == symbol).map_or(0.0, |place| self.values[place])
    }
}

/// A joint of the chain.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Turning or sliding.
    pub kind: JointKind,
    /// Lower limit, radians or metres.
    pub min: Option<f64>,
    /// Upper limit, radians or metres.
    pub max: Option<f64>,
    /// Motor turns per joint turn.
    pub gear_ratio: Option<f64>,
}

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Its position adds to `theta`.
    Revolute,
    /// Its position adds to `d`.
    Prismatic,
}

/// A target on the tool.
#[derive(Debug, Clone, PartialEq)]
pub struct Target {
    /// Its name in `points.csv`.
    pub name: String,
    /// Its place in the flange frame, metres; none: to be identified.
    pub position: Option<Vector3<f64>>,
}

/// A mass that moves with a transform.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// The transform that it moves with.
    pub transform: usize,
    /// Kilograms.
    pub mass_kg: f64,
    /// The centre of mass in the frame after that transform, metres.
    pub center: Vector3<f64>,
}

/// A temperature sensor on the arm.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sensor {
    /// Its name in `temperatures.csv`.
    pub name: String,
    /// The link it is glued to: link N moves with transform N.
    pub link: usize,
    /// The link board that reads it.
    pub board: Option<u32>,
    /// Its I2C address on that board, 7 bits.
    pub address: Option<u8>,
}

/// The sensors that one parameter is said to follow.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThermalChoice {
    /// The parameter.
    pub parameter: ParameterId,
    /// Names of sensors.
    pub sensors: Vec<String>,
}

impl Robot {
    /// The structure of the chain.
    pub fn chain(&self) -> Chain {
        Chain::new(self)
    }

    /// The nominal values of all parameters in the chain's order.
    pub fn nominal(&self) -> Vec<f64> {
        self.transforms.iter().flat_map(|transform| transform.values.iter().copied()).collect()
    }

    /// Puts other values in place of the nominal ones.
    ///
    /// # Panics
    /// When `values` has another length than the chain has parameters.
    pub fn set_values(&mut self, values: &[f64]) {
        assert_eq!(values.len(), self.transforms.iter().map(|transform| transform.values.len()).sum::<usize>());
        let mut rest = values.iter();
        for value in self.transforms.iter_mut().flat_map(|transform| transform.values.iter_mut()) {
            *value = *rest.next().unwrap_or(value);
        }
    }

    /// The frames of the joints' axes with all joints at zero, seen from the world, each with its joint, and the flange; for
    /// `values` in place of the nominal ones.
    pub fn axes(&self, values: &[f64]) -> Axes {
        let frames = self.chain().prepare(values).frames(&Posture::new(&vec![0.0; self.joint_count()]));
        let before = |number: usize| number.checked_sub(1).map_or_else(Frame::identity, |place| frames[place]);
        let joints = self.transforms.iter().enumerate();
        let joints =
            joints.filter_map(|(number, transform)| Some((before(number), transform.joint.clone()?))).collect();
        Axes { joints, flange: frames.last().copied().unwrap_or_else(Frame::identity) }
    }

    /// The number of joints.
    pub fn joint_count(&self) -> usize {
        self.transforms.iter().filter(|transform| transform.joint.is_some()).count()
    }

    /// The target of a name.
    pub fn target(&self, name: &str) -> Option<usize> {
        self.targets.iter().position(|target| target.name == name)
    }

    /// The sensor of a name.
    pub fn sensor(&self, name: &str) -> Option<usize> {
        self.sensors.iter().position(|sensor| sensor.name == name)
    }
}
