//! A parameter that grows with temperature although the model keeps it fixed.
//!
//! `Δk = coefficient · rise` of one sensor, or of the mean of a link's sensors: what the sensors of a link say apart from each
//! other is hardly more than their noise.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct ThermalGrowth;

/// The shape is the link and a sensor of it, counted from 1; 0 is their mean.
const MEAN: f64 = 0.0;

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
            shapes.push(vec![link as f64, MEAN]);
            let sensors = scene.sensors_of(link).len();
            if sensors > 1 {
                shapes.extend((1..=sensors).map(|sensor| vec![link as f64, sensor as f64]));
            }
        }
        shapes
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(place) = site.parameter else { return Vec::new() };
        let all = scene.sensors_of(shape[0] as usize);
        let sensors = match all.get((shape[1] as usize).wrapping_sub(1)) {
            Some(one) => std::slice::from_ref(one),
            None => &all[..],
        };
        let mean = scene.by_visit(|visit| {
            sensors.iter().map(|&sensor| visit.rises[sensor]).sum::<f64>() / sensors.len().max(1) as f64
        });
        vec![vec![Acts::Parameter(place, mean)]]
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![
            Named::new("coefficient", coefficients[0]),
            Named::new("link", shape[0]),
            Named::new("sensor_of_link", shape[1]),
        ]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().parameter().shape(2..=2)
    }

    fn values(&self, scene: &Scene, site: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let coefficient = given.number("coefficient")?;
        // Without a word about it, the link that the parameter belongs to.
        let own = site.parameter.map_or(0, |place| scene.chain.parameters()[place].transform);
        let link = given.optional("link")?.unwrap_or(own as f64);
        let sensors = scene.sensors_of(link as usize).len();
        given.require("link", link, sensors > 0, "a link with sensors")?;
        let sensor = given.optional("sensor_of_link")?.unwrap_or(MEAN);
        given.require(
            "sensor_of_link",
            sensor,
            (0..=sensors).any(|one| one as f64 == sensor),
            "a sensor of the link",
        )?;
        Ok(Values::new([link, sensor], [coefficient]))
    }

    fn lacks(&self, scene: &Scene, _: &Site, shape: &[f64]) -> Option<&'static str> {
        let sensors = scene.sensors_of(shape[0] as usize).len();
        (sensors == 0 || shape[1] > sensors as f64).then_some("the sensors that it follows")
    }
}
