//! A small maker of campaigns for the tests of `host::calibrate`: an arm with known true values, visited at random
//! postures, seen with the three strata of noise that the covariance knows. It shares nothing with `host::simulate`.

#![allow(dead_code, reason = "every test binary uses its own part")]

use nalgebra::{UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};
use std::collections::HashMap;
use thermokin::calibrate::{
    Campaign, GrowthTerm, Names, ObservedDistance, ObservedPosition, ObservedTurn, ObservedVisit, State, Unknown,
};
use thermokin::model::Geometry;
use thermokin::robot::{Posture, Robot, Target};

/// Random numbers whose seed is printed, so that a failure can be repeated: `THERMOKIN_TEST_SEED`.
pub struct Dice(ChaCha8Rng);

impl Dice {
    pub fn new(test: &str) -> Self {
        let seed: u64 = std::env::var("THERMOKIN_TEST_SEED").ok().and_then(|text| text.parse().ok()).unwrap_or(20_140);
        println!("{test}: THERMOKIN_TEST_SEED={seed}");
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64)
    }

    /// Standard normal, by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.between(0.0, 1.0)).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.between(0.0, 1.0)).cos()
    }

    pub fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| size * self.normal())
    }
}

/// Standard deviations of the strata of noise.
#[derive(Clone, Copy, Default)]
pub struct Strata {
    /// Of a measured coordinate (m), of a distance, and of an orientation in rad.
    pub point: f64,
    /// Of each joint at each visit, rad.
    pub visit: f64,
    /// Of each joint at each posture, rad.
    pub posture: f64,
}

/// What a visit measures.
#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    Positions,
    FullPoses,
    /// To every anchor of the twin.
    Distances,
}

/// An arm with known true values.
pub struct Twin {
    pub robot: Robot,
    pub nominal: State,
    pub truth: State,
    pub anchors: Vec<String>,
    pub sensors: Vec<String>,
    pub growth: Vec<GrowthTerm>,
    pub kind: Kind,
}

/// The instrument's stated standard deviation of a coordinate, m.
pub const SIGMA: f64 = 10e-6;
/// Of an orientation, rad.
pub const TURN_SIGMA: f64 = 20e-6;

impl Twin {
    /// An arm whose true parameters are off nominal by half a millimetre and half a milliradian (one standard deviation).
    pub fn new(robot: Robot, dice: &mut Dice) -> Self {
        let nominal = State { geometry: Geometry::nominal(&robot), growth: Vec::new() };
        let mut truth = nominal.clone();
        for value in &mut truth.geometry.parameters {
            *value += 5e-4 * dice.normal();
        }
        Self {
            robot,
            nominal,
            truth,
            anchors: Vec::new(),
            sensors: Vec::new(),
            growth: Vec::new(),
            kind: Kind::Positions,
        }
    }

    /// Replaces the targets by `count` ones of unknown place.
    pub fn with_unknown_targets(mut self, count: usize, dice: &mut Dice) -> Self {
        self.robot.targets = (0..count).map(|n| Target { name: format!("U{n}"), position: None }).collect();
        for state in [&mut self.nominal, &mut self.truth] {
            let nominal = Geometry::nominal(&self.robot);
            state.geometry.targets = nominal.targets;
            state.geometry.turns = nominal.turns;
        }
        for target in &mut self.truth.geometry.targets {
            *target = dice.vector(0.1);
        }
        self
    }

    /// Adds an anchor beside the arm.
    pub fn with_anchor(mut self, at: Vector3<f64>) -> Self {
        self.anchors.push(format!("W{}", self.anchors.len()));
        self.nominal.geometry.anchors.push(at);
        self.truth.geometry.anchors.push(at);
        self
    }

    pub fn place(&self, name: &str) -> usize {
        self.robot.chain().place(name.parse().expect("a parameter's name")).expect("a parameter of the chain")
    }

    /// Lets a parameter follow a sensor (added to the twin's sensors where it is new).
    pub fn grows(&mut self, parameter: &str, sensor: &str, coefficient: f64) {
        let sensor = self.sensor(sensor);
        self.growth.push(GrowthTerm { parameter: self.place(parameter), sensor });
        self.nominal.growth.push(0.0);
        self.truth.growth.push(coefficient);
    }

    pub fn sensor(&mut self, name: &str) -> usize {
        self.sensors.iter().position(|own| own == name).unwrap_or_else(|| {
            self.sensors.push(name.to_owned());
            self.sensors.len() - 1
        })
    }

    /// A campaign of the twin without visits.
    pub fn empty(&self) -> Campaign {
        Campaign {
            chain: self.robot.chain(),
            targets: self.robot.targets.iter().map(|target| target.name.clone()).collect(),
            anchors: self.anchors.clone(),
            sensors: self.sensors.clone(),
            growth: self.growth.clone(),
            visits: Vec::new(),
        }
    }

    /// Random joints within ±`range` rad.
    pub fn postures(&self, count: usize, range: f64, dice: &mut Dice) -> Vec<Vec<f64>> {
        let joints = self.robot.joint_count();
        (0..count).map(|_| (0..joints).map(|_| dice.between(-range, range)).collect()).collect()
    }

    /// Visits all postures in every cycle. `rises` gives each cycle's rise of each sensor.
    pub fn visit(&self, postures: &[Vec<f64>], rises: &[Vec<f64>], strata: Strata, dice: &mut Dice) -> Campaign {
        let mut campaign = self.empty();
        let mut stays: HashMap<usize, Vec<f64>> = HashMap::new();
        for (cycle, rises) in rises.iter().enumerate() {
            let mut values = self.truth.geometry.parameters.clone();
            for (term, coefficient) in self.growth.iter().zip(&self.truth.growth) {
                values[term.parameter] += coefficient * rises[term.sensor];
            }
            let prepared = campaign.chain.prepare(&values);
            for (pose, joints) in postures.iter().enumerate() {
                let stays = stays
                    .entry(pose)
                    .or_insert_with(|| joints.iter().map(|_| strata.posture * dice.normal()).collect())
                    .clone();
                let true_joints: Vec<f64> =
                    joints.iter().zip(&stays).map(|(q, stays)| q + stays + strata.visit * dice.normal()).collect();
                let flange = prepared.flange(&Posture::new(&true_joints));
                let mut visit = ObservedVisit {
                    place: campaign.visits.len(),
                    cycle: cycle as u32,
                    pose: pose as u32,
                    posture: Posture::new(joints),
                    rises: rises.clone(),
                    positions: Vec::new(),
                    sigma: SIGMA,
                    turns: Vec::new(),
                    turn_sigma: TURN_SIGMA,
                    distances: Vec::new(),
                };
                for (target, place) in self.truth.geometry.targets.iter().enumerate() {
                    let at = flange.point(place);
                    if self.kind == Kind::Distances {
                        for (anchor, from) in self.truth.geometry.anchors.iter().enumerate() {
                            let distance = (at - from).norm() + strata.point * dice.normal();
                            visit.distances.push(ObservedDistance { target, anchor, distance, sigma: SIGMA });
                        }
                        continue;
                    }
                    visit.positions.push(ObservedPosition { target, at: at + dice.vector(strata.point) });
                    if self.kind == Kind::FullPoses {
                        let noise = UnitQuaternion::from_scaled_axis(dice.vector(strata.point));
                        let at = noise * flange.quaternion() * self.truth.geometry.turns[target];
                        visit.turns.push(ObservedTurn { target, at });
                    }
                }
                campaign.visits.push(visit);
            }
        }
        campaign
    }

    /// One cycle without any rise.
    pub fn cold(&self, postures: &[Vec<f64>], strata: Strata, dice: &mut Dice) -> Campaign {
        self.visit(postures, &[vec![0.0; self.sensors.len()]], strata, dice)
    }
}

/// Names of unknowns.
pub fn names(names: &Names<'_>, unknowns: &[Unknown]) -> Vec<String> {
    unknowns.iter().map(|&unknown| names.name(unknown)).collect()
}
