//! `thermokin board config`: the page that a board reads its number, key, sensors, host and network from.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use thermokin_protocol::{Configuration, Sensor, SensorKind, Wifi};

use super::path_or_default;
use super::update::key_path;
use crate::cli::Failure;
use crate::input::InputError;
use crate::logger::program::signing_key;
use crate::logger::registry::{Registry, write_secret};

/// The most sensors that the firmware reads.
const MOST_SENSORS: usize = 4;
/// The addresses that a MAX30205 can have.
const ADDRESSES: std::ops::RangeInclusive<u8> = 0x40..=0x5F;

/// What a board is told beside what the registry knows.
#[derive(Debug, Args)]
pub struct PageArguments {
    /// The board's number, as in the registry
    #[arg(long, value_name = "N")]
    board: u32,
    /// The computer that `thermokin log` runs on: an IPv4 address, or a name such as logger.local
    #[arg(long, value_name = "HOST")]
    host: String,
    /// The UDP port that it listens on
    #[arg(long, value_name = "PORT", default_value_t = 4840)]
    udp_port: u16,
    /// The name of the wireless network
    #[arg(long, value_name = "NAME")]
    ssid: String,
    /// A file whose first line is the network's password; without it the network is open
    #[arg(long, value_name = "FILE")]
    password_file: Option<PathBuf>,
    /// The key that signs programs, made if there is none yet: the board takes new programs of this key over the air
    /// [default: update.key beside the registry]
    #[arg(long, value_name = "FILE")]
    update_key: Option<PathBuf>,
    /// The registry of boards [default: thermokin/boards.toml in the user's configuration]
    #[arg(long, value_name = "FILE")]
    registry: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct Arguments {
    #[command(flatten)]
    page: PageArguments,
    /// The file to write, readable by its owner only
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Writes the page. Neither the key nor the password is ever shown.
///
/// # Errors
/// Bad input, or a file that cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let configuration = configuration(&arguments.page)?;
    write_secret(&arguments.out, &configuration.to_page())
        .map_err(|error| Failure::Work(format!("{}: {error}", arguments.out.display())))?;
    println!(
        "what board {} needs is in {}; it holds the board's key: keep it from others",
        configuration.board,
        arguments.out.display()
    );
    Ok(())
}

/// A board's configuration, from the registry and the command line.
///
/// # Errors
/// A board that the registry does not have, or something that the firmware could not use.
pub fn configuration(arguments: &PageArguments) -> Result<Configuration, Failure> {
    let path = path_or_default(arguments.registry.as_ref());
    let registry = Registry::read(&path)?;
    let wrong = |message: String| Failure::from(InputError::of_file(&path, message));
    let number = arguments.board;
    let board = registry
        .board(number)
        .ok_or_else(|| wrong(format!("has no board {number}: thermokin board add --board {number} makes one")))?;
    if board.sensors.len() > MOST_SENSORS {
        let count = board.sensors.len();
        return Err(wrong(format!("board {number} has {count} sensors, its firmware reads at most {MOST_SENSORS}")));
    }
    if let Some(address) = board.sensors.iter().find(|address| !ADDRESSES.contains(*address)) {
        return Err(wrong(format!(
            "board {number}: a MAX30205 cannot have address 0x{address:02X}, only 0x40 to 0x5F"
        )));
    }
    let update_key = signing_key(&key_path(arguments.update_key.as_ref(), &path))?;
    let long = |what: &str, most: usize| Failure::Usage(format!("{what} is longer than {most} bytes"));
    let password = match &arguments.password_file {
        Some(file) => first_line(file)?,
        None => String::new(),
    };
    // The place is for people; a long robot's name is cut.
    let mut place = format!("{}, link {}", board.robot, board.link);
    while place.len() > 63 {
        place.pop();
    }
    Ok(Configuration {
        board: number,
        key: board.key.clone(),
        first_boot: board.first_boot,
        host: arguments.host.as_str().try_into().map_err(|_| long("--host", 63))?,
        port: arguments.udp_port,
        sensors: board.sensors.iter().map(|&address| Sensor { address, kind: SensorKind::Max30205 }).collect(),
        place: place.as_str().try_into().map_err(|_| long("the place", 63))?,
        wifi: Some(Wifi {
            ssid: arguments.ssid.as_str().try_into().map_err(|_| long("--ssid", 32))?,
            password: password.as_str().try_into().map_err(|_| long("the password", 64))?,
        }),
        update_key: Some(update_key.verifying_key().to_bytes()),
    })
}

fn first_line(file: &Path) -> Result<String, InputError> {
    let text = fs::read_to_string(file).map_err(|error| InputError::of_file(file, error.to_string()))?;
    Ok(text.lines().next().unwrap_or_default().to_owned())
}
