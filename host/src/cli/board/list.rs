//! `thermokin board list`: the boards of the registry, and what their logger hears of them.

use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use clap::Args;
use serde_json::json;

use super::path_or_default;
use crate::cli::Failure;
use crate::cli::output::JsonOption;
use crate::input::InputError;
use crate::logger::registry::Registry;
use crate::logger::status::{BoardStatus, Status, status_path};

/// A board counts as heard when its last word is no older than this: what the logger calls silent.
const HEARD_US: u64 = 10_000_000;

#[derive(Debug, Args)]
pub struct Arguments {
    /// The folder of log files of the logger that hears the boards
    #[arg(long, value_name = "DIR", default_value = "thermokin-log")]
    store: PathBuf,
    /// The registry of boards [default: thermokin/boards.toml in the user's configuration]
    #[arg(long, value_name = "FILE")]
    registry: Option<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
}

/// Lists the boards.
///
/// # Errors
/// A registry or a logger's state that cannot be read.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let registry = Registry::read(&path_or_default(arguments.registry.as_ref()))?;
    let status = Status::read(&arguments.store)
        .map_err(|error| InputError::of_file(&status_path(&arguments.store), error.to_string()))?;
    let now_us = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_micros() as u64);
    let of = |number: u32| status.as_ref().and_then(|status| status.board(number));
    let heard = |number: u32| {
        of(number).and_then(|board| board.heard_us).is_some_and(|at| now_us.saturating_sub(at) <= HEARD_US)
    };
    if arguments.json.leaves_words() {
        for board in &registry.boards {
            let sensors: Vec<String> = board.sensors.iter().map(|address| format!("0x{address:02X}")).collect();
            println!(
                "board {}: {}, link {}, sensors {}: {}",
                board.board,
                board.robot,
                board.link,
                sensors.join(" "),
                words(of(board.board), now_us)
            );
        }
        if status.is_none() {
            eprintln!(
                "no logger has written to {} yet: --store names the folder of the one that hears the boards",
                arguments.store.display()
            );
        }
    }
    arguments.json.write(&json!({
        "format": 1, "command": "board list",
        "boards": registry.boards.iter().map(|board| json!({
            "board": board.board, "robot": board.robot, "link": board.link, "sensors": board.sensors,
            "heard": heard(board.board), "status": of(board.board),
        })).collect::<Vec<_>>(),
    }))
}

/// What is heard of a board, in words.
fn words(board: Option<&BoardStatus>, now_us: u64) -> String {
    let Some((board, heard_us)) = board.and_then(|board| Some((board, board.heard_us?))) else {
        return "not heard".to_owned();
    };
    let ago_us = now_us.saturating_sub(heard_us);
    let mut parts = Vec::new();
    let from = board.address.as_deref().unwrap_or("an unknown address");
    parts.push(if ago_us <= HEARD_US {
        format!("heard from {from}")
    } else {
        format!("silent for {} s, last heard from {from}", ago_us / 1_000_000)
    });
    if let (Some(firmware), Some(reset)) = (&board.firmware, &board.reset) {
        parts.push(format!("firmware {firmware}, last start: {reset}"));
    }
    parts.extend(board.battery_mv.map(|millivolts| format!("battery {:.2} V", f64::from(millivolts) / 1e3)));
    parts.extend(board.signal_dbm.map(|dbm| format!("signal {dbm} dBm")));
    for (count, what) in [
        (u64::from(board.reads_failed), "reads failed"),
        (u64::from(board.bus_recoveries), "bus recoveries"),
        (u64::from(board.records_dropped), "records thinned out"),
        (board.lost, "records lost"),
    ] {
        if count > 0 {
            parts.push(format!("{count} {what}"));
        }
    }
    parts.extend(board.update.as_ref().map(|update| format!("new program {}", update.state)));
    parts.join(", ")
}
