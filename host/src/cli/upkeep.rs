//! `thermokin compensate MODEL --checks RUN`: a model kept true by occasional checks.

use std::path::Path;

use serde_json::json;

use super::Failure;
use super::output::{JsonOption, write_whole};
use crate::calibrate::{Drift, GrowthTerm, Innovation, ObserveOptions, State, Unknown, Upkeep, observe};
use crate::input::InputError;
use crate::model::{Level, Model};
use crate::run;

/// Refused checks beyond this share are no outliers: something has moved.
const TOO_MANY: f64 = 0.3;

/// Takes the checks of a run folder in the order of their times, says what each told, and writes the refined model.
///
/// # Errors
/// Bad input; a model that cannot be refined; checks that mostly contradict it.
pub fn keep(model: &Model, folder: &Path, out: &Path, drift: Drift, json: &JsonOption) -> Result<(), Failure> {
    if model.extended.is_some() {
        let message =
            "the model carries effects, whose parameters belong to its own values; expected one as calibrate wrote it";
        return Err(Failure::Usage(message.to_owned()));
    }
    let run = run::read(folder)?;
    let observed = observe(&model.robot, &run, &ObserveOptions::default(), Some(&model.temperatures))?;
    let mut campaign = observed.campaign;
    let sigma = |name: String| {
        model.estimates.iter().find(|estimate| estimate.name == name).and_then(|estimate| estimate.sigma).unwrap_or(0.0)
    };
    let (mut coefficients, mut sigmas) = (Vec::new(), Vec::new());
    for growth in &model.growth {
        let places =
            (campaign.chain.place(growth.parameter), campaign.sensors.iter().position(|own| *own == growth.sensor));
        let (Some(parameter), Some(sensor)) = places else {
            let message = format!("has no readings of sensor {}, which {} follows", growth.sensor, growth.parameter);
            return Err(InputError::of_file(&folder.join("temperatures.csv"), message).into());
        };
        campaign.growth.push(GrowthTerm { parameter, sensor });
        coefficients.push(growth.coefficient);
        sigmas.push([growth.sigma, sigma(growth.parameter.to_string())]);
    }
    if sigmas.is_empty() {
        return Err(Failure::Usage(
            "the model has no thermal coefficient; expected one that was calibrated with temperatures".to_owned(),
        ));
    }
    let state = State { geometry: model.reference.clone(), growth: coefficients };
    let mut upkeep = Upkeep::new(&campaign, state, &sigmas, drift);
    let taken: Vec<Innovation> =
        campaign.visits.iter().map(|visit| upkeep.take(visit, run.visits[visit.place].time_s)).collect();
    let refused = taken.iter().filter(|check| check.refused).count();
    let refined = refined(model, &upkeep, &campaign.growth);
    let (nis, freedom) = taken
        .iter()
        .filter(|check| !check.refused)
        .fold((0.0, 0), |(nis, freedom), check| (nis + check.nis, freedom + check.freedom));
    if json.leaves_words() {
        println!("{} checks, {refused} of them refused", taken.len());
        for check in taken.iter().filter(|check| check.refused) {
            let visit = &run.visits[check.place];
            println!(
                "  refused: cycle {}, pose {}: {:.3} mm from where it was expected, {:.0} times as far as is probable",
                visit.cycle,
                visit.pose,
                check.distance_m * 1e3,
                (check.nis / check.freedom.max(1) as f64).sqrt()
            );
        }
        println!(
            "  innovations: {nis:.1} for {freedom} coordinates (as many as that where what is believed of drift is right)"
        );
        println!("\n  coefficient      before        now        ± (1-sigma), 1e-6 m/K or rad/K");
        for (before, now) in model.growth.iter().zip(&refined.growth) {
            let name = format!("{}({})", before.parameter, before.sensor);
            println!(
                "  {name:<12} {:+10.3} {:+10.3} {:10.3}",
                before.coefficient * 1e6,
                now.coefficient * 1e6,
                now.sigma * 1e6
            );
        }
    }
    json.write(&json!({
        "format": 1, "command": "compensate", "checks": taken.iter().map(|check| json!({
            "cycle": run.visits[check.place].cycle, "pose": run.visits[check.place].pose, "time_s": check.time_s,
            "distance_mm": check.distance_m * 1e3, "nis": check.nis, "freedom": check.freedom, "refused": check.refused,
        })).collect::<Vec<_>>(),
        "refused": refused, "nis": nis, "freedom": freedom,
    }))?;
    if refused as f64 > TOO_MANY * taken.len() as f64 {
        return Err(Failure::Work(format!(
            "{refused} of {} checks contradict the model: the tracker, the tool or the arm has moved; no model was written",
            taken.len()
        )));
    }
    write_whole(out, refined.to_json().as_bytes())
}

/// The model with the values that the filter came to.
fn refined(model: &Model, upkeep: &Upkeep, growth: &[GrowthTerm]) -> Model {
    let mut refined = model.clone();
    let chain = model.robot.chain();
    for (unknown, sigma) in upkeep.unknowns().iter().zip(upkeep.sigmas()) {
        let value = upkeep.state().value(*unknown);
        match *unknown {
            Unknown::Growth(term) if term < growth.len() => {
                refined.growth[term].coefficient = value;
                refined.growth[term].sigma = sigma;
            }
            Unknown::Parameter(place) => {
                let name = chain.parameters()[place].to_string();
                // What has moved has moved at the reference cycle's geometry too.
                refined.geometric.parameters[place] += value - model.geometry(Level::Thermal).parameters[place];
                refined.reference.parameters[place] = value;
                if let Some(estimate) = refined.estimates.iter_mut().find(|estimate| estimate.name == name) {
                    let widened = |half: f64, before: f64| if before > 0.0 { half * sigma / before } else { half };
                    estimate.half_width =
                        estimate.half_width.zip(estimate.sigma).map(|(half, before)| widened(half, before));
                    estimate.sigma = estimate.sigma.map(|_| sigma);
                    estimate.value = value;
                }
            }
            _ => {}
        }
    }
    refined
}
