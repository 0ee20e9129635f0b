//! The measurements of a run as an identification needs them: postures with their sines, observed positions, turns and
//! distances with their noise, and how far each sensor is above its reference.

use nalgebra::{UnitQuaternion, Vector3};

use super::unknown::{GrowthTerm, Names};
use crate::effect::{Growing, Seen};
use crate::robot::{Chain, Posture};

/// A measured position of a target, world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservedPosition {
    /// The target.
    pub target: usize,
    /// Where it was seen.
    pub at: Vector3<f64>,
}

/// A measured orientation of a target in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservedTurn {
    /// The target.
    pub target: usize,
    /// How it was seen.
    pub at: UnitQuaternion<f64>,
}

/// A measured distance between a target and an anchor, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservedDistance {
    /// The target.
    pub target: usize,
    /// The anchor.
    pub anchor: usize,
    /// The distance.
    pub distance: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// One visit of one posture with all that was measured there.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservedVisit {
    /// Its place among the visits of the run.
    pub place: usize,
    /// The cycle.
    pub cycle: u32,
    /// The posture's number, the same in every cycle.
    pub pose: u32,
    /// The joints.
    pub posture: Posture,
    /// Rise of each of the campaign's sensors above its reference, kelvin.
    pub rises: Vec<f64>,
    /// Measured positions.
    pub positions: Vec<ObservedPosition>,
    /// Standard deviation of one coordinate of the positions, at the visit's mean distance from the instrument.
    pub sigma: f64,
    /// Measured orientations.
    pub turns: Vec<ObservedTurn>,
    /// Standard deviation of one component of an orientation, radians.
    pub turn_sigma: f64,
    /// Measured distances.
    pub distances: Vec<ObservedDistance>,
}

impl ObservedVisit {
    /// The number of scalars measured.
    pub fn rows(&self) -> usize {
        3 * (self.positions.len() + self.turns.len()) + self.distances.len()
    }
}

/// All visits that an identification uses, and the names of what was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Campaign {
    /// The arm's chain.
    pub chain: Chain,
    /// Names of the targets, in the robot's order.
    pub targets: Vec<String>,
    /// Names of the anchors.
    pub anchors: Vec<String>,
    /// Names of the sensors whose rises the visits carry.
    pub sensors: Vec<String>,
    /// Which parameters follow which sensors.
    pub growth: Vec<GrowthTerm>,
    /// The visits in order of time.
    pub visits: Vec<ObservedVisit>,
}

impl Campaign {
    /// The names of unknowns.
    pub fn names(&self) -> Names<'_> {
        Names {
            chain: &self.chain,
            targets: &self.targets,
            anchors: &self.anchors,
            sensors: &self.sensors,
            growth: &self.growth,
        }
    }

    /// The number of scalars measured.
    pub fn rows(&self) -> usize {
        self.visits.iter().map(ObservedVisit::rows).sum()
    }

    /// The same campaign with the visits that are picked.
    pub fn select(&self, pick: impl Fn(&ObservedVisit) -> bool) -> Campaign {
        Campaign { visits: self.visits.iter().filter(|visit| pick(visit)).cloned().collect(), ..self.clone_empty() }
    }

    fn clone_empty(&self) -> Campaign {
        Campaign {
            chain: self.chain.clone(),
            targets: self.targets.clone(),
            anchors: self.anchors.clone(),
            sensors: self.sensors.clone(),
            growth: self.growth.clone(),
            visits: Vec::new(),
        }
    }

    /// The visits as effects see them.
    pub fn seen(&self) -> impl Iterator<Item = Seen> {
        self.visits.iter().map(|visit| Seen {
            place: visit.place,
            joints: visit.posture.positions(),
            rises: visit.rises.clone(),
        })
    }

    /// What grows with which sensor, by coefficients in the order of the growth's terms.
    pub fn growing(&self, coefficients: &[f64]) -> Vec<Growing> {
        let terms = self.growth.iter().zip(coefficients);
        terms
            .map(|(term, &coefficient)| Growing { parameter: term.parameter, sensor: term.sensor, coefficient })
            .collect()
    }

    /// The targets that any visit saw.
    pub fn seen_targets(&self) -> Vec<bool> {
        let mut seen = vec![false; self.targets.len()];
        for visit in &self.visits {
            let targets = visit.positions.iter().map(|position| position.target);
            for target in targets.chain(visit.distances.iter().map(|distance| distance.target)) {
                seen[target] = true;
            }
        }
        seen
    }
}
