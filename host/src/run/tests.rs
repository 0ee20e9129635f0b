//! Tests of the room from within: the measured sets, round trips, joins to temperatures, approach, choosing visits.

use std::path::{Path, PathBuf};

use super::*;

fn shared() -> Option<PathBuf> {
    let shared = std::env::var_os("THERMOKIN_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    if shared.join("data").is_dir() {
        return Some(shared.join("data"));
    }
    eprintln!("skipped: {} is not there (THERMOKIN_SHARED says where else)", shared.join("data").display());
    None
}

/// Six visits of two joints, five minutes between the cycles, and nothing else.
fn small_run() -> Run {
    let visit = |cycle: u32, pose: u32, joints: [f64; 2]| Visit {
        cycle,
        pose,
        time_s: f64::from(cycle) * 300.0 + f64::from(pose) * 10.0,
        joints: joints.to_vec(),
        commanded: None,
        payload_kg: None,
        approach: None,
        points: Vec::new(),
        distances: Vec::new(),
        broken_beams: Vec::new(),
    };
    let postures = [[0.0, 0.5], [1.0, 0.5], [0.5, -0.5]];
    let visits = (0..6_u32).map(|index| visit(index / 3, index % 3, postures[index as usize % 3])).collect();
    Run {
        folder: PathBuf::from("small"),
        description: RunDescription {
            name: "small".to_owned(),
            robot: PathBuf::from("small/robot.toml"),
            reference_cycle: 0,
            ambient: None,
            instrument: Instrument {
                name: "laser tracker".to_owned(),
                position: [0.0; 3],
                sigma_m: 1e-5,
                sigma_per_m: 0.0,
                sigma_rad: None,
            },
            anchors: Vec::new(),
        },
        visits,
        target_names: Vec::new(),
        temperatures: None,
        motion: Vec::new(),
        notes: Vec::new(),
    }
}

#[test]
fn the_measured_sets_are_read() {
    let Some(data) = shared() else { return };
    for (name, visits, points, targets) in [
        ("irb120", 700, 4191, &["SMR1", "SMR2", "SMR3", "BASE1", "BASE2", "BASE3"][..]),
        ("ur10-a", 11911, 11911, &["TMAC"]),
        ("tx2-cal", 40, 40, &["TMAC"]),
        ("tx2-points", 300, 300, &["TMAC"]),
        ("blind-examples/example1", 360, 1437, &["T1", "T2", "T3", "T4"]),
    ] {
        let run = read(&data.join(name)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(run.visits.len(), visits, "{name}");
        assert_eq!(run.point_count(), points, "{name}");
        assert_eq!(run.target_names, targets, "{name}");
        let notes = match name {
            "irb120" => &["points.csv: 9 broken beams (empty x_m, y_m, z_m)"][..],
            "blind-examples/example1" => &["points.csv: 3 broken beams (empty x_m, y_m, z_m)"],
            _ => &[],
        };
        assert_eq!(run.notes, notes, "{name}");
        let turned = run.visits.iter().flat_map(|visit| &visit.points).filter(|point| point.orientation.is_some());
        assert_eq!(turned.count(), if targets == ["TMAC"] { points } else { 0 }, "{name}");
    }
}

#[test]
fn the_measured_sets_are_written_and_read_back_the_same() {
    let Some(data) = shared() else { return };
    for name in ["irb120", "ur10-a", "tx2-cal", "tx2-points", "blind-examples/example1"] {
        let run = read(&data.join(name)).unwrap_or_else(|error| panic!("{error}"));
        let folder = tempfile::tempdir().expect("a folder");
        write(&run, folder.path()).unwrap_or_else(|error| panic!("{error}"));
        let again = read(folder.path()).unwrap_or_else(|error| panic!("{error}"));
        assert!(again.description.robot.is_file(), "{name}: the robot travels along");
        assert_eq!(again.description.robot, folder.path().join("robot.toml"));
        let moved = Run { folder: run.folder.clone(), ..again };
        let moved =
            Run { description: RunDescription { robot: run.description.robot.clone(), ..moved.description }, ..moved };
        assert_eq!(moved, run, "{name}");
    }
}

#[test]
fn every_blind_example_is_read() {
    let Some(data) = shared() else { return };
    for example in 1..=10 {
        let run =
            read(&data.join(format!("blind-examples/example{example}"))).unwrap_or_else(|error| panic!("{error}"));
        let table = run.temperatures_at_visits(&JoinOptions::default());
        assert!(table.notes().is_empty(), "{:?}", table.notes());
    }
}

#[test]
fn writing_over_an_earlier_run_leaves_nothing_of_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut earlier = small_run();
    earlier.temperatures = Some(TemperatureLog::from_readings([(0.0, "AMB", 20.0)]));
    write(&earlier, folder.path()).expect("written");
    assert!(read(folder.path()).expect("read").temperatures.is_some());
    write(&small_run(), folder.path()).expect("written");
    assert_eq!(read(folder.path()).expect("read").temperatures, None);
    let mut names: Vec<_> =
        std::fs::read_dir(folder.path()).expect("there").map(|entry| entry.expect("readable").file_name()).collect();
    names.sort();
    assert_eq!(names, ["points.csv", "poses.csv", "run.toml"]);
}

#[test]
fn what_could_not_be_read_back_is_not_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let target = folder.path().join("run");
    type Spoil = fn(&mut Run);
    let spoil: [(&str, Spoil); 9] = [
        ("a number is NaN", |run| run.visits[3].joints[1] = f64::NAN),
        ("another count of joints", |run| run.visits[3].joints.push(0.0)),
        ("stands twice", |run| run.visits[3].cycle = 0),
        ("the column q1 is missing", |run| run.visits.clear()),
        ("reference_cycle is 9", |run| run.description.reference_cycle = 9),
        ("expected degrees Celsius", |run| {
            run.temperatures = Some(TemperatureLog::from_readings([(0.0, "AMB", -300.0)]));
        }),
        ("the name \" T\" cannot be written", |run| {
            run.target_names = vec![" T".to_owned()];
            run.visits[0].broken_beams.push(BrokenBeam { time_s: 0.0, target: 0, anchor: None });
        }),
        ("has no name", |run| {
            run.visits[0].points.push(Point {
                time_s: 0.0,
                target: 2,
                position: Vector3::zeros(),
                orientation: None,
                sigma_m: None,
            });
        }),
        ("expected metres, not negative", |run| run.description.instrument.sigma_m = -1.0),
    ];
    for (expected, spoil) in spoil {
        let mut run = small_run();
        spoil(&mut run);
        let error = write(&run, &target).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}");
        assert!(!target.exists(), "nothing is written");
    }
}

#[test]
fn a_robot_elsewhere_is_found_from_the_new_place() {
    let place = tempfile::tempdir().expect("a folder");
    let robot = place.path().join("robots/arm.toml");
    std::fs::create_dir(place.path().join("robots")).expect("made");
    std::fs::write(&robot, "format = 1\n").expect("written");
    let mut run = small_run();
    run.description.robot.clone_from(&robot);
    let folder = place.path().join("runs/monday");
    write(&run, &folder).expect("written");
    let text = std::fs::read_to_string(folder.join("run.toml")).expect("there");
    assert!(text.contains("robot = \"../../robots/arm.toml\""), "{text}");
    let again = read(&folder).expect("read");
    assert_eq!(again.description.robot.canonicalize().ok(), robot.canonicalize().ok());
}

#[test]
fn readings_are_interpolated_held_or_missing() {
    let log = TemperatureLog::from_readings([
        (60.0, "A", 22.0),
        (0.0, "A", 20.0),
        (120.0, "A", 24.0),
        (1000.0, "A", 40.0),
        (1060.0, "A", 41.0),
    ]);
    let series = &log.series[0];
    assert_eq!(series.median_period_s(), Some(60.0));
    assert_eq!(series.max_gap_s(&JoinOptions::default()), 300.0);
    assert_eq!(series.spread(), 21.0);
    for (time_s, expected) in [
        (0.0, Joined::Interpolated(20.0)),
        (15.0, Joined::Interpolated(20.5)),
        (120.0, Joined::Interpolated(24.0)),
        (400.0, Joined::Held(24.0)),
        (421.0, Joined::Missing),
        (699.0, Joined::Missing),
        (800.0, Joined::Held(40.0)),
        (-300.0, Joined::Held(20.0)),
        (-300.5, Joined::Missing),
        (1360.0, Joined::Held(41.0)),
        (1361.0, Joined::Missing),
    ] {
        assert_eq!(series.at(time_s, 300.0), expected, "{time_s} s");
    }
    assert_eq!(log.at(0, 30.0), Some(21.0));
    assert_eq!(log.at(1, 30.0), None);
    assert_eq!(log.at(0, f64::NAN), None);
}

#[test]
fn readings_of_one_time_become_their_mean() {
    let log = TemperatureLog::from_readings([(0.0, "A", 20.0), (0.0, "B", 0.1), (0.0, "A", 21.0), (0.0, "B", 0.1)]);
    assert_eq!(log.sensors, ["A", "B"]);
    assert_eq!(log.series[0].celsius(), [20.5]);
    assert_eq!(log.series[1].celsius(), [0.1]);
    assert_eq!(log.series[0].median_period_s(), None);
    assert_eq!(log.at(0, 120.0), Some(20.5));
    assert_eq!(log.at(0, 121.0), None);
}

#[test]
fn temperatures_at_visits_are_counted() {
    let mut run = small_run();
    let readings = (0..33).map(|index| (f64::from(index) * 10.0, "STEADY", 20.0 + f64::from(index) * 0.5));
    let early = [(0.0, "EARLY", 30.0), (10.0, "EARLY", 31.0)];
    run.temperatures = Some(TemperatureLog::from_readings(readings.chain(early)));
    let table = run.temperatures_at_visits(&JoinOptions { max_gap_s: Some(15.0) });
    assert_eq!(table.sensors, ["STEADY", "EARLY"]);
    assert_eq!(table.at_visit(1), [Some(20.5), Some(31.0)]);
    assert_eq!(table.at_visit(3), [Some(35.0), None]);
    let counts: Vec<_> = table.report.iter().map(|join| (join.interpolated, join.held, join.missing)).collect();
    assert_eq!(counts, [(6, 0, 0), (2, 1, 3)]);
    assert_eq!(table.report[0].spread_k, 16.0);
    assert_eq!(
        table.notes(),
        ["temperatures.csv: EARLY: of 6 visits 1 hold the nearest reading and 3 have none (gaps above 15 s)"]
    );
    run.temperatures = None;
    let none = run.temperatures_at_visits(&JoinOptions::default());
    assert!(none.sensors.is_empty() && none.at_visit(5).is_empty());
}

#[test]
fn approach_follows_from_the_order_of_the_visits() {
    let mut run = small_run();
    assert_eq!(run.approach_directions(), [[0, 0], [1, 0], [-1, -1], [-1, 1], [1, 1], [-1, -1]]);

    // Jitter of a resting joint is no motion, and what was commanded counts before what was logged.
    run.visits[1].joints[1] += 2e-5;
    assert_eq!(run.approach_directions()[1], [1, 0]);
    run.visits[0].commanded = Some(vec![0.0, 0.6]);
    run.visits[1].commanded = Some(vec![1.0, 0.5]);
    assert_eq!(run.approach_directions()[1], [1, -1]);

    run.visits[1].approach = Some(vec![-1, 1]);
    assert_eq!(run.approach_directions()[1], [-1, 1]);
}

#[test]
fn selections_pick_visits() {
    let visits = small_run().visits;
    let picked = |text: &str| -> Vec<usize> {
        let selection: Selection = text.parse().unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(selection.to_string().parse(), Ok(selection.clone()));
        let mask = selection.mask(&visits);
        (0..visits.len()).filter(|&index| mask[index]).collect()
    };
    assert_eq!(picked("every:2"), [0, 2, 4]);
    assert_eq!(picked("every:3:2"), [2, 5]);
    assert_eq!(picked("first:2"), [0, 1]);
    assert_eq!(picked("last:1"), [5]);
    assert_eq!(picked("last:99"), [0, 1, 2, 3, 4, 5]);
    assert_eq!(picked("cycles:1"), [3, 4, 5]);
    assert_eq!(picked("cycles:0-1"), [0, 1, 2, 3, 4, 5]);
    assert_eq!(picked("poses:0,2-7"), [0, 2, 3, 5]);
}

#[test]
fn selections_that_mean_nothing_are_refused() {
    for text in [
        "",
        "every",
        "every:0",
        "every:5:5",
        "every:-1",
        "first:0",
        "first:x",
        "cycles:",
        "cycles:3-1",
        "poses:1,,2",
        "odd:3",
    ] {
        let error = text.parse::<Selection>().expect_err(text).to_string();
        assert!(
            error.starts_with(&format!("cannot understand the selection \"{text}\"; expected every:STEP, ")),
            "{error}"
        );
    }
}

#[test]
fn folds_keep_poses_and_cycles_whole() {
    let visits = small_run().visits;
    for seed in 0..20 {
        let by_pose = folds_by_pose(&visits, 3, seed).expect("three poses");
        assert_eq!(by_pose[..3], by_pose[3..], "both visits of a pose are in one fold");
        let mut dealt = by_pose[..3].to_vec();
        dealt.sort_unstable();
        assert_eq!(dealt, [0, 1, 2], "no fold is empty");
        assert_eq!(folds_by_pose(&visits, 3, seed), Ok(by_pose), "the same seed, the same folds");

        let by_cycle = folds_by_cycle(&visits, 2, seed).expect("two cycles");
        assert!(by_cycle[..3].iter().all(|&fold| fold == by_cycle[0]));
        assert!(by_cycle[3..].iter().all(|&fold| fold == 1 - by_cycle[0]));
    }
    let error = folds_by_cycle(&visits, 5, 1).expect_err("too many").to_string();
    assert_eq!(error, "cannot split 2 cycles into 5 folds; expected 2 to 2");
    assert!(folds_by_pose(&visits, 1, 1).is_err());
}
