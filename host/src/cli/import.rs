//! `thermokin import`: exports of trackers, controllers and loggers into a run folder.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use super::Failure;
use super::output::JsonOption;
use crate::import::{Mapping, Report, Unmatched};
use crate::input::InputError;
use crate::run::WriteError;

const AFTER_HELP: &str = "\
Examples:
  thermokin import --print-mapping > import.toml
  thermokin import import.toml --out run-monday

host/docs/import.md says what a mapping may hold.";

/// A run folder from exports of trackers, controllers and temperature logs
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct Arguments {
    /// The mapping: which file holds what, in which columns, units and frames
    #[arg(required_unless_present = "print_mapping")]
    mapping: Option<PathBuf>,
    /// The run folder to make
    #[arg(long, value_name = "RUN", required_unless_present = "print_mapping")]
    out: Option<PathBuf>,
    /// Print a commented mapping to start from
    #[arg(long, conflicts_with_all = ["mapping", "out", "strict", "force"])]
    print_mapping: bool,
    /// Refuse what does not match as a whole: exit code 2, and nothing is written
    #[arg(long)]
    strict: bool,
    #[command(flatten)]
    json: JsonOption,
    /// Replace the run in a folder that is not empty
    #[arg(long)]
    force: bool,
}

/// So many of what did not match are shown; all are in the JSON.
const SHOWN: usize = 5;

/// Carries the command out.
///
/// # Errors
/// Bad usage or input; a disk that does not take the run.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (Some(file), Some(out)) = (&arguments.mapping, &arguments.out) else {
        print!("{}", Mapping::TEMPLATE);
        return Ok(());
    };
    let occupied = std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
    if occupied && !arguments.force {
        return Err(Failure::Usage(format!("{}: is not empty; expected a new folder, or --force", out.display())));
    }
    let text =
        std::fs::read_to_string(file).map_err(|error| InputError::of_file(file, format!("cannot be read: {error}")))?;
    let mapping = Mapping::parse(file, &text)?;
    let imported = mapping.import(&mapping.load()?)?;
    let report = &imported.report;
    let refused = arguments.strict && !report.is_complete();
    if !refused {
        let files = imported.files(out).map_err(|error| match error {
            WriteError::Content { .. } => Failure::Usage(error.to_string()),
            WriteError::Disk { .. } => Failure::Work(error.to_string()),
        })?;
        files.store(out).map_err(|error| Failure::Work(error.to_string()))?;
    }
    if arguments.json.leaves_words() {
        if !refused {
            println!("{}: {}", out.display(), imported.run.description.name);
        }
        print_words(report);
    }
    arguments.json.write(&with_command(report)?)?;
    match refused {
        false => Ok(()),
        true => Err(Failure::Usage(format!("{}: not everything matches, and --strict was asked for", file.display()))),
    }
}

fn with_command(report: &Report) -> Result<Value, Failure> {
    let mut value = json!({ "format": 1, "command": "import" });
    let report = serde_json::to_value(report).map_err(|error| Failure::Work(format!("the report as JSON: {error}")))?;
    if let (Value::Object(value), Value::Object(report)) = (&mut value, report) {
        value.extend(report);
    }
    Ok(value)
}

fn print_words(report: &Report) {
    let counted = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    println!(
        "  {} of {} in {}, {} joints; {} of {}, {}",
        counted(report.visits, "visit"),
        counted(report.poses, "posture"),
        counted(report.cycles, "cycle"),
        report.joints,
        counted(report.points, "point"),
        counted(report.targets.len(), "target"),
        counted(report.broken_beams, "broken beam"),
    );
    println!("  joined: {} rows by cycle and pose, {} by time", report.joined_by_key, report.joined_by_time);
    let samples = &report.samples;
    if let (Some(median), Some(greatest)) = (samples.spread_median_m, samples.spread_max_m) {
        println!(
            "  {} samples averaged, {} without a position and {} contradicted by the others left out; 1-sigma of a \
             coordinate of a sample {:.1} µm (median), {:.1} µm (greatest)",
            samples.used,
            samples.not_seen,
            samples.dropped,
            median * 1e6,
            greatest * 1e6
        );
    }
    if samples.passed_over > 0 {
        println!("  {} rows passed over by their names", samples.passed_over);
    }
    if let Some(holders) = &report.holders {
        let sigma = holders.sigma_m.map(|sigma| format!("; 1-sigma of a coordinate {:.1} µm", sigma * 1e6));
        println!(
            "  {} holders registered: {:.1} µm rms, {:.1} µm at most{}",
            holders.residuals.len(),
            holders.rms_m * 1e6,
            holders.max_m * 1e6,
            sigma.unwrap_or_default()
        );
        for target in &holders.targets {
            let [x, y, z] = target.position_m.map(|coordinate| coordinate * 1e3);
            println!("    {:<8} {x:10.4} {y:10.4} {z:10.4} mm in the flange frame", target.name);
        }
    }
    unmatched("without a posture", &report.unmatched_points);
    unmatched("postures without a measurement", &report.unmatched_visits);
    unmatched("temperatures without a visit", &report.unmatched_readings);
    for sensor in report.sensors.iter().filter(|sensor| sensor.held + sensor.missing > 0) {
        println!(
            "  {}: of {} visits {} hold the nearest reading and {} have none (gaps above {:.0} s)",
            sensor.sensor,
            sensor.interpolated + sensor.held + sensor.missing,
            sensor.held,
            sensor.missing,
            sensor.max_gap_s
        );
    }
    if report.empty_readings > 0 {
        println!("  {} without a temperature left out", counted(report.empty_readings, "cell"));
    }
    report.notes.iter().for_each(|note| println!("  note: {note}"));
    if report.is_complete() {
        println!("  everything matched");
    }
}

fn unmatched(what: &str, list: &[Unmatched]) {
    if list.is_empty() {
        return;
    }
    println!("  not matched, {what}: {} ({} rows)", list.len(), list.iter().map(|one| one.rows).sum::<usize>());
    for one in list.iter().take(SHOWN) {
        let name = one.name.as_ref().map(|name| format!(" {name}")).unwrap_or_default();
        let visit = match (one.cycle, one.pose) {
            (Some(cycle), Some(pose)) => format!(" cycle {cycle}, pose {pose}"),
            (Some(cycle), None) => format!(" cycle {cycle}"),
            _ => String::new(),
        };
        let time = one.time_s.map(|time| format!(" at {time:.3} s")).unwrap_or_default();
        println!("    {}:{}:{name}{visit}{time}: {}", one.file, one.line, one.reason);
    }
    if list.len() > SHOWN {
        println!("    and {} more (--json FILE has all)", list.len() - SHOWN);
    }
}
