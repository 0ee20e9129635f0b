//! The instrument or the base was knocked: a rigid motion between them from one time on.

use super::frame_drift::{motion_names, world};
use super::{Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct FrameJump;

/// The times at which a step may have come: between visits, as many as are worth telling apart.
pub(super) fn step_times(scene: &Scene) -> Vec<Vec<f64>> {
    let mut times: Vec<f64> = scene.visits.windows(2).map(|pair| 0.5 * (pair[0].time_s + pair[1].time_s)).collect();
    times.dedup();
    let most = 160;
    let every = times.len().div_ceil(most).max(1);
    times.into_iter().enumerate().filter(|(place, _)| place % every == every / 2).map(|(_, time)| vec![time]).collect()
}

/// Half the way to the neighbours on that grid.
pub(super) fn step_reach(scene: &Scene) -> f64 {
    let (first, last) = scene.span_s();
    (last - first) / 100.0
}

/// The way back from the parameters of a motion at one time.
pub(super) fn motion_at_a_time(given: &mut Given) -> Result<Values, InstanceError> {
    let time = given.number("time_s")?;
    let mut coefficients = given.vector("shift", "m")?;
    coefficients.extend(given.vector("turn", "rad")?);
    Ok(Values::new([time], coefficients))
}

impl Effect for FrameJump {
    fn name(&self) -> &'static str {
        "frame_jump"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let (first, last) = scene.span_s();
        if last > first { vec![Site::whole()] } else { Vec::new() }
    }

    fn shapes(&self, scene: &Scene, _: &Site) -> Vec<Vec<f64>> {
        step_times(scene)
    }

    fn terms(&self, scene: &Scene, _: &Site, shape: &[f64]) -> Vec<Term> {
        world(&scene.by_visit(|visit| if visit.time_s >= shape[0] { 1.0 } else { 0.0 }))
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
