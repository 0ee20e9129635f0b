//! The arm as it truly is: its parameters, its targets, what heat does to them, and how its joints err.

use nalgebra::Vector3;

use super::SimulationError;
use super::random::{Purpose, Stream};
use super::scenario::{Node, Scenario};
use crate::effect::Adjustment;
use crate::robot::{Chain, Frame, Posture, Twist};

/// The place of a link's node in the heat network: cores and housings in turn, the base's first.
pub(super) fn node_place(link: usize, node: Node) -> usize {
    2 * link + usize::from(node == Node::Housing)
}

/// A wave of a joint's position that no parameter describes: `amplitude · cos(harmonic · q + phase)`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Wave {
    amplitude_rad: f64,
    harmonic: f64,
    phase_rad: f64,
}

/// How a parameter follows the nodes.
#[derive(Debug, Clone, PartialEq)]
struct Follows {
    /// The parameter's place in parameter vectors.
    parameter: usize,
    /// Node and m/K or rad/K.
    terms: Vec<(usize, f64)>,
}

/// The true arm.
pub(super) struct TrueArm {
    chain: Chain,
    /// Parameters with every node at the reference temperature.
    pub cold: Vec<f64>,
    /// Places of the targets in the flange frame, m.
    pub targets: Vec<Vector3<f64>>,
    growth: Vec<Follows>,
    reference_c: f64,
    /// One a joint; of no amplitude at prismatic joints.
    waves: Vec<Wave>,
    /// 1-sigma of every joint from visit to visit, rad or m.
    pub joint_sigma: f64,
}

impl TrueArm {
    /// Draws the arm that the scenario's `arm.seed` stands for.
    pub(super) fn new(scenario: &Scenario, postures: &[Vec<f64>]) -> Result<Self, SimulationError> {
        let (robot, arm) = (&scenario.robot, &scenario.arm);
        let chain = robot.chain();
        let mut stream = Stream::new(arm.seed, Purpose::Parameters);
        let cold = chain
            .parameters()
            .iter()
            .zip(robot.nominal())
            .map(|(id, nominal)| {
                let sigma = match (id.transform, id.symbol.is_angle()) {
                    (0, false) => arm.base_length_error_m,
                    (0, true) => arm.base_angle_error_rad,
                    (_, false) => arm.length_error_m,
                    (_, true) => arm.angle_error_rad,
                };
                // Drawn in any case, so that an offset leaves the other parameters as they were.
                let drawn = sigma * stream.normal();
                nominal + arm.offsets.get(&id.to_string()).copied().unwrap_or(drawn)
            })
            .collect();
        let mut stream = Stream::new(arm.seed, Purpose::Targets);
        let targets = robot
            .targets
            .iter()
            .map(|target| {
                let error = Vector3::from([stream.normal(), stream.normal(), stream.normal()]) * arm.target_error_m;
                match arm.targets.get(&target.name) {
                    Some(place) => Ok(Vector3::from(*place)),
                    None => target
                        .position
                        .map(|place| place + error)
                        .ok_or_else(|| SimulationError::UnplacedTarget(target.name.clone())),
                }
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut stream = Stream::new(arm.seed, Purpose::Transmission);
        let waves = (0..chain.joint_count())
            .map(|joint| Wave {
                amplitude_rad: if chain.is_revolute(joint) { arm.transmission_error_rad } else { 0.0 },
                // Slow enough for a posture to matter, fast enough not to be a joint offset.
                harmonic: stream.between(1.5, 6.0),
                phase_rad: stream.between(0.0, std::f64::consts::TAU),
            })
            .collect();
        let growth = scenario
            .growth
            .iter()
            .map(|growth| {
                let parameter =
                    chain.place(growth.parameter.0).ok_or(SimulationError::NoParameter(growth.parameter.0))?;
                let terms = growth.terms.iter().map(|term| (node_place(term.link, term.node), term.per_k)).collect();
                Ok(Follows { parameter, terms })
            })
            .collect::<Result<Vec<_>, SimulationError>>()?;
        let mut made = Self { chain, cold, targets, growth, reference_c: arm.reference_c, waves, joint_sigma: 0.0 };
        let displaced = made.displacement_by_unit_joint_noise(postures);
        if displaced > 0.0 {
            made.joint_sigma = arm.repeatability_m / 3.0 / displaced;
        }
        Ok(made)
    }

    /// The change of all parameters by the temperatures of the nodes, m and rad.
    pub(super) fn growth(&self, nodes_c: &[f64]) -> Vec<f64> {
        let mut change = vec![0.0; self.cold.len()];
        for follows in &self.growth {
            for &(node, per_k) in &follows.terms {
                change[follows.parameter] += per_k * (nodes_c[node] - self.reference_c);
            }
        }
        change
    }

    /// Where the joints truly are, without noise, for what their encoders say.
    pub(super) fn joints(&self, encoders: &[f64]) -> Vec<f64> {
        encoders
            .iter()
            .zip(&self.waves)
            .map(|(&q, wave)| q + wave.amplitude_rad * libm::cos(wave.harmonic * q + wave.phase_rad))
            .collect()
    }

    /// The flange in the world frame at true joint positions and temperatures of the nodes, with what effects do to the
    /// parameters.
    pub(super) fn flange(&self, joints: &[f64], nodes_c: &[f64], adjustment: &Adjustment) -> Frame {
        let grown = self.cold.iter().zip(self.growth(nodes_c)).map(|(cold, growth)| cold + growth);
        let values: Vec<f64> = grown.zip(&adjustment.parameters).map(|(value, more)| value + more).collect();
        self.chain.prepare(&values).flange(&Posture::new(joints))
    }

    /// Root mean square over postures and targets of a target's displacement when every joint errs by 1 rad (or 1 m) of
    /// deviation, to first order, m.
    fn displacement_by_unit_joint_noise(&self, postures: &[Vec<f64>]) -> f64 {
        let prepared = self.chain.prepare(&self.cold);
        let mut parameters = vec![Twist::default(); self.cold.len()];
        let mut joints = vec![Twist::default(); self.chain.joint_count()];
        let mut sum = 0.0;
        for posture in postures {
            prepared.twists(&Posture::new(posture), &mut parameters, &mut joints);
            for target in &self.targets {
                let target: [f64; 3] = (*target).into();
                sum += joints.iter().map(|twist| Vector3::from(twist.at(&target)).norm_squared()).sum::<f64>();
            }
        }
        libm::sqrt(sum / (postures.len() * self.targets.len()) as f64)
    }
}
