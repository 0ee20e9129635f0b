//! A parameter that follows its temperatures late: through a first-order lag.
//!
//! `Δk = Σ coefficient · (lagged rise - rise)` with the model's own coefficients: the coefficient of this term is one when
//! the lag is right, and is fitted so that its size tells whether it is there at all.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct ThermalLag;

/// Lags that are tried, seconds: less cannot be seen in cycles of minutes, more never comes to rest within a run.
const LAGS_S: [f64; 9] = [60.0, 120.0, 240.0, 420.0, 700.0, 1100.0, 1800.0, 3000.0, 5000.0];

impl Effect for ThermalLag {
    fn name(&self) -> &'static str {
        "thermal_lag"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        scene.growing_parameters().into_iter().map(Site::parameter).collect()
    }

    fn shapes(&self, _: &Scene, _: &Site) -> Vec<Vec<f64>> {
        LAGS_S.iter().map(|&tau| vec![tau]).collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(place) = site.parameter else { return Vec::new() };
        let mut amounts = vec![0.0; scene.visits.len()];
        for growing in scene.growth.iter().filter(|growing| growing.parameter == place) {
            let lagged = scene.lagged(growing.sensor, shape[0]);
            for ((amount, late), visit) in amounts.iter_mut().zip(lagged).zip(&scene.visits) {
                *amount += growing.coefficient * (late - visit.rises[growing.sensor]);
            }
        }
        vec![vec![Acts::Parameter(place, amounts)]]
    }

    fn parameters(&self, _: &Site, shape: &[f64], _: &[f64]) -> Vec<Named> {
        vec![Named::new("tau_s", shape[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().parameter().shape(1..=1)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        Ok(Values::new([given.positive("tau_s")?], [1.0]))
    }

    fn lacks(&self, scene: &Scene, site: &Site, _: &[f64]) -> Option<&'static str> {
        let mut own = scene.growth.iter().filter(|growing| site.parameter == Some(growing.parameter));
        own.any(|growing| scene.sensors[growing.sensor].series.times_s().is_empty()).then_some("the temperature log")
    }

    fn refine(&self, _: &Scene, shape: &[f64]) -> Vec<f64> {
        vec![0.6 * shape[0]]
    }

    fn fixed_coefficient(&self) -> Option<f64> {
        Some(1.0)
    }

    fn growth_derivative(&self, scene: &Scene, site: &Site, shape: &[f64], growing: usize) -> Option<Vec<f64>> {
        let growing = scene.growth[growing];
        (site.parameter == Some(growing.parameter)).then(|| {
            let late = scene.lagged(growing.sensor, shape[0]);
            late.iter().zip(&scene.visits).map(|(late, visit)| late - visit.rises[growing.sensor]).collect()
        })
    }
}
