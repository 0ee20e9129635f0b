//! From the sensor's registers to the disk: the firmware in QEMU, its sensors set while it runs, and the real
//! `thermokin log` over the emulator's network.

mod board_support;

use std::collections::BTreeMap;
use std::thread::sleep;
use std::time::Duration;

use board_support::{Workshop, sensor_names, thermokin};
use thermokin_protocol::Key;

/// The emulated sensors need 300 ms for a conversion.
const PERIOD_MS: u32 = 500;
/// A pause between two readings that no busy machine explains: the emulator keeps its grid, but may be scheduled late.
const HOLE_S: f64 = 2.0;

/// Readings later than this lie nearer to another point of the grid; on a machine at load 9 they are late by 19 ms.
const MOST_LATENESS_S: f64 = PERIOD_MS as f64 * 1e-3 / 2.0;

/// Counts without repetitions, in order: what a sensor was seen to go through.
fn steps(readings: &[(f64, i32)]) -> Vec<i32> {
    let mut counts: Vec<_> = readings.iter().map(|&(_, counts)| counts).collect();
    counts.dedup();
    counts
}

/// The longest time between two readings of a sensor.
fn longest_pause(readings: &[(f64, i32)]) -> f64 {
    readings.windows(2).map(|pair| pair[1].0 - pair[0].0).fold(0.0, f64::max)
}

/// How much later than the earliest, against the grid, the latest reading of a sensor was taken.
fn worst_lateness(readings: &[(f64, i32)]) -> f64 {
    let period = f64::from(PERIOD_MS) * 1e-3;
    // From the first one's place in the grid, between half a period before and after.
    let place = |time: f64| {
        let periods = (time - readings[0].0) / period;
        (periods - periods.round()) * period
    };
    let places = || readings.iter().map(|&(time, _)| place(time));
    places().fold(f64::MIN, f64::max) - places().fold(f64::MAX, f64::min)
}

/// Whether the newest reading of each sensor of a board is this one.
fn shows(readings: &BTreeMap<String, Vec<(f64, i32)>>, board: u32, counts: [i32; 4]) -> bool {
    sensor_names(board)
        .iter()
        .zip(counts)
        .all(|(name, counts)| readings.get(name).and_then(|all| all.last()).is_some_and(|&(_, last)| last == counts))
}

#[test]
fn what_is_set_is_stored_to_the_count() {
    let workshop = Workshop::new("set_and_stored", 1, PERIOD_MS, 1, "live");
    let logger = workshop.logger(Some("bench"));
    let mut board = workshop.board(0);
    // 0 °C before anything is set, then ordinary ones, the last below zero.
    let temperatures =
        [[5888, 6400, 6912, 7424], [5904, 6384, 12800, 7424], [16, 0, 9488, 20480], [-16, -2560, 256, 6400]];
    for counts in temperatures {
        for (sensor, counts) in counts.into_iter().enumerate() {
            board.set_counts(sensor, counts);
        }
        workshop.wait_until(&format!("{counts:?} on disk"), |readings| shows(readings, 0, counts));
    }
    workshop.wait_for_readings(0, 30);
    logger.stop();
    let readings = workshop.readings(Some("bench"));
    for (sensor, name) in sensor_names(0).iter().enumerate() {
        let mut expected: Vec<_> = temperatures.iter().map(|counts| counts[sensor]).collect();
        expected.dedup();
        let mut seen = steps(&readings[name]);
        // The first samples may precede the first order.
        if seen[0] == 0 {
            seen.remove(0);
        }
        assert_eq!(seen, expected, "{name}");
        assert!(longest_pause(&readings[name]) < HOLE_S, "{name} has a hole");
        let lateness = worst_lateness(&readings[name]);
        println!("{name}: {} readings, the latest {:.1} ms late", readings[name].len(), lateness * 1e3);
        assert!(lateness < MOST_LATENESS_S, "{name}: {lateness} s late");
    }
    assert_eq!(workshop.records_lost(), 0);
    let (well, words) = workshop.doctor();
    assert!(well, "{words}");
}

#[test]
fn a_sensor_that_vanishes_costs_nobody_else_and_is_taken_up_again() {
    let workshop = Workshop::new("vanishing", 1, PERIOD_MS, 1, "live");
    let logger = workshop.logger(None);
    let mut board = workshop.board(0);
    let counts = [5888, 6400, 6912, 7424];
    for (sensor, counts) in counts.into_iter().enumerate() {
        board.set_counts(sensor, counts);
    }
    workshop.wait_until("the temperatures on disk", |readings| shows(readings, 0, counts));
    board.take_off(1);
    let before = workshop.readings(None);
    workshop.wait_until("eight more of another sensor", |readings| readings["L0S0"].len() >= before["L0S0"].len() + 8);
    let during = workshop.readings(None);
    assert!(during["L0S1"].len() <= before["L0S1"].len() + 2, "a sensor that is not there was read");
    board.put_back(1);
    board.set_counts(1, 6656);
    let back = [5888, 6656, 6912, 7424];
    workshop.wait_until("the sensor back on disk", |readings| shows(readings, 0, back));
    logger.stop();
    let readings = workshop.readings(None);
    assert!(longest_pause(&readings["L0S1"]) > 3.0);
    for name in ["L0S0", "L0S2", "L0S3"] {
        assert!(longest_pause(&readings[name]) < HOLE_S, "{name} has a hole");
    }
}

#[test]
fn a_host_that_was_away_gets_everything() {
    let workshop = Workshop::new("host_away", 1, PERIOD_MS, 4, "live");
    let logger = workshop.logger(None);
    let mut board = workshop.board(0);
    board.set_counts(0, 5888);
    workshop.wait_for_readings(0, 8);
    logger.kill();
    board.set_counts(0, 6400);
    sleep(Duration::from_secs(15));
    let logger = workshop.logger(None);
    board.set_counts(0, 6912);
    // 15 s away are about 30 records; they come back with the newest.
    workshop.wait_until("the newest", |readings| readings["L0S0"].last().is_some_and(|&(_, counts)| counts == 6912));
    workshop.wait_until("all of the outage", |readings| {
        readings["L0S0"].iter().filter(|&&(_, counts)| counts == 6400).count() >= 24
            && longest_pause(&readings["L0S0"]) < HOLE_S
    });
    logger.stop();
    assert_eq!(workshop.records_lost(), 0);
    let (well, words) = workshop.doctor();
    assert!(well, "{words}");
}

#[test]
fn a_board_that_is_reset_in_the_middle_of_a_batch_goes_on() {
    let workshop = Workshop::new("reset", 1, PERIOD_MS, 8, "live");
    let logger = workshop.logger(None);
    let mut board = workshop.board(0);
    board.set_counts(0, 5888);
    workshop.wait_for_readings(0, 12);
    for counts in [6400, 6912] {
        // A batch takes 4 s: a reset 2 s after one arrived finds records that were never sent.
        sleep(Duration::from_secs(2));
        board.reset();
        board.set_counts(0, counts);
        let newest = move |readings: &BTreeMap<String, Vec<(f64, i32)>>| {
            readings["L0S0"].iter().filter(|reading| reading.1 == counts).count() >= 8
        };
        workshop.wait_until("readings of the next boot", newest);
    }
    logger.stop();
    let readings = workshop.readings(None);
    let times: Vec<_> = readings["L0S0"].iter().map(|&(time, _)| time).collect();
    assert!(
        times.windows(2).all(|pair| pair[1] - pair[0] > 0.4 * f64::from(PERIOD_MS) / 1e3),
        "stored twice: {times:?}"
    );
    let info = thermokin().args(["log", "info", "--json", "-"]).arg(workshop.store()).output().unwrap();
    let info = String::from_utf8(info.stdout).unwrap();
    assert!(info.contains("\"boots\""), "{info}");
    let (well, words) = workshop.doctor();
    assert!(well, "{words}");
}

#[test]
fn a_board_with_another_key_is_not_believed() {
    let workshop = Workshop::new("wrong_key", 2, PERIOD_MS, 1, "live");
    let logger = workshop.logger(None);
    let _stranger = workshop.board_with_key(1, Key::from_bytes([0x55; 32]));
    let _board = workshop.board(0);
    workshop.wait_for_readings(0, 20);
    logger.stop();
    let readings = workshop.readings(None);
    assert!(sensor_names(1).iter().all(|name| !readings.contains_key(name)), "readings were believed");
}

#[test]
fn five_boards_make_one_run() {
    let workshop = Workshop::new("five_boards", 5, 1000, 2, "live");
    let logger = workshop.logger(Some("fleet"));
    let mut boards: Vec<_> = (0..5).map(|board| workshop.board(board)).collect();
    let counts = |board: u32| std::array::from_fn(|sensor| (5120 + 256 * board + 64 * sensor as u32) as i32);
    for (number, board) in (0..).zip(&mut boards) {
        for (sensor, counts) in counts(number).into_iter().enumerate() {
            board.set_counts(sensor, counts);
        }
    }
    workshop.wait_until("all temperatures", |readings| (0..5).all(|board| shows(readings, board, counts(board))));
    sleep(Duration::from_secs(5));
    logger.stop();
    let csv = workshop.file("temperatures.csv");
    let exported = thermokin().args(["log", "export", "--run=fleet", "--out"]).arg(&csv).arg(workshop.store()).status();
    assert!(exported.unwrap().success());
    let text = std::fs::read_to_string(csv).unwrap();
    assert!(text.starts_with("time_s,sensor,celsius\n"), "{text}");
    let readings = workshop.readings(Some("fleet"));
    for board in 0..5 {
        for (name, counts) in sensor_names(board).iter().zip(counts(board)) {
            assert_eq!(steps(&readings[name]).last(), Some(&counts), "{name}");
            assert!(readings[name].len() >= 5, "{name} has {} readings", readings[name].len());
        }
    }
}

#[test]
fn bursts_bring_everything_with_the_radio_down_in_between() {
    let workshop = Workshop::new("bursts", 1, PERIOD_MS, 8, "burst");
    let logger = workshop.logger(None);
    let mut board = workshop.board(0);
    board.set_counts(0, 5888);
    workshop.wait_until("four bursts", |readings| readings.get("L0S0").is_some_and(|all| all.len() >= 32));
    logger.stop();
    let readings = workshop.readings(None);
    assert!(longest_pause(&readings["L0S0"]) < HOLE_S, "a hole between bursts");
    assert_eq!(workshop.records_lost(), 0);
    let (well, words) = workshop.doctor();
    assert!(well, "{words}");
}
