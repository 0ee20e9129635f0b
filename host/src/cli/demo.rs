//! `thermokin demo`: the whole chain on one machine, told in ten lines.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use super::Failure;
use super::output::JsonOption;
use super::progress::Steps;
use crate::calibrate::{
    Calibration, Group, ObserveOptions, ObservedVisit, Refit, Request, Validation, calibrate, validate,
};
use crate::model::Errors;
use crate::robot::Robot;
use crate::run::{self, Run, Selection};
use crate::simulate::{Scenario, simulate};

/// The run that the simulated arm is calibrated on, and the one that it is tried on.
const SCENARIOS: [(&str, &str); 2] = [("thesis-75-25", "run-75-25"), ("thesis-90-30", "run-90-30")];

/// The measured example: its files by name.
const EXAMPLE: [(&str, &str); 7] = [
    ("LICENSE", include_str!("../../data/ur10/LICENSE")),
    ("SOURCE.txt", include_str!("../../data/ur10/SOURCE.txt")),
    ("robot.toml", include_str!("../../data/ur10/robot.toml")),
    ("poses.csv", include_str!("../../data/ur10/poses.csv")),
    ("points.csv", include_str!("../../data/ur10/points.csv")),
    ("temperatures.csv", include_str!("../../data/ur10/temperatures.csv")),
    ("run.toml", include_str!("../../data/ur10/run.toml")),
];

/// The share of the example's poses that it is calibrated on.
const EXAMPLE_POSES: Selection = Selection::Every { step: 10, offset: 0 };

/// What the demonstration works on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Data {
    /// Two simulated runs of one arm that warms up and cools down
    Simulated,
    /// The measured run that ships with thermokin
    Ur10,
}

/// Show the whole chain at work: a run, a calibration on it, and its errors on data that it did not see
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  thermokin demo --out /tmp/demo\n  thermokin demo --data ur10")]
pub struct Arguments {
    /// The folder that the runs and the model are written into
    #[arg(long, value_name = "DIR", default_value = "thermokin-demo")]
    out: PathBuf,
    /// What to work on
    #[arg(long, value_enum, default_value = "simulated")]
    data: Data,
    #[command(flatten)]
    json: JsonOption,
}

/// What a demonstration has to say: lines for people, an object for programs.
struct Told {
    lines: Vec<String>,
    result: Value,
}

/// Carries the command out.
///
/// # Errors
/// A disk that does not take the files.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let told = match arguments.data {
        Data::Simulated => simulated(&arguments.out)?,
        Data::Ur10 => measured(&arguments.out)?,
    };
    if arguments.json.leaves_words() {
        for line in &told.lines {
            println!("{line}");
        }
    }
    arguments.json.write(&told.result)
}

/// Two simulated runs: calibrated on the first, tried on the second.
fn simulated(out: &Path) -> Result<Told, Failure> {
    let steps = Steps::new(4, "demonstrating");
    let [(first, first_folder), (second, second_folder)] = SCENARIOS.map(|(name, folder)| (name, out.join(folder)));
    let (first, first_run, robot) = simulate_into(first, &first_folder)?;
    steps.done();
    let (calibration, seconds) = timed_calibration(&robot, &first_run, |_| true)?;
    let model = out.join("model.json");
    write_model(&calibration, &model)?;
    steps.done();
    let (second, second_run, second_robot) = simulate_into(second, &second_folder)?;
    steps.done();
    let observe = ObserveOptions::default();
    let validation = validate(&calibration.model, &second_run, &second_robot, &observe, Refit::default(), |_| true)?;
    drop(steps);

    let mut lines = vec![
        format!("simulated {}, {}", first.robot.name, speeds(&first)),
        format!("  {}: {}", counts(&first, &first_run), first_folder.display()),
        format!("calibrated on it: {}, {:.2} s: {}", found(&calibration), seconds, model.display()),
        format!("  mean error there: {}", means(&calibration.errors(&calibration.campaign))),
        format!("simulated the same arm again, {}", speeds(&second)),
        format!("  {}: {}", counts(&second, &second_run), second_folder.display()),
        "tried the model on this second run, of which the calibration saw nothing".to_owned(),
        format!("  mean error there: {}", means(&without_effects(&validation))),
    ];
    lines.extend(worst_cycle(&validation).map(|worst| {
        let [_, geometric, thermal, _] = worst.errors.map(|errors| errors.mean_mm);
        format!(
            "  the cycle that geometry alone predicts worst, {} after {:.1} h: geometric {geometric:.3} mm, thermal \
             {thermal:.3} mm",
            worst.number,
            worst.time_s / 3600.0
        )
    }));
    lines.push(look(&model, &second_folder));
    let result = json!({
        "format": 1, "command": "demo", "data": "simulated",
        "calibration_s": seconds,
        "calibration": levels(&calibration.errors(&calibration.campaign)),
        "validation": levels(&without_effects(&validation)),
        "model": model, "runs": [first_folder, second_folder],
    });
    Ok(Told { lines, result })
}

/// The measured example: calibrated on every tenth pose, tried on all others.
fn measured(out: &Path) -> Result<Told, Failure> {
    let folder = out.join("ur10");
    std::fs::create_dir_all(&folder).map_err(|error| unwritable(&folder, &error))?;
    for (name, text) in EXAMPLE {
        let file = folder.join(name);
        std::fs::write(&file, text).map_err(|error| unwritable(&file, &error))?;
    }
    let run = run::read(&folder)?;
    let robot = Robot::read(&run.description.robot)?;
    let mask = EXAMPLE_POSES.mask(&run.visits);
    let (calibration, seconds) = timed_calibration(&robot, &run, |visit| mask[visit.place])?;
    let model = out.join("ur10.json");
    write_model(&calibration, &model)?;
    let observe = ObserveOptions::default();
    let validation =
        validate(&calibration.model, &run, &robot, &observe, Refit::default(), |visit| !mask[visit.place])?;

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
        format!("see every parameter: thermokin calibrate {} --poses {EXAMPLE_POSES}", folder.display()),
        look(&model, &folder),
    ];
    let result = json!({
        "format": 1, "command": "demo", "data": "ur10",
        "calibration_s": seconds,
        "calibration": levels(&calibration.errors(&calibration.campaign)),
        "validation": levels(&without_effects(&validation)),
        "model": model, "runs": [folder],
    });
    Ok(Told { lines, result })
}

/// Simulates a scenario that ships into a folder and reads it back, as a user's run is read.
fn simulate_into(name: &str, folder: &Path) -> Result<(Scenario, Run, Robot), Failure> {
    let scenario = Scenario::shipped(name).ok_or_else(|| Failure::Work(format!("no scenario {name} ships")))?;
    let simulated = simulate(&scenario).map_err(|error| Failure::Work(format!("{name}: {error}")))?;
    simulated.write(folder).map_err(|error| Failure::Work(error.to_string()))?;
    let run = run::read(folder)?;
    let robot = Robot::read(&run.description.robot)?;
    Ok((scenario, run, robot))
}

/// A calibration and the seconds that it took.
fn timed_calibration(
    robot: &Robot,
    run: &Run,
    pick: impl Fn(&ObservedVisit) -> bool,
) -> Result<(Calibration, f64), Failure> {
    let begun = Instant::now();
    let calibration = calibrate(robot, run, &Request::default(), pick)?;
    Ok((calibration, begun.elapsed().as_secs_f64()))
}

fn write_model(calibration: &Calibration, file: &Path) -> Result<(), Failure> {
    calibration.model.write(file).map_err(|error| Failure::Work(error.to_string()))
}

fn unwritable(file: &Path, error: &std::io::Error) -> Failure {
    Failure::Work(format!("{}: cannot be written: {error}", file.display()))
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

fn counts(scenario: &Scenario, run: &Run) -> String {
    let cycles = run.cycles().len();
    let hours = run.visits.last().map_or(0.0, |visit| visit.time_s) / 3600.0;
    format!(
        "{} poses, {} points and {} temperature sensors in {hours:.1} h (seed {})",
        run.visits.len() / cycles.max(1),
        run.point_count(),
        run.temperatures.as_ref().map_or(0, |log| log.series.len()),
        scenario.seed
    )
}

/// "30 of 30 unknowns, 9 thermal coefficients".
fn found(calibration: &Calibration) -> String {
    let joint = &calibration.joint;
    let growth = calibration.model.growth.len();
    let asked = joint.unknowns.len() + joint.held.len() + joint.weak.len();
    let geometric = format!("{} of {} unknowns of geometry", joint.unknowns.len() - growth, asked - growth);
    if growth == 0 { geometric } else { format!("{geometric}, {growth} thermal coefficients") }
}

fn means([nominal, geometric, thermal]: &[Errors; 3]) -> String {
    let growth = if geometric == thermal { String::new() } else { format!(", thermal {:.3} mm", thermal.mean_mm) };
    format!("nominal {:.3} mm, geometric {:.3} mm{growth}", nominal.mean_mm, geometric.mean_mm)
}

fn levels([nominal, geometric, thermal]: &[Errors; 3]) -> Value {
    json!({ "nominal": nominal, "geometric": geometric, "thermal": thermal })
}

/// The levels of a model that carries no effects.
fn without_effects(validation: &Validation) -> [Errors; 3] {
    let [nominal, geometric, thermal, _] = validation.errors;
    [nominal, geometric, thermal]
}

/// The cycle with the largest mean error of the geometric model.
fn worst_cycle(validation: &Validation) -> Option<&Group> {
    validation.cycles.iter().max_by(|a, b| a.errors[1].mean_mm.total_cmp(&b.errors[1].mean_mm))
}

fn look(model: &Path, run: &Path) -> String {
    format!("see the errors one by one: thermokin validate {} {}", model.display(), run.display())
}
