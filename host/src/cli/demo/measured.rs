//! The demonstration on measured data that ship.

use std::path::Path;

use serde_json::json;

use super::super::Failure;
use super::super::report::{Material, Sought, as_given, make};
use super::{
    Told, found, levels, means, read, timed_calibration, unwritable, without_effects, write_model, write_report,
};
use crate::calibrate::{ObserveOptions, Refit, validate};
use crate::run::Selection;

/// The measured example: its files by name.
const EXAMPLE: [(&str, &str); 7] = [
    ("LICENSE", include_str!("../../../data/ur10/LICENSE")),
    ("SOURCE.txt", include_str!("../../../data/ur10/SOURCE.txt")),
    ("robot.toml", include_str!("../../../data/ur10/robot.toml")),
    ("poses.csv", include_str!("../../../data/ur10/poses.csv")),
    ("points.csv", include_str!("../../../data/ur10/points.csv")),
    ("temperatures.csv", include_str!("../../../data/ur10/temperatures.csv")),
    ("run.toml", include_str!("../../../data/ur10/run.toml")),
];

/// The share of the example's poses that it is calibrated on.
const EXAMPLE_POSES: Selection = Selection::Every { step: 10, offset: 0 };

/// The measured example: calibrated on every tenth pose, tried on all others.
pub fn tell(out: &Path) -> Result<Told, Failure> {
    let folder = out.join("ur10");
    std::fs::create_dir_all(&folder).map_err(|error| unwritable(&folder, &error))?;
    for (name, text) in EXAMPLE {
        let file = folder.join(name);
        std::fs::write(&file, text).map_err(|error| unwritable(&file, &error))?;
    }
    let own = read(&folder)?;
    let (run, robot) = (&own.run, &own.robot);
    let mask = EXAMPLE_POSES.mask(&run.visits);
    let (calibration, seconds) = timed_calibration(robot, run, |visit| mask[visit.place])?;
    let model = out.join("ur10.json");
    write_model(&calibration.model, &model)?;
    let observe = ObserveOptions::default();
    let refit = Refit::default();
    let validation = validate(&calibration.model, run, robot, &observe, refit, |visit| !mask[visit.place])?;
    let made = make(&Material {
        own: &own,
        taken: Some(mask),
        other: None,
        refit,
        model: (&calibration.model, &model),
        observe,
        discovery: Sought::No,
        link: None,
        command: as_given(),
    })?;

    let hours = run.visits.last().map_or(0.0, |visit| visit.time_s) / 3600.0;
    let lines = vec![
        format!("wrote the example run, measured on a {} within {hours:.0} hours: {}", robot.name, folder.display()),
        format!("  {} poses of one target; SOURCE.txt and LICENSE there say whose they are", run.visits.len()),
        format!(
            "calibrated on every tenth pose, {} of them: {}, {seconds:.2} s: {}",
            calibration.campaign.visits.len(),
            found(&calibration),
            model.display()
        ),
        "  base and target were found first; 'nominal' is the nominal arm so placed".to_owned(),
        format!("  mean error there: {}", means(&calibration.errors(&calibration.campaign))),
        format!("tried the model on the other {} poses", validation.visits),
        format!("  mean error there: {}", means(&without_effects(&validation))),
        format!(
            "  largest error there: nominal {:.2} mm, calibrated {:.2} mm",
            validation.errors[0].max_mm, validation.errors[2].max_mm
        ),
        format!("look for what the model gets wrong, for some minutes: thermokin discover {}", folder.display()),
        write_report(&made, out)?,
    ];
    let result = json!({
        "format": 1, "command": "demo", "data": "ur10",
        "calibration_s": seconds,
        "calibration": levels(&calibration.errors(&calibration.campaign)),
        "validation": levels(&without_effects(&validation)),
        "model": model, "runs": [folder], "report": out.join("report.html"),
    });
    Ok(Told { lines, result })
}
