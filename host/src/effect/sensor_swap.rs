//! Two sensors that carry each other's names.

use super::{Acts, Effect, Named, Scene, Site, Term};

/// The effect.
pub struct SensorSwap;

impl Effect for SensorSwap {
    fn name(&self) -> &'static str {
        "sensor_swap"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let sensors = scene.driving_sensors();
        let mut sites = Vec::new();
        for (place, &one) in sensors.iter().enumerate() {
            // On one link the names say nothing: each sensor has its own coefficient.
            let others =
                sensors[place + 1..].iter().filter(|&&other| scene.sensors[other].link != scene.sensors[one].link);
            sites.extend(others.map(|&other| Site { sensors: vec![one, other], ..Site::default() }));
        }
        sites
    }

    fn terms(&self, scene: &Scene, site: &Site, _: &[f64]) -> Vec<Term> {
        let [one, other] = site.sensors[..] else { return Vec::new() };
        let difference = scene.by_visit(|visit| visit.rises[other] - visit.rises[one]);
        let opposite = difference.iter().map(|value| -value).collect();
        vec![vec![Acts::Reading(one, difference), Acts::Reading(other, opposite)]]
    }

    fn parameters(&self, _: &Site, _: &[f64], _: &[f64]) -> Vec<Named> {
        Vec::new()
    }

    fn of_readings(&self) -> bool {
        true
    }

    fn fixed_coefficient(&self) -> Option<f64> {
        Some(1.0)
    }
}
