//! `thermokin plan probes`: one joint warms at a time.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::schedule::{as_json, hours};
use super::write;
use crate::cli::Failure;
use crate::cli::output::JsonOption;
use crate::plan::{prepared, probes, tell_apart};
use crate::simulate::Scenario;

/// Probes of single joints that tell each joint's own heat from the others'
#[derive(Debug, Args)]
pub struct Arguments {
    /// What is believed of the arm and its heat: a scenario file, or the name of one that ships
    scenario: PathBuf,
    /// How long the run may take, hours
    #[arg(long, value_name = "H")]
    hours: f64,
    /// Speed override of the joint that moves, above 0, 1 at most
    #[arg(long = "override", value_name = "SHARE", default_value_t = 1.0)]
    speed_override: f64,
    /// The postures to measure, as `plan poses` writes them [default: the scenario's]
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// The scenario to write, for `thermokin simulate`
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
}

/// Carries the command out.
///
/// # Errors
/// Bad usage or input; too little time.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    hours(arguments.hours)?;
    if !(arguments.speed_override > 0.0 && arguments.speed_override <= 1.0) {
        let message = format!("--override {}: expected a share above 0, 1 at most", arguments.speed_override);
        return Err(Failure::Usage(message));
    }
    let base = write::read(&arguments.scenario)?;
    let postures = write::postures(&base, arguments.poses.as_deref())?;
    let planned = prepared(&base.scenario, postures.as_deref());
    let (alone, together) = probes(&planned, arguments.hours, arguments.speed_override)?;
    let tried = |phases: &[crate::simulate::DrivePhase]| {
        let mut scenario: Scenario = planned.clone();
        scenario.schedule.phases = phases.to_vec();
        tell_apart(&scenario)
    };
    let (single, all) = (tried(&alone)?, tried(&together)?);
    if let Some(out) = &arguments.out {
        write::scenario(&base, &planned, &alone, out)?;
    }
    if arguments.json.leaves_words() {
        println!("{}: probes of single joints, {:.1} h", base.scenario.name, single.duration_s / 3600.0);
        println!("  cycle 0 cold, then");
        alone.iter().for_each(|phase| println!("    {}", write::phase(phase)));
        println!("\n  link   rise, K (SD)           share that no other links' rises explain");
        println!("         probes   all at once   probes   all at once");
        for (link, rise, share) in &single.links {
            let other = all.links.iter().find(|(own, ..)| own == link).map_or([f64::NAN; 2], |own| [own.1, own.2]);
            println!("  {link:<6} {rise:6.2} {:13.2} {share:8.3} {:13.3}", other[0], other[1]);
        }
        println!("\n  thermal coefficient   SD, probes   SD, all at once   (1e-6 m/K or rad/K)");
        for ((name, sigma), (_, other)) in single.coefficients.iter().zip(&all.coefficients) {
            println!("  {name:<21} {:10.4} {:17.4}", sigma * 1e6, other * 1e6);
        }
        if let Some(out) = &arguments.out {
            println!("\n  written to {}", out.display());
        }
    }
    arguments.json.write(&json!({
        "format": 1, "command": "plan", "plan": "probes", "hours": arguments.hours,
        "probes": as_json(&single), "all_at_once": as_json(&all),
    }))
}
