//! The gear's play taken up by the load: `Δq = amplitude · tanh(torque / scale)`.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct LostMotion;

/// Shares of the largest torque that are tried as the scale: a larger one is compliance, a smaller one a step.
const SHARES: [f64; 5] = [0.02, 0.06, 0.15, 0.35, 0.7];

/// A torque below this does not load a gear, N·m.
const LEAST_TORQUE: f64 = 1e-6;

fn largest(scene: &Scene, joint: usize) -> f64 {
    scene.visits.iter().map(|visit| visit.torques[joint].abs()).fold(0.0, f64::max)
}

impl Effect for LostMotion {
    fn name(&self) -> &'static str {
        "lost_motion"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let loaded = |joint: &usize| scene.masses_known && largest(scene, *joint) > LEAST_TORQUE;
        (0..scene.chain.joint_count()).filter(loaded).map(Site::joint).collect()
    }

    fn shapes(&self, scene: &Scene, site: &Site) -> Vec<Vec<f64>> {
        let Some(joint) = site.joint else { return Vec::new() };
        SHARES.iter().map(|share| vec![share * largest(scene, joint)]).collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(joint) = site.joint else { return Vec::new() };
        vec![vec![Acts::Joint(joint, scene.by_visit(|visit| libm::tanh(visit.torques[joint] / shape[0])))]]
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("amplitude_rad", coefficients[0]), Named::new("torque_scale_nm", shape[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().joint().shape(1..=1)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let amplitude = given.number("amplitude_rad")?;
        Ok(Values::new([given.positive("torque_scale_nm")?], [amplitude]))
    }

    fn lacks(&self, scene: &Scene, _: &Site, _: &[f64]) -> Option<&'static str> {
        (!scene.masses_known).then_some("masses in robot.toml")
    }

    fn refine(&self, _: &Scene, shape: &[f64]) -> Vec<f64> {
        vec![0.65 * shape[0]]
    }
}
