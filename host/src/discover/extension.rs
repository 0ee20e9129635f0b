//! The extended model: what was found becomes part of the calibrated arm.

use super::discovery::Discovery;
use super::estimate::{Estimate, estimates};
use crate::model::{EffectParameter, Extended, ExtendedGrowth, ExtendedNoise, Model, ModelEffect};

impl Discovery {
    /// The calibrated model with the effects that were found, and with the geometry and growth that were fitted together with
    /// them; the calibration's model as it is where nothing was found.
    pub fn model(&self) -> Model {
        let mut model = self.calibration.model.clone();
        let point = &self.search.last.point;
        if point.effects.is_empty() {
            return model;
        }
        let named = |instance: &crate::effect::Instance| {
            let of_finding = |finding: &&super::Finding| {
                finding.instance.as_ref().is_some_and(|own| own.same_name(instance) && own.shape == instance.shape)
            };
            self.findings.iter().find(of_finding).map(|finding| finding.parameters.clone())
        };
        let effects = point
            .effects
            .iter()
            .zip(&self.search.last.covariances)
            .map(|(instance, covariance)| ModelEffect {
                effect: instance.effect.name(),
                place: instance.site.named(&self.campaign.chain, &self.campaign.sensors, &self.campaign.targets),
                shape: instance.shape.clone(),
                coefficients: instance.coefficients.clone(),
                parameters: named(instance)
                    .unwrap_or_else(|| estimates(instance, covariance, &[]))
                    .into_iter()
                    .map(|Estimate { name, value, low, high }| EffectParameter { name, value, low, high })
                    .collect(),
            })
            .collect();
        let growth = self
            .campaign
            .growth
            .iter()
            .zip(&point.state.growth)
            .map(|(term, &coefficient)| ExtendedGrowth {
                parameter: self.campaign.chain.parameters()[term.parameter],
                sensor: self.campaign.sensors[term.sensor].clone(),
                coefficient,
            })
            .collect();
        model.extended = Some(Extended {
            geometry: point.state.geometry.clone(),
            growth,
            air_reference_c: self.scene.air_reference_c.or_else(|| self.scene.air_at_first()),
            effects,
            noise: Some(ExtendedNoise {
                point: self.noise.point,
                visit_rad: self.noise.visit.clone(),
                posture_rad: self.noise.posture,
                cycle_rad: self.noise.cycle,
            }),
        });
        model
    }
}
