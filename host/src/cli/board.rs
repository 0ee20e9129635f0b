//! `thermokin board`: link boards, real and virtual, and the registry of them.

mod config;
mod flash;
mod list;
mod update;

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Command as Program;
use std::time::{SystemTime, UNIX_EPOCH};

use clap::{Args, Subcommand};
use serde_json::json;
use thermokin_protocol::{MAX_SENSORS, SCHEMA_VERSION, Settings};

use super::Failure;
use super::output::JsonOption;
use crate::input::InputError;
use crate::logger::registry::{Board, Registry, hex, new_key, write_secret};
use crate::logger::scenario::Recorded;
use crate::logger::serve::stop_on_signals;
use crate::logger::virtual_board::{Faults, Outcome, Place, Simulation, simulate, warming, write_truth};
use crate::robot::Robot;

/// Link boards: give them their key and place, list them, simulate them
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  thermokin board add --robot robot.toml --board 0 --out board0.toml\n  \
    thermokin board virtual --count 5 --duration 60")]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a board's key and its place in the registry, and write what the board needs
    #[command(after_help = "Example:\n  thermokin board add --robot robot.toml --board 0 --out board0.toml")]
    Add(AddArguments),
    /// The boards of the registry, without their keys, and which of them are heard
    #[command(after_help = "Example:\n  thermokin board list --store thermokin-log")]
    List(list::Arguments),
    /// Write the page that a board reads its key, sensors, host and network from
    #[command(after_help = "Example:\n  thermokin board config --board 0 --host logger.local --ssid cell \
        --password-file wifi.txt --out board0.page")]
    Config(config::Arguments),
    /// Write firmware and configuration onto an ESP32-C3, by espflash
    #[command(after_help = "Example:\n  thermokin board flash --port /dev/ttyACM0 --board 0 --host logger.local \
        --ssid cell --password-file wifi.txt")]
    Flash(flash::Arguments),
    /// Give boards that are already glued on a new program, over the air
    #[command(after_help = "Example:\n  thermokin board update --board 0,1 --store thermokin-log")]
    Update(update::Arguments),
    /// Simulate boards on this machine that speak the same protocol
    #[command(after_help = "Examples:\n  thermokin board virtual --robot robot.toml --duration 60\n  \
        thermokin board virtual --count 5 --loss 0.3 --reorder 0.1 --duplicate 0.1 --reboot 60 --truth truth.csv")]
    Virtual(VirtualArguments),
}

#[derive(Debug, Args)]
struct AddArguments {
    /// The board's number, as in robot.toml
    #[arg(long, value_name = "N")]
    board: u32,
    /// Take robot, link and sensors from this robot.toml
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// The link that the board is glued to, if robot.toml does not say
    #[arg(long, value_name = "N")]
    link: Option<u32>,
    /// The I2C addresses of its sensors, if robot.toml does not say
    #[arg(long, value_name = "0x48,0x49", value_delimiter = ',', value_parser = address)]
    sensors: Vec<u8>,
    /// Give the board a new key if it is in the registry already; its old key is void
    #[arg(long)]
    new_key: bool,
    /// Write what the board needs to this file (mode 600) and not to standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// The registry of boards [default: thermokin/boards.toml in the user's configuration]
    #[arg(long, value_name = "FILE")]
    registry: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct VirtualArguments {
    /// How many boards, numbered from --first; those that the registry does not have are added to it
    #[arg(long, value_name = "N", default_value_t = 5)]
    count: u32,
    /// The number of the first board
    #[arg(long, value_name = "N", default_value_t = 0)]
    first: u32,
    /// Simulate the boards and sensors of this robot, and not --count boards
    #[arg(long, value_name = "FILE", conflicts_with = "count")]
    robot: Option<PathBuf>,
    /// Take the temperatures from a temperatures.csv, by the sensors' names in robot.toml
    #[arg(long, value_name = "FILE", requires = "robot")]
    scenario: Option<PathBuf>,
    /// Run through the scenario this many times as fast
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    speed: f64,
    /// Where the logger listens
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:4840")]
    host: SocketAddr,
    /// How long to take readings, in seconds; without it until interrupted
    #[arg(long, value_name = "S")]
    duration: Option<f64>,
    /// How long to wait after that for the last acknowledgement, in seconds
    #[arg(long, value_name = "S", default_value_t = 30.0)]
    drain: f64,
    /// Records a second of each board until the host's settings say otherwise [default: the registry's]
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// How many records a board sends together [default: the registry's]
    #[arg(long, value_name = "N")]
    batch: Option<u16>,
    /// The probability that a datagram is lost
    #[arg(long, value_name = "P", default_value_t = 0.0, value_parser = probability)]
    loss: f64,
    /// The probability that a datagram comes twice
    #[arg(long, value_name = "P", default_value_t = 0.0, value_parser = probability)]
    duplicate: f64,
    /// The probability that a datagram is held back by up to a second
    #[arg(long, value_name = "P", default_value_t = 0.0, value_parser = probability)]
    reorder: f64,
    /// Delay each datagram by up to this many milliseconds
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    delay: f64,
    /// The probability that a bit of a datagram is flipped
    #[arg(long, value_name = "P", default_value_t = 0.0, value_parser = probability)]
    corrupt: f64,
    /// The probability, with each datagram, that an earlier one is sent again
    #[arg(long, value_name = "P", default_value_t = 0.0, value_parser = probability)]
    replay: f64,
    /// The mean time between two reboots of a board, in seconds; 0 is never
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    reboot: f64,
    /// The probability that a board's unsent records survive its reboot
    #[arg(long, value_name = "P", default_value_t = 1.0, value_parser = probability)]
    retain: f64,
    /// How many more boards with wrong keys to simulate, under the numbers of the last
    #[arg(long, value_name = "N", default_value_t = 0)]
    bad_keys: u32,
    /// The seed of everything random [default: the time of day]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Write every record taken, with its fate, to this file: `thermokin log doctor --truth` compares
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// The registry of boards [default: thermokin/boards.toml in the user's configuration]
    #[arg(long, value_name = "FILE")]
    registry: Option<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
}

fn probability(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number from 0 to 1".to_owned())?;
    if (0.0..=1.0).contains(&value) { Ok(value) } else { Err("expected a number from 0 to 1".to_owned()) }
}

fn address(text: &str) -> Result<u8, String> {
    let wrong = || "expected a 7-bit I2C address such as 0x48".to_owned();
    let value = match text.strip_prefix("0x") {
        Some(digits) => u8::from_str_radix(digits, 16),
        None => text.parse(),
    };
    value.ok().filter(|address| *address < 0x80).ok_or_else(wrong)
}

/// Carries the command out.
///
/// # Errors
/// Bad input, or a file that cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.command {
        Command::Add(arguments) => add(arguments),
        Command::List(arguments) => list::run(arguments),
        Command::Config(arguments) => config::run(arguments),
        Command::Flash(arguments) => flash::run(arguments),
        Command::Update(arguments) => update::run(arguments),
        Command::Virtual(arguments) => simulate_boards(arguments),
    }
}

/// The registry, or an empty one where there is none yet.
pub(super) fn registry_or_new(path: &Path) -> Result<Registry, InputError> {
    if path.exists() { Registry::read(path) } else { Ok(Registry::default()) }
}

fn path_or_default(path: Option<&PathBuf>) -> PathBuf {
    path.cloned().unwrap_or_else(Registry::default_path)
}

/// Runs another program to its end.
fn execute(command: &mut Program) -> Result<(), Failure> {
    let program = command.get_program().to_string_lossy().into_owned();
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(Failure::Work(format!("{program} failed ({status})"))),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            Err(Failure::Work(format!("{program} is not installed: cargo install espflash --locked")))
        }
        Err(error) => Err(Failure::Work(format!("{program}: {error}"))),
    }
}

fn now_s() -> u32 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(1, |since| since.as_secs() as u32)
}

fn add(arguments: &AddArguments) -> Result<(), Failure> {
    let path = path_or_default(arguments.registry.as_ref());
    let mut registry = registry_or_new(&path)?;
    let number = arguments.board;
    if registry.board(number).is_some() && !arguments.new_key {
        let message = format!("has board {number} already; --new-key gives it a new key and makes the old one void");
        return Err(InputError::of_file(&path, message).into());
    }
    let mut board = Board {
        board: number,
        robot: String::new(),
        link: arguments.link.unwrap_or(0),
        sensors: arguments.sensors.clone(),
        key: new_key().map_err(|error| Failure::Work(format!("/dev/urandom: {error}")))?,
        // Boots are counted up from now: above every boot under an earlier key, if the board booted less than once a
        // second since.
        first_boot: now_s(),
    };
    if let Some(file) = &arguments.robot {
        let robot = Robot::read(file)?;
        let (link, sensors) = place_of(&robot, number);
        if sensors.is_empty() && board.sensors.is_empty() {
            return Err(InputError::of_file(file, format!("has no sensor on board {number}")).into());
        }
        board.robot = robot.name.clone();
        board.link = arguments.link.or(link).unwrap_or(0);
        if board.sensors.is_empty() {
            board.sensors = sensors;
        }
    }
    if board.sensors.is_empty() {
        return Err(Failure::Usage(
            "a board needs sensors: --robot FILE names them, or --sensors 0x48,0x49".to_owned(),
        ));
    }
    if board.sensors.len() > MAX_SENSORS {
        return Err(Failure::Usage(format!("a board reads at most {MAX_SENSORS} sensors")));
    }
    let sensors: Vec<String> = board.sensors.iter().map(|address| format!("0x{address:02X}")).collect();
    let needed = format!(
        "# What link board {number} needs. It holds the board's key: keep it from others, erase it when the board has it.\n\
         board = {number}\nlink = {}\nsensors = [{}]\nkey = \"{}\"\nfirst_boot = {}\n",
        board.link,
        sensors.join(", "),
        hex(&board.key),
        board.first_boot
    );
    registry.boards.retain(|other| other.board != number);
    registry.boards.push(board);
    registry.boards.sort_by_key(|board| board.board);
    registry.write(&path)?;
    match &arguments.out {
        Some(out) => {
            write_secret(out, needed.as_bytes())
                .map_err(|error| Failure::Work(format!("{}: {error}", out.display())))?;
            println!("board {number} is in {}; what it needs is in {}", path.display(), out.display());
        }
        None => print!("{needed}"),
    }
    Ok(())
}

/// The link and the addresses of a robot's sensors on a board.
fn place_of(robot: &Robot, board: u32) -> (Option<u32>, Vec<u8>) {
    let on_board = || robot.sensors.iter().filter(|sensor| sensor.board == Some(board));
    let link = on_board().map(|sensor| sensor.link as u32).next();
    (link, on_board().filter_map(|sensor| sensor.address).collect())
}

/// A board's number, its link and the addresses of its sensors.
pub(super) type Wanted = (u32, u32, Vec<u8>);

/// The boards that a robot's sensors are read by.
pub(super) fn boards_of(robot: &Robot) -> Vec<Wanted> {
    let mut numbers: Vec<u32> = robot.sensors.iter().filter_map(|sensor| sensor.board).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let place = |number: u32| {
        let (link, sensors) = place_of(robot, number);
        (number, link.unwrap_or(0), sensors)
    };
    numbers.into_iter().map(place).collect()
}

/// Those boards as the registry has them, to be simulated.
pub(super) fn places(registry: &Registry, wanted: &[Wanted]) -> Vec<Place> {
    let known = wanted.iter().filter_map(|(number, ..)| registry.board(*number));
    known
        .map(|board| Place {
            board: board.board,
            key: board.key.clone(),
            sensors: board.sensors.clone(),
            first_boot: board.first_boot,
        })
        .collect()
}

fn simulate_boards(arguments: &VirtualArguments) -> Result<(), Failure> {
    let path = path_or_default(arguments.registry.as_ref());
    let mut registry = registry_or_new(&path)?;
    let robot = arguments.robot.as_ref().map(|file| Robot::read(file).map(|robot| (file, robot))).transpose()?;
    let wanted: Vec<Wanted> = match &robot {
        Some((file, robot)) => {
            let wanted = boards_of(robot);
            if wanted.is_empty() {
                return Err(InputError::of_file(file, "has no sensor with a board and an address").into());
            }
            wanted
        }
        None => (arguments.first..arguments.first.saturating_add(arguments.count))
            .map(|number| (number, 0, vec![0x48, 0x49, 0x4A, 0x4B]))
            .collect(),
    };
    let name = robot.as_ref().map_or("virtual", |(_, robot)| robot.name.as_str());
    add_missing(&mut registry, &path, name, &wanted)?;
    let mut places = places(&registry, &wanted);
    let bad = arguments.bad_keys as usize;
    for index in 0..bad {
        let copied = places[places.len() - 1 - index.min(wanted.len() - 1)].clone();
        places.push(copied);
    }
    let mut settings = Settings { revision: 0, ..registry.settings };
    if let Some(rate) = arguments.rate {
        if !(rate > 0.0 && rate <= 1000.0) {
            return Err(Failure::Usage("--rate: expected records a second above 0 and up to 1000".to_owned()));
        }
        settings.sampling_period_ms = ((1000.0 / rate).round() as u32).max(1);
        settings.revision = u32::MAX;
    }
    if let Some(batch) = arguments.batch {
        settings.batch_length = batch.max(1);
        settings.revision = u32::MAX;
    }
    let seed = arguments
        .seed
        .unwrap_or_else(|| SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64));
    eprintln!("{} virtual boards to {}, seed {seed}", wanted.len(), arguments.host);
    let recorded = match (&arguments.scenario, &robot) {
        (Some(file), Some((_, robot))) => Some(Recorded::read(file, robot)?),
        _ => None,
    };
    let speed = arguments.speed;
    let scenario = move |board: u32, address: u8, seconds: f64| match &recorded {
        Some(recorded) => recorded.celsius(board, address, seconds * speed),
        None => warming(board, address, seconds * speed),
    };
    let simulation = Simulation {
        places,
        host: arguments.host,
        settings,
        faults: Faults {
            loss: arguments.loss,
            duplicate: arguments.duplicate,
            reorder: arguments.reorder,
            delay_ms: arguments.delay,
            corrupt: arguments.corrupt,
            replay: arguments.replay,
            reboot_s: arguments.reboot,
            retain: arguments.retain,
            bad_keys: bad,
        },
        seed,
        duration_s: arguments.duration,
        drain_s: arguments.drain,
        scenario: &scenario,
        keep_truth: arguments.truth.is_some(),
    };
    let stop = stop_on_signals().map_err(|error| Failure::Work(error.to_string()))?;
    // Few boards have room for an hour of outage; thousands share this machine's memory.
    let outcome = if wanted.len() <= 100 {
        simulate::<4096>(simulation, &stop, progress)
    } else {
        simulate::<256>(simulation, &stop, progress)
    }
    .map_err(|error| Failure::Work(format!("{}: {error}", arguments.host)))?;
    if let Some(theirs) = outcome.host_version {
        eprintln!(
            "the host speaks schema version {theirs}, these boards speak {SCHEMA_VERSION}: update the older one; \
             the boards keep their records until then"
        );
    }
    if let Some(file) = &arguments.truth {
        write_truth(file, &outcome.truth).map_err(|error| Failure::Work(format!("{}: {error}", file.display())))?;
    }
    if arguments.json.leaves_words() {
        println!(
            "{} records taken, {} acknowledged, {} thinned out, {} lost with power, {} still held; {} datagrams sent, \
             {} replayed, {} reboots; slowest acknowledgement {:.2} s",
            outcome.taken,
            outcome.acknowledged,
            outcome.thinned,
            outcome.powered_off,
            outcome.held,
            outcome.sent,
            outcome.replayed,
            outcome.reboots,
            outcome.slowest_s
        );
    }
    arguments.json.write(&json!({
        "format": 1, "command": "board virtual", "seed": seed,
        "taken": outcome.taken, "acknowledged": outcome.acknowledged, "thinned": outcome.thinned,
        "powered_off": outcome.powered_off, "held": outcome.held, "datagrams": outcome.sent,
        "replayed": outcome.replayed, "reboots": outcome.reboots, "slowest_s": outcome.slowest_s,
    }))
}

/// Adds to the registry the boards that it does not have, and says so.
fn add_missing(registry: &mut Registry, path: &Path, robot: &str, wanted: &[Wanted]) -> Result<(), Failure> {
    let added = add_boards(registry, robot, wanted)?;
    if added > 0 {
        registry.write(path)?;
        eprintln!("{added} boards added to {}", path.display());
    }
    Ok(())
}

/// Adds to a registry the boards that it does not have, each with a new key; returns how many.
pub(super) fn add_boards(registry: &mut Registry, robot: &str, wanted: &[Wanted]) -> Result<usize, Failure> {
    let known: std::collections::BTreeSet<u32> = registry.boards.iter().map(|board| board.board).collect();
    let mut added = 0;
    for (number, link, sensors) in wanted.iter().filter(|(number, ..)| !known.contains(number)) {
        registry.boards.push(Board {
            board: *number,
            robot: robot.to_owned(),
            link: *link,
            sensors: sensors.clone(),
            key: new_key().map_err(|error| Failure::Work(format!("/dev/urandom: {error}")))?,
            first_boot: now_s(),
        });
        added += 1;
    }
    registry.boards.sort_by_key(|board| board.board);
    Ok(added)
}

fn progress(outcome: &Outcome) {
    use std::io::IsTerminal;
    if std::io::stderr().is_terminal() {
        eprint!("\r{} records taken, {} acknowledged ", outcome.taken, outcome.acknowledged);
    }
}
