//! `thermokin log` and `thermokin board virtual` through the real binary: a robot's sensors by name with temperatures
//! from a scenario, times as they are exported, ends that speak different schemas, and a disk that is full for a while.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use link_bench::{Bench, PATIENCE};
use serde_json::Value;
use thermokin::logger::registry::Registry;
use thermokin::robot::Robot;
use thermokin_protocol::{
    BoardLink, Direction, Firmware, Header, Identity, Key, Kind, MAX_DATAGRAM, Refused, ResetReason, SCHEMA_VERSION,
    Sensor, SensorKind, Settings, seal,
};

mod link_bench;

/// The fields of each line of a CSV file but the first.
fn rows(text: &str) -> Vec<Vec<&str>> {
    text.lines().skip(1).map(|line| line.split(',').collect()).collect()
}

#[test]
fn a_robots_sensors_by_name_with_a_scenarios_temperatures_at_their_times() {
    let bench = Bench::new();
    let robot_path = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/comau-nj-130-2.0.toml");
    let robot = Robot::read(Path::new(robot_path)).expect("it ships");
    let on_boards: Vec<_> = robot.sensors.iter().filter(|sensor| sensor.board.is_some()).collect();
    assert!(on_boards.len() >= 16, "a robot with several boards");
    // Each sensor has its own temperature and warms by 0.1 K a second; the first jumps by 5 K in its fourth second.
    let mut scenario = "time_s,sensor,celsius\n".to_owned();
    for (number, sensor) in on_boards.iter().enumerate() {
        let first = 20.0 + number as f64;
        let jump = if number == 0 { 5.0 } else { 0.0 };
        for (time, celsius) in
            [(0.0, first), (3.0, first + 0.3), (3.001, first + 0.3 + jump), (60.0, first + 6.0 + jump)]
        {
            writeln!(scenario, "{time},{},{celsius}", sensor.name).expect("text");
        }
    }
    fs::write(bench.path("scenario.csv"), scenario).expect("it is written");
    let boards = ["board", "virtual", "--registry", "boards.toml", "--robot", robot_path, "--seed", "11"];
    bench.run(&[&boards[..], &["--duration", "0", "--drain", "0"]].concat());
    let logger = bench.logger(&["--robot", robot_path, "--run", "warm-up"]);
    bench.run(
        &[
            &boards[..],
            &["--scenario", "scenario.csv", "--host", &logger.address, "--rate", "10", "--batch", "5"],
            &["--duration", "6", "--drain", "60", "--truth", "truth.csv", "--delay", "20"],
        ]
        .concat(),
    );
    let words = logger.stop();
    let jumps = words.matches(&format!("sensor {} jumps: from 20.", on_boards[0].name)).count();
    assert_eq!((jumps, words.matches("jumps").count()), (1, 1), "{words}");
    assert!(!words.contains("does not name") && !words.contains("in the registry"), "{words}");

    let log = "thermokin-log";
    assert_eq!(bench.json(&["log", "doctor", log, "--truth", "truth.csv"])["truth"]["missing"], 0);
    let info = bench.json(&["log", "info", log]);
    let named: Vec<&str> = info["boards"]
        .as_array()
        .expect("boards")
        .iter()
        .flat_map(|board| {
            board["sensors"].as_array().expect("sensors").iter().map(|name| name.as_str().expect("a name"))
        })
        .collect();
    for sensor in &on_boards {
        assert!(named.contains(&sensor.name.as_str()), "no {} in {named:?}", sensor.name);
    }
    assert_eq!(named.len(), on_boards.len());

    // Every value is that of its sensor's place: a sensor that is taken for another is a degree off.
    let exported =
        bench.json(&["log", "export", log, "--run", "warm-up", "--out", "temperatures.csv"])["exported"].take();
    let text = fs::read_to_string(bench.path("temperatures.csv")).expect("it is written");
    let mut times: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for row in rows(&text) {
        let [time_s, name, celsius] = row[..] else { panic!("{row:?}") };
        let (time_s, celsius): (f64, f64) = (time_s.parse().expect("a time"), celsius.parse().expect("a value"));
        times.entry(name).or_default().push(time_s);
        let number = on_boards.iter().position(|sensor| sensor.name == name).expect("a sensor of the robot");
        let rise = celsius - (20.0 + number as f64);
        let expected = if number == 0 { -0.01..=5.7 } else { -0.01..=0.7 };
        assert!(expected.contains(&rise), "{row:?}");
    }

    assert_eq!(exported["times_unbounded"], 0);
    let uncertainty_s = exported["time_uncertainty_s"].as_f64().expect("a number");
    assert!(uncertainty_s > 0.0 && uncertainty_s < 0.2, "{uncertainty_s}");
    // It keeps what it states. Two processes read the system's clock at their starts, which may take a moment each.
    let start_s = bench.json(&["log", "info", log])["runs"][0]["start_s"].as_f64().expect("a run");
    let truth = fs::read_to_string(bench.path("truth.csv")).expect("it is written");
    let mut compared = 0;
    for sensor in &on_boards {
        let mut taken: Vec<f64> = rows(&truth)
            .iter()
            .filter(|row| row[0] == sensor.board.expect("it has a board").to_string())
            .map(|row| row[5].parse::<f64>().expect("a time") / 1e6)
            .collect();
        taken.sort_by(f64::total_cmp);
        let times = &times[sensor.name.as_str()];
        assert_eq!(times.len(), taken.len(), "{}", sensor.name);
        for (time_s, taken_s) in times.iter().zip(taken) {
            let error_s = (start_s + time_s - taken_s).abs();
            assert!(error_s <= uncertainty_s + 0.1, "{}: {error_s} s off", sensor.name);
            compared += 1;
        }
    }
    assert_eq!(exported["readings"], compared);
}

#[test]
fn runs_and_marks_from_another_terminal() {
    let bench = Bench::new();
    let boards = ["board", "virtual", "--registry", "boards.toml", "--count", "1", "--seed", "6"];
    bench.run(&[&boards[..], &["--duration", "0", "--drain", "0"]].concat());
    let logger = bench.logger(&[]);
    let mut child = bench
        .thermokin(&boards)
        .args(["--host", &logger.address, "--rate", "10", "--batch", "5", "--duration", "6", "--drain", "60"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the boards start");
    bench.run(&["log", "run", "first"]);
    sleep(Duration::from_secs(1));
    bench.run(&["log", "mark", "cycle \"3\""]);
    bench.run(&["log", "run", "--stop"]);
    logger.wait_for("run first ends");
    bench.run(&["log", "run", "second"]);
    assert!(child.wait().expect("the boards end").success());
    let words = logger.stop();
    assert!(words.contains("mark: cycle \"3\""), "{words}");
    let info = bench.json(&["log", "info"]);
    let runs = info["runs"].as_array().expect("runs");
    let names: Vec<_> = runs.iter().map(|run| run["name"].as_str().expect("a name")).collect();
    assert_eq!(names, ["first", "second"]);
    let (start_s, stop_s) = (runs[0]["start_s"].as_f64().expect("a time"), runs[0]["stop_s"].as_f64().expect("a time"));
    // The times are those at which the commands were given: the logger hears them within a few milliseconds, if it runs.
    assert!(stop_s - start_s >= 0.95, "{info}");
    // A run's table has what was read within it: its times begin with the run and end before it does.
    let table = |run: &str| {
        bench.run(&["log", "export", "--run", run, "--out", "table.csv"]);
        let text = fs::read_to_string(bench.path("table.csv")).expect("it is written");
        rows(&text).iter().map(|row| row[0].parse().expect("a time")).collect::<Vec<f64>>()
    };
    let (first, second) = (table("first"), table("second"));
    assert!(!second.is_empty() && second.iter().all(|time_s| *time_s >= 0.0), "{second:?}");
    assert!(first.iter().all(|time_s| (0.0..=stop_s - start_s).contains(time_s)), "{first:?}");
    // Four sensors, ten times a second; what lies between the runs is in neither.
    let all = bench.json(&["log", "export", "--out", "all.csv"])["exported"]["readings"].as_u64().expect("a number");
    assert!(first.len() >= 4 && first.len() as u64 + (second.len() as u64) <= all, "{} {}", first.len(), second.len());
}

/// A datagram of another schema version under the right key: a message that this version cannot read, or a notice.
fn foreign(key: &Key, header: Header) -> Vec<u8> {
    let mut buffer = [0xA5; MAX_DATAGRAM];
    let length = seal::seal(key, &header, &mut buffer, if header.kind == Kind::Message { 50 } else { 0 });
    buffer[..length].to_vec()
}

#[test]
fn a_board_of_another_schema_is_told_which_end_is_older() {
    for theirs in [SCHEMA_VERSION - 1, SCHEMA_VERSION + 1] {
        let bench = Bench::new();
        bench.run(&[
            "board",
            "add",
            "--registry",
            "boards.toml",
            "--board",
            "3",
            "--sensors",
            "0x48",
            "--out",
            "3.toml",
        ]);
        let key = Registry::read(&bench.path("boards.toml")).expect("it is a registry").boards[0].key.clone();
        let logger = bench.logger(&[]);
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.connect(&logger.address).expect("an address");
        socket.set_read_timeout(Some(Duration::from_millis(300))).expect("a time-out");
        let header = Header {
            version: theirs,
            direction: Direction::ToHost,
            kind: Kind::Message,
            board: 3,
            epoch: u32::MAX - 1,
            counter: 0,
        };
        // The board sends again until it hears something.
        let mut notice = [0; MAX_DATAGRAM];
        let length = (0..200)
            .find_map(|counter| {
                socket.send(&foreign(&key, Header { counter, ..header })).expect("it is sent");
                socket.recv(&mut notice).ok()
            })
            .expect("the host answers with its version");
        let heard = Header::parse(&notice[..length]).expect("it is of this protocol");
        assert_eq!((heard.version, heard.kind, heard.board), (SCHEMA_VERSION, Kind::Version, 3));
        logger.wait_for(&format!(
            "board 3 speaks schema version {theirs}, this host speaks {SCHEMA_VERSION}: update the older one; \
             its records stay on the board until then"
        ));
        // It is authentic: a board of the host's own version opens it and only misses a message in it.
        let mut board = link(key.clone());
        assert_eq!(board.receive(0, &mut notice[..length]), Err(Refused::Malformed));
        assert_eq!(logger.stop().matches("schema version").count(), 1, "it is said once");
    }
}

fn link(key: Key) -> BoardLink<8> {
    let identity =
        Identity { firmware: Firmware { major: 0, minor: 1, patch: 0 }, reset: ResetReason::PowerOn, capacity: 0 };
    let sensors = [Sensor { address: 0x48, kind: SensorKind::Max30205 }];
    BoardLink::new(3, key, 1, identity, &sensors, Settings::default(), 0)
}

#[test]
fn boards_say_that_a_host_speaks_another_schema_and_keep_their_records() {
    for theirs in [SCHEMA_VERSION - 1, SCHEMA_VERSION + 1] {
        let bench = Bench::new();
        let boards = ["board", "virtual", "--registry", "boards.toml", "--count", "1", "--seed", "3"];
        bench.run(&[&boards[..], &["--duration", "0", "--drain", "0"]].concat());
        let key = Registry::read(&bench.path("boards.toml")).expect("it is a registry").boards[0].key.clone();
        let host = UdpSocket::bind("127.0.0.1:0").expect("a port");
        host.set_read_timeout(Some(PATIENCE)).expect("a time-out");
        let address = host.local_addr().expect("an address").to_string();
        let child = bench
            .thermokin(&boards)
            .args(["--host", &address, "--rate", "10", "--duration", "2", "--drain", "0", "--json", "out.json"])
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the boards start");
        let mut datagram = [0; MAX_DATAGRAM];
        let (length, from) = host.recv_from(&mut datagram).expect("a board reports");
        let board = Header::parse(&datagram[..length]).expect("it is of this protocol").board;
        let header =
            Header { version: theirs, direction: Direction::ToBoard, kind: Kind::Version, board, epoch: 1, counter: 0 };
        host.send_to(&foreign(&key, header), from).expect("it is sent");
        let output = child.wait_with_output().expect("the boards end");
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        let said = format!(
            "the host speaks schema version {theirs}, these boards speak {SCHEMA_VERSION}: update the older one"
        );
        assert_eq!(words.matches(&said).count(), 1, "{words}");
        let json: Value = serde_json::from_slice(&fs::read(bench.path("out.json")).expect("written")).expect("JSON");
        assert!(json["taken"].as_u64() >= Some(15), "{json}");
        assert_eq!(json["held"], json["taken"], "the board keeps what nobody acknowledged");
    }
}

/// A small disk of its own for a test; none where the system does not let us have one.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(at: PathBuf) -> Option<Self> {
        fs::create_dir(&at).expect("it is made");
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", "size=4m", "tmpfs"]).arg(&at).output();
        mounted.is_ok_and(|output| output.status.success()).then_some(Self(at))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).output();
    }
}

#[test]
fn a_disk_that_is_full_for_a_while_costs_nothing() {
    let bench = Bench::new();
    let Some(disk) = SmallDisk::mount(bench.path("disk")) else {
        println!("skipped: this user may not mount a small disk");
        return;
    };
    let ballast = disk.0.join("ballast");
    fs::write(&ballast, vec![1; 3500 << 10]).expect("it fits");
    let boards = ["board", "virtual", "--registry", "boards.toml", "--count", "4", "--seed", "5"];
    bench.run(&[&boards[..], &["--duration", "0", "--drain", "0"]].concat());
    let logger = bench.logger(&["--store", "disk/log"]);
    let child = bench
        .thermokin(&boards)
        .args(["--host", &logger.address, "--rate", "50", "--batch", "10", "--duration", "8", "--drain", "60"])
        .args(["--truth", "truth.csv"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    let mut child = child.expect("the boards start");
    logger.wait_for("nothing can be stored");
    fs::remove_file(&ballast).expect("it is removed");
    logger.wait_for("storing again");
    assert!(child.wait().expect("the boards end").success());
    let words = logger.stop();
    let said = |text: &str| words.matches(text).count();
    assert_eq!((said("nothing can be stored"), said("the disk is nearly full")), (1, 1), "{words}");
    let truth = bench.json(&["log", "doctor", "disk/log", "--truth", "truth.csv"])["truth"].take();
    assert_eq!((&truth["stored"], &truth["wrong"]), (&truth["taken"], &0.into()), "{truth}");
}
