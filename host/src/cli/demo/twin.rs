//! The demonstration on two runs of one simulated arm. Only the arm, its heat and the tracker are simulated: the temperatures go
//! through link boards and the logger, and everything after that is what a user's run meets.

use std::path::Path;
use std::time::Instant;

use serde_json::json;

use super::super::Failure;
use super::super::progress::Steps;
use super::super::report::{Material, Sought, as_given, look, make};
use super::link::{Link, SPEED};
use super::{
    Told, findings, found, levels, means, read, timed_calibration, without_effects, write_model, write_report,
};
use crate::calibrate::{ObserveOptions, Refit, Request, validate};
use crate::effect::SiteNames;
use crate::run::{Run, Selection};
use crate::simulate::{HiddenEffect, Scenario, simulate};

/// The run that the arm is calibrated on, and the one that it is tried on.
const SCENARIOS: [(&str, &str); 2] = [("thesis-75-25", "run-75-25"), ("thesis-90-30", "run-90-30")];

/// What the arm hides in both runs, sized so that it shows beside what its gears do otherwise: an eccentric gear.
fn hidden() -> HiddenEffect {
    let parameters = [("amplitude_rad", 1.5e-4), ("phase_rad", 0.4), ("harmonic", 3.0)];
    HiddenEffect {
        effect: "gear_eccentricity".to_owned(),
        place: SiteNames { joint: Some(1), ..SiteNames::default() },
        parameters: parameters.map(|(name, value)| (name.to_owned(), value)).into(),
    }
}

/// What the arm's gears do otherwise, 1-sigma of a posture, rad.
const TRANSMISSION_ERROR_RAD: f64 = 3e-5;

/// Carries it out.
pub fn tell(out: &Path) -> Result<Told, Failure> {
    let begun = Instant::now();
    let mut twins = Vec::new();
    for (name, folder) in SCENARIOS {
        let mut scenario = Scenario::shipped(name).ok_or_else(|| Failure::Work(format!("no scenario {name} ships")))?;
        scenario.arm.transmission_error_rad = TRANSMISSION_ERROR_RAD;
        scenario.effects.push(hidden());
        let simulated = simulate(&scenario).map_err(|error| Failure::Work(format!("{name}: {error}")))?;
        twins.push((scenario, simulated, folder));
    }
    let steps = Steps::new(twins.iter().map(|(_, twin, _)| Link::steps(&twin.run)).sum::<u64>() + 5, "demonstrating");

    let mut link = Link::start(&twins[0].1.robot, out)?;
    let mut spans = Vec::new();
    for (scenario, twin, folder) in &twins {
        spans.push(link.log(folder, &twin.run, &twin.robot, scenario.seed, &steps)?);
    }
    let boards = link.boards();
    let tally = link.end()?;
    let mut assembled = Vec::new();
    for ((_, mut twin, folder), span) in twins.iter().cloned().zip(&spans) {
        let (log, exported) = link.export(span, &twin.run, &out.join(format!("{folder}.log.csv")))?;
        twin.run.temperatures = Some(log);
        let place = out.join(folder);
        twin.write(&place).map_err(|error| Failure::Work(error.to_string()))?;
        assembled.push((read(&place)?, exported, place));
    }
    drop(link);
    steps.done();
    let [(own, exported, folder), (other, _, other_folder)] = &assembled[..] else {
        return Err(Failure::Work("expected two runs".to_owned()));
    };

    let half = own.run.cycles().len() as u32 / 2;
    let first_half = Selection::Cycles(vec![0..=half.saturating_sub(1)]);
    let mask = first_half.mask(&own.run.visits);
    let (calibration, seconds) = timed_calibration(&own.robot, &own.run, |visit| mask[visit.place])?;
    let model = out.join("model.json");
    write_model(&calibration.model, &model)?;
    steps.done();
    let observe = ObserveOptions::default();
    let judge = |model| validate(model, &other.run, &other.robot, &observe, Refit::default(), |_| true);
    let validation = judge(&calibration.model)?;
    steps.done();

    // What it gains is measured on the second run: nothing of the first has to be held out.
    let discovery = look(&own.robot, &own.run, &Request::default(), false)?;
    let (extended, extended_file) = match &discovery {
        Some(discovery) => (discovery.model(), out.join("extended.json")),
        None => (calibration.model.clone(), model.clone()),
    };
    write_model(&extended, &extended_file)?;
    steps.done();
    let with_found = judge(&extended)?;
    let made = make(&Material {
        own,
        taken: None,
        other: Some(other),
        refit: Refit::default(),
        model: (&extended, &extended_file),
        observe,
        discovery: Sought::Done(discovery.as_ref()),
        link: serde_json::from_value(json!(exported)).ok(),
        command: as_given(),
    })?;
    drop(steps);

    let (scenario, ..) = &twins[0];
    let lines = vec![
        format!("twin: a {} with an eccentric gear at joint 1, {}", scenario.robot.name, speeds(scenario)),
        format!(
            "its temperatures went through {boards} virtual link boards and the logger, {SPEED:.0} times as fast: {} readings stored \
             and acknowledged, {} lost",
            tally.readings, tally.lost
        ),
        format!(
            "  runs assembled from the log's export: {}; {}",
            counts(&own.run, folder),
            counts(&other.run, other_folder)
        ),
        format!(
            "calibrated on the first half of the first, {seconds:.2} s: {}: {}",
            found(&calibration),
            model.display()
        ),
        format!("  mean error there: {}", means(&calibration.errors(&calibration.campaign))),
        format!("tried on the second, of which the calibration saw nothing: {}", means(&without_effects(&validation))),
        format!("looked for what the model gets wrong: found {}", findings(&made.results)),
        format!(
            "  with it, calibrated on the whole first run, mean error on the second: {:.3} mm: {}",
            with_found.errors[3].mean_mm,
            extended_file.display()
        ),
        write_report(&made, out)?,
        format!("all this took {:.0} s", begun.elapsed().as_secs_f64()),
    ];
    let result = json!({
        "format": 1, "command": "demo", "data": "simulated",
        "calibration_s": seconds,
        "calibration": levels(&calibration.errors(&calibration.campaign)),
        "validation": levels(&without_effects(&validation)),
        "extended": with_found.errors[3],
        "findings": made.results["discovery"]["findings"],
        "link": {"boards": boards, "readings": tally.readings, "lost": tally.lost, "speed": SPEED, "exported": exported},
        "model": model, "extended_model": extended_file, "runs": [folder, other_folder], "report": out.join("report.html"),
    });
    Ok(Told { lines, result })
}

/// "measured cold, then 14 cycles at 75 % and 9 cycles at 25 % of its speed".
fn speeds(scenario: &Scenario) -> String {
    let phases = scenario
        .schedule
        .phases
        .iter()
        .map(|phase| format!("{} cycles at {:.0} %", phase.cycles, 100.0 * phase.speed_override));
    format!("measured cold, then {} of its speed", phases.collect::<Vec<_>>().join(" and "))
}

fn counts(run: &Run, folder: &Path) -> String {
    let hours = run.visits.last().map_or(0.0, |visit| visit.time_s) / 3600.0;
    format!("{} ({} points in {hours:.1} h)", folder.display(), run.point_count())
}
