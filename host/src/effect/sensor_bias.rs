//! A sensor whose zero moves: a step in its reading at one time, or a steady drift. A constant one cannot be seen: only
//! rises count.

use super::frame_jump::{step_reach, step_times};
use super::{Acts, Effect, Named, Scene, Site, Term};

/// The effect.
pub struct SensorBias;

/// The shape is a kind and a time: a drift has none.
pub(crate) const STEP: f64 = 0.0;
pub(crate) const DRIFT: f64 = 1.0;

/// Step times that are tried here: the readings themselves tell the time better.
const EVERY: usize = 5;

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
        let amounts = scene.by_visit(|visit| match shape[0] {
            DRIFT => -(visit.time_s - shape[1]) / 3600.0,
            _ if visit.time_s >= shape[1] => -1.0,
            _ => 0.0,
        });
        vec![vec![Acts::Reading(sensor, amounts)]]
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        match shape[0] {
            DRIFT => vec![Named::new("drift_k_per_h", coefficients[0])],
            _ => vec![Named::new("time_s", shape[1]), Named::new("step_k", coefficients[0])],
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
