//! Two sensors that carry each other's names.

use super::{Acts, Effect, Form, Given, Instance, InstanceError, Named, Readings, Scene, Site, Term, Values};

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

    fn form(&self, _: &Site) -> Form {
        Form::whole().sensors(2)
    }

    fn values(&self, _: &Scene, _: &Site, _: &mut Given) -> Result<Values, InstanceError> {
        Ok(Values::new([], [1.0]))
    }

    fn spoil(&self, scene: &Scene, instance: &Instance, log: &mut [Readings]) {
        let [one, other] = instance.site.sensors[..] else { return };
        let names = [&scene.sensors[one].name, &scene.sensors[other].name];
        for readings in log.iter_mut() {
            if let Some(place) = names.iter().position(|name| **name == readings.sensor) {
                readings.sensor = names[1 - place].clone();
            }
        }
    }

    fn of_readings(&self) -> bool {
        true
    }

    fn fixed_coefficient(&self) -> Option<f64> {
        Some(1.0)
    }

    fn is_of_run(&self) -> bool {
        true
    }
}
