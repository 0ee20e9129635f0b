//! What a scenario hides beyond geometry and growth: effects of the catalogue, in the arm, the instrument and the sensors.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::SimulationError;
use super::arm::TrueArm;
use super::scenario::Scenario;
use crate::effect::{
    Acts, Adjustment, Instance, InstanceError, Named, Readings, Scene, Seen, SiteNames, adjustments, by_name,
};
use crate::model::ReferenceTemperature;
use crate::run::{JoinOptions, Run, TemperatureLog};

/// An effect by the names of the contract (`effects.md`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HiddenEffect {
    /// Its name.
    pub effect: String,
    /// Where it sits.
    #[serde(rename = "where", default)]
    pub place: SiteNames,
    /// Its numbers, SI units.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
}

/// What all effects of a scenario do to a run.
pub(super) struct Doing {
    /// To each visit, but for what goes through readings: true temperatures are what the arm follows.
    pub adjustments: Vec<Adjustment>,
    /// The log as the effects spoil it.
    pub log: Option<TemperatureLog>,
}

/// What the scenario's effects do to a run whose positions are yet to be measured.
///
/// # Errors
/// An effect that does not exist, at a place that the arm does not have, with other numbers than it has, or that does
/// nothing here.
pub(super) fn doing(scenario: &Scenario, arm: &TrueArm, run: &Run) -> Result<Doing, SimulationError> {
    let scene = scene(scenario, arm, run);
    let mut instances = Vec::new();
    let mut log = run.temperatures.as_ref().map(readings);
    for (number, hidden) in scenario.effects.iter().enumerate() {
        let refused = |error: InstanceError| SimulationError::Effect { number, message: error.to_string() };
        let instance = instance(hidden, &scene, &run.target_names).map_err(refused)?;
        let before = log.clone();
        if let Some(log) = &mut log {
            instance.effect.spoil(&scene, &instance, log);
        }
        let acts = |act: &Acts| !matches!(act, Acts::Reading(..)) && act.amounts().iter().any(|amount| *amount != 0.0);
        let terms = instance.terms(&scene);
        let mut acting = terms.iter().zip(&instance.coefficients).filter(|(_, coefficient)| **coefficient != 0.0);
        if log == before && !acting.any(|(term, _)| term.iter().any(acts)) {
            let message = format!("{} does nothing in this scenario: {}", hidden.effect, needed(&instance, &scene));
            return Err(SimulationError::Effect { number, message });
        }
        instances.push(instance);
    }
    let log = log.map(|log| {
        let of_sensor = |own: Readings| {
            own.times_s.into_iter().zip(own.celsius).map(move |(time_s, celsius)| (time_s, own.sensor.clone(), celsius))
        };
        TemperatureLog::from_readings(log.into_iter().flat_map(of_sensor))
    });
    Ok(Doing { adjustments: adjustments(&scene, &instances, &arm.targets), log })
}

/// What an effect that does nothing would need.
fn needed(instance: &Instance, scene: &Scene) -> &'static str {
    instance
        .lacks(scene)
        .unwrap_or("what it follows does not change here, or the heat network of the twin has it already")
}

fn instance(hidden: &HiddenEffect, scene: &Scene, targets: &[String]) -> Result<Instance, InstanceError> {
    let effect = by_name(&hidden.effect).ok_or_else(|| InstanceError::NoEffect(hidden.effect.clone()))?;
    let sensors: Vec<String> = scene.sensors.iter().map(|sensor| sensor.name.clone()).collect();
    let site =
        hidden.place.site(&scene.chain, &sensors, targets).ok_or_else(|| InstanceError::NoPlace(effect.name()))?;
    let named: Vec<Named> = hidden.parameters.iter().map(|(name, value)| Named::new(name.clone(), *value)).collect();
    Instance::from_parameters(effect, scene, site, &named)
}

/// The true arm as effects see it. Sensors count from what they read in the first cycle.
fn scene(scenario: &Scenario, arm: &TrueArm, run: &Run) -> Scene {
    let reading = |sensor: &str, time_s: f64| {
        let log = run.temperatures.as_ref()?;
        let series = &log.series[log.index_of(sensor)?];
        series.at(time_s, series.max_gap_s(&JoinOptions::default())).celsius()
    };
    let first = run.visits.first().map(|visit| visit.cycle);
    let references: Vec<ReferenceTemperature> = scenario
        .robot
        .sensors
        .iter()
        .map(|sensor| {
            let cold = run.visits.iter().filter(|visit| Some(visit.cycle) == first);
            let read: Vec<f64> = cold.filter_map(|visit| reading(&sensor.name, visit.time_s)).collect();
            let celsius = read.iter().sum::<f64>() / read.len().max(1) as f64;
            ReferenceTemperature { sensor: sensor.name.clone(), celsius, lowest: celsius, highest: celsius }
        })
        .collect();
    let seen = run.visits.iter().enumerate().map(|(place, visit)| {
        let rise = |reference: &ReferenceTemperature| {
            reading(&reference.sensor, visit.time_s).map_or(0.0, |celsius| celsius - reference.celsius)
        };
        Seen { place, joints: visit.joints.clone(), rises: references.iter().map(rise).collect() }
    });
    let seen: Vec<Seen> = seen.collect();
    let unknown: Vec<usize> = (0..scenario.robot.targets.len()).collect();
    Scene::new(&scenario.robot, run, seen, &arm.cold, &references, arm.targets.clone(), &unknown)
}

fn readings(log: &TemperatureLog) -> Vec<Readings> {
    let of_sensor = |(sensor, series): (&String, &crate::run::TemperatureSeries)| Readings {
        sensor: sensor.clone(),
        times_s: series.times_s().to_vec(),
        celsius: series.celsius().to_vec(),
    };
    log.sensors.iter().zip(&log.series).map(of_sensor).collect()
}
