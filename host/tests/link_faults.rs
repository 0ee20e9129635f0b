//! The link under fire: virtual boards behind a bad network, rebooting, with forgers and replays among them, and the real
//! logger killed with SIGKILL again and again. At the end the store must equal the truth, record for record.
//!
//! In the test suite it runs for a third of a minute. `THERMOKIN_FAULT_SECONDS=600 THERMOKIN_FAULT_KILLS=20 cargo test
//! --release -p thermokin --test link_faults -- --nocapture` is the long form.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// The number in an environment variable, or a default.
fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

fn thermokin(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_thermokin"));
    command.current_dir(folder);
    command
}

fn start_logger(folder: &Path, port: u16) -> Child {
    thermokin(folder)
        .args(["log", "--plain", "--registry", "boards.toml", "--store", "store", "--rotate-mib", "1", "--listen"])
        .arg(format!("127.0.0.1:{port}"))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the logger starts")
}

fn words(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// A port that is free now.
fn free_port() -> u16 {
    std::net::UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a free port").port()
}

/// Runs the boards for a time while the logger is killed, and returns what the doctor says.
fn fault_run(faults: &[&str], seconds: u64, kills: u64) -> Output {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let port = free_port();
    let seed = number("THERMOKIN_FAULT_SEED", u64::from(std::process::id()));
    println!("seed {seed} (THERMOKIN_FAULT_SEED), {seconds} s, {kills} kills");
    // The registry first, so that the logger finds it.
    let boards = ["board", "virtual", "--registry", "boards.toml", "--count", "8", "--seed", &seed.to_string()]
        .map(str::to_owned);
    let made = thermokin(folder).args(&boards).args(["--duration", "0", "--drain", "0"]).output().expect("it runs");
    assert!(made.status.success(), "{}", words(&made));
    let mut simulation = thermokin(folder)
        .args(&boards)
        .args(["--rate", "10", "--batch", "5", "--drain", "120", "--truth", "truth.csv", "--host"])
        .arg(format!("127.0.0.1:{port}"))
        .args(["--duration", &seconds.to_string()])
        .args(faults)
        .stdout(Stdio::piped())
        .spawn()
        .expect("the boards start");
    let begun = Instant::now();
    let mut logger = start_logger(folder, port);
    // Kills at unequal times, so that they meet every part of a group's way to the disk.
    for kill in 0..kills {
        let at = seconds as f64 * (kill as f64 + 0.35 + 0.6 * ((kill * 7 % 10) as f64 / 10.0)) / (kills as f64 + 0.5);
        sleep(Duration::from_secs_f64(at).saturating_sub(begun.elapsed()));
        logger.kill().expect("it is killed");
        logger.wait().expect("it is gone");
        logger = start_logger(folder, port);
    }
    let ended = simulation.wait().expect("the boards end");
    assert!(ended.success());
    // The last kill finds the files as they are: nothing is finished for the doctor's sake but by the next start.
    logger.kill().expect("it is killed");
    logger.wait().expect("it is gone");
    let mut last = start_logger(folder, port);
    sleep(Duration::from_secs(2));
    last.kill().expect("it is killed");
    last.wait().expect("it is gone");
    let doctor = thermokin(folder)
        .args(["log", "doctor", "store", "--truth", "truth.csv", "--json", "-"])
        .output()
        .expect("the doctor runs");
    println!("{}", words(&doctor));
    doctor
}

/// What the doctor found, without the complaint that the file of the last, killed logger is not finished.
fn truth_of(doctor: &Output) -> serde_json::Value {
    let json: serde_json::Value = serde_json::from_slice(&doctor.stdout).expect("the doctor writes JSON");
    assert_eq!(json["twice"], 0, "{json}");
    let truth = json["truth"].clone();
    assert_eq!((&truth["wrong"], &truth["missing"], &truth["untold"]), (&0.into(), &0.into(), &0.into()), "{json}");
    truth
}

#[test]
fn the_store_equals_the_truth_after_kills_losses_and_reboots() {
    let (seconds, kills) = (number("THERMOKIN_FAULT_SECONDS", 20), number("THERMOKIN_FAULT_KILLS", 5));
    let faults = [
        "--loss",
        "0.3",
        "--reorder",
        "0.1",
        "--duplicate",
        "0.1",
        "--delay",
        "50",
        "--corrupt",
        "0.01",
        "--replay",
        "0.05",
        "--reboot",
        "15",
        "--retain",
        "1",
        "--bad-keys",
        "2",
    ];
    let truth = truth_of(&fault_run(&faults, seconds, kills));
    // Ten records a second of eight boards; what the two forgers took is not in the truth and must be nowhere.
    assert!(truth["stored"].as_u64() >= Some(seconds * 70), "{truth}");
    assert_eq!(truth["stored"], truth["taken"], "stores survived every reboot, so nothing may be lost: {truth}");
}

#[test]
fn what_dies_with_a_boards_power_is_told_and_nothing_else_is_lost() {
    let faults = ["--loss", "0.2", "--reorder", "0.1", "--reboot", "5", "--retain", "0.3"];
    let truth = truth_of(&fault_run(&faults, 12, 2));
    assert!(truth["stored"].as_u64() >= truth["acknowledged"].as_u64(), "{truth}");
    let told = truth["told"].as_u64().expect("a number");
    let stored = truth["stored"].as_u64().expect("a number");
    assert_eq!(Some(told + stored), truth["taken"].as_u64(), "{truth}");
}
