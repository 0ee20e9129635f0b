//! `thermokin discover`: what the simulation gets wrong, its cause, and the extended model.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use super::Failure;
use super::campaign::RunOptions;
use super::output::JsonOption;
use super::progress::Steps;
use super::words;
use crate::calibrate::Request;
use crate::discover::{Discovery, DiscoveryError, DiscoveryRequest, Finding, Level, STEPS, discover_in_steps};

/// Find what a calibrated model gets wrong, name the physical cause, and measure what its correction gains
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  thermokin discover run-75-25 --out extended.json\n  \
    thermokin discover run-75-25 --json - | jq .findings")]
pub struct Arguments {
    /// The run folder
    run: PathBuf,
    /// Write the extended model here
    #[arg(long, value_name = "MODEL")]
    out: Option<PathBuf>,
    #[command(flatten)]
    options: RunOptions,
    /// Do not measure the gain on held-out cycles and poses: faster by half
    #[arg(long)]
    no_hold_out: bool,
    /// Seed of the draws of noise by which the search is calibrated
    #[arg(long, default_value_t = 1, value_name = "N")]
    seed: u64,
    #[command(flatten)]
    json: JsonOption,
}

impl From<DiscoveryError> for Failure {
    fn from(error: DiscoveryError) -> Self {
        match error {
            DiscoveryError::Calibration(error) => error.into(),
            error @ DiscoveryError::TooSmall => Failure::Work(error.to_string()),
        }
    }
}

/// Carries the command out.
///
/// # Errors
/// Bad input, or work that fails.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (run, robot) = arguments.options.read(&arguments.run)?;
    let request = DiscoveryRequest {
        calibration: Request { observe: arguments.options.observe(), ..Request::default() },
        seed: arguments.seed,
        hold_out: !arguments.no_hold_out,
    };
    let steps = Steps::new(STEPS, "discovering");
    let discovery = discover_in_steps(&robot, &run, &request, &|| steps.done())?;
    drop(steps);
    if let Some(file) = &arguments.out {
        discovery.model().write(file).map_err(|error| Failure::Work(error.to_string()))?;
    }
    if arguments.json.leaves_words() {
        say(&discovery);
    }
    arguments.json.write(&as_json(&discovery))
}

/// Tests with larger chances than this are counted, not listed, and at most so many are listed.
const LEAST_TOLD: f64 = 0.01;
const MOST_TOLD: usize = 10;

/// A chance from its logarithm; the smallest positive number where it is smaller than any.
fn chance(ln_p: f64) -> f64 {
    ln_p.min(0.0).exp().max(f64::MIN_POSITIVE)
}

fn say_finding(finding: &Finding) {
    println!("\n{} {} (chance in noise {:.1e})", finding.effect.replace('_', " "), finding.place, chance(finding.ln_p));
    for estimate in &finding.parameters {
        println!("  {:<28} {:+.4e}  [{:+.4e}, {:+.4e}]", estimate.name, estimate.value, estimate.low, estimate.high);
    }
    if !finding.cycles.is_empty() {
        let cycles: Vec<String> = finding.cycles.iter().map(ToString::to_string).collect();
        println!("  in cycles {}; the labels are put right here", cycles.join(", "));
    }
    for wrong in finding.points.iter().take(10) {
        println!(
            "  cycle {}, pose {}, {}: {:.3} mm off, set aside",
            wrong.cycle,
            wrong.pose,
            wrong.target,
            wrong.error * 1e3
        );
    }
    if let Some(evidence) = &finding.evidence {
        println!("  {evidence}");
    }
    if finding.cost_rms_mm > 0.0 {
        println!("  it moves the targets by {:.3} mm RMS", finding.cost_rms_mm);
    }
    if let Some(gain) = finding.gain {
        println!("  corrected, held-out RMS goes from {:.4} to {:.4} mm", gain.before_mm, gain.after_mm);
    }
    for other in &finding.alternatives {
        println!(
            "  these data hardly tell it from {} {} (log evidence {:+.1})",
            other.effect.replace('_', " "),
            other.place,
            other.log_evidence
        );
    }
    if let Some(words) = &finding.separate_by {
        println!("  what would tell them apart: {words}");
    }
}

fn say(discovery: &Discovery) {
    let Discovery { baseline, extended, .. } = discovery;
    for note in &discovery.notes {
        println!("note: {note}");
    }
    println!("position error       mean      RMS      max  mm   held-out RMS");
    for (name, level) in [("baseline", baseline), ("extended", extended)] {
        let held_out = level.held_out.map_or_else(|| "-".to_owned(), |errors| format!("{:.4}", errors.rms_mm));
        println!("{}   {held_out:>12}", words::errors(name, &level.fitted));
    }
    println!(
        "\nnoise: {:.1} µm of a point; the joints repeat to {} µrad; together they make {:.4} mm RMS",
        discovery.noise_um,
        discovery.noise.visit.iter().map(|sigma| format!("{:.1}", sigma * 1e6)).collect::<Vec<_>>().join(", "),
        discovery.floor_rms_mm
    );
    if !discovery.tests.is_empty() {
        println!("\nhow far what calibration leaves is from noise, along what each effect follows at its best place:");
        for test in discovery.tests.iter().filter(|test| test.ln_p < LEAST_TOLD.ln()).take(MOST_TOLD) {
            println!(
                "  {:<22} {:<28} chance in noise {:.1e}",
                test.effect.replace('_', " "),
                test.place.to_string(),
                chance(test.ln_p)
            );
        }
        let rest = discovery.tests.iter().filter(|test| test.ln_p >= LEAST_TOLD.ln()).count();
        println!("  {rest} effects have chances above {LEAST_TOLD}");
    }
    if discovery.findings.is_empty() && !discovery.unexplained.significant {
        println!("nothing was found: the model explains these data down to their noise");
    }
    for finding in &discovery.findings {
        say_finding(finding);
    }
    if discovery.unexplained.significant {
        println!(
            "\nunexplained: {:.4} mm RMS follow {} (chance in noise {:.1e}); no effect of the catalogue does that",
            discovery.unexplained.rms_mm,
            discovery.unexplained.follows().join(", "),
            chance(discovery.unexplained.ln_p)
        );
    }
}

/// The object of `--json` (contract `results.md`).
pub(super) fn as_json(discovery: &Discovery) -> Value {
    let level = |level: &Level| {
        json!({
            "mean_mm": level.fitted.mean_mm, "rms_mm": level.fitted.rms_mm, "max_mm": level.fitted.max_mm,
            "heldout_rms_mm": level.held_out.map(|errors| errors.rms_mm),
            "heldout_mean_mm": level.held_out.map(|errors| errors.mean_mm),
            "heldout_max_mm": level.held_out.map(|errors| errors.max_mm),
        })
    };
    let finding = |finding: &Finding| {
        let mut value = json!({
            "effect": finding.effect, "where": finding.place, "p_value": chance(finding.ln_p),
            "parameters": finding.parameters,
            "alternatives": finding.alternatives.iter().map(|other| json!({
                "effect": other.effect, "where": other.place, "log_evidence": other.log_evidence,
            })).collect::<Vec<_>>(),
            "cost_rms_mm": finding.cost_rms_mm,
            "gain": finding.gain.map(|gain| json!({
                "heldout_rms_mm_before": gain.before_mm, "heldout_rms_mm_after": gain.after_mm,
            })),
        });
        if let Some(words) = &finding.separate_by {
            value["separate_by"] = json!(words);
        }
        if !finding.cycles.is_empty() {
            value["cycles"] = json!(finding.cycles);
        }
        if let Some(evidence) = &finding.evidence {
            value["evidence"] = json!(evidence);
        }
        if !finding.points.is_empty() {
            let point = |wrong: &crate::discover::Outlier| json!({"cycle": wrong.cycle, "pose": wrong.pose, "target": wrong.target, "error_mm": wrong.error * 1e3});
            value["points"] = json!(finding.points.iter().map(point).collect::<Vec<_>>());
        }
        value
    };
    json!({
        "format": 1, "command": "discover",
        "noise_um": discovery.noise_um,
        "noise": {
            "point_um": discovery.noise_um, "visit_urad": discovery.noise.visit.iter().map(|sigma| sigma * 1e6).collect::<Vec<_>>(),
            "posture_urad": discovery.noise.posture * 1e6, "cycle_urad": discovery.noise.cycle * 1e6,
            "floor_rms_mm": discovery.floor_rms_mm,
        },
        "baseline": level(&discovery.baseline),
        "findings": discovery.findings.iter().map(finding).collect::<Vec<_>>(),
        "unexplained": {
            "significant": discovery.unexplained.significant, "p_value": chance(discovery.unexplained.ln_p),
            "follows": discovery.unexplained.follows(), "rms_mm": discovery.unexplained.rms_mm,
            "parts": discovery.unexplained.parts.iter().map(|part| json!({
                "follows": part.follows, "share": part.share, "rms_mm": part.rms_mm,
            })).collect::<Vec<_>>(),
        },
        "extended": level(&discovery.extended),
        "tests": discovery.tests.iter().map(|test| json!({
            "effect": test.effect, "where": test.place, "p_value": chance(test.ln_p),
            "likelihood_ratio": test.ratio, "visible": test.visible,
        })).collect::<Vec<_>>(),
        "notes": discovery.notes,
    })
}
