//! A sensor that has come off: it reads a mix of the body and the air.
//!
//! Reading = (1 - share) · body + share · air, so the body is what was read plus `share / (1 - share)` times what the
//! reading is above the air.

use super::{Acts, Effect, Named, Scene, Site, Term};

/// The effect.
pub struct SensorDetached;

impl Effect for SensorDetached {
    fn name(&self) -> &'static str {
        "sensor_detached"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        if scene.air.is_none() { Vec::new() } else { scene.driving_sensors().into_iter().map(Site::sensor).collect() }
    }

    fn terms(&self, scene: &Scene, site: &Site, _: &[f64]) -> Vec<Term> {
        let (Some(&sensor), Some(air)) = (site.sensors.first(), scene.air_rises()) else { return Vec::new() };
        let amounts = scene.visits.iter().zip(air).map(|(visit, air)| visit.rises[sensor] - air).collect();
        vec![vec![Acts::Reading(sensor, amounts)]]
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("air_share", coefficients[0] / (1.0 + coefficients[0]))]
    }

    fn of_readings(&self) -> bool {
        true
    }

    fn is_plausible(&self, _: &[f64], coefficients: &[f64]) -> bool {
        coefficients[0] > 0.0
    }
}
