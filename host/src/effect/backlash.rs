//! Play in a gear: the joint stops on the side that it came from, `Δq = width / 2 · approach`.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct Backlash;

impl Effect for Backlash {
    fn name(&self) -> &'static str {
        "backlash"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        (0..scene.chain.joint_count())
            .filter(|&joint| scene.visits.iter().any(|visit| visit.approach[joint] != 0.0))
            .map(Site::joint)
            .collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, _: &[f64]) -> Vec<Term> {
        let Some(joint) = site.joint else { return Vec::new() };
        vec![vec![Acts::Joint(joint, scene.by_visit(|visit| 0.5 * visit.approach[joint]))]]
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("width_rad", coefficients[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().joint()
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        Ok(Values::new([], [given.number("width_rad")?]))
    }
}
