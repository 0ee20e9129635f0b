//! Heat that no sensor sees: a parameter follows a joint's mean squared speed through a first-order lag.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct UnsensedHeat;

/// Lags that are tried, seconds.
const LAGS_S: [f64; 5] = [200.0, 500.0, 1100.0, 2400.0, 5000.0];

impl Effect for UnsensedHeat {
    fn name(&self) -> &'static str {
        "unsensed_heat"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        if scene.motion.is_empty() || scene.cycles().len() < 3 {
            return Vec::new();
        }
        let parameters = scene.chain.parameters().iter().enumerate().filter(|(_, id)| id.transform > 0);
        let moves = |joint: &usize| scene.motion.iter().any(|step| step.rms[*joint] > 0.0);
        let joints: Vec<usize> = (0..scene.chain.joint_count()).filter(moves).collect();
        parameters
            .flat_map(|(place, _)| {
                joints.iter().map(move |&joint| Site { parameter: Some(place), ..Site::joint(joint) })
            })
            .collect()
    }

    fn shapes(&self, _: &Scene, _: &Site) -> Vec<Vec<f64>> {
        LAGS_S.iter().map(|&tau| vec![tau]).collect()
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let (Some(place), Some(joint)) = (site.parameter, site.joint) else { return Vec::new() };
        vec![vec![Acts::Parameter(place, scene.driven(joint, shape[0]))]]
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("coefficient", coefficients[0]), Named::new("tau_s", shape[0])]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().joint().parameter().shape(1..=1)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let coefficient = given.number("coefficient")?;
        Ok(Values::new([given.positive("tau_s")?], [coefficient]))
    }

    fn lacks(&self, scene: &Scene, _: &Site, _: &[f64]) -> Option<&'static str> {
        scene.motion.is_empty().then_some("motion.csv")
    }

    fn refine(&self, _: &Scene, shape: &[f64]) -> Vec<f64> {
        vec![0.6 * shape[0]]
    }
}
