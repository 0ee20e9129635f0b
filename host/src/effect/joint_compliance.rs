//! A joint that gives under gravity: `Δq = compliance · torque`, payload included.
//!
//! Where robot.toml gives no masses, the torque is linear in the unknown first moments of what the joint carries: the
//! coefficients are then compliance times moment: of the joint's own link alone, as if all that it carries were one body, or of
//! all links, as many as the visits tell apart.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct JointCompliance;

/// Torques that vary by less than this over the visits cannot be told from an offset, N·m.
const LEAST_VARIATION: f64 = 1e-6;

impl Effect for JointCompliance {
    fn name(&self) -> &'static str {
        "joint_compliance"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let varies = |joint: &usize| {
            let torque = |visit: &super::Situation| visit.torques[*joint];
            let (low, high) = scene
                .visits
                .iter()
                .map(torque)
                .fold((f64::MAX, f64::MIN), |(low, high), torque| (low.min(torque), high.max(torque)));
            high - low > LEAST_VARIATION || !scene.told_apart[*joint].is_empty()
        };
        (0..scene.chain.joint_count()).filter(varies).map(Site::joint).collect()
    }

    /// Where masses are unknown, which moments the run tells apart and the mean of each: another run may tell apart others,
    /// and has other means.
    fn shapes(&self, scene: &Scene, site: &Site) -> Vec<Vec<f64>> {
        let Some(joint) = site.joint.filter(|_| !scene.masses_known) else { return vec![Vec::new()] };
        let shape = |set: &Vec<(usize, f64)>| set.iter().flat_map(|&(moment, mean)| [moment as f64, mean]).collect();
        scene.told_apart[joint].iter().map(shape).collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(joint) = site.joint else { return Vec::new() };
        if scene.masses_known {
            return vec![vec![Acts::Joint(joint, scene.by_visit(|visit| visit.torques[joint]))]];
        }
        let about_mean = |pair: &[f64]| {
            let amounts = scene.moments[joint].get(pair[0] as usize)?;
            Some(vec![Acts::Joint(joint, amounts.iter().map(|amount| amount - pair[1]).collect())])
        };
        shape.chunks_exact(2).filter_map(about_mean).collect()
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        match coefficients {
            [one] => vec![Named::new("compliance_rad_per_nm", *one)],
            many => (1..)
                .zip(many)
                .map(|(number, value)| Named::new(format!("compliance_times_moment_{number}_rad"), *value))
                .collect(),
        }
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().joint().shape(0..=usize::MAX).coefficients(1..=usize::MAX)
    }

    fn values(&self, scene: &Scene, site: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let number = |number| format!("compliance_times_moment_{number}_rad");
        let coefficients = given.numbered("compliance_rad_per_nm", number)?;
        let pairs = if scene.masses_known { 0 } else { coefficients.len() };
        let shape = self.shapes(scene, site).into_iter().find(|shape| shape.len() == 2 * pairs);
        let shape = shape.ok_or(InstanceError::NoPlace(self.name()))?;
        Ok(Values::new(shape, coefficients))
    }
}
