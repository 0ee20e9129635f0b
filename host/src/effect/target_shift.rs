//! A target that sits elsewhere in the flange frame, from one time on or for the whole run.

use super::frame_drift::AXES;
use super::frame_jump::{step_reach, step_times};
use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct TargetShift;

impl Effect for TargetShift {
    fn name(&self) -> &'static str {
        "target_shift"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        (0..scene.targets.len()).map(Site::target).collect()
    }

    fn shapes(&self, scene: &Scene, site: &Site) -> Vec<Vec<f64>> {
        let mut shapes = step_times(scene);
        let unknown = site.targets.first().is_some_and(|&target| scene.unknown_targets[target]);
        if !unknown {
            // For the whole run: the time of the first visit.
            shapes.insert(0, vec![scene.span_s().0]);
        }
        shapes
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(&target) = site.targets.first() else { return Vec::new() };
        let amounts = scene.by_visit(|visit| if visit.time_s >= shape[0] { 1.0 } else { 0.0 });
        (0..3).map(|axis| vec![Acts::Target(target, axis, amounts.clone())]).collect()
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        let mut named = vec![Named::new("time_s", shape[0])];
        named.extend(AXES.iter().zip(coefficients).map(|(axis, value)| Named::new(format!("shift_{axis}_m"), *value)));
        named
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().targets(1).shape(1..=1).coefficients(3..=3)
    }

    fn values(&self, scene: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        // For the whole run where no time is given.
        let time = given.optional("time_s")?.unwrap_or(scene.span_s().0);
        Ok(Values::new([time], given.vector("shift", "m")?))
    }

    fn refine(&self, scene: &Scene, shape: &[f64]) -> Vec<f64> {
        vec![if shape[0] <= scene.span_s().0 { 0.0 } else { step_reach(scene) }]
    }

    fn is_smooth(&self) -> bool {
        false
    }

    fn is_of_run(&self) -> bool {
        true
    }
}
