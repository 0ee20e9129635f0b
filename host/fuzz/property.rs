//! What must hold for any bytes in any file that a user gives: no panic, an error that names the file, the line and
//! what was expected on one line, and a run that is the same once written and read again. The fuzz targets and
//! host/tests/bad_input.rs share it.

use std::path::Path;

use thermokin::import::{Loaded, Mapping, Source};
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
    if let Some(file) = file.strip_prefix("import/") {
        import_holds(file, bytes);
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

/// The files of the mapping that an import begins with.
const IMPORT: [(&str, &[u8]); 7] = [
    ("import.toml", include_bytes!("fixture/import/import.toml")),
    ("points.txt", include_bytes!("fixture/import/points.txt")),
    ("joints.csv", include_bytes!("fixture/import/joints.csv")),
    ("temperatures.csv", include_bytes!("fixture/import/temperatures.csv")),
    ("machine.csv", include_bytes!("fixture/import/machine.csv")),
    ("holders.txt", include_bytes!("fixture/import/holders.txt")),
    ("targets.csv", include_bytes!("fixture/import/targets.csv")),
];

/// The mapping's text, and the files that it names; one of them replaced.
fn import_with<'b>(replaced: &str, bytes: &'b [u8]) -> (Vec<u8>, impl Fn(&str) -> Vec<Source> + 'b) {
    let replaced = replaced.to_owned();
    let of = move |name: &str| match IMPORT.iter().find(|(own, _)| *own == name) {
        _ if name == replaced => bytes.to_vec(),
        Some((_, own)) => own.to_vec(),
        None => panic!("an import has no file {name}"),
    };
    let mapping = of("import.toml");
    (mapping, move |name| vec![Source { path: Path::new("/no/such/folder").join(name), bytes: of(name) }])
}

/// An import either says what is wrong or gives a run that can be written and read.
fn import_holds(file: &str, bytes: &[u8]) {
    let (mapping, of) = import_with(file, bytes);
    let Ok(text) = str::from_utf8(&mapping) else { return };
    let folder = Path::new("/no/such/folder");
    let imported = Mapping::parse(&folder.join("import.toml"), text).and_then(|mapping| {
        mapping.import(&Loaded {
            tracker: vec![of("points.txt")],
            joints: vec![of("joints.csv")],
            temperatures: vec![of("temperatures.csv")],
            holders: Some([of("machine.csv"), of("holders.txt"), of("targets.csv")]),
            robot: None,
        })
    });
    match imported {
        Err(error) => {
            // What no single file is to blame for is said of the mapping as a whole.
            let has_line = error.line.is_some_and(|line| line > 0) || error.file.ends_with("import.toml");
            assert!(has_line, "names no line: {error}");
            is_helpful(&error);
        }
        Ok(imported) => {
            let files = imported.files(folder).expect("what was imported can be written");
            let run = files.parse(folder).expect("what was written can be read");
            assert_eq!(run.point_count(), imported.report.points);
            assert_eq!(run.visits.len(), imported.report.visits);
            Robot::parse(folder, &imported.robot).expect("its robot can be read");
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
