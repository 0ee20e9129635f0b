//! What is estimated: the unknowns of an identification, their names, units and the order in which they are kept.

use crate::model::Geometry;
use crate::robot::Chain;

/// One number that an identification may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Unknown {
    /// A parameter of the chain, by its place in [`Chain::parameters`].
    Parameter(usize),
    /// A coordinate of a target in the flange frame.
    Target {
        /// The target.
        target: usize,
        /// 0 x, 1 y, 2 z.
        axis: usize,
    },
    /// A turn of a six-degree-of-freedom target about an axis of the flange.
    Turn {
        /// The target.
        target: usize,
        /// 0 x, 1 y, 2 z.
        axis: usize,
    },
    /// A coordinate of an anchor in the world frame.
    Anchor {
        /// The anchor.
        anchor: usize,
        /// 0 x, 1 y, 2 z.
        axis: usize,
    },
    /// A thermal coefficient, by its place among the growth terms.
    Growth(usize),
}

/// A growth term before it has a value: which parameter follows which sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct GrowthTerm {
    /// Place of the parameter in [`Chain::parameters`].
    pub parameter: usize,
    /// Place of the sensor in the campaign's sensors.
    pub sensor: usize,
}

/// Values for all unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Everything at the reference temperatures.
    pub geometry: Geometry,
    /// Thermal coefficients in the order of the growth terms, m/K and rad/K.
    pub growth: Vec<f64>,
}

impl State {
    /// The present value of an unknown. A turn has none of its own: it is counted from the present orientation.
    pub fn value(&self, unknown: Unknown) -> f64 {
        match unknown {
            Unknown::Parameter(place) => self.geometry.parameters[place],
            Unknown::Target { target, axis } => self.geometry.targets[target][axis],
            Unknown::Turn { target, axis } => self.geometry.turns[target].scaled_axis()[axis],
            Unknown::Anchor { anchor, axis } => self.geometry.anchors[anchor][axis],
            Unknown::Growth(term) => self.growth[term],
        }
    }

    /// The state after each unknown has moved by its step.
    pub fn moved(&self, unknowns: &[Unknown], step: &[f64]) -> State {
        let mut state = self.clone();
        let mut turns = vec![nalgebra::Vector3::zeros(); state.geometry.turns.len()];
        for (unknown, step) in unknowns.iter().zip(step) {
            match *unknown {
                Unknown::Parameter(place) => state.geometry.parameters[place] += step,
                Unknown::Target { target, axis } => state.geometry.targets[target][axis] += step,
                Unknown::Turn { target, axis } => turns[target][axis] += step,
                Unknown::Anchor { anchor, axis } => state.geometry.anchors[anchor][axis] += step,
                Unknown::Growth(term) => state.growth[term] += step,
            }
        }
        for (turn, step) in state.geometry.turns.iter_mut().zip(turns) {
            if step != nalgebra::Vector3::zeros() {
                *turn = nalgebra::UnitQuaternion::from_scaled_axis(step) * *turn;
            }
        }
        state
    }
}

/// The names by which unknowns are reported.
#[derive(Debug, Clone, Copy)]
pub struct Names<'a> {
    /// For the parameters.
    pub chain: &'a Chain,
    /// Names of the targets.
    pub targets: &'a [String],
    /// Names of the anchors.
    pub anchors: &'a [String],
    /// Names of the sensors.
    pub sensors: &'a [String],
    /// The growth terms.
    pub growth: &'a [GrowthTerm],
}

const AXES: [char; 3] = ['x', 'y', 'z'];

impl Names<'_> {
    /// `d1`, `T1.x`, `T1.rx`, `A1.x`, or `d1(L0S1)` for a thermal coefficient.
    pub fn name(&self, unknown: Unknown) -> String {
        match unknown {
            Unknown::Parameter(place) => self.chain.parameters()[place].to_string(),
            Unknown::Target { target, axis } => format!("{}.{}", self.targets[target], AXES[axis]),
            Unknown::Turn { target, axis } => format!("{}.r{}", self.targets[target], AXES[axis]),
            Unknown::Anchor { anchor, axis } => format!("{}.{}", self.anchors[anchor], AXES[axis]),
            Unknown::Growth(term) => {
                let GrowthTerm { parameter, sensor } = self.growth[term];
                format!("{}({})", self.chain.parameters()[parameter], self.sensors[sensor])
            }
        }
    }

    /// `m`, `rad`, `m/K` or `rad/K`.
    pub fn unit(&self, unknown: Unknown) -> &'static str {
        match unknown {
            Unknown::Parameter(place) => self.chain.parameters()[place].symbol.unit(),
            Unknown::Target { .. } | Unknown::Anchor { .. } => "m",
            Unknown::Turn { .. } => "rad",
            Unknown::Growth(term) => match self.chain.parameters()[self.growth[term].parameter].symbol.is_angle() {
                true => "rad/K",
                false => "m/K",
            },
        }
    }
}

/// Puts unknowns in the order in which they are kept when the data cannot tell them apart: targets and anchors, the arm's
/// own transforms, the base, the last transform (whose part an unknown target plays), thermal coefficients.
pub fn keep_order(chain: &Chain, unknowns: &mut [Unknown]) {
    let last = chain.transform_count() - 1;
    unknowns.sort_by_key(|unknown| match *unknown {
        Unknown::Target { target, axis } => (0, target, axis),
        Unknown::Turn { target, axis } => (1, target, axis),
        Unknown::Anchor { anchor, axis } => (2, anchor, axis),
        Unknown::Parameter(place) => match chain.parameters()[place].transform {
            0 => (4, 0, place),
            transform if transform == last => (5, 0, place),
            _ => (3, 0, place),
        },
        Unknown::Growth(term) => (6, 0, term),
    });
}
