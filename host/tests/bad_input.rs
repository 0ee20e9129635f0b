//! Bad input at the readers: never a panic, always the file, the line and what was expected, and for what is odd but
//! usable the reasonable thing and a note.

#[path = "../fuzz/property.rs"]
mod property;

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use thermokin::run::{self, Run};

const FILES: [&str; 14] = [
    "robot.toml",
    "run.toml",
    "poses.csv",
    "points.csv",
    "temperatures.csv",
    "motion.csv",
    "distances.csv",
    "import/import.toml",
    "import/points.txt",
    "import/joints.csv",
    "import/temperatures.csv",
    "import/machine.csv",
    "import/holders.txt",
    "import/targets.csv",
];

/// The fixture's text of a file; the robot is one that ships.
fn fixture_text(file: &str) -> String {
    let path = match file {
        "robot.toml" => "robots/comau-nj-130-2.0.toml".to_owned(),
        _ => format!("fuzz/fixture/{file}"),
    };
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).expect("the fixture is there")
}

/// The fixture on the disk, with files replaced, or removed where there is no text.
fn folder_with(changes: &[(&str, Option<&str>)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    property::fixture().store(folder.path()).expect("written");
    for (file, text) in changes {
        let path = folder.path().join(file);
        match text {
            Some(text) => fs::write(path, text).expect("written"),
            None => fs::remove_file(path).expect("removed"),
        }
    }
    folder
}

/// The error of the fixture with one file replaced, the folder left out of it.
fn error_of(file: &str, text: &str) -> String {
    error_of_folder(folder_with(&[(file, Some(text))]))
}

fn error_of_folder(folder: tempfile::TempDir) -> String {
    let error = run::read(folder.path()).expect_err("must be refused").to_string();
    let prefix = format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR);
    error.strip_prefix(&prefix).unwrap_or_else(|| panic!("does not begin with its file: {error}")).to_owned()
}

/// The fixture with one file replaced; the notes that the fixture gives by itself are left out.
fn read_with(file: &str, text: &str) -> Run {
    let plain = run::read(folder_with(&[]).path()).expect("the fixture is valid");
    let folder = folder_with(&[(file, Some(text))]);
    let mut run = run::read(folder.path()).unwrap_or_else(|error| panic!("{error}"));
    run.notes.retain(|note| !plain.notes.contains(note));
    run
}

/// The fixture's file with a part replaced, which must be there.
fn edited(file: &str, from: &str, to: &str) -> String {
    let text = fixture_text(file);
    assert!(text.contains(from), "{file} has no {from:?}");
    text.replacen(from, to, 1)
}

fn same_data(left: &Run, right: &Run) -> bool {
    left.visits == right.visits
        && left.target_names == right.target_names
        && left.temperatures == right.temperatures
        && left.motion == right.motion
}

#[test]
fn the_fixture_is_valid_and_its_oddities_are_noted() {
    let run = run::read(folder_with(&[]).path()).expect("valid");
    assert_eq!(run.visits.len(), 6);
    assert_eq!(run.point_count(), 9);
    assert_eq!(run.target_names, ["T1", "T2", "BASE1", "T3"]);
    assert_eq!(run.visits[0].distances.len(), 2);
    assert_eq!(run.visits[4].commanded, None);
    assert_eq!(
        run.notes,
        [
            "points.csv: 1 broken beam (empty x_m, y_m, z_m)",
            "distances.csv: 1 without a distance (empty distance_m)",
            "temperatures.csv: 1 row without a reading left out",
        ]
    );
}

#[test]
fn not_a_number_and_infinity_are_refused() {
    assert_eq!(
        error_of("points.csv", &edited("points.csv", "0,0,T2,1.26", "0,0,T2,NaN")),
        "points.csv:3: column x_m: found \"NaN\", expected metres (x_m, y_m and z_m all empty for a broken beam)"
    );
    assert_eq!(
        error_of("poses.csv", &edited("poses.csv", "0.25,-0.5", "inf,-0.5")),
        "poses.csv:2: column q1: found \"inf\", expected radians or metres"
    );
    assert_eq!(
        error_of("temperatures.csv", &edited("temperatures.csv", "25.25", "1e999")),
        "temperatures.csv:6: column celsius: found \"1e999\", expected degrees Celsius from -273.15 (empty where the \
         sensor gave none)"
    );
    assert_eq!(
        error_of("motion.csv", &edited("motion.csv", "840,1,move", "-inf,1,move")),
        "motion.csv:3: column end_s: found \"-inf\", expected a time in seconds"
    );
    assert_eq!(
        error_of("distances.csv", &edited("distances.csv", "1.875", "-nan")),
        "distances.csv:3: column distance_m: found \"-nan\", expected metres above 0 (empty where the measurement failed)"
    );
    assert_eq!(
        error_of("run.toml", &edited("run.toml", "sigma_m = 4.0e-6", "sigma_m = nan")),
        "run.toml:10: sigma_m is NaN; expected metres, not negative"
    );
}

#[test]
fn words_where_numbers_belong_are_refused() {
    assert_eq!(
        error_of("points.csv", &edited("points.csv", "0.5,0.75", "beam,0.75")),
        "points.csv:2: column y_m: found \"beam\", expected metres (x_m, y_m and z_m all empty for a broken beam)"
    );
    assert_eq!(
        error_of("points.csv", &edited("points.csv", "1.25,0.5,0.75", "1.25,,0.75")),
        "points.csv:2: column y_m: found nothing, expected metres (x_m, y_m and z_m all empty for a broken beam)"
    );
    assert_eq!(
        error_of("poses.csv", &edited("poses.csv", "20.5,0,1,", "20.5,0,1.5,")),
        "poses.csv:3: column pose: found \"1.5\", expected a whole number from 0"
    );
    assert_eq!(
        error_of("poses.csv", &edited("poses.csv", "20.5,0,1,", "20.5,-1,1,")),
        "poses.csv:3: column cycle: found \"-1\", expected a whole number from 0"
    );
    assert_eq!(
        error_of("poses.csv", &edited("poses.csv", ",1,1\n", ",1,2\n")),
        "poses.csv:2: column approach2: found \"2\", expected -1, 0 or 1, the sign of the joint's last motion"
    );
    assert_eq!(
        error_of("points.csv", &edited("points.csv", "0.75,1,0,0,0", "0.75,1,1,0,0")),
        "points.csv:2: qw, qx, qy, qz have the norm 1.4142; expected a unit quaternion"
    );
    assert_eq!(
        error_of("distances.csv", &edited("distances.csv", "A1,0.875", "A7,0.875")),
        "distances.csv:2: column anchor: found \"A7\", expected an [[anchor]] of run.toml (A1, A2)"
    );
    assert_eq!(
        error_of("motion.csv", &edited("motion.csv", "pause", "sleep")),
        "motion.csv:4: column phase: found \"sleep\", expected move, pause or measure"
    );
    assert_eq!(
        error_of("motion.csv", &edited("motion.csv", "0.75", "75")),
        "motion.csv:3: column override: found \"75\", expected a share from 0 to 1"
    );
}

#[test]
fn what_stands_twice_is_refused_with_both_lines() {
    assert_eq!(
        error_of("points.csv", &(fixture_text("points.csv") + "\n14,0,0,T1,1.25,0.5,0.75,,,,\n")),
        "points.csv:13: the same cycle, pose and target stand in line 2 already; expected each target once a visit"
    );
    assert_eq!(
        error_of("poses.csv", &edited("poses.csv", "20.5,0,1,", "20.5,0,0,")),
        "poses.csv:3: cycle 0, pose 0 stands twice (first in line 2); expected each visit once"
    );
    assert_eq!(
        error_of("distances.csv", &edited("distances.csv", "0,0,T1,A2", "0,0,T1,A1")),
        "distances.csv:3: the same cycle, pose, target and anchor stand in line 2 already; expected each once a visit"
    );
    assert_eq!(
        error_of("run.toml", &edited("run.toml", "name = \"A2\"", "name = \"A1\"")),
        "run.toml:20: the anchor \"A1\" stands twice; expected each name once"
    );
    assert_eq!(
        error_of("poses.csv", &edited("poses.csv", "cmd2", "cmd1")),
        "poses.csv:1: the column cmd1 stands twice; expected it once"
    );
}

#[test]
fn a_target_measured_again_after_a_broken_beam_is_one_point() {
    let run = read_with("points.csv", &(fixture_text("points.csv") + "23,0,1,T2,1,2,3,,,,\n"));
    assert_eq!(run.visits[1].points.len(), 2);
    assert_eq!(run.visits[1].broken_beams.len(), 2);
}

#[test]
fn a_cycle_without_poses_is_noted_and_a_reference_without_poses_refused() {
    let one_cycle: String =
        fixture_text("poses.csv").lines().map(|line| line.replacen("0.5,1,", "0.5,4,", 1) + "\n").collect();
    let points: String = fixture_text("points.csv").lines().map(|line| move_cycle(line, "4")).collect();
    let folder = folder_with(&[("poses.csv", Some(&one_cycle)), ("points.csv", Some(&points))]);
    let run = run::read(folder.path()).expect("usable");
    assert!(run.notes.contains(&"poses.csv: no poses in cycle 1 to 3".to_owned()), "{:?}", run.notes);

    assert_eq!(
        error_of("run.toml", &edited("run.toml", "reference_cycle = 0", "reference_cycle = 7")),
        "run.toml:4: reference_cycle is 7, but poses.csv has no pose in that cycle; expected one of its cycles"
    );
}

fn move_cycle(line: &str, cycle: &str) -> String {
    let mut cells: Vec<&str> = line.split(',').collect();
    if cells[1] == "1" {
        cells[1] = cycle;
    }
    cells.join(",") + "\n"
}

#[test]
fn points_of_no_visit_are_refused_and_visits_of_no_point_noted() {
    assert_eq!(
        error_of("points.csv", &edited("points.csv", "921,1,1", "921,1,9")),
        "points.csv:10: cycle 1, pose 9 is not in poses.csv; expected one of the visits there"
    );
    let without_last: String = fixture_text("points.csv").lines().take(10).map(|line| line.to_owned() + "\n").collect();
    assert_eq!(read_with("points.csv", &without_last).notes, ["poses.csv: 1 pose has no measurement"]);
}

#[test]
fn columns_in_another_order_are_the_same_run() {
    let plain = read_with("points.csv", &fixture_text("points.csv"));
    for file in ["poses.csv", "points.csv", "temperatures.csv", "motion.csv", "distances.csv"] {
        let reversed: String =
            fixture_text(file).lines().map(|line| line.split(',').rev().collect::<Vec<_>>().join(",") + "\n").collect();
        let run = read_with(file, &reversed);
        assert!(same_data(&run, &plain), "{file}");
        assert!(run.notes.is_empty(), "{:?}", run.notes);
    }
}

#[test]
fn line_ends_byte_order_mark_blank_lines_and_spaces_change_nothing() {
    let plain = read_with("points.csv", &fixture_text("points.csv"));
    for file in FILES.into_iter().skip(1).filter(|file| !file.starts_with("import/")) {
        let text = fixture_text(file);
        let mut variants =
            vec![text.replace('\n', "\r\n"), format!("\u{feff}{text}"), format!("\n{}\n\n", text.trim_end())];
        if file.ends_with(".csv") {
            variants.push(text.replace(',', " , "));
            variants.push(text.replace('\n', "\n\n"));
            variants.push(text.replace('\n', "\r"));
            variants.push(text.clone() + ",,\n , , \n");
        }
        for variant in variants {
            let run = read_with(file, &variant);
            assert!(same_data(&run, &plain), "{file}: {variant:?}");
            assert!(run.notes.is_empty(), "{file}: {:?}", run.notes);
        }
    }
}

#[test]
fn the_line_is_right_whatever_the_line_ends() {
    let wrong = edited("points.csv", "0,0,T2,1.26", "0,0,T2,x");
    let expected = "column x_m: found \"x\"";
    for (variant, line) in [
        (wrong.replace('\n', "\r\n"), 3),
        (wrong.replace('\n', "\r"), 3),
        (format!("\u{feff}{wrong}"), 3),
        (wrong.replace('\n', "\n\n"), 5),
        (wrong.replace('\n', "\r\n\r\n"), 5),
        (format!("\r\n\r\n{}", wrong.replace('\n', "\r\n")), 5),
    ] {
        let error = error_of("points.csv", &variant);
        assert!(error.starts_with(&format!("points.csv:{line}: {expected}")), "{error} in {variant:?}");
    }
}

#[test]
fn semicolons_tabs_and_decimal_commas_are_read_and_noted() {
    let plain = read_with("points.csv", &fixture_text("points.csv"));
    for file in ["poses.csv", "points.csv", "temperatures.csv", "motion.csv", "distances.csv"] {
        let text = fixture_text(file);
        let semicolons = read_with(file, &text.replace(',', ";"));
        assert!(same_data(&semicolons, &plain), "{file}");
        assert_eq!(semicolons.notes, [format!("{file}: read with semicolons between the columns")]);

        let tabs = read_with(file, &text.replace(',', "\t"));
        assert!(same_data(&tabs, &plain), "{file}");
        assert_eq!(tabs.notes, [format!("{file}: read with tabs between the columns")]);

        let excel = read_with(file, &text.replace(',', ";").replace('.', ","));
        assert!(same_data(&excel, &plain), "{file}");
        assert_eq!(
            excel.notes,
            [
                format!("{file}: read with semicolons between the columns"),
                format!("{file}: numbers read with a decimal comma"),
            ]
        );
    }
}

#[test]
fn decimal_commas_that_cannot_be_told_apart_are_refused() {
    let semicolons = fixture_text("points.csv").replace(',', ";");
    assert_eq!(
        error_of("points.csv", &semicolons.replacen("1.26", "1,26", 1)),
        "points.csv:3: column x_m: decimal points and decimal commas are mixed (line 2 has a decimal point); expected \
         one of them throughout"
    );
    assert_eq!(
        error_of("points.csv", &semicolons.replacen("1.26", "1.000,26", 1)),
        "points.csv:3: column x_m: found \"1.000,26\", expected metres (x_m, y_m and z_m all empty for a broken beam)"
    );
    assert_eq!(
        error_of("points.csv", &edited("points.csv", "1.26,", "1,26,")),
        "points.csv:3: has 12 fields; expected 11 as in the header (a decimal comma needs semicolons between the columns)"
    );
}

#[test]
fn unknown_columns_are_noted_and_missing_ones_refused() {
    let wider: String = fixture_text("points.csv")
        .lines()
        .enumerate()
        .map(|(index, line)| if index == 0 { format!("{line},quality\n") } else { format!("{line},good\n") })
        .collect();
    assert_eq!(read_with("points.csv", &wider).notes, ["points.csv: unknown column quality ignored"]);
    assert_eq!(
        error_of("points.csv", &edited("points.csv", "x_m,y_m", "x,y")),
        "points.csv:1: the columns x_m, y_m are missing; found cycle, pose, qw, qx, qy, qz, target, time_s, x, y, z_m"
    );
    assert_eq!(
        error_of("points.csv", &edited("points.csv", "qz", "q4")),
        "points.csv:1: has some of the columns qw, qx, qy, qz; expected all of them, or none"
    );
    assert_eq!(
        error_of("poses.csv", &edited("poses.csv", "q2", "q3")),
        "poses.csv:1: has the column q3 but not q2; expected q1 to q3 without a gap"
    );
    assert_eq!(
        error_of("poses.csv", &edited("poses.csv", "approach2", "approach")),
        "poses.csv:1: has 1 columns approach1 to approach1 but q1 to q2; expected one approach for each joint, or none"
    );
    assert_eq!(
        error_of("motion.csv", &edited("motion.csv", "rms2", "speed")),
        "motion.csv:1: has 1 rms columns, but poses.csv has 2 joints; expected rms1 to rms2"
    );
    assert_eq!(
        error_of("temperatures.csv", "\n\n"),
        "temperatures.csv:1: is empty; expected a header with the columns time_s, sensor, celsius"
    );
    assert_eq!(
        error_of("poses.csv", "time_s,cycle,pose,q1\n"),
        "poses.csv:1: has no rows below its header; expected one a visit"
    );
    assert_eq!(
        error_of("points.csv", &edited("points.csv", "21,0,1,T1", "21,0,1")),
        "points.csv:5: has 10 fields; expected 11 as in the header"
    );
}

#[test]
fn run_toml_is_held_to_its_form() {
    for (from, to, expected) in [
        ("format = 1", "format = 2", "run.toml:1: format is 2; expected 1, the only one there is"),
        (
            "reference_cycle = 0",
            "reference_cycle = -1",
            "run.toml:4: reference_cycle is -1; expected a whole number from 0",
        ),
        ("ambient", "ambiance", "run.toml:5: unknown field `ambiance`, expected one of"),
        ("sigma_per_m", "sigma_permille", "run.toml:11: unknown field `sigma_permille`, expected one of"),
        ("name = \"fixture\"", "name = 3", "run.toml:2: invalid type: integer `3`, expected a string"),
        ("robot = \"robot.toml\"\n", "", "run.toml:1: missing field `robot`"),
        ("sigma_per_m = 1e-6\n", "", "run.toml:7: missing field `sigma_per_m`"),
        ("[0.0, 0.0, 0.0]", "[0.0, 0.0]", "run.toml:9: invalid length 2, expected an array of length 3"),
        (
            "[0.0, 0.0, 0.0]",
            "[0.0, 0.0, inf]",
            "run.toml:9: position is [0.0, 0.0, inf]; expected three finite numbers",
        ),
        ("sigma_m = 4.0e-6", "sigma_m = -4.0e-6", "run.toml:10: sigma_m is -4e-6; expected metres, not negative"),
        ("sigma_rad = 2.0e-5", "sigma_rad = 0.0", "run.toml:12: sigma_rad is 0.0; expected radians above 0"),
        ("sigma_m = 2.0e-5", "sigma_m = 0", "run.toml:17: an anchor's sigma_m is 0.0; expected metres above 0"),
        ("name = \"fixture\"", "name = \"fixture", "run.toml:2: "),
    ] {
        let error = error_of("run.toml", &edited("run.toml", from, to));
        assert!(error.starts_with(expected), "{error}");
    }
    let silent = edited("run.toml", "4.0e-6", "0").replacen("1e-6", "0", 1);
    assert_eq!(
        error_of("run.toml", &silent),
        "run.toml:10: sigma_m and sigma_per_m are both 0; expected the instrument's 1-sigma of one coordinate, by which \
         points are weighted"
    );
}

#[test]
fn what_is_no_text_in_utf8_is_refused() {
    let folder = folder_with(&[]);
    let utf16: Vec<u8> =
        [0xff, 0xfe].into_iter().chain(fixture_text("points.csv").bytes().flat_map(|b| [b, 0])).collect();
    fs::write(folder.path().join("points.csv"), utf16).expect("written");
    assert_eq!(error_of_folder(folder), "points.csv:1: is UTF-16 text; expected UTF-8 (save it as \"CSV UTF-8\")");
    let folder = folder_with(&[]);
    fs::write(folder.path().join("run.toml"), b"format = 1\nname = \"k\xfchl\"\n").expect("written");
    assert_eq!(error_of_folder(folder), "run.toml:2: is not UTF-8 text; expected TOML in UTF-8");
}

#[test]
fn missing_files_are_named() {
    for (file, expected) in [
        ("run.toml", "run.toml: is not there; expected a run folder with run.toml, poses.csv and points.csv"),
        ("poses.csv", "poses.csv: is not there; expected a run folder with run.toml, poses.csv and points.csv"),
    ] {
        assert_eq!(error_of_folder(folder_with(&[(file, None)])), expected);
    }
    assert_eq!(
        error_of_folder(folder_with(&[("points.csv", None), ("distances.csv", None)])),
        "points.csv: is not there; expected the measured points (or distances.csv)"
    );
    let distances_only = run::read(folder_with(&[("points.csv", None)]).path()).expect("distances are enough");
    assert_eq!(distances_only.point_count(), 0);
    let geometric =
        run::read(folder_with(&[("temperatures.csv", None), ("motion.csv", None)]).path()).expect("geometric");
    assert_eq!(geometric.temperatures, None);
}

#[test]
fn the_count_of_joints_is_compared_with_the_robot() {
    let run = run::read(folder_with(&[]).path()).expect("valid");
    assert!(run.check_joint_count(2).is_ok());
    let error = run.check_joint_count(6).expect_err("differs");
    assert_eq!((error.file.file_name(), error.line), (Some("poses.csv".as_ref()), Some(1)));
    assert!(error.message.starts_with("has 2 joint columns (q1 to q2), but "), "{error}");
    assert!(error.message.ends_with("has 6 moving transforms; expected one column for each"), "{error}");
}

/// What the fuzzer has found worth keeping, as an ordinary test.
#[test]
fn the_corpus_holds() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    for file in FILES {
        let inputs = fs::read_dir(corpus.join(file.replace(['.', '/'], "_"))).expect("a corpus for each file");
        let mut count = 0;
        for input in inputs {
            let input = input.expect("readable").path();
            eprintln!("{}", input.display());
            property::holds(file, &fs::read(input).expect("readable"));
            count += 1;
        }
        assert!(count > 0, "no corpus for {file}");
    }
}

/// One change to a valid file.
#[derive(Debug, Clone)]
enum Change {
    Byte(usize, u8),
    Remove(usize, usize),
    Insert(usize, &'static str),
    RepeatLine(usize),
    RemoveLine(usize),
}

fn change() -> impl Strategy<Value = Change> {
    let words = prop::sample::select(vec![
        "NaN",
        "inf",
        "-",
        ",",
        ";",
        "\t",
        "\n",
        "\r",
        "\"",
        ".",
        "1e999",
        "-1",
        "99999999999",
        "\u{feff}",
        "ä",
        "\0",
        "[[",
        "]",
        "=",
        " ",
        "'",
        "#",
    ]);
    prop_oneof![
        (any::<usize>(), any::<u8>()).prop_map(|(at, byte)| Change::Byte(at, byte)),
        (any::<usize>(), 1_usize..20).prop_map(|(at, count)| Change::Remove(at, count)),
        (any::<usize>(), words).prop_map(|(at, word)| Change::Insert(at, word)),
        any::<usize>().prop_map(Change::RepeatLine),
        any::<usize>().prop_map(Change::RemoveLine),
    ]
}

fn changed(mut bytes: Vec<u8>, changes: &[Change]) -> Vec<u8> {
    for change in changes {
        let length = bytes.len().max(1);
        let lines = || -> Vec<Vec<u8>> { bytes.split_inclusive(|&byte| byte == b'\n').map(<[u8]>::to_vec).collect() };
        match *change {
            Change::Byte(at, byte) => {
                if let Some(place) = bytes.get_mut(at % length) {
                    *place = byte;
                }
            }
            Change::Remove(at, count) => {
                let start = (at % length).min(bytes.len());
                bytes.drain(start..(start + count).min(bytes.len()));
            }
            Change::Insert(at, word) => {
                let at = (at % length).min(bytes.len());
                bytes.splice(at..at, word.bytes());
            }
            Change::RepeatLine(at) => {
                let mut lines = lines();
                if let Some(line) = lines.get(at % lines.len().max(1)).cloned() {
                    lines.push(line);
                }
                bytes = lines.concat();
            }
            Change::RemoveLine(at) => {
                let mut lines = lines();
                if !lines.is_empty() {
                    lines.remove(at % lines.len());
                }
                bytes = lines.concat();
            }
        }
    }
    bytes
}

/// The seed of the mutations: the same unless THERMOKIN_SEED says another.
fn seed() -> u64 {
    std::env::var("THERMOKIN_SEED").ok().and_then(|seed| seed.parse().ok()).unwrap_or(1)
}

#[test]
fn valid_files_with_any_changes_hold() {
    let seed = seed();
    eprintln!("THERMOKIN_SEED={seed}");
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    let config = Config { cases: 3000, failure_persistence: None, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &bytes));
    let cases = (prop::sample::select(FILES.to_vec()), prop::collection::vec(change(), 1..4));
    runner
        .run(&cases, |(file, changes)| {
            property::holds(file, &changed(fixture_text(file).into_bytes(), &changes));
            Ok(())
        })
        .unwrap_or_else(|error| panic!("{error}"));
}
