//! A log file cut off at any byte, or with rubbish behind its durable part, costs nothing that was durable.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use thermokin::logger::group::{BoardState, Entry, Group, MarkKind, SensorLabel};
use thermokin::logger::sink::Sink;
use thermokin::logger::store::{Attachment, Rotation, Store, Topic, files, scan};
use thermokin_protocol::{Reading, Record, SensorKind};

const START_US: u64 = 1_795_000_000_000_000;

/// A group of one mark and one record, with what the host must remember after it.
fn group(number: u64) -> Group {
    let record = Record {
        sequence: number,
        time_us: number * 1_000_000,
        readings: [Reading::Ok(5440), Reading::Absent].into_iter().collect(),
    };
    let sensors: Arc<[SensorLabel]> =
        ["J1 \"hot\"", "AMB"].map(|name| SensorLabel::new(name.to_owned(), SensorKind::Max30205)).into();
    let closed_us = START_US + number * 1_000_000;
    let entries = vec![
        Entry::Mark { time_us: closed_us, kind: MarkKind::Mark, name: format!("step {number}") },
        Entry::Records {
            board: 3,
            store: 7,
            boot: 7,
            fit: None,
            arrived_us: closed_us,
            sensors,
            records: vec![record],
        },
    ];
    let state = BoardState { board: 3, guard: (7, number + 1, 1), boot: 7, inbox: Some((7, number + 1, Vec::new())) };
    Group { entries, states: vec![state], closed_us }
}

fn open(folder: &Path, now_us: u64) -> Store {
    let attachment =
        Attachment { name: "robot.toml".into(), media_type: "application/toml".into(), data: vec![b'x'; 40] };
    Store::open(folder, Rotation::default(), vec![attachment], now_us).expect("the store opens").0
}

/// A file of five groups as a killed logger leaves it, and its length after each group.
fn written(folder: &Path) -> (PathBuf, Vec<u64>) {
    let mut store = open(folder, START_US);
    let path = files(folder).expect("the folder is read").remove(0);
    let length = || path.metadata().expect("it exists").len();
    let mut durable = vec![length()];
    for number in 0..5 {
        store.take(&group(number)).expect("it is written");
        durable.push(length());
    }
    (path, durable)
}

#[test]
fn a_cut_at_any_byte_costs_no_durable_group() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (path, durable) = written(folder.path());
    let bytes = std::fs::read(&path).expect("it is read");
    let cut_path = folder.path().join("cut.bin");
    // A mark, a record and a state each.
    const MESSAGES: u64 = 3;
    for cut in durable[0]..=bytes.len() as u64 {
        let groups = durable.iter().filter(|&&end| end <= cut).count() as u64 - 1;
        let mut torn = bytes[..cut as usize].to_vec();
        std::fs::write(&cut_path, &torn).expect("it is written");
        let found = scan(&cut_path, |_| {}).expect("it is a log");
        assert_eq!(
            (found.summary.message_count(), found.valid),
            (groups * MESSAGES, durable[groups as usize]),
            "cut at {cut}"
        );
        assert_eq!(found.torn(), cut - durable[groups as usize]);
        // A power cut can leave blocks that were never written: zeros, to the length that the file was to have.
        torn.resize(bytes.len() + 100, 0);
        std::fs::write(&cut_path, &torn).expect("it is written");
        let found = scan(&cut_path, |_| {}).expect("it is a log");
        // Where the missing bytes were zeros anyway, the group is whole.
        let whole = durable.iter().filter(|&&end| torn[..end as usize] == bytes[..end as usize]).count() as u64 - 1;
        assert_eq!(found.summary.message_count(), whole * MESSAGES, "zeros from {cut}");
    }
}

#[test]
fn the_next_start_finishes_what_a_kill_left_and_remembers_it() {
    let source = tempfile::tempdir().expect("a temporary folder");
    let (path, durable) = written(source.path());
    let bytes = std::fs::read(&path).expect("it is read");
    for (groups, &end) in durable.iter().enumerate().skip(1) {
        for torn in [0, 1, 9, 60] {
            let folder = tempfile::tempdir().expect("a temporary folder");
            let cut = bytes.len().min(end as usize + torn);
            let left = folder.path().join(path.file_name().expect("it has a name"));
            std::fs::write(&left, &bytes[..cut]).expect("it is written");
            let store = open(folder.path(), START_US + 60_000_000);
            let inbox = store.states()[&3].inbox.clone();
            assert_eq!(inbox, Some((7, groups as u64, Vec::new())), "group {groups}, {torn} torn bytes");
            assert!(store.epoch() > 1_795_000_000, "an epoch is never used twice");
            let found = scan(&left, |_| {}).expect("it is a log");
            assert!(found.finished && found.damage.is_none(), "{:?}", found.damage);
            assert_eq!(found.summary.message_count(), groups as u64 * 3);
            assert_eq!(found.summary.attachments.len(), 1);
        }
    }
}

#[test]
fn any_flipped_bit_of_a_group_is_noticed() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (path, durable) = written(folder.path());
    let bytes = std::fs::read(&path).expect("it is read");
    let flipped_path = folder.path().join("flipped.bin");
    // Within the third group's chunk record, whose length is in its bytes 1 to 9.
    let start = durable[2] as usize;
    let length = 9 + u64::from_le_bytes(bytes[start + 1..start + 9].try_into().expect("eight bytes")) as usize;
    for place in (start..start + length).step_by(3) {
        // The times of a chunk are for finding one's way only and are under no CRC.
        if (start + 9..start + 33).contains(&place) {
            continue;
        }
        let mut flipped = bytes.clone();
        flipped[place] ^= 0x10;
        std::fs::write(&flipped_path, &flipped).expect("it is written");
        let found = scan(&flipped_path, |_| {}).expect("it is a log");
        assert!(found.damage.is_some(), "byte {place}");
        assert_eq!(found.valid, durable[2], "byte {place}");
    }
}

#[test]
fn a_file_that_is_old_enough_is_followed_by_another() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let rotation = Rotation { bytes: 1 << 30, seconds: 10 };
    let (mut store, _) = Store::open(folder.path(), rotation, Vec::new(), START_US).expect("the store opens");
    for number in 0..35 {
        store.take(&group(number)).expect("it is written");
    }
    store.finish().expect("it ends");
    // Groups are a second apart: ten in each file, the last of five.
    let mut records = Vec::new();
    for file in files(folder.path()).expect("the folder is read") {
        let mut sequences = Vec::new();
        let found = scan(&file, |logged| {
            if logged.topic == Some(Topic::Readings(3)) {
                let json: serde_json::Value = serde_json::from_slice(logged.data).expect("JSON");
                sequences.push(json["sequence"].as_u64().expect("a number"));
            }
        })
        .expect("it is a log");
        assert!(found.finished && found.damage.is_none(), "{:?}", found.damage);
        records.push(sequences);
    }
    assert_eq!(records.iter().map(Vec::len).collect::<Vec<_>>(), [10, 10, 10, 5]);
    assert_eq!(records.concat(), (0..35).collect::<Vec<u64>>());
}
