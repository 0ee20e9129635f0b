//! A joint that is moved along by another, as in a wrist with common gears: `Δq = ratio · q_from`.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct JointCoupling;

impl Effect for JointCoupling {
    fn name(&self) -> &'static str {
        "joint_coupling"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let joints = scene.chain.joint_count();
        let pairs = (0..joints).flat_map(|from| (0..joints).map(move |joint| (from, joint)));
        pairs
            .filter(|&(from, joint)| from != joint && scene.half_range(from) > 0.0)
            .map(|(from, joint)| Site { from: Some(from), ..Site::joint(joint) })
            .collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, _: &[f64]) -> Vec<Term> {
        let (Some(joint), Some(from)) = (site.joint, site.from) else { return Vec::new() };
        vec![vec![Acts::Joint(joint, scene.by_visit(|visit| visit.joints[from]))]]
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("ratio", coefficients[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().from().joint()
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        Ok(Values::new([], [given.number("ratio")?]))
    }
}
