//! A parameter that follows a temperature by more than a straight line: `Δk = coefficient · rise²`.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct ThermalNonlinearity;

impl Effect for ThermalNonlinearity {
    fn name(&self) -> &'static str {
        "thermal_nonlinearity"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let pairs = scene.growth.iter();
        pairs.map(|growing| Site { parameter: Some(growing.parameter), ..Site::sensor(growing.sensor) }).collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, _: &[f64]) -> Vec<Term> {
        let (Some(place), Some(&sensor)) = (site.parameter, site.sensors.first()) else { return Vec::new() };
        vec![vec![Acts::Parameter(place, scene.by_visit(|visit| visit.rises[sensor].powi(2)))]]
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("coefficient", coefficients[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().parameter().sensors(1)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        Ok(Values::new([], [given.number("coefficient")?]))
    }
}
