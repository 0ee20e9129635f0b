//! The warnings that matter, from a board's readings through sealed datagrams to the logger's words: each said once when
//! it begins and once when it is over. Time is an argument of both ends, so that ten minutes take no time.

use std::collections::{BTreeMap, HashMap};
use std::net::SocketAddr;
use std::path::Path;

use thermokin::logger::engine::Engine;
use thermokin::logger::export::export;
use thermokin::logger::registry::{Board, Registry};
use thermokin::logger::sink::Sink;
use thermokin::logger::store::{Rotation, Store, Topic, files, scan};
use thermokin_protocol::{
    BoardLink, Firmware, Identity, Key, MAX_DATAGRAM, Reading, ResetReason, Sensor, SensorKind, Settings,
};

const START_US: u64 = 1_795_000_000_000_000;
const BOARD: u32 = 3;

/// A board with one sensor, and the logger; what is sent arrives at once, and what gathered is durable at once.
struct World {
    now_us: u64,
    board: BoardLink<512>,
    engine: Engine,
    /// Where groups are stored, if anywhere.
    store: Option<Store>,
    /// Whether the logger's answers reach the board.
    answers: bool,
    said: Vec<String>,
}

impl World {
    fn new() -> Self {
        let key = Key::from_bytes([7; 32]);
        let settings = Settings { revision: 1, ..Settings::default() };
        let identity =
            Identity { firmware: Firmware { major: 0, minor: 1, patch: 0 }, reset: ResetReason::PowerOn, capacity: 0 };
        let sensors = [Sensor { address: 0x48, kind: SensorKind::Max30205 }];
        let place =
            Board { board: BOARD, robot: "arm".into(), link: 0, sensors: vec![0x48], key: key.clone(), first_boot: 1 };
        let registry = Registry { settings, boards: vec![place] };
        let names = HashMap::from([((BOARD, 0x48), "L0S1".to_owned())]);
        Self {
            now_us: START_US,
            board: BoardLink::new(BOARD, key, 1, identity, &sensors, settings, 0),
            engine: Engine::new((START_US / 1_000_000) as u32, &registry, names, BTreeMap::new()),
            store: None,
            answers: true,
            said: Vec::new(),
        }
    }

    /// A second passes, in which the sensor gives a reading.
    fn second(&mut self, reading: Reading) {
        self.now_us += 1_000_000;
        let board_us = self.now_us - START_US;
        self.board.record(board_us, &[reading]);
        let address = SocketAddr::from(([127, 0, 0, 1], 9));
        let mut buffer = [0; MAX_DATAGRAM];
        while let Some(length) = self.board.poll(board_us, &mut buffer) {
            assert_eq!(self.engine.on_datagram(address, &mut buffer[..length], self.now_us), None);
        }
        if let Some(group) = self.engine.close_group(self.now_us) {
            self.store.iter_mut().for_each(|store| store.take(&group).expect("it is written"));
            self.engine.committed(self.now_us);
        }
        let mut answers = Vec::new();
        let now_us = self.now_us;
        self.engine.answers(|| now_us, |_, datagram| answers.push(datagram.to_vec()));
        for mut answer in answers.into_iter().filter(|_| self.answers) {
            self.board.receive(board_us + 1000, &mut answer).expect("it is authentic and fresh");
        }
        self.engine.on_tick(self.now_us);
        self.said.extend(self.engine.watch_mut().take_unsaid());
    }

    /// What was said since the last call, with the second since the start.
    fn take_said(&mut self) -> Vec<String> {
        std::mem::take(&mut self.said)
    }
}

/// Counts that change from one second to the next, as a sensor's noise makes them.
fn noisy(second: u64) -> Reading {
    Reading::Ok(5120 + (second % 3) as i16)
}

#[test]
fn a_stuck_sensor_is_told_after_ten_minutes_and_when_it_moves_again() {
    let mut world = World::new();
    (0..60).for_each(|second| world.second(noisy(second)));
    (0..599).for_each(|_| world.second(Reading::Ok(5150)));
    assert_eq!(world.take_said(), [] as [&str; 0]);
    (0..600).for_each(|_| world.second(Reading::Ok(5150)));
    assert_eq!(world.take_said(), ["sensor L0S1 is stuck: exactly 20.1172 °C for 10 min"]);
    world.second(Reading::Ok(5151));
    assert_eq!(world.take_said(), ["sensor L0S1 moves again"]);
}

#[test]
fn a_jumping_sensor_is_told_once_and_when_it_is_steady() {
    let mut world = World::new();
    (0..20).for_each(|second| world.second(noisy(second)));
    for second in 0..10 {
        world.second(noisy(second));
        world.second(Reading::Ok(5632));
    }
    // The last counts before the step are 5121: the twentieth second's.
    assert_eq!(world.take_said(), ["sensor L0S1 jumps: from 20.00 to 22.00 °C between two readings"]);
    (0..59).for_each(|second| world.second(Reading::Ok(5632 + (second % 2) as i16)));
    assert_eq!(world.take_said(), [] as [&str; 0]);
    (0..3).for_each(|second| world.second(Reading::Ok(5632 + second)));
    assert_eq!(world.take_said(), ["sensor L0S1 is steady again"]);
}

#[test]
fn a_clock_that_will_not_settle_is_told_after_a_minute_and_when_it_has() {
    let mut world = World::new();
    world.answers = false;
    (0..60).for_each(|second| world.second(noisy(second)));
    assert_eq!(world.take_said(), [] as [&str; 0]);
    (60..120).for_each(|second| world.second(noisy(second)));
    assert_eq!(world.take_said(), ["board 3: the clock will not settle, one direction is not heard after a minute"]);
    world.answers = true;
    (120..150).for_each(|second| world.second(noisy(second)));
    assert_eq!(world.take_said(), ["board 3: the clock has settled"]);
}

#[test]
fn a_sensor_that_goes_and_comes_and_a_board_that_is_silent() {
    let mut world = World::new();
    world.second(noisy(0));
    world.second(Reading::Absent);
    world.second(Reading::BusError);
    assert_eq!(world.take_said(), ["sensor L0S1 gives no reading (absent), board 3 address 0x48"]);
    world.second(noisy(1));
    assert_eq!(world.take_said(), ["sensor L0S1 gives readings again, 2 s later"]);
    world.now_us += 9_000_000;
    world.engine.on_tick(world.now_us);
    assert_eq!(world.engine.watch_mut().take_unsaid(), [] as [&str; 0]);
    world.now_us += 1_000_000;
    world.engine.on_tick(world.now_us);
    assert_eq!(world.engine.watch_mut().take_unsaid(), ["board 3 has been silent for 10 s"]);
    world.second(noisy(2));
    assert_eq!(world.take_said(), ["board 3 is heard again, 11 s later"]);
}

#[test]
fn a_disk_that_is_nearly_full_is_told_once_and_when_it_has_room_again() {
    let mut world = World::new();
    let mut said = |free_mib: u64| {
        world.engine.on_disk(free_mib << 20, START_US);
        world.engine.watch_mut().take_unsaid()
    };
    assert_eq!(said(10_000), [] as [&str; 0]);
    assert_eq!(said(500), ["the disk is nearly full: 524 MB are free"]);
    assert_eq!(said(400), [] as [&str; 0]);
    // Neither full nor roomy: it would be said again and again at the border.
    assert_eq!(said(600), [] as [&str; 0]);
    assert_eq!(said(400), [] as [&str; 0]);
    assert_eq!(said(700), ["the disk has room again"]);
    assert_eq!(said(511), ["the disk is nearly full: 535 MB are free"]);
}

/// The uncertainties of a log's records as they stand there, in seconds; none where there is none.
fn uncertainties(folder: &Path) -> Vec<Option<f64>> {
    let mut found = Vec::new();
    for file in files(folder).expect("the folder is read") {
        scan(&file, |logged| {
            if let Some(Topic::Readings(_)) = logged.topic {
                let json: serde_json::Value = serde_json::from_slice(logged.data).expect("JSON");
                found.push(json["uncertainty_s"].as_f64());
            }
        })
        .expect("it is a log");
    }
    found
}

#[test]
fn readings_from_before_an_echo_have_no_uncertainty_until_they_are_exported() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut world = World::new();
    world.store = Some(Store::open(folder.path(), Rotation::default(), Vec::new(), START_US).expect("it opens").0);
    world.answers = false;
    (0..10).for_each(|second| world.second(noisy(second)));
    // A board that hears nothing sends ever more rarely: what it took last may still be on it.
    let early = uncertainties(folder.path());
    assert!(early.len() >= 5 && early.iter().all(Option::is_none), "{early:?}");
    let exported = export(folder.path(), None, &|_| {}, &mut Vec::new()).expect("it is exported");
    let count = early.len() as u64;
    assert_eq!((exported.readings, exported.times_unbounded, exported.time_uncertainty_s), (count, count, 0.0));

    world.answers = true;
    (10..40).for_each(|second| world.second(noisy(second)));
    let late = uncertainties(folder.path());
    assert_eq!(late[..early.len()], early);
    // From the first echo on each record has an uncertainty, and the echo comes with the board's next attempt.
    let unbounded = late.iter().take_while(|uncertainty| uncertainty.is_none()).count();
    assert!(unbounded <= 20 && late[unbounded..].iter().all(Option::is_some), "{late:?}");
    let mut table = Vec::new();
    let exported = export(folder.path(), None, &|_| {}, &mut table).expect("it is exported");
    assert_eq!((exported.readings, exported.times_unbounded), (40, 0));
    // Answers take a millisecond and reports none, and ten seconds before them drifts may differ by what the bounds allow.
    assert!(exported.time_uncertainty_s > 0.0 && exported.time_uncertainty_s < 0.006, "{exported:?}");
    // Readings are a second apart and come out so to within that.
    let table = String::from_utf8(table).expect("text");
    for (second, line) in table.lines().skip(1).enumerate() {
        let time_s: f64 = line.split(',').next().and_then(|time| time.parse().ok()).expect("a time");
        assert!((time_s - second as f64).abs() <= 2.0 * exported.time_uncertainty_s, "{line}");
    }
}
