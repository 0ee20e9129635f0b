//! What must hold for any bytes in any file that a user gives: no panic, an error that names the file, the line and
//! what was expected on one line, and a run that is the same once written and read again. The fuzz targets and
//! host/tests/bad_input.rs share it.

use std::path::Path;

use thermokin::input::InputError;
use thermokin::robot::Robot;
use thermokin::run::RunFiles;

/// A small valid run that has every file.
pub fn fixture() -> RunFiles {
    RunFiles {
        run: include_bytes!("fixture/run.toml").to_vec(),
        poses: include_bytes!("fixture/poses.csv").to_vec(),
        points: Some(include_bytes!("fixture/points.csv").to_vec()),
        temperatures: Some(include_bytes!("fixture/temperatures.csv").to_vec()),
        motion: Some(include_bytes!("fixture/motion.csv").to_vec()),
        distances: Some(include_bytes!("fixture/distances.csv").to_vec()),
        robot: None,
    }
}

/// The fixture with one of its files replaced.
pub fn fixture_with(file: &str, bytes: &[u8]) -> RunFiles {
    let mut files = fixture();
    let bytes = bytes.to_vec();
    match file {
        "run.toml" => files.run = bytes,
        "poses.csv" => files.poses = bytes,
        "points.csv" => files.points = Some(bytes),
        "temperatures.csv" => files.temperatures = Some(bytes),
        "motion.csv" => files.motion = Some(bytes),
        "distances.csv" => files.distances = Some(bytes),
        _ => panic!("a run has no file {file}"),
    }
    files
}

/// Fails where the property does not hold for these bytes as this file.
pub fn holds(file: &str, bytes: &[u8]) {
    if file == "robot.toml" {
        robot_holds(bytes);
        return;
    }
    let folder = Path::new("/no/such/folder");
    match fixture_with(file, bytes).parse(folder) {
        Err(error) => {
            assert!(error.line.is_some_and(|line| line > 0), "names no line: {error}");
            is_helpful(&error);
        }
        Ok(run) => {
            let written = RunFiles::of(&run, folder).expect("what was read can be written");
            let mut again = written.parse(folder).expect("what was written can be read");
            assert_eq!(RunFiles::of(&again, folder).expect("still written"), written, "the same run, the same bytes");
            again.notes.clone_from(&run.notes);
            assert_eq!(again, run);
        }
    }
}

fn robot_holds(bytes: &[u8]) {
    let file = Path::new("/no/such/folder/robot.toml");
    let Ok(text) = str::from_utf8(bytes) else { return };
    match Robot::parse(file, text) {
        Err(error) => is_helpful(&error),
        Ok(robot) => {
            robot.remarks();
            robot.chain();
            Robot::parse(file, &robot.to_toml()).expect("what was written can be read");
        }
    }
}

fn is_helpful(error: &InputError) {
    let words = error.to_string();
    assert!(!words.contains(char::is_control), "more than one line: {words:?}");
    assert!(words.len() < 2000, "too long: {words}");
}
