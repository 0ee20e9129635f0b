//! A sensor whose zero moves: a step in its reading at one time, or a steady drift. A constant one cannot be seen: only
//! rises count.

use super::frame_jump::{step_reach, step_times};
use super::{Acts, Effect, Form, Given, Instance, InstanceError, Named, Readings, Scene, Site, Term, Values};

/// The effect.
pub struct SensorBias;

/// The shape is a kind and a time: a drift has none.
pub(crate) const STEP: f64 = 0.0;
pub(crate) const DRIFT: f64 = 1.0;

/// Step times that are tried here: the readings themselves tell the time better.
const EVERY: usize = 5;

/// What the reading has too much at a time for a unit of the coefficient.
fn excess(shape: &[f64], time_s: f64) -> f64 {
    match shape[0] {
        DRIFT => (time_s - shape[1]) / 3600.0,
        _ if time_s >= shape[1] => 1.0,
        _ => 0.0,
    }
}

impl Effect for SensorBias {
    fn name(&self) -> &'static str {
        "sensor_bias"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        scene.driving_sensors().into_iter().map(Site::sensor).collect()
    }

    fn shapes(&self, scene: &Scene, _: &Site) -> Vec<Vec<f64>> {
        let steps = step_times(scene).into_iter().step_by(EVERY).map(|time| vec![STEP, time[0]]);
        steps.chain([vec![DRIFT, scene.span_s().0]]).collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(&sensor) = site.sensors.first() else { return Vec::new() };
        // What the reading has too much, the body has not.
        let amounts = scene.by_visit(|visit| -excess(shape, visit.time_s));
        vec![vec![Acts::Reading(sensor, amounts)]]
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        match shape[0] {
            DRIFT => vec![Named::new("drift_k_per_h", coefficients[0])],
            _ => vec![Named::new("time_s", shape[1]), Named::new("step_k", coefficients[0])],
        }
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().sensors(1).shape(2..=2)
    }

    fn values(&self, scene: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        if let Some(drift) = given.optional("drift_k_per_h")? {
            return Ok(Values::new([DRIFT, scene.span_s().0], [drift]));
        }
        let step = given.number("step_k")?;
        Ok(Values::new([STEP, given.number("time_s")?], [step]))
    }

    fn spoil(&self, scene: &Scene, instance: &Instance, log: &mut [Readings]) {
        let Some(&sensor) = instance.site.sensors.first() else { return };
        for readings in log.iter_mut().filter(|readings| readings.sensor == scene.sensors[sensor].name) {
            for (time, celsius) in readings.times_s.iter().zip(&mut readings.celsius) {
                *celsius += instance.coefficients[0] * excess(&instance.shape, *time);
            }
        }
    }

    fn refine(&self, scene: &Scene, shape: &[f64]) -> Vec<f64> {
        vec![0.0, if shape[0] == STEP { EVERY as f64 * step_reach(scene) } else { 0.0 }]
    }

    fn of_readings(&self) -> bool {
        true
    }

    fn is_smooth(&self) -> bool {
        false
    }

    fn is_of_run(&self) -> bool {
        true
    }
}
