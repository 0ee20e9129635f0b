//! A scenario with another schedule and other postures, as the text of a file that `thermokin simulate` runs.

use std::path::{Path, PathBuf};

use crate::cli::Failure;
use crate::cli::output::write_whole;
use crate::input::InputError;
use crate::run::read_postures;
use crate::simulate::{DrivePhase, SHIPPED_SCENARIOS, Scenario};

/// A scenario with the text of its file.
pub(super) struct Base {
    pub(super) scenario: Scenario,
    text: String,
    folder: PathBuf,
}

/// Reads a scenario by its file, or by the name of one that ships.
pub(super) fn read(named: &Path) -> Result<Base, Failure> {
    let shipped = SHIPPED_SCENARIOS.iter().find(|(name, _)| !named.exists() && named.to_str() == Some(name));
    let text = match shipped {
        Some((_, text)) => (*text).to_owned(),
        None => std::fs::read_to_string(named)
            .map_err(|error| InputError::of_file(named, format!("cannot be read: {error}")))?,
    };
    let folder = named.parent().unwrap_or(Path::new("")).to_owned();
    Ok(Base { scenario: Scenario::parse(named, &text)?, text, folder })
}

/// Reads the postures of a plan for a scenario's arm.
pub(super) fn postures(base: &Base, file: Option<&Path>) -> Result<Option<Vec<Vec<f64>>>, Failure> {
    let Some(file) = file else { return Ok(None) };
    let postures = read_postures(file)?;
    let joints = base.scenario.robot.joint_count();
    match postures.iter().find(|posture| posture.len() != joints) {
        Some(posture) => {
            let message = format!("has {} joints, expected the arm's {joints}", posture.len());
            Err(InputError::at_line(file, 1, message).into())
        }
        None => Ok(Some(postures)),
    }
}

/// Writes the base's file with the schedule and the postures of `planned`.
///
/// # Errors
/// A disk that does not take it.
pub(super) fn scenario(base: &Base, planned: &Scenario, phases: &[DrivePhase], out: &Path) -> Result<(), Failure> {
    let broken = |error: &dyn std::fmt::Display| Failure::Work(format!("{}: {error}", out.display()));
    let mut file: toml::Table =
        base.text.trim_start_matches('\u{feff}').parse().map_err(|error: toml::de::Error| broken(&error))?;
    let name = format!("{}-planned", base.scenario.name);
    file.insert("name".to_owned(), toml::Value::String(name));
    let numbers = |values: &[f64]| toml::Value::Array(values.iter().map(|&value| toml::Value::Float(value)).collect());
    if let Some(arm) = file.get_mut("arm").and_then(toml::Value::as_table_mut)
        && let Some(robot) = arm.get("robot").and_then(toml::Value::as_str)
        && robot.ends_with(".toml")
    {
        // The path counts from the new file: an absolute one does wherever that is.
        let robot = std::path::absolute(base.folder.join(robot)).map_err(|error| broken(&error))?;
        arm.insert("robot".to_owned(), toml::Value::String(robot.display().to_string()));
    }
    if let Some(schedule) = file.get_mut("schedule").and_then(toml::Value::as_table_mut) {
        let phase = |phase: &DrivePhase| {
            let mut table = toml::Table::new();
            table.insert("override".to_owned(), toml::Value::Float(phase.speed_override));
            table.insert("cycles".to_owned(), toml::Value::Integer(phase.cycles.into()));
            if let Some(joints) = &phase.joints {
                let joints = joints.iter().map(|&joint| toml::Value::Integer(joint as i64)).collect();
                table.insert("joints".to_owned(), toml::Value::Array(joints));
            }
            toml::Value::Table(table)
        };
        schedule.insert("phases".to_owned(), toml::Value::Array(phases.iter().map(phase).collect()));
        schedule.insert("cycle_s".to_owned(), numbers(&planned.schedule.cycle_s));
    }
    if let Some(joints) = &planned.postures.joints {
        let mut table = toml::Table::new();
        let joints = joints.iter().map(|posture| numbers(posture)).collect();
        table.insert("joints".to_owned(), toml::Value::Array(joints));
        file.insert("postures".to_owned(), toml::Value::Table(table));
    }
    let text = toml::to_string(&file).map_err(|error| broken(&error))?;
    // Written only if it can be read again.
    Scenario::parse(out, &text)?;
    write_whole(out, text.as_bytes())
}

/// A stretch of cycles in words.
pub(super) fn phase(phase: &DrivePhase) -> String {
    let what = match &phase.joints {
        _ if phase.speed_override == 0.0 => "rest".to_owned(),
        None => format!("all joints at {:.0} %", 100.0 * phase.speed_override),
        Some(joints) => {
            let names: Vec<String> = joints.iter().map(usize::to_string).collect();
            format!("joint {} at {:.0} %", names.join(", "), 100.0 * phase.speed_override)
        }
    };
    format!("{} cycles {what}", phase.cycles)
}
