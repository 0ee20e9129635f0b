//! A sensor that the draught cools while the robot moves: its reading falls below the body and recovers after.
//!
//! The reading errs by `-depth · x` with `x` following motion (1) and rest (0) through a first-order lag; the body's rise is
//! what was read plus that depth.

use super::{Acts, Effect, Form, Given, Instance, InstanceError, Named, Readings, Scene, Site, Term, Values};

/// The effect.
pub struct SensorChill;

/// Time constants that are tried, seconds.
pub(crate) const LAGS_S: [f64; 8] = [20.0, 40.0, 70.0, 110.0, 170.0, 260.0, 420.0, 700.0];

impl Effect for SensorChill {
    fn name(&self) -> &'static str {
        "sensor_chill"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        if scene.motion.is_empty() {
            Vec::new()
        } else {
            scene.driving_sensors().into_iter().map(Site::sensor).collect()
        }
    }

    fn shapes(&self, _: &Scene, _: &Site) -> Vec<Vec<f64>> {
        LAGS_S.iter().map(|&tau| vec![tau]).collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(&sensor) = site.sensors.first() else { return Vec::new() };
        vec![vec![Acts::Reading(sensor, scene.stirred(shape[0]))]]
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("depth_k", coefficients[0]), Named::new("tau_s", shape[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().sensors(1).shape(1..=1)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let depth = given.number("depth_k")?;
        Ok(Values::new([given.positive("tau_s")?], [depth]))
    }

    fn lacks(&self, scene: &Scene, _: &Site, _: &[f64]) -> Option<&'static str> {
        scene.motion.is_empty().then_some("motion.csv")
    }

    fn spoil(&self, scene: &Scene, instance: &Instance, log: &mut [Readings]) {
        let Some(&sensor) = instance.site.sensors.first() else { return };
        for readings in log.iter_mut().filter(|readings| readings.sensor == scene.sensors[sensor].name) {
            let stirred = scene.stirred_at(instance.shape[0], &readings.times_s);
            for (celsius, stirred) in readings.celsius.iter_mut().zip(stirred) {
                *celsius -= instance.coefficients[0] * stirred;
            }
        }
    }

    fn refine(&self, _: &Scene, shape: &[f64]) -> Vec<f64> {
        vec![0.5 * shape[0]]
    }

    fn of_readings(&self) -> bool {
        true
    }

    fn is_plausible(&self, _: &[f64], coefficients: &[f64]) -> bool {
        coefficients[0] > 0.0
    }
}
