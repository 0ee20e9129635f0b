//! The instrument and the base move against each other, steadily.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct FrameDrift;

pub(super) const AXES: [&str; 3] = ["x", "y", "z"];

/// Six numbers of a motion by their names.
pub(super) fn motion_names(along: &str, about: &str, coefficients: &[f64]) -> Vec<Named> {
    let name = |(axis, value): (usize, &f64)| {
        let unit = if axis < 3 { along } else { about };
        let (kind, unit) = unit.split_once(' ').unwrap_or((unit, ""));
        Named::new(format!("{kind}_{}_{unit}", AXES[axis % 3]), *value)
    };
    coefficients.iter().enumerate().map(name).collect()
}

/// Six terms of a motion of the world, each with the same amounts.
pub(super) fn world(amounts: &[f64]) -> Vec<Term> {
    (0..6).map(|axis| vec![Acts::World(axis, amounts.to_vec())]).collect()
}

impl Effect for FrameDrift {
    fn name(&self) -> &'static str {
        "frame_drift"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let (first, last) = scene.span_s();
        if last > first { vec![Site::whole()] } else { Vec::new() }
    }

    fn terms(&self, scene: &Scene, _: &Site, _: &[f64]) -> Vec<Term> {
        world(&scene.by_visit(|visit| visit.time_s - scene.origin_s))
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        motion_names("shift m_per_s", "turn rad_per_s", coefficients)
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().coefficients(6..=6)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let mut coefficients = given.vector("shift", "m_per_s")?;
        coefficients.extend(given.vector("turn", "rad_per_s")?);
        Ok(Values::new([], coefficients))
    }

    fn is_of_run(&self) -> bool {
        true
    }
}
