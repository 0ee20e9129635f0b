//! An instrument whose metre is not a metre: coordinates scaled about it.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct ScaleError;

impl Effect for ScaleError {
    fn name(&self) -> &'static str {
        "scale_error"
    }

    fn sites(&self, _: &Scene) -> Vec<Site> {
        vec![Site::whole()]
    }

    fn terms(&self, scene: &Scene, _: &Site, _: &[f64]) -> Vec<Term> {
        vec![vec![Acts::Scale(scene.by_visit(|_| 1.0))]]
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("scale", coefficients[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole()
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        Ok(Values::new([], [given.number("scale")?]))
    }
}
