//! An encoder whose scale is off: `Δq = gain · q`.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct EncoderGain;

impl Effect for EncoderGain {
    fn name(&self) -> &'static str {
        "encoder_gain"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        (0..scene.chain.joint_count()).filter(|&joint| scene.half_range(joint) > 0.0).map(Site::joint).collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, _: &[f64]) -> Vec<Term> {
        let Some(joint) = site.joint else { return Vec::new() };
        vec![vec![Acts::Joint(joint, scene.by_visit(|visit| visit.joints[joint]))]]
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("gain", coefficients[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().joint()
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        Ok(Values::new([], [given.number("gain")?]))
    }
}
