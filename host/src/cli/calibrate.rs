//! `thermokin calibrate`: from a run folder to a calibrated arm.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::Serialize;
use serde_json::json;

use super::campaign::RunOptions;
use super::output::JsonOption;
use super::progress::Steps;
use super::words;
use super::{Failure, method_table};
use crate::calibrate::thermal::ChosenBy;
use crate::calibrate::{
    Calibration, CalibrationError, Folds, HeldOut, HeldOutBy, HeldOutError, Loss, Manner, Request, Stopping, calibrate,
    held_out,
};
use crate::model::{Errors, HOW_TO_APPLY};
use crate::robot::ParameterId;
use crate::run::Selection;

/// Robust losses by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum LossName {
    /// Least squares
    Squares,
    /// Huber: linear for points beyond 1.3 standard deviations
    Huber,
    /// Cauchy: points far out hardly count
    Cauchy,
}

/// Identify the geometry and the thermal coefficients of an arm from a run folder
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  thermokin calibrate host/data/ur10 --poses every:10 --out ur10.json\n\n\
    identifies on every tenth pose and says how well the other poses are predicted.")]
pub struct Arguments {
    /// The run folder
    run: PathBuf,
    /// Where to write the model
    #[arg(long, value_name = "MODEL")]
    out: Option<PathBuf>,
    #[command(flatten)]
    options: RunOptions,
    /// Visits to hold out of the identification and to judge it by (with --poses, all others are held out as well)
    #[arg(long, value_name = "SELECTION")]
    hold_out: Option<Selection>,
    /// Judge by K folds: calibrate K times without a K-th of the poses (see --fold-by) and predict these
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(2..))]
    folds: Option<u32>,
    /// What a fold holds out
    #[arg(long, value_enum, default_value = "pose", requires = "folds")]
    fold_by: FoldBy,
    /// Seed by which poses or cycles are dealt out to the folds
    #[arg(long, value_name = "N", default_value_t = 1, requires = "folds")]
    fold_seed: u64,
    /// Parameters to leave at their nominal values, as in a6,beta6
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    fix: Vec<ParameterId>,
    /// The loss of a residual
    #[arg(long, value_enum, default_value = "squares")]
    loss: LossName,
    /// Estimate parameters, too, which these data determine worse than 10 mm or 10 mrad
    #[arg(long)]
    keep_weak: bool,
    /// Leave temperatures out
    #[arg(long)]
    geometry_only: bool,
    /// Weigh measurements by the instrument's noise alone for thermal coefficients, too, although postures were visited
    /// more than once
    #[arg(long)]
    instrument_weights: bool,
    /// List all pairs of parameters that are correlated by more than 0.9
    #[arg(long)]
    correlations: bool,
    /// Compare steepest descent, Newton-Raphson, Gauss-Newton and Levenberg-Marquardt from the same start (thesis 5.2.2)
    #[arg(long)]
    compare_methods: bool,
    #[command(flatten)]
    json: JsonOption,
}

/// What is held out together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FoldBy {
    /// All visits of a posture
    Pose,
    /// All visits of a cycle
    Cycle,
}

impl From<CalibrationError> for Failure {
    fn from(error: CalibrationError) -> Self {
        match error {
            CalibrationError::Input(error) => Failure::Input(error),
            error => Failure::Work(error.to_string()),
        }
    }
}

impl From<HeldOutError> for Failure {
    fn from(error: HeldOutError) -> Self {
        match error {
            HeldOutError::Folds(error) => Failure::Usage(format!("--folds: {error}")),
            HeldOutError::Calibration(error) => error.into(),
        }
    }
}

/// Errors on visits that were not used.
pub(super) struct Unseen {
    words: String,
    points: usize,
    errors: Errors,
}

/// Carries the command out.
///
/// # Errors
/// Bad input, or work that fails.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (run, robot) = arguments.options.read(&arguments.run)?;
    let request = Request {
        observe: arguments.options.observe(),
        fixed: arguments.fix.clone(),
        manner: Manner {
            stopping: Stopping::default(),
            loss: match arguments.loss {
                LossName::Squares => Loss::Squares,
                LossName::Huber => Loss::Huber,
                LossName::Cauchy => Loss::Cauchy,
            },
            keep_weak: arguments.keep_weak,
        },
        geometry_only: arguments.geometry_only,
        instrument_weights: arguments.instrument_weights,
    };
    let taken = arguments.options.poses.as_ref().map(|selection| selection.mask(&run.visits));
    let withheld = arguments.hold_out.as_ref().map(|selection| selection.mask(&run.visits));
    let learns = |place: usize| {
        taken.as_ref().is_none_or(|mask| mask[place]) && withheld.as_ref().is_none_or(|mask| !mask[place])
    };
    let folds = arguments.folds.map_or(0, |folds| folds as usize);
    let steps = Steps::new(1 + folds as u64, "calibrating");
    let calibration = calibrate(&robot, &run, &request, |visit| learns(visit.place))?;
    steps.done();
    let whole = crate::calibrate::observe(
        &calibration.model.robot,
        &run,
        &request.observe,
        Some(&calibration.model.temperatures),
    )?;
    let unseen = whole.campaign.select(|visit| !learns(visit.place));
    let unseen = (!unseen.visits.is_empty()).then(|| {
        let errors = calibration.errors(&unseen)[2];
        let points = unseen.visits.iter().map(|visit| visit.positions.len()).sum();
        Unseen { words: format!("{} visits not used", unseen.visits.len()), points, errors }
    });
    let by = match arguments.fold_by {
        FoldBy::Pose => HeldOutBy::Pose,
        FoldBy::Cycle => HeldOutBy::Cycle,
    };
    let folded = match folds {
        0 => None,
        _ => Some(held_out(
            &robot,
            &run,
            &request,
            &calibration.campaign,
            Folds { by, count: folds, seed: arguments.fold_seed },
            |_| steps.done(),
        )?),
    };
    drop(steps);
    let methods = match arguments.compare_methods {
        true => Some(method_table::compare(&robot, &run, &request, |visit| learns(visit.place))?),
        false => None,
    };
    if let Some(out) = &arguments.out {
        calibration.model.write(out).map_err(|error| Failure::Work(error.to_string()))?;
    }
    if arguments.json.leaves_words() {
        say(arguments, &calibration, unseen.as_ref(), folded.as_ref());
        if let Some(methods) = &methods {
            println!("\n{}", method_table::words(methods));
        }
    }
    let mut result = as_json(&calibration, unseen.as_ref(), folded.as_ref());
    if let Some(methods) = &methods {
        result["methods"] = json!(methods);
    }
    arguments.json.write(&result)
}

/// The poses, points and cycles that a calibration used.
fn counts(calibration: &Calibration) -> (usize, usize, usize) {
    let count = |number: fn(&crate::calibrate::ObservedVisit) -> u32| {
        let mut numbers: Vec<u32> = calibration.campaign.visits.iter().map(number).collect();
        numbers.sort_unstable();
        numbers.dedup();
        numbers.len()
    };
    let points = calibration.campaign.visits.iter().map(|visit| visit.positions.len() + visit.distances.len()).sum();
    (count(|visit| visit.pose), points, count(|visit| visit.cycle))
}

fn say(arguments: &Arguments, calibration: &Calibration, unseen: Option<&Unseen>, folded: Option<&HeldOut>) {
    let (poses, points, cycles) = counts(calibration);
    let joint = &calibration.joint;
    println!("{}: {poses} poses, {points} measurements, {cycles} cycles", calibration.model.robot.name);
    if calibration.aligned {
        println!("base and unknown targets were aligned first: 'nominal' below is the nominal arm so placed");
    }
    for note in &calibration.notes {
        println!("note: {note}");
    }
    println!("\nposition error       mean      RMS      max  mm",);
    let [nominal, geometric, thermal] = calibration.errors(&calibration.campaign);
    println!("{}", words::errors("nominal", &nominal));
    println!("{}", words::errors("geometric", &geometric));
    println!("{}", words::errors("thermal", &thermal));
    if let Some(beside) = calibration.cycle_by_cycle_errors() {
        println!(
            "{}   (thermal, cycle by cycle: {:+.3} mm on average)",
            words::errors("the thesis's", &beside),
            beside.mean_mm - thermal.mean_mm
        );
    }
    if let Some(unseen) = unseen {
        println!("{}   ({})", words::errors("held out", &unseen.errors), unseen.words);
    }
    if let Some(folded) = folded {
        let by = if folded.by == HeldOutBy::Pose { "poses" } else { "cycles" };
        println!(
            "{}   ({} folds by whole {by}, seed {})",
            words::errors("held out", &folded.errors),
            folded.folds,
            folded.seed
        );
    }
    println!(
        "\n{} after {} steps{}; {} of {} unknowns identified, condition {:.0}",
        joint.solution.stop.words(),
        joint.solution.steps,
        if joint.solution.damped > 0 { format!(" ({} damped)", joint.solution.damped) } else { String::new() },
        joint.unknowns.len(),
        joint.unknowns.len() + joint.held.len() + joint.weak.len(),
        joint.observability(&calibration.campaign).condition,
    );
    for line in calibration.unidentifiable().iter().chain(&calibration.weak()) {
        println!("  {line}");
    }
    let noise = &calibration.uncertainty.noise;
    println!(
        "noise: {} the instrument's stated one for a point{}; {:.1} µrad in each joint from visit to visit{}",
        if noise.point_estimated { format!("{:.2} times", noise.point) } else { "taken as".to_owned() },
        if noise.point_estimated { "" } else { " (a single target cannot tell)" },
        noise.visit * 1e6,
        if noise.posture > 0.0 {
            format!(", {:.1} µrad that stay with a posture", noise.posture * 1e6)
        } else {
            String::new()
        },
    );
    if calibration.weighed_by_strata {
        println!("thermal coefficients are judged by what changes at a posture, not by what stays with it");
    }
    println!("\nparameter        nominal         value    correction   ± 95 %");
    for estimate in &calibration.model.estimates {
        println!("{}", words::estimate(estimate));
    }
    if !calibration.model.growth.is_empty() {
        let factor = calibration.uncertainty.coverage_factor();
        let why = match calibration.choice.as_ref().map(|choice| choice.by) {
            Some(ChosenBy::Description) => "named by robot.toml",
            _ => "chosen by held-out cycles",
        };
        println!("\nthermal coefficients ({why})     joint fit ± 95 %      cycle by cycle");
        for growth in &calibration.model.growth {
            println!("{}", words::growth(growth, factor, calibration.cycle_by_cycle(growth)));
        }
        if let Some(left_out) = calibration.per_cycle.as_ref().map(|way| &way.left_out).filter(|left| !left.is_empty())
        {
            println!("cycles with too few poses for a calibration of their own: {left_out:?}");
        }
    }
    if arguments.correlations {
        println!("\ncorrelations above 0.9");
        for (first, second, correlation) in calibration.correlations(0.9) {
            println!("  {first:>10} {second:<10} {correlation:+.4}");
        }
    }
    println!("\n{HOW_TO_APPLY}");
    if let Some(out) = &arguments.out {
        println!("\nmodel written to {}", out.display());
    }
}

#[derive(Serialize)]
struct ParameterResult<'a> {
    name: &'a str,
    unit: &'a str,
    nominal: f64,
    value: f64,
    sigma: Option<f64>,
    low: Option<f64>,
    high: Option<f64>,
}

/// The object of `--json` (contract `results.md`).
pub(super) fn as_json(
    calibration: &Calibration,
    unseen: Option<&Unseen>,
    folded: Option<&HeldOut>,
) -> serde_json::Value {
    let (poses, points, cycles) = counts(calibration);
    let [nominal, geometric, thermal] = calibration.errors(&calibration.campaign);
    let parameters: Vec<ParameterResult> = calibration
        .model
        .estimates
        .iter()
        .map(|estimate| ParameterResult {
            name: &estimate.name,
            unit: estimate.unit,
            nominal: estimate.nominal,
            value: estimate.value,
            sigma: estimate.sigma,
            low: estimate.half_width.map(|half| estimate.value - half),
            high: estimate.half_width.map(|half| estimate.value + half),
        })
        .collect();
    let factor = calibration.uncertainty.coverage_factor();
    let coefficients: Vec<serde_json::Value> = calibration
        .model
        .growth
        .iter()
        .map(|growth| {
            json!({
                "parameter": growth.parameter.to_string(), "sensor": growth.sensor,
                "unit": format!("{}/K", growth.parameter.symbol.unit()),
                "value": growth.coefficient, "sigma": growth.sigma,
                "low": growth.coefficient - factor * growth.sigma, "high": growth.coefficient + factor * growth.sigma,
                "cycle_by_cycle": calibration.cycle_by_cycle(growth),
            })
        })
        .collect();
    let joint = &calibration.joint;
    let observability = joint.observability(&calibration.campaign);
    let noise = &calibration.uncertainty.noise;
    let mut result = json!({
        "format": 1, "command": "calibrate",
        "robot": calibration.model.robot.name,
        "poses": poses, "points": points, "cycles": cycles, "aligned": calibration.aligned,
        "nominal": nominal, "geometric": geometric, "thermal": thermal,
        "thermal_cycle_by_cycle": calibration.cycle_by_cycle_errors(),
        "parameters": parameters,
        "thermal_coefficients": coefficients,
        "thermal_choice": calibration.choice.as_ref().map(|choice| match choice.by {
            ChosenBy::Description => "robot.toml",
            ChosenBy::HeldOutCycles => "held-out cycles",
        }),
        "observability": {
            "rank": observability.rank, "condition": observability.condition,
            "unidentifiable": calibration.unidentifiable(),
            "weak": calibration.weak(),
            "singular_values": observability.singular_values,
            "indices": observability.indices,
        },
        "convergence": {
            "converged": joint.solution.stop.converged(), "reason": joint.solution.stop.words(),
            "steps": joint.solution.steps, "damped": joint.solution.damped,
            "initial_loss": joint.solution.initial_loss, "loss": joint.solution.loss,
        },
        "noise": {
            "point_over_instrument": noise.point, "point_estimated": noise.point_estimated,
            "visit_joint_rad": noise.visit, "posture_joint_rad": noise.posture,
            "degrees_of_freedom": calibration.uncertainty.freedom,
            "growth_weighed_by": if calibration.weighed_by_strata { "strata" } else { "instrument" },
        },
        "correlations": calibration.correlations(0.9).into_iter()
            .map(|(first, second, correlation)| json!({"parameters": [first, second], "correlation": correlation}))
            .collect::<Vec<_>>(),
        "how_to_apply": HOW_TO_APPLY,
        "notes": calibration.notes,
    });
    if let Some(unseen) = unseen {
        result["held_out"] = json!({
            "points": unseen.points, "mean_mm": unseen.errors.mean_mm,
            "rms_mm": unseen.errors.rms_mm, "max_mm": unseen.errors.max_mm,
        });
    }
    if let Some(folded) = folded {
        result["folds"] = json!({
            "folds": folded.folds, "seed": folded.seed, "by": if folded.by == HeldOutBy::Pose { "pose" } else { "cycle" },
            "mean_mm": folded.errors.mean_mm, "rms_mm": folded.errors.rms_mm, "max_mm": folded.errors.max_mm,
        });
    }
    result
}
