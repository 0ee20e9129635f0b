//! The tool slipped on the flange: all targets move rigidly in the flange frame at one time.

use super::frame_drift::motion_names;
use super::frame_jump::{motion_at_a_time, step_reach, step_times};
use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct ToolSlip;

impl Effect for ToolSlip {
    fn name(&self) -> &'static str {
        "tool_slip"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let (first, last) = scene.span_s();
        // One target that moves is a target that moves.
        if last > first && scene.targets.len() > 1 { vec![Site::whole()] } else { Vec::new() }
    }

    fn shapes(&self, scene: &Scene, _: &Site) -> Vec<Vec<f64>> {
        step_times(scene)
    }

    fn terms(&self, scene: &Scene, _: &Site, shape: &[f64]) -> Vec<Term> {
        let amounts = scene.by_visit(|visit| if visit.time_s >= shape[0] { 1.0 } else { 0.0 });
        (0..6).map(|axis| vec![Acts::Tool(axis, amounts.clone())]).collect()
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        let mut named = vec![Named::new("time_s", shape[0])];
        named.extend(motion_names("shift m", "turn rad", coefficients));
        named
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().shape(1..=1).coefficients(6..=6)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        motion_at_a_time(given)
    }

    fn refine(&self, scene: &Scene, _: &[f64]) -> Vec<f64> {
        vec![step_reach(scene)]
    }

    fn is_smooth(&self) -> bool {
        false
    }

    fn is_of_run(&self) -> bool {
        true
    }
}
