//! A sensor that has come off: it reads a mix of the body and the air.
//!
//! Reading = (1 - share) · body + share · air, so the body is what was read plus `share / (1 - share)` times what the
//! reading is above the air.

use super::{Acts, Effect, Form, Given, Instance, InstanceError, Named, Readings, Scene, Site, Term, Values};

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

    fn form(&self, _: &Site) -> Form {
        Form::whole().sensors(1)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let share = given.number("air_share")?;
        given.require("air_share", share, (0.0..1.0).contains(&share), "a share from 0 to below 1")?;
        Ok(Values::new([], [share / (1.0 - share)]))
    }

    fn lacks(&self, scene: &Scene, _: &Site, _: &[f64]) -> Option<&'static str> {
        scene.air.is_none().then_some("a sensor of the air")
    }

    fn spoil(&self, scene: &Scene, instance: &Instance, log: &mut [Readings]) {
        let (Some(&sensor), Some(air)) = (instance.site.sensors.first(), &scene.air) else { return };
        let share = instance.coefficients[0] / (1.0 + instance.coefficients[0]);
        for readings in log.iter_mut().filter(|readings| readings.sensor == scene.sensors[sensor].name) {
            for (time, celsius) in readings.times_s.iter().zip(&mut readings.celsius) {
                if let Some(air_c) = air.at(*time, f64::INFINITY).celsius() {
                    *celsius += share * (air_c - *celsius);
                }
            }
        }
    }

    fn is_plausible(&self, _: &[f64], coefficients: &[f64]) -> bool {
        coefficients[0] > 0.0
    }
}
