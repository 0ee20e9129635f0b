//! The temperature log runs early or late against the poses: logged time less true time.
//!
//! What stood at a visit's true time is logged at that time plus the offset.

use super::{Acts, Effect, Form, Given, Instance, InstanceError, Named, Readings, Scene, Site, Term, Values};

/// The effect.
pub struct ClockOffset;

/// Offsets that are tried, seconds.
const OFFSETS_S: [f64; 12] = [-900.0, -480.0, -240.0, -120.0, -60.0, -30.0, 30.0, 60.0, 120.0, 240.0, 480.0, 900.0];

impl Effect for ClockOffset {
    fn name(&self) -> &'static str {
        "clock_offset"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        if scene.growth.is_empty() { Vec::new() } else { vec![Site::whole()] }
    }

    fn shapes(&self, _: &Scene, _: &Site) -> Vec<Vec<f64>> {
        OFFSETS_S.iter().map(|&offset| vec![offset]).collect()
    }

    fn terms(&self, scene: &Scene, _: &Site, shape: &[f64]) -> Vec<Term> {
        let sensors = scene.driving_sensors().into_iter();
        vec![sensors.map(|sensor| Acts::Reading(sensor, scene.shifted(sensor, shape[0]))).collect()]
    }

    fn parameters(&self, _: &Site, shape: &[f64], _: &[f64]) -> Vec<Named> {
        vec![Named::new("offset_s", shape[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().shape(1..=1)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        Ok(Values::new([given.number("offset_s")?], [1.0]))
    }

    fn spoil(&self, _: &Scene, instance: &Instance, log: &mut [Readings]) {
        for time in log.iter_mut().flat_map(|readings| &mut readings.times_s) {
            *time += instance.shape[0];
        }
    }

    fn refine(&self, _: &Scene, shape: &[f64]) -> Vec<f64> {
        vec![0.5 * shape[0].abs()]
    }

    fn fixed_coefficient(&self) -> Option<f64> {
        Some(1.0)
    }

    fn is_of_run(&self) -> bool {
        true
    }
}
