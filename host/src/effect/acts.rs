//! What effects do to a prediction, in the few places where anything can act.

use nalgebra::Vector3;

/// What a unit of a coefficient adds in one place, one amount a visit.
#[derive(Debug, Clone, PartialEq)]
pub enum Acts {
    /// To a joint, radians or metres.
    Joint(usize, Vec<f64>),
    /// To a parameter of the chain, metres or radians.
    Parameter(usize, Vec<f64>),
    /// To what a sensor reads above its reference, kelvin; it reaches the arm through the thermal coefficients.
    Reading(usize, Vec<f64>),
    /// To the measured coordinates, as a motion of the world frame: along x, y, z (0 to 2) or about them (3 to 5).
    World(usize, Vec<f64>),
    /// To the measured coordinates, as a scale about the instrument.
    Scale(Vec<f64>),
    /// To a target's place in the flange frame, along an axis.
    Target(usize, usize, Vec<f64>),
    /// To all targets, as a motion in the flange frame: along (0 to 2) or about (3 to 5) its axes.
    Tool(usize, Vec<f64>),
}

impl Acts {
    /// The amounts, one a visit.
    pub fn amounts(&self) -> &[f64] {
        match self {
            Acts::Joint(_, amounts)
            | Acts::Parameter(_, amounts)
            | Acts::Reading(_, amounts)
            | Acts::World(_, amounts)
            | Acts::Scale(amounts)
            | Acts::Target(_, _, amounts)
            | Acts::Tool(_, amounts) => amounts,
        }
    }

    /// Whether two acts add to the same place.
    pub fn same_place(&self, other: &Acts) -> bool {
        match (self, other) {
            (Acts::Joint(a, _), Acts::Joint(b, _))
            | (Acts::Parameter(a, _), Acts::Parameter(b, _))
            | (Acts::Reading(a, _), Acts::Reading(b, _))
            | (Acts::World(a, _), Acts::World(b, _))
            | (Acts::Tool(a, _), Acts::Tool(b, _)) => a == b,
            (Acts::Scale(_), Acts::Scale(_)) => true,
            (Acts::Target(a, x, _), Acts::Target(b, y, _)) => (a, x) == (b, y),
            _ => false,
        }
    }
}

/// The sum of what all effects of a model add at one visit.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjustment {
    /// Added to the joints.
    pub joints: Vec<f64>,
    /// Added to the chain's parameters.
    pub parameters: Vec<f64>,
    /// Added to the sensors' rises.
    pub rises: Vec<f64>,
    /// Added to the targets' places in the flange frame.
    pub targets: Vec<Vector3<f64>>,
    /// Measured coordinates are shifted by this.
    pub shift: Vector3<f64>,
    /// And turned by this, radians about the world's axes.
    pub turn: Vector3<f64>,
    /// And scaled about the instrument by one plus this.
    pub scale: f64,
}

impl Adjustment {
    /// No adjustment.
    pub fn none(joints: usize, parameters: usize, sensors: usize, targets: usize) -> Self {
        Self {
            joints: vec![0.0; joints],
            parameters: vec![0.0; parameters],
            rises: vec![0.0; sensors],
            targets: vec![Vector3::zeros(); targets],
            shift: Vector3::zeros(),
            turn: Vector3::zeros(),
            scale: 0.0,
        }
    }

    /// Takes in `coefficient` times an act at a visit. `places` are the targets in the flange frame, for motions of the tool.
    pub fn add(&mut self, act: &Acts, visit: usize, coefficient: f64, places: &[Vector3<f64>]) {
        let amount = coefficient * act.amounts()[visit];
        match *act {
            Acts::Joint(joint, _) => self.joints[joint] += amount,
            Acts::Parameter(place, _) => self.parameters[place] += amount,
            Acts::Reading(sensor, _) => self.rises[sensor] += amount,
            Acts::World(axis, _) if axis < 3 => self.shift[axis] += amount,
            Acts::World(axis, _) => self.turn[axis - 3] += amount,
            Acts::Scale(_) => self.scale += amount,
            Acts::Target(target, axis, _) => self.targets[target][axis] += amount,
            Acts::Tool(axis, _) => {
                for (moved, place) in self.targets.iter_mut().zip(places) {
                    *moved += tool_motion(axis, place) * amount;
                }
            }
        }
    }

    /// A position as the instrument would report it, from where the target truly stands.
    pub fn seen(&self, truly: &Vector3<f64>, station: &Vector3<f64>) -> Vector3<f64> {
        let turned = truly + self.turn.cross(truly) + self.shift;
        turned + (turned - station) * self.scale
    }
}

/// What a unit motion of the tool along (0 to 2) or about (3 to 5) an axis of the flange does to a place in its frame.
pub fn tool_motion(axis: usize, place: &Vector3<f64>) -> Vector3<f64> {
    let mut along = Vector3::zeros();
    along[axis % 3] = 1.0;
    if axis < 3 { along } else { along.cross(place) }
}
