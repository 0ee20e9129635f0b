//! A parameter that grows with temperature although the model keeps it fixed.
//!
//! `Δk = Σ coefficient · rise` over the sensors of one link: one coefficient for their mean, or one each.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct ThermalGrowth;

/// The shape is the link, and whether its sensors share a coefficient or have one each.
const SHARED: f64 = 0.0;
const EACH: f64 = 1.0;

fn sensors(scene: &Scene, shape: &[f64]) -> Vec<usize> {
    scene.sensors_of(shape[0] as usize)
}

impl Effect for ThermalGrowth {
    fn name(&self) -> &'static str {
        "thermal_growth"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        if scene.sensors.is_empty() || scene.cycles().len() < 3 {
            return Vec::new();
        }
        let growing = scene.growing_parameters();
        let parameters = scene.chain.parameters().iter().enumerate();
        parameters
            .filter(|(place, id)| id.transform > 0 && !growing.contains(place))
            .map(|(place, _)| Site::parameter(place))
            .collect()
    }

    fn shapes(&self, scene: &Scene, _: &Site) -> Vec<Vec<f64>> {
        let mut shapes = Vec::new();
        for link in scene.sensed_links() {
            shapes.push(vec![link as f64, SHARED]);
            if scene.sensors_of(link).len() > 1 {
                shapes.push(vec![link as f64, EACH]);
            }
        }
        shapes
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(place) = site.parameter else { return Vec::new() };
        let sensors = sensors(scene, shape);
        if shape[1] == EACH {
            let one = |&sensor: &usize| vec![Acts::Parameter(place, scene.by_visit(|visit| visit.rises[sensor]))];
            return sensors.iter().map(one).collect();
        }
        let mean = scene.by_visit(|visit| {
            sensors.iter().map(|&sensor| visit.rises[sensor]).sum::<f64>() / sensors.len().max(1) as f64
        });
        vec![vec![Acts::Parameter(place, mean)]]
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        let mut named = match coefficients {
            [one] => vec![Named::new("coefficient", *one)],
            many => (1..).zip(many).map(|(n, value)| Named::new(format!("coefficient_{n}"), *value)).collect(),
        };
        named.push(Named::new("link", shape[0]));
        named
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().parameter().shape(2..=2).coefficients(1..=usize::MAX)
    }

    fn values(&self, scene: &Scene, site: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let coefficients = given.numbered("coefficient", |number| format!("coefficient_{number}"))?;
        // Without a word about it, the link that the parameter belongs to.
        let own = site.parameter.map_or(0, |place| scene.chain.parameters()[place].transform);
        let link = given.optional("link")?.unwrap_or(own as f64);
        given.require("link", link, !sensors(scene, &[link]).is_empty(), "a link with sensors")?;
        let kind = if coefficients.len() == 1 { SHARED } else { EACH };
        Ok(Values::new([link, kind], coefficients))
    }

    fn lacks(&self, scene: &Scene, _: &Site, shape: &[f64]) -> Option<&'static str> {
        sensors(scene, shape).is_empty().then_some("the sensors that it follows")
    }
}
