//! A scene of the present moment: one visit that has no run around it, for an arm that is to be corrected now.

use nalgebra::Vector3;

use super::scene::moments;
use super::{Growing, Scene, Sensed, Situation};
use crate::model::ReferenceTemperature;
use crate::robot::{JointKind, Payload, Posture, Prepared, Robot, gravity_torques};
use crate::run::TemperatureSeries;

impl Scene {
    /// A scene with one visit and all joints at zero, at the reference temperatures. There is no schedule and no air, the
    /// arm came from nowhere, and nothing is logged of it.
    pub fn present(
        robot: &Robot,
        references: &[ReferenceTemperature],
        growth: Vec<Growing>,
        targets: Vec<Vector3<f64>>,
    ) -> Scene {
        let chain = robot.chain();
        let joints: Vec<_> = robot.transforms.iter().filter_map(|transform| transform.joint.as_ref()).collect();
        let count = joints.len();
        let sensors = references.iter().map(|reference| Sensed {
            name: reference.sensor.clone(),
            link: robot.sensor(&reference.sensor).map_or(0, |place| robot.sensors[place].link),
            reference_c: reference.celsius,
            series: TemperatureSeries::constant(0.0, reference.celsius),
        });
        Scene {
            revolute: joints.iter().map(|joint| joint.kind == JointKind::Revolute).collect(),
            gear_ratios: joints.iter().map(|joint| joint.gear_ratio).collect(),
            chain,
            masses_known: !robot.bodies.is_empty(),
            moments: vec![Vec::new(); count],
            told_apart: vec![Vec::new(); count],
            origin_s: 0.0,
            visits: vec![Situation {
                time_s: 0.0,
                cycle: 0,
                pose: 0,
                joints: vec![0.0; count],
                before: None,
                other_account: None,
                approach: vec![0.0; count],
                torques: vec![0.0; count],
                rises: vec![0.0; references.len()],
            }],
            sensors: sensors.collect(),
            air: None,
            air_reference_c: None,
            growth,
            motion: Vec::new(),
            unknown_targets: vec![false; targets.len()],
            targets,
            station: Vector3::zeros(),
        }
    }

    /// Moves the one visit of a present scene to other joints. Gravity is weighed where `loaded` says that an effect asks
    /// for it; `prepared` is the chain with its present values.
    pub fn stand(&mut self, robot: &Robot, prepared: &Prepared, joints: &[f64], payload_kg: f64, loaded: bool) {
        let Some(visit) = self.visits.first_mut() else { return };
        visit.joints.copy_from_slice(joints);
        if !loaded {
            return;
        }
        let payload = (payload_kg != 0.0).then(|| Payload { mass_kg: payload_kg, center: Vector3::zeros() });
        visit.torques = gravity_torques(robot, prepared, &Posture::new(joints), payload);
        if !self.masses_known {
            self.moments = moments(robot, &self.visits, prepared);
        }
    }
}
