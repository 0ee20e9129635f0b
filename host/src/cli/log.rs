//! `thermokin log`: the host logger, and what one does with the log files.

mod live;
mod plain;
mod terminal;

use std::io::{self, BufWriter, IsTerminal, Write};
use std::net::SocketAddr;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde_json::json;

use super::Failure;
use super::output::JsonOption;
use super::progress::Steps;
use crate::input::InputError;
use crate::logger::export::{ExportError, LoggedRun, export, runs};
use crate::logger::read;
use crate::logger::registry::Registry;
use crate::logger::serve::{Options, ServeError, View, control_path, serve, stop_on_signals};
use crate::logger::store::{self, Rotation, Scan, StoreError};
use crate::logger::verify;

/// The host logger: link boards to disk, with a live view
#[derive(Debug, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "Examples:\n  thermokin log --robot robot.toml --run warm-up\n  \
        thermokin log mark \"cycle 3\"\n  thermokin log export thermokin-log --run warm-up --out run/temperatures.csv"
)]
pub struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: ServeArguments,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// What log files hold: time, boards, sensors, runs
    #[command(after_help = "Example:\n  thermokin log info thermokin-log")]
    Info(InfoArguments),
    /// Check log files to the last byte; exit code 1 if anything is damaged, missing or double
    #[command(after_help = "Examples:\n  thermokin log doctor thermokin-log\n  \
        thermokin log doctor thermokin-log --truth truth.csv")]
    Doctor(DoctorArguments),
    /// Copy what is whole of a cut-off or damaged file into a new, finished one
    #[command(after_help = "Example:\n  thermokin log recover torn.mcap --out whole.mcap")]
    Recover(RecoverArguments),
    /// Write readings as a run folder's temperatures.csv
    #[command(after_help = "Example:\n  thermokin log export thermokin-log --run warm-up --out run/temperatures.csv")]
    Export(ExportArguments),
    /// Mark a step in the log that is running
    #[command(after_help = "Example:\n  thermokin log mark \"cycle 3\"")]
    Mark(MarkArguments),
    /// Start a run in the log that is running, or end it
    #[command(after_help = "Examples:\n  thermokin log run warm-up\n  thermokin log run --stop")]
    Run(RunArguments),
}

#[derive(Debug, Args)]
struct ServeArguments {
    /// The address and UDP port to listen on
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "0.0.0.0:4840")]
    listen: SocketAddr,
    /// The folder of log files
    #[arg(long, value_name = "DIR", default_value = "thermokin-log")]
    store: PathBuf,
    /// The registry of boards [default: thermokin/boards.toml in the user's configuration]
    #[arg(long, value_name = "FILE")]
    registry: Option<PathBuf>,
    /// The robot whose sensors are read: gives them their names
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Start a run of this name at once
    #[arg(long, value_name = "NAME")]
    run: Option<String>,
    /// Begin a new file at this many MiB
    #[arg(long, value_name = "MIB", default_value_t = 1024, value_parser = clap::value_parser!(u64).range(1..))]
    rotate_mib: u64,
    /// Begin a new file after this many hours
    #[arg(long, value_name = "HOURS", default_value_t = 24, value_parser = clap::value_parser!(u64).range(1..))]
    rotate_hours: u64,
    /// How long readings gather before they are synced and acknowledged, in milliseconds
    #[arg(long, value_name = "MS", default_value_t = 100)]
    gather_ms: u64,
    /// Write lines even where there is a terminal
    #[arg(long)]
    plain: bool,
    #[command(flatten)]
    live: live::LiveArguments,
    #[command(flatten)]
    json: JsonOption,
}

#[derive(Debug, Args)]
struct InfoArguments {
    /// A folder of log files, or one file
    #[arg(default_value = "thermokin-log")]
    log: PathBuf,
    #[command(flatten)]
    json: JsonOption,
}

#[derive(Debug, Args)]
struct DoctorArguments {
    /// A folder of log files, or one file
    #[arg(default_value = "thermokin-log")]
    log: PathBuf,
    /// What virtual boards say they took: the log must equal it, record for record
    #[arg(long, value_name = "FILE")]
    truth: Vec<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
}

#[derive(Debug, Args)]
struct RecoverArguments {
    /// The file
    file: PathBuf,
    /// The new file
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Debug, Args)]
struct ExportArguments {
    /// A folder of log files, or one file
    #[arg(default_value = "thermokin-log")]
    log: PathBuf,
    /// The run to export; without it, everything, with times since the first reading
    #[arg(long, value_name = "NAME")]
    run: Option<String>,
    /// The file to write; - is standard output
    #[arg(long, value_name = "FILE", default_value = "-")]
    out: PathBuf,
    #[command(flatten)]
    json: JsonOption,
}

#[derive(Debug, Args)]
struct MarkArguments {
    /// The words
    text: String,
    /// The folder of log files
    #[arg(long, value_name = "DIR", default_value = "thermokin-log")]
    store: PathBuf,
}

#[derive(Debug, Args)]
struct RunArguments {
    /// The run's name
    #[arg(required_unless_present = "stop")]
    name: Option<String>,
    /// End the run
    #[arg(long, conflicts_with = "name")]
    stop: bool,
    /// The folder of log files
    #[arg(long, value_name = "DIR", default_value = "thermokin-log")]
    store: PathBuf,
}

/// Carries the command out.
///
/// # Errors
/// Bad input, or what kept the logger from starting or ending.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.command {
        None => listen(&arguments.serve),
        Some(Command::Info(arguments)) => info(arguments),
        Some(Command::Doctor(arguments)) => doctor(arguments),
        Some(Command::Recover(arguments)) => recover(arguments),
        Some(Command::Export(arguments)) => export_run(arguments),
        Some(Command::Mark(arguments)) => wish(&arguments.store, &format!("mark {}", arguments.text)),
        Some(Command::Run(arguments)) => match &arguments.name {
            Some(name) => wish(&arguments.store, &format!("run {name}")),
            None => wish(&arguments.store, "stop-run"),
        },
    }
}

fn listen(arguments: &ServeArguments) -> Result<(), Failure> {
    let options = Options {
        listen: arguments.listen,
        store: arguments.store.clone(),
        registry: arguments.registry.clone().unwrap_or_else(Registry::default_path),
        robot: arguments.robot.clone(),
        run: arguments.run.clone(),
        rotation: Rotation { bytes: arguments.rotate_mib << 20, seconds: arguments.rotate_hours * 3600 },
        gather_us: arguments.gather_ms * 1000,
    };
    // What is wrong with the live page's arguments is said before the logger opens its store.
    let page = live::Page::start(&arguments.live, arguments.robot.as_deref())?;
    let stop = stop_on_signals().map_err(|error| Failure::Work(error.to_string()))?;
    let on_terminal = !arguments.plain && io::stdout().is_terminal() && io::stdin().is_terminal();
    let mut view: Box<dyn View> = if on_terminal {
        Box::new(terminal::Terminal::open().map_err(|error| Failure::Work(format!("the terminal: {error}")))?)
    } else {
        Box::new(plain::Plain::default())
    };
    if let Some(page) = &page {
        view = page.beside(view);
    }
    let outcome = serve(&options, &stop, view.as_mut());
    drop(page);
    // The terminal is given back before the last words.
    drop(view);
    let tally = outcome.map_err(failure)?;
    if arguments.json.leaves_words() {
        println!(
            "{} readings in {} records stored and acknowledged; {} records told as lost; {} datagrams accepted, {} refused",
            tally.readings, tally.records, tally.lost, tally.accepted, tally.refused
        );
    }
    arguments.json.write(&json!({
        "format": 1, "command": "log",
        "readings": tally.readings, "records": tally.records, "lost": tally.lost, "repeated": tally.repeated,
        "datagrams_accepted": tally.accepted, "datagrams_refused": tally.refused, "overrun": tally.overrun,
        "answers": tally.answers, "groups": tally.groups,
    }))
}

/// Why a logger failed, as a command says it.
pub(super) fn failure(error: ServeError) -> Failure {
    match error {
        ServeError::Input(error) | ServeError::Store(StoreError::Foreign(error)) => Failure::Input(error),
        ServeError::Listen { .. } | ServeError::Store(_) | ServeError::Sink(_) | ServeError::System(_) => {
            Failure::Work(error.to_string())
        }
    }
}

/// Sends a wish to the logger of a store.
fn wish(store: &Path, words: &str) -> Result<(), Failure> {
    let path = control_path(store);
    UnixDatagram::unbound()
        .and_then(|socket| socket.send_to(words.as_bytes(), &path))
        .map_err(|error| Failure::Work(format!("{}: no logger is running on this store ({error})", store.display())))?;
    Ok(())
}

fn info(arguments: &InfoArguments) -> Result<(), Failure> {
    let steps = Steps::of_bytes(2 * read::size(&arguments.log)?, "reading the log");
    let contents = verify::contents(&arguments.log, &|bytes| steps.advance(bytes))?;
    let runs = runs(&arguments.log, &|bytes| steps.advance(bytes))?;
    drop(steps);
    if arguments.json.leaves_words() {
        let mut out = io::stdout().lock();
        say_info(&mut out, &contents, &runs).map_err(|error| Failure::Work(format!("standard output: {error}")))?;
    }
    let span = contents.times_s();
    arguments.json.write(&json!({
        "format": 1, "command": "log info",
        "files": contents.files.iter().map(|(path, scan)| json!({
            "file": path, "bytes": scan.length, "finished": scan.finished, "torn_bytes": scan.torn(),
            "messages": scan.summary.message_count(),
        })).collect::<Vec<_>>(),
        "start_s": span.map(|span| span.0), "end_s": span.map(|span| span.1),
        "boards": contents.boards.iter().map(|(board, of_board)| json!({
            "board": board, "records": of_board.records, "lost": of_board.lost, "open_gaps": of_board.open_gaps,
            "boots": of_board.boots, "sensors": of_board.sensors,
        })).collect::<Vec<_>>(),
        "runs": runs.iter().map(|run| json!({
            "name": run.name, "start_s": run.start_s, "stop_s": run.stop_s,
        })).collect::<Vec<_>>(),
    }))
}

fn say_info(out: &mut impl Write, contents: &verify::Contents, runs: &[LoggedRun]) -> io::Result<()> {
    for (path, scan) in &contents.files {
        let messages = scan.summary.message_count();
        writeln!(out, "{}: {} bytes, {messages} messages{}", path.display(), scan.length, state_words(scan))?;
    }
    if let Some((start_s, end_s)) = contents.times_s() {
        let utc = |seconds: f64| crate::logger::civil::utc(seconds as u64);
        writeln!(out, "from {} to {} UTC, {:.1} s", utc(start_s), utc(end_s), end_s - start_s)?;
    }
    for (board, of_board) in &contents.boards {
        let sensors: Vec<&str> = of_board.sensors.iter().map(String::as_str).collect();
        writeln!(
            out,
            "board {board}: {} records, {} lost, {} boots, sensors {}",
            of_board.records,
            of_board.lost,
            of_board.boots,
            sensors.join(" ")
        )?;
        if of_board.open_gaps > 0 {
            let gaps = of_board.open_gaps;
            writeln!(
                out,
                "board {board}: {gaps} gaps of unknown length: stores that ended, or boots never heard; see /gaps"
            )?;
        }
    }
    for run in runs {
        match run.stop_s {
            Some(stop_s) => writeln!(out, "run {}: {:.1} s", run.name, stop_s - run.start_s)?,
            None => writeln!(out, "run {}: not ended", run.name)?,
        }
    }
    Ok(())
}

fn state_words(scan: &Scan) -> String {
    match (&scan.damage, scan.finished) {
        (Some(damage), _) => format!(", not finished: {damage}, {} bytes belong to no whole group", scan.torn()),
        (None, false) => ", not finished".to_owned(),
        (None, true) => String::new(),
    }
}

fn doctor(arguments: &DoctorArguments) -> Result<(), Failure> {
    let mut truths = Vec::new();
    for path in &arguments.truth {
        truths.extend(verify::read_truth(path)?);
    }
    let steps = Steps::of_bytes(read::size(&arguments.log)?, "checking the log");
    let truths = (!arguments.truth.is_empty()).then_some(truths);
    let finding = verify::verify(&arguments.log, truths, &|bytes| steps.advance(bytes))?;
    drop(steps);
    if arguments.json.leaves_words() {
        for (path, scan) in &finding.files {
            println!("{}: {} bytes{}", path.display(), scan.length, state_words(scan));
        }
        println!("{} records, none twice: {}", finding.records, if finding.twice == 0 { "yes" } else { "no" });
        for fault in &finding.faults {
            println!("{fault}");
        }
        if let Some(truth) = &finding.truth {
            println!(
                "truth: {} records taken, {} of them acknowledged; {} stored as taken, {} thinned out or lost with power and told",
                truth.taken, truth.acknowledged, truth.stored, truth.told
            );
        }
    }
    arguments.json.write(&json!({
        "format": 1, "command": "log doctor",
        "records": finding.records, "twice": finding.twice, "faults": finding.faults, "truth": finding.truth,
    }))?;
    if finding.is_sound() { Ok(()) } else { Err(Failure::Work(finding.in_a_line())) }
}

fn recover(arguments: &RecoverArguments) -> Result<(), Failure> {
    // It is read, copied, and read again.
    let steps = Steps::of_bytes(3 * read::size(&arguments.file)?, "recovering");
    let step = |bytes| steps.advance(bytes);
    let scan = store::scan_stepwise(&arguments.file, step, |_| {})?;
    let copied = verify::recover(&arguments.file, &scan, &arguments.out, &step)
        .map_err(|error| Failure::Work(format!("{}: {error}", arguments.out.display())))?;
    // A file that was recovered is read again before anybody trusts it.
    let again = store::scan_stepwise(&arguments.out, step, |_| {})?;
    drop(steps);
    if !again.finished || again.summary.message_count() != scan.summary.message_count() {
        return Err(Failure::Work(format!("{}: did not read back as it was written", arguments.out.display())));
    }
    println!(
        "{}: {} messages in {copied} bytes; {} bytes of {} belonged to no whole group",
        arguments.out.display(),
        again.summary.message_count(),
        scan.torn(),
        arguments.file.display()
    );
    Ok(())
}

fn export_run(arguments: &ExportArguments) -> Result<(), Failure> {
    let passes = 2 + u64::from(arguments.run.is_some());
    let steps = Steps::of_bytes(passes * read::size(&arguments.log)?, "exporting");
    let step = |bytes| steps.advance(bytes);
    let run = match &arguments.run {
        None => None,
        Some(name) => Some(chosen_run(&arguments.log, name, &step)?),
    };
    let to_standard = arguments.out == Path::new("-");
    let failed = |error: ExportError| match error {
        ExportError::Input(error) => Failure::Input(error),
        ExportError::Output(error) => Failure::Work(format!("{}: {error}", arguments.out.display())),
    };
    let exported = if to_standard {
        export(&arguments.log, run.as_ref(), &step, &mut BufWriter::new(io::stdout().lock())).map_err(failed)?
    } else {
        // Written beside its place and moved there whole.
        let mut name = arguments.out.clone().into_os_string();
        name.push(".part");
        let part = PathBuf::from(name);
        let file = std::fs::File::create(&part).map_err(|error| failed(error.into()))?;
        let mut out = BufWriter::new(file);
        let exported = export(&arguments.log, run.as_ref(), &step, &mut out).and_then(|exported| {
            out.flush()?;
            std::fs::rename(&part, &arguments.out)?;
            Ok(exported)
        });
        exported.map_err(|error| {
            let _ = std::fs::remove_file(&part);
            failed(error)
        })?
    };
    drop(steps);
    if arguments.json.leaves_words() {
        eprintln!(
            "{} readings of {} sensors; left out: {} without a value, {} out of range; times known to {:.1} ms",
            exported.readings,
            exported.sensors.len(),
            exported.missing,
            exported.out_of_range,
            exported.time_uncertainty_s * 1e3
        );
        if exported.times_unbounded > 0 {
            eprintln!(
                "{} readings have times known on one side only, they were read then or before: their boards' boots ended \
                 before an answer was echoed",
                exported.times_unbounded
            );
        }
    }
    arguments.json.write(&json!({"format": 1, "command": "log export", "exported": exported}))
}

fn chosen_run(log: &Path, name: &str, step: &dyn Fn(u64)) -> Result<LoggedRun, Failure> {
    let found = runs(log, step)?;
    let named: Vec<&str> = found.iter().map(|run| run.name.as_str()).collect();
    // Of several runs of one name the last is meant: the others were tries.
    found.iter().rfind(|run| run.name == name).cloned().ok_or_else(|| {
        let known = if named.is_empty() { "no run".to_owned() } else { named.join(", ") };
        Failure::Input(InputError::of_file(log, format!("has no run named {name}; it has {known}")))
    })
}
