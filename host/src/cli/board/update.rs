//! `thermokin board update`: a new program for boards that are already glued on, over the air.

use std::fs;
use std::io::{IsTerminal, Write};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use serde_json::json;
use thermokin_protocol::Firmware;
use thermokin_protocol::update::Target;

use super::{execute, now_s, path_or_default};
use crate::cli::Failure;
use crate::cli::output::JsonOption;
use crate::input::InputError;
use crate::logger::program::{SignedProgram, described, signing_key, version};
use crate::logger::registry::Registry;
use crate::logger::serve::control_path;
use crate::logger::status::{Status, UpdateStatus};

/// How often the logger's state is read.
const LOOK: Duration = Duration::from_millis(500);
/// A logger that does not show the order by then is given it again: it may have been restarted.
const ASK_AGAIN: Duration = Duration::from_secs(10);

#[derive(Debug, Args)]
pub struct Arguments {
    /// The boards' numbers, as in the registry
    #[arg(long, value_name = "N,N", value_delimiter = ',', required_unless_present = "all")]
    board: Vec<u32>,
    /// All boards of the registry
    #[arg(long, conflicts_with = "board")]
    all: bool,
    /// The program: what firmware/build-image makes, or an image of espflash save-image
    #[arg(long, value_name = "FILE", default_value = "firmware/target/riscv32imc-unknown-none-elf/release/esp32c3")]
    image: PathBuf,
    /// What it runs on, where it does not say so itself
    #[arg(long, value_name = "TARGET")]
    target: Option<TargetName>,
    /// Its version, where it does not say so itself
    #[arg(long, value_name = "1.2.3", value_parser = parse_version)]
    program_version: Option<Firmware>,
    /// How long the new program may take to reach the logger before the board restarts, in seconds; after three starts
    /// the board goes back to the earlier program
    #[arg(long, value_name = "S", default_value_t = 300, value_parser = clap::value_parser!(u16).range(10..))]
    patience: u16,
    /// The key that signs programs, made if there is none yet [default: update.key beside the registry]
    #[arg(long, value_name = "FILE")]
    update_key: Option<PathBuf>,
    /// The folder of log files of the logger that hears the boards
    #[arg(long, value_name = "DIR", default_value = "thermokin-log")]
    store: PathBuf,
    /// Do not wait for the boards: `thermokin board list` shows how far they are
    #[arg(long)]
    no_wait: bool,
    /// The espflash to make an image with, where the program is an ELF file
    #[arg(long, value_name = "PROGRAM", default_value = "espflash")]
    espflash: PathBuf,
    /// The registry of boards [default: thermokin/boards.toml in the user's configuration]
    #[arg(long, value_name = "FILE")]
    registry: Option<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
}

/// What a program runs on, as said on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TargetName {
    Esp32c3,
    Esp32c6,
    Emulated,
}

fn parse_version(text: &str) -> Result<Firmware, String> {
    version(text).ok_or_else(|| "expected a version of the form 1.2.3".to_owned())
}

/// Signs the program, hands it to the logger, and waits until each board has come to an end with it.
///
/// # Errors
/// Bad input, no logger, or a board that does not run the new program in the end.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let registry_path = path_or_default(arguments.registry.as_ref());
    let registry = Registry::read(&registry_path)?;
    let boards: Vec<u32> = match arguments.all {
        true => registry.boards.iter().map(|board| board.board).collect(),
        false => arguments.board.clone(),
    };
    if let Some(number) = boards.iter().find(|number| registry.board(**number).is_none()) {
        return Err(InputError::of_file(&registry_path, format!("has no board {number}")).into());
    }
    let key = signing_key(&key_path(arguments.update_key.as_ref(), &registry_path))?;
    let image = image(arguments)?;
    let wrong = |message: String| InputError::of_file(&arguments.image, message);
    let (target, version) = match described(&image).transpose().map_err(wrong)? {
        Some(said) => said,
        None => match (arguments.target, arguments.program_version) {
            (Some(target), Some(version)) => (target.into(), version),
            _ => return Err(wrong("does not say what it is: --target and --program-version do".to_owned()).into()),
        },
    };
    if arguments.target.is_some_and(|wanted| Target::from(wanted) != target) {
        return Err(wrong("is for another kind of board than --target says".to_owned()).into());
    }
    let order = now_s();
    let program = SignedProgram::sign(image, target, version, &key).map_err(wrong)?;
    let file = handed_over(&arguments.store, order, &program)?;
    let outcome = boards
        .iter()
        .try_for_each(|&board| ask(&arguments.store, board, order, arguments.patience, &file))
        .and_then(|()| if arguments.no_wait { Ok(Vec::new()) } else { wait(arguments, &boards, order, &file) });
    // A logger that was asked holds the program in its memory; one that has yet to take the wish needs the file.
    if !arguments.no_wait {
        let _ = fs::remove_file(&file);
    }
    let ends = outcome?;
    let number = |version: Firmware| format!("{}.{}.{}", version.major, version.minor, version.patch);
    if arguments.json.leaves_words() {
        for (board, end) in &ends {
            println!("board {board}: {}", end.state);
        }
        if arguments.no_wait {
            println!("version {} is offered to {} boards", number(version), boards.len());
        }
    }
    arguments.json.write(&json!({
        "format": 1, "command": "board update", "version": number(version), "order": order,
        "boards": ends.iter().map(|(board, end)| json!({
            "board": board, "state": end.state, "installed": end.installed,
        })).collect::<Vec<_>>(),
    }))?;
    match ends.iter().filter(|(_, end)| !end.installed).count() {
        0 => Ok(()),
        left => Err(Failure::Work(format!("{left} of {} boards do not run the new program", boards.len()))),
    }
}

impl From<TargetName> for Target {
    fn from(name: TargetName) -> Self {
        match name {
            TargetName::Esp32c3 => Target::Esp32c3,
            TargetName::Esp32c6 => Target::Esp32c6,
            TargetName::Emulated => Target::Emulated,
        }
    }
}

/// Where the key that signs programs is.
pub fn key_path(given: Option<&PathBuf>, registry: &Path) -> PathBuf {
    given.cloned().unwrap_or_else(|| registry.with_file_name("update.key"))
}

/// The image's bytes; an ELF file for an ESP32 is made one by espflash.
fn image(arguments: &Arguments) -> Result<Vec<u8>, Failure> {
    let path = &arguments.image;
    let unreadable = |error: std::io::Error| InputError::of_file(path, error.to_string());
    let bytes = fs::read(path).map_err(unreadable)?;
    let chip = match arguments.target {
        Some(TargetName::Emulated) => return Ok(bytes),
        Some(TargetName::Esp32c6) => "esp32c6",
        Some(TargetName::Esp32c3) | None => "esp32c3",
    };
    if !bytes.starts_with(b"\x7FELF") {
        return Ok(bytes);
    }
    let made = std::env::temp_dir().join(format!("thermokin-update-{}.bin", std::process::id()));
    let mut espflash = Command::new(&arguments.espflash);
    espflash.args(["save-image", "--chip", chip, "--flash-size", "4mb"]).arg(path).arg(&made);
    execute(&mut espflash)?;
    let image = fs::read(&made).map_err(|error| Failure::Work(format!("{}: {error}", made.display())));
    let _ = fs::remove_file(&made);
    image
}

/// Lays the signed program where the logger can read it.
fn handed_over(store: &Path, order: u32, program: &SignedProgram) -> Result<PathBuf, Failure> {
    let failed = |error: std::io::Error| Failure::Work(format!("{}: {error}", store.display()));
    let folder = store.canonicalize().map_err(failed)?;
    let file = folder.join(format!("update-{order}.program"));
    fs::write(&file, program.to_bytes()).map_err(failed)?;
    Ok(file)
}

/// Asks the logger of a store to offer a board the program.
fn ask(store: &Path, board: u32, order: u32, patience_s: u16, file: &Path) -> Result<(), Failure> {
    let words = format!("update {board} {order} {patience_s} {}", file.display());
    UnixDatagram::unbound()
        .and_then(|socket| socket.send_to(words.as_bytes(), control_path(store)))
        .map_err(|error| Failure::Work(format!("{}: no logger is running on this store ({error})", store.display())))?;
    Ok(())
}

/// Waits until all boards have come to an end.
fn wait(arguments: &Arguments, boards: &[u32], order: u32, file: &Path) -> Result<Vec<(u32, UpdateStatus)>, Failure> {
    let mut asked = Instant::now();
    let on_terminal = std::io::stderr().is_terminal();
    loop {
        sleep(LOOK);
        // A file that is half gone for a moment is read the next time.
        let status = Status::read(&arguments.store).ok().flatten();
        let of = |board: u32| {
            let board = status.as_ref().and_then(|status| status.board(board));
            board.and_then(|board| board.update.clone()).filter(|update| update.order == order)
        };
        let known: Vec<(u32, UpdateStatus)> =
            boards.iter().filter_map(|&board| of(board).map(|update| (board, update))).collect();
        if on_terminal {
            let words: Vec<_> = known.iter().map(|(board, update)| format!("board {board} {}", update.state)).collect();
            eprint!("\r\x1B[K{}", words.join(", "));
            let _ = std::io::stderr().flush();
        }
        if known.len() == boards.len() && known.iter().all(|(_, update)| update.over) {
            if on_terminal {
                eprintln!();
            }
            return Ok(known);
        }
        if known.len() < boards.len() && asked.elapsed() > ASK_AGAIN {
            asked = Instant::now();
            for &board in boards.iter().filter(|board| of(**board).is_none()) {
                // A logger that is away may come back.
                let _ = ask(&arguments.store, board, order, arguments.patience, file);
            }
        }
    }
}
