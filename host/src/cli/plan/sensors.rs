//! `thermokin plan sensors`: the fewest temperature sensors that do.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use crate::cli::Failure;
use crate::cli::campaign::RunOptions;
use crate::cli::output::JsonOption;
use crate::cli::progress::Steps;
use crate::model::Model;
use crate::plan::{SensorError, SensorPlan, SensorSet, SensorStudy};

/// The smallest set of temperature sensors that keeps the predicted thermal error within a bound
#[derive(Debug, Args)]
pub struct Arguments {
    /// The model, as calibrate wrote it
    model: PathBuf,
    /// The run that it was calibrated on
    run: PathBuf,
    /// How far predictions may be from those with the model's own sensors, root mean square over the run's points, mm
    #[arg(long, value_name = "MM")]
    bound_mm: f64,
    /// 1-sigma of a reading, K
    #[arg(long, value_name = "K", default_value_t = 0.02)]
    reading: f64,
    #[command(flatten)]
    options: RunOptions,
    #[command(flatten)]
    json: JsonOption,
}

impl From<SensorError> for Failure {
    fn from(error: SensorError) -> Self {
        match error {
            SensorError::Input(error) => Failure::Input(error),
            error => Failure::Work(error.to_string()),
        }
    }
}

/// Carries the command out.
///
/// # Errors
/// Bad usage or input; a bound that no set keeps.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    for (name, value) in [("bound-mm", arguments.bound_mm), ("reading", arguments.reading)] {
        if !(value.is_finite() && value > 0.0) {
            return Err(Failure::Usage(format!("--{name} {value}: expected a number above 0")));
        }
    }
    let model = Model::read(&arguments.model)?;
    let (run, _) = arguments.options.read(&arguments.run)?;
    let study = SensorStudy::new(&model, &run, &arguments.options.observe(), arguments.reading)?;
    let steps = Steps::new(study.names().len() as u64, "trying sets");
    let plan = study.smallest(arguments.bound_mm * 1e-3, |_| steps.done())?;
    drop(steps);
    if arguments.json.leaves_words() {
        print(&study, &plan, arguments.bound_mm);
    }
    let set = |set: &SensorSet| -> Value {
        let own = set.sensors.iter().zip(&set.without);
        json!({
            "sensors": set.sensors.iter().map(|&sensor| &study.names()[sensor]).collect::<Vec<_>>(),
            "rms_mm": set.rms * 1e3, "worst_visit_mm": set.worst * 1e3, "measured_rms_mm": set.measured * 1e3,
            "without": own.map(|(&sensor, error)| json!({"sensor": study.names()[sensor], "rms_mm": error * 1e3})).collect::<Vec<_>>(),
        })
    };
    arguments.json.write(&json!({
        "format": 1, "command": "plan", "plan": "sensors", "bound_mm": arguments.bound_mm, "reading_k": arguments.reading,
        "exhaustive": plan.exhaustive, "measured_rms_mm_with_model": plan.measured_by_model * 1e3,
        "chosen": plan.by_size.last().map(set), "by_size": plan.by_size.iter().map(set).collect::<Vec<_>>(),
        "all": set(&plan.all),
    }))
}

fn print(study: &SensorStudy, plan: &SensorPlan, bound_mm: f64) {
    let names = |set: &SensorSet| {
        let own: Vec<&str> = set.sensors.iter().map(|&sensor| study.names()[sensor].as_str()).collect();
        if own.is_empty() { "none".to_owned() } else { own.join(", ") }
    };
    let Some(chosen) = plan.by_size.last() else { return };
    println!(
        "{} of {} sensors keep the thermal error within {bound_mm} mm: {}",
        chosen.sensors.len(),
        study.names().len(),
        names(chosen)
    );
    println!(
        "  {}; errors are of cycles that were held out, with the noise of readings",
        if plan.exhaustive {
            "every set of each size was tried"
        } else {
            "larger sets by exchange, not all were tried"
        }
    );
    println!("\n  sensors   predicted, mm (rms, worst visit)   measured, mm (rms)   the best set");
    for set in plan.by_size.iter().chain([&plan.all]) {
        let (rms, worst, measured) = (set.rms * 1e3, set.worst * 1e3, set.measured * 1e3);
        let own = if set.sensors.len() == study.names().len() { "all".to_owned() } else { names(set) };
        println!("  {:<9} {rms:14.4} {worst:12.4} {measured:22.4}        {own}", set.sensors.len());
    }
    println!("  the model with its own coefficients: {:31.4}", plan.measured_by_model * 1e3);
    println!("\n  without one of the chosen:");
    for (&sensor, error) in chosen.sensors.iter().zip(&chosen.without) {
        println!("  {:<9} {:14.4}", study.names()[sensor], error * 1e3);
    }
    println!("\n  without one of all:");
    for (&sensor, error) in plan.all.sensors.iter().zip(&plan.all.without) {
        println!("  {:<9} {:14.4}", study.names()[sensor], error * 1e3);
    }
}
