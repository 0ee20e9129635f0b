//! The part of a model's file that holds what discovery added.

use std::path::Path;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::extended::{EffectParameter, Extended, ExtendedGrowth, ExtendedNoise, ModelEffect};
use super::geometry::{Geometry, ReferenceTemperature};
use crate::effect::{Instance, InstanceError, SiteNames, Values, by_name};
use crate::input::InputError;
use crate::robot::{Chain, ParameterId, Robot};

/// `extended` of a model's file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ExtendedEntry {
    how_to_apply: String,
    parameters: Vec<ValueEntry>,
    targets: Vec<PlaceEntry>,
    thermal_coefficients: Vec<GrowthEntry>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    air_reference_c: Option<f64>,
    effects: Vec<EffectEntry>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    noise: Option<NoiseEntry>,
}

/// Standard deviations of what is left.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NoiseEntry {
    /// In units of the instrument's.
    point: f64,
    visit_rad: Vec<f64>,
    posture_rad: f64,
    cycle_rad: f64,
}

/// How the extended values are to be used.
const HOW_TO_APPLY: &str = "These values replace those of the same names above when the effects are applied; parameters of \
an effect are the contract's, and what it adds follows from them.";

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ValueEntry {
    name: String,
    unit: String,
    value: f64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlaceEntry {
    name: String,
    position: [f64; 3],
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct GrowthEntry {
    parameter: String,
    sensor: String,
    unit: String,
    value: f64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EffectEntry {
    effect: String,
    #[serde(rename = "where")]
    place: SiteNames,
    parameters: Vec<EffectParameterEntry>,
    shape: Vec<f64>,
    coefficients: Vec<f64>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EffectParameterEntry {
    name: String,
    value: f64,
    low: f64,
    high: f64,
}

impl ExtendedEntry {
    pub(super) fn of(extended: &Extended, robot: &Robot) -> Self {
        let chain = robot.chain();
        let parameters = chain.parameters().iter().zip(&extended.geometry.parameters).map(|(id, &value)| ValueEntry {
            name: id.to_string(),
            unit: id.symbol.unit().to_owned(),
            value,
        });
        let targets = robot
            .targets
            .iter()
            .zip(&extended.geometry.targets)
            .map(|(target, &place)| PlaceEntry { name: target.name.clone(), position: place.into() });
        let growth = extended.growth.iter().map(|growth| GrowthEntry {
            parameter: growth.parameter.to_string(),
            sensor: growth.sensor.clone(),
            unit: format!("{}/K", growth.parameter.symbol.unit()),
            value: growth.coefficient,
        });
        let effects = extended.effects.iter().map(|effect| EffectEntry {
            effect: effect.effect.to_owned(),
            place: effect.place.clone(),
            parameters: effect
                .parameters
                .iter()
                .map(|EffectParameter { name, value, low, high }| EffectParameterEntry {
                    name: name.clone(),
                    value: *value,
                    low: *low,
                    high: *high,
                })
                .collect(),
            shape: effect.shape.clone(),
            coefficients: effect.coefficients.clone(),
        });
        Self {
            how_to_apply: HOW_TO_APPLY.to_owned(),
            parameters: parameters.collect(),
            targets: targets.collect(),
            thermal_coefficients: growth.collect(),
            air_reference_c: extended.air_reference_c,
            effects: effects.collect(),
            noise: extended.noise.as_ref().map(|noise| NoiseEntry {
                point: noise.point,
                visit_rad: noise.visit_rad.clone(),
                posture_rad: noise.posture_rad,
                cycle_rad: noise.cycle_rad,
            }),
        }
    }

    /// Checked against the rest of the file; orientations and anchors are the reference's.
    pub(super) fn read(
        self,
        file: &Path,
        robot: &Robot,
        reference: &Geometry,
        temperatures: &[ReferenceTemperature],
    ) -> Result<Extended, InputError> {
        let fail = |message: String| InputError::of_file(file, format!("extended: {message}"));
        let chain = robot.chain();
        let names = chain.parameters().iter().map(ToString::to_string);
        if !names.eq(self.parameters.iter().map(|entry| entry.name.clone())) {
            return Err(fail("parameters are not those of the robot".to_owned()));
        }
        if !robot.targets.iter().map(|target| &target.name).eq(self.targets.iter().map(|entry| &entry.name)) {
            return Err(fail("targets are not those of the robot".to_owned()));
        }
        let sensors: Vec<String> = temperatures.iter().map(|reference| reference.sensor.clone()).collect();
        let growth = self
            .thermal_coefficients
            .into_iter()
            .map(|entry| {
                let unknown = || fail(format!("thermal coefficient of {}: no such parameter", entry.parameter));
                let parameter: ParameterId = entry.parameter.parse().map_err(|_| unknown())?;
                chain.place(parameter).ok_or_else(unknown)?;
                Ok(ExtendedGrowth { parameter, sensor: entry.sensor, coefficient: entry.value })
            })
            .collect::<Result<Vec<_>, InputError>>()?;
        let effects = self
            .effects
            .into_iter()
            .enumerate()
            .map(|(number, entry)| {
                entry.read(&chain, &sensors, robot).map_err(|error| fail(format!("effect {}: {error}", number + 1)))
            })
            .collect::<Result<Vec<_>, InputError>>()?;
        let noise = self.noise.map(|NoiseEntry { point, visit_rad, posture_rad, cycle_rad }| ExtendedNoise {
            point,
            visit_rad,
            posture_rad,
            cycle_rad,
        });
        if let Some(noise) = &noise {
            let sizes = [noise.point, noise.posture_rad, noise.cycle_rad];
            let is_right = |size: &f64| size.is_finite() && *size >= 0.0;
            if noise.visit_rad.len() != chain.joint_count() || !sizes.iter().chain(&noise.visit_rad).all(is_right) {
                return Err(fail(format!(
                    "noise: expected sizes of 0 or more, visit_rad one for each of {} joints",
                    chain.joint_count()
                )));
            }
        }
        Ok(Extended {
            geometry: Geometry {
                parameters: self.parameters.iter().map(|entry| entry.value).collect(),
                targets: self.targets.iter().map(|entry| Vector3::from(entry.position)).collect(),
                ..reference.clone()
            },
            growth,
            air_reference_c: self.air_reference_c,
            effects,
            noise,
        })
    }
}

impl EffectEntry {
    fn read(self, chain: &Chain, sensors: &[String], robot: &Robot) -> Result<ModelEffect, InstanceError> {
        let kind = by_name(&self.effect).ok_or_else(|| InstanceError::NoEffect(self.effect.clone()))?;
        let targets: Vec<String> = robot.targets.iter().map(|target| target.name.clone()).collect();
        let site = self.place.site(chain, sensors, &targets).ok_or_else(|| InstanceError::NoPlace(kind.name()))?;
        // Made once to be checked; a run has its own sensors, and so its own instance.
        let checked = Instance::new(kind, site, Values::new(self.shape, self.coefficients))?;
        Ok(ModelEffect {
            effect: kind.name(),
            place: self.place,
            shape: checked.shape,
            coefficients: checked.coefficients,
            parameters: self
                .parameters
                .into_iter()
                .map(|entry| EffectParameter { name: entry.name, value: entry.value, low: entry.low, high: entry.high })
                .collect(),
        })
    }
}
