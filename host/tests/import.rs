//! `thermokin import`: runs written as other programs write them come back as they were, what does not match is told, and
//! what is wrong is refused with its line.
//!
//! # Tolerances
//! Inches are written with 12 decimals, degrees with 12: half a unit of the last place is 1.3e-14 m and 9e-15 rad, below the
//! rounding of doubles of a few metres (4e-16 of 4, a few times in a conversion). `EXACT_M` and `EXACT_RAD` are a hundred times that.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use nalgebra::{Rotation3, Vector3};
use serde_json::Value;
use thermokin::run::{self, Run};

const EXACT_M: f64 = 1e-12;
const EXACT_RAD: f64 = 1e-12;

/// Numbers from a seed: `splitmix64` (Steele, Lea, Flood 2014).
struct Numbers(u64);

impl Numbers {
    /// The same numbers again where `THERMOKIN_SEED` is set to what was printed.
    fn new() -> Self {
        let seed = std::env::var("THERMOKIN_SEED").ok().and_then(|seed| seed.parse().ok()).unwrap_or(1);
        eprintln!("THERMOKIN_SEED={seed}");
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// From -1 to 1.
    fn signed(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from([self.signed(), self.signed(), self.signed()])
    }

    fn shuffle<T>(&mut self, list: &mut [T]) {
        for place in (1..list.len()).rev() {
            list.swap(place, (self.next() % (place as u64 + 1)) as usize);
        }
    }
}

fn thermokin(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_thermokin")).current_dir(folder).args(arguments).output().expect("runs")
}

fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    let output = thermokin(folder, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("UTF-8")
}

fn json(folder: &Path, file: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.join(file)).expect("there")).expect("JSON")
}

/// A folder with a simulated run.
fn simulated() -> (tempfile::TempDir, Run) {
    let folder = tempfile::tempdir().expect("a folder");
    succeeds(folder.path(), &["simulate", "small", "--out", "original"]);
    let run = run::read(&folder.path().join("original")).expect("a run");
    (folder, run)
}

/// `07:00:00` and so many seconds, as other programs write it.
fn clock(time_s: f64) -> (u32, u32, f64) {
    let micros = (time_s * 1e6).round() as u64;
    ((7 + micros / 3_600_000_000) as u32, (micros / 60_000_000 % 60) as u32, (micros % 60_000_000) as f64 * 1e-6)
}

const SAMPLES: usize = 50;

/// Uniform noise of a sample, m: its deviation over √50 stays below what the instrument states, so that weights are equal.
const SAMPLE_NOISE_M: f64 = 4e-6;

/// Tracker samples as SpatialAnalyzer exports them: no header, inches, names from 1, every point of 50 samples, beams that break,
/// rows in any order. The mean of a point's samples is the point.
fn spatial_analyzer(run: &Run, numbers: &mut Numbers) -> (String, [usize; 2]) {
    let mut rows: Vec<String> = Vec::new();
    let [mut zeros, mut jumps] = [0; 2];
    let mut row = |visit: &run::Visit, target: usize, time_s: f64, place: Vector3<f64>| {
        let (hour, minute, second) = clock(time_s);
        let [x, y, z] = (place / 25.4e-3).into();
        rows.push(format!(
            "A,Cycle {},P{}_{}, {x:.12}, {y:.12}, {z:.12}, 05/06/2024 {hour:02}:{minute:02}:{second:09.6}",
            visit.cycle + 1,
            visit.pose + 1,
            run.target_names[target]
        ));
    };
    for (number, visit) in run.visits.iter().enumerate() {
        for (which, point) in visit.points.iter().enumerate() {
            for sample in 0..SAMPLES / 2 {
                let noise = numbers.vector() * SAMPLE_NOISE_M;
                let away_s = 0.005 + 0.01 * sample as f64;
                row(visit, point.target, point.time_s - away_s, point.position + noise);
                row(visit, point.target, point.time_s + away_s, point.position - noise);
            }
            // A beam that breaks: nothing for a moment, and then another fringe.
            if (number + which) % 7 == 0 {
                for _ in 0..3 {
                    row(visit, point.target, point.time_s, Vector3::zeros());
                    zeros += 1;
                }
                for _ in 0..8 {
                    row(visit, point.target, point.time_s, point.position + Vector3::new(2e-3, -1e-3, 0.5e-3));
                    jumps += 1;
                }
            }
        }
        for beam in &visit.broken_beams {
            row(visit, beam.target, beam.time_s, Vector3::zeros());
            zeros += 1;
        }
    }
    numbers.shuffle(&mut rows);
    let head = "// SpatialAnalyzer\r\n// Frame: A::WORLD, Inches\r\n\r\n";
    (rows.iter().fold(head.to_owned(), |text, row| text + row + "\r\n"), [zeros, jumps])
}

/// A controller's table in degrees with decimal commas, joint 3 counted the other way and from 90°.
fn controller(run: &Run) -> String {
    let mut text = "Datum;Zeit;Zyklus;Lage;A1;A2;A3;A4;A5;A6;Bemerkung\n".to_owned();
    for visit in run.visits.iter().rev() {
        let (hour, minute, second) = clock(visit.time_s);
        write!(text, "06.05.2024;{hour}:{minute:02}:{second:09.6};{};{}", visit.cycle + 1, visit.pose + 1)
            .expect("text");
        for (joint, value) in visit.joints.iter().enumerate() {
            let degrees = value.to_degrees();
            let degrees = if joint == 2 { 90.0 - degrees } else { degrees };
            write!(text, ";{}", format!("{degrees:.12}").replace('.', ",")).expect("text");
        }
        text.push_str(";-\n");
    }
    text
}

fn fahrenheit(run: &Run) -> String {
    let log = run.temperatures.as_ref().expect("simulated");
    let mut text = "when\tchannel\tvalue\n".to_owned();
    for (sensor, series) in log.sensors.iter().zip(&log.series) {
        for (time_s, celsius) in series.times_s().iter().zip(series.celsius()) {
            writeln!(text, "{:.9}\tch-{sensor}\t{:.12}", time_s / 60.0, celsius * 1.8 + 32.0).expect("text");
        }
    }
    text
}

fn instrument(run: &Run) -> String {
    let stated = &run.description.instrument;
    format!(
        "[instrument]\nname = \"{}\"\nposition = {:?}\nsigma_m = {:e}\nsigma_per_m = {:e}\n",
        stated.name, stated.position, stated.sigma_m, stated.sigma_per_m
    )
}

fn foreign_mapping(run: &Run) -> String {
    let sensors = &run.temperatures.as_ref().expect("simulated").sensors;
    let rename: Vec<String> = sensors.iter().map(|sensor| format!("\"ch-{sensor}\" = \"{sensor}\"")).collect();
    format!(
        r#"
format = 1
name = "foreign"
robot = "original/robot.toml"
reference_cycle = 0
ambient = "AMB"
start = "2024-05-06 07:00:00"
{}
[[tracker]]
files = ["sa*.txt"]
unit = "in"
layout = {{ header = false }}
columns = {{ target = [1, 2, 3], x = 4, y = 5, z = 6 }}
target_pattern = '.*::Cycle (?<cycle>\d+)::P(?<pose>\d+)_(?<target>.+)'
first_cycle = 1
first_pose = 1
time = {{ column = 7, format = "%m/%d/%Y %H:%M:%S%.f" }}
samples = {{}}

[[joints]]
files = ["joints.csv"]
unit = "deg"
signs = [1, 1, -1, 1, 1, 1]
offsets = [0, 0, 90, 0, 0, 0]
columns = {{ joints = ["A1", "A2", "A3", "A4", "A5", "A6"], cycle = "Zyklus", pose = "Lage" }}
first_cycle = 1
first_pose = 1
time = {{ column = ["Datum", "Zeit"], format = "%d.%m.%Y %H:%M:%S%.f" }}

[[temperatures]]
files = ["log.txt"]
columns = {{ sensor = "channel", value = "value" }}
time = {{ column = "when", unit = "min" }}
unit = "F"
rename = {{ {} }}
"#,
        instrument(run),
        rename.join(", ")
    )
}

/// The same visits with the same joints and points, however they are ordered.
fn assert_same(original: &Run, imported: &Run) {
    assert_eq!(imported.visits.len(), original.visits.len());
    for (own, other) in original.visits.iter().zip(&imported.visits) {
        let what = format!("cycle {}, pose {}", own.cycle, own.pose);
        assert_eq!((own.cycle, own.pose), (other.cycle, other.pose));
        assert!((own.time_s - other.time_s).abs() < 1e-6, "{what}: microseconds are written");
        for (own, other) in own.joints.iter().zip(&other.joints) {
            assert!((own - other).abs() < EXACT_RAD, "{what}: {own} {other}");
        }
        assert_eq!(own.points.len(), other.points.len(), "{what}");
        assert_eq!(own.broken_beams.len(), other.broken_beams.len(), "{what}");
        for point in &own.points {
            let name = &original.target_names[point.target];
            let found = other.points.iter().find(|found| imported.target_names[found.target] == *name);
            let found = found.unwrap_or_else(|| panic!("{what} has no {name}"));
            let apart = (found.position - point.position).norm();
            assert!(apart < EXACT_M, "{what}, {name}: {apart} m apart");
        }
    }
}

#[test]
fn a_run_in_another_programs_words_calibrates_the_same() {
    let (folder, original) = simulated();
    let path = folder.path();
    let mut numbers = Numbers::new();
    let (text, [zeros, jumps]) = spatial_analyzer(&original, &mut numbers);
    fs::write(path.join("sa-monday.txt"), text).expect("written");
    fs::write(path.join("joints.csv"), controller(&original)).expect("written");
    fs::write(path.join("log.txt"), fahrenheit(&original)).expect("written");
    fs::write(path.join("import.toml"), foreign_mapping(&original)).expect("written");
    let words = succeeds(path, &["import", "import.toml", "--out", "run", "--json", "import.json", "--strict"]);
    assert!(words.contains("everything matched"), "{words}");
    let imported = run::read(&path.join("run")).expect("a run");
    assert_same(&original, &imported);

    let report = json(path, "import.json");
    let samples = &report["samples"];
    assert_eq!(samples["used"], (SAMPLES * original.point_count()) as u64);
    assert_eq!((&samples["not_seen"], &samples["dropped"]), (&zeros.into(), &jumps.into()));
    assert!(jumps > 0 && zeros >= jumps * 3 / 8, "beams do break");
    // The deviation of uniform noise is its half-width over √3; that of 50 pairwise opposite samples scatters by less than 20 %.
    let spread = samples["spread_median_m"].as_f64().expect("a number") * 3_f64.sqrt() / SAMPLE_NOISE_M;
    assert!((0.8..1.25).contains(&spread), "{spread}");
    let sigma = imported.visits[0].points[0].sigma_m.expect("kept as the point's noise");
    assert!((0.5..2.0).contains(&(sigma * (SAMPLES as f64).sqrt() * 3_f64.sqrt() / SAMPLE_NOISE_M)), "{sigma}");

    let log = (original.temperatures.as_ref().expect("a log"), imported.temperatures.as_ref().expect("a log"));
    for (own, series) in log.0.sensors.iter().zip(&log.0.series) {
        let other = &log.1.series[log.1.index_of(own).expect("the same sensors")];
        assert_eq!(series.times_s().len(), other.times_s().len(), "{own}");
        for (own, other) in series.celsius().iter().zip(other.celsius()) {
            assert!((own - other).abs() < 1e-11, "12 decimals of a degree Fahrenheit: {own} {other}");
        }
    }

    for run in ["original", "run"] {
        succeeds(path, &["calibrate", run, "--out", &format!("{run}.json"), "--json", &format!("{run}-result.json")]);
    }
    // A shift of the data by at most e moves an estimate by at most its deviation times ‖e/σ‖ (Cauchy and Schwarz): with
    // √(3·290) coordinates, e of 1e-12 m and σ above 1e-7 m that is 3e-4 of it. Times differ by microseconds, in which
    // temperatures do not change; where the iteration stops moves estimates by less.
    let models = ["original.json", "run.json"].map(|file| json(path, file));
    let [own, other] = models.each_ref().map(|model| model["estimates"].as_array().expect("a list"));
    assert_eq!(own.len(), other.len());
    let mut compared = 0;
    for (own, other) in own.iter().zip(other) {
        assert_eq!((&own["name"], own["half_width_95"].is_null()), (&other["name"], other["half_width_95"].is_null()));
        let Some(half) = own["half_width_95"].as_f64() else { continue };
        let apart = own["value"].as_f64().expect("a number") - other["value"].as_f64().expect("a number");
        assert!(apart.abs() < 1e-3 * half, "{}: {apart} apart, ± {half}", own["name"]);
        compared += 1;
    }
    assert!(compared > 20, "{compared}");
}

/// The run again, by time alone: positions in another frame, and joints as a controller logs them all the time.
struct ByTime {
    points: String,
    joints: String,
    mapping: String,
}

/// The joint log lacks the visit `without_joints`; points lack the visit `without_points`.
fn by_time(run: &Run, without_joints: Option<usize>, without_points: Option<usize>) -> ByTime {
    let frame = (Vector3::new(0.4, -1.2, 0.3), Rotation3::from_euler_angles(0.1, -0.2, 1.3));
    let (mut points, mut joints) = ("# X Y Z\n".to_owned(), "t_ms,j\n".to_owned());
    joints = joints.replace(",j", ",q1,q2,q3,q4,q5,q6");
    for (number, visit) in run.visits.iter().enumerate() {
        let times = visit.points.iter().map(|point| point.time_s).chain([visit.time_s]);
        let (first, last) = times.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
        if without_joints != Some(number) {
            // On the way, every joint turns by a degree a tenth of a second; then it stands.
            for step in (1..20).rev() {
                let time = first - 0.1 * f64::from(step);
                write!(joints, "{:.1}", time * 1e3).expect("text");
                for joint in &visit.joints {
                    write!(joints, ",{:.15}", joint + 0.0175 * f64::from(step)).expect("text");
                }
                joints.push('\n');
            }
            let rows = ((last - first) / 0.1).ceil() as usize;
            for row in 0..=rows.max(10) {
                write!(joints, "{:.1}", (first + 0.1 * row as f64) * 1e3).expect("text");
                visit.joints.iter().for_each(|joint| write!(joints, ",{joint:.15}").expect("text"));
                joints.push('\n');
            }
        }
        if without_points != Some(number) {
            for point in &visit.points {
                let [x, y, z] = (frame.1.inverse() * (point.position - frame.0)).into();
                let name = &run.target_names[point.target];
                writeln!(points, "  {name}  {x:.15}   {y:.15} {z:.15}\t{:.6} ", point.time_s + 100.0).expect("text");
            }
        }
    }
    let turn: Vec<f64> = [0.1_f64, -0.2, 1.3].map(f64::to_degrees).to_vec();
    let mapping = format!(
        "format = 1\nname = \"by time\"\nrobot = \"original/robot.toml\"\n{}\n\
         [[tracker]]\nfiles = [\"points.txt\"]\nunit = \"m\"\nlayout = {{ separator = \"space\", header = false }}\n\
         columns = {{ target = 1, x = 2, y = 3, z = 4 }}\ntime = {{ column = 5, offset_s = -100.0 }}\n\
         frame = {{ position = [0.4, -1.2, 0.3], turn_deg = {turn:?} }}\n\
         [[joints]]\nfiles = [\"joints.csv\"]\nrows = \"log\"\nunit = \"rad\"\n\
         columns = {{ joints = [\"q1\", \"q2\", \"q3\", \"q4\", \"q5\", \"q6\"] }}\n\
         time = {{ column = \"t_ms\", unit = \"ms\" }}\nmax_gap_s = 0.2\n",
        instrument(run)
    );
    ByTime { points, joints, mapping }
}

impl ByTime {
    fn import(&self, folder: &Path) -> (Run, Value) {
        fs::write(folder.join("points.txt"), &self.points).expect("written");
        fs::write(folder.join("joints.csv"), &self.joints).expect("written");
        fs::write(folder.join("by-time.toml"), &self.mapping).expect("written");
        succeeds(folder, &["import", "by-time.toml", "--out", "timed", "--json", "timed.json", "--force"]);
        (run::read(&folder.join("timed")).expect("a run"), json(folder, "timed.json"))
    }
}

#[test]
fn visits_that_nothing_numbers_are_found_by_time_and_posture() {
    let (folder, original) = simulated();
    let (run, report) = by_time(&original, None, None).import(folder.path());
    assert_eq!(report["joined_by_time"], original.point_count() as u64);
    assert!(report["unmatched_points"].as_array().expect("a list").is_empty());
    assert_eq!(run.visits.len(), original.visits.len());
    for (own, other) in original.visits.iter().zip(&run.visits) {
        assert_eq!((own.cycle, own.pose), (other.cycle, other.pose));
        let apart = own.joints.iter().zip(&other.joints).map(|(own, other)| (own - other).abs()).fold(0.0, f64::max);
        // The log's first row within 1e-4 of where the arm then stands is none on the way, whose steps are larger.
        assert!(apart < EXACT_RAD, "{apart}");
        for (own, other) in own.points.iter().zip(&other.points) {
            assert!((own.position - other.position).norm() < EXACT_M);
        }
    }
}

#[test]
fn what_does_not_match_is_reported_with_its_line() {
    let (folder, original) = simulated();
    let (without_joints, without_points) = (4, 9);
    let timed = by_time(&original, Some(without_joints), Some(without_points));
    let (run, report) = timed.import(folder.path());
    assert_eq!(run.visits.len(), original.visits.len() - 2);
    let points = report["unmatched_points"].as_array().expect("a list");
    let lost = &original.visits[without_joints].points;
    assert_eq!(points.len(), lost.len());
    let before: usize = original.visits[..without_joints].iter().map(|visit| visit.points.len()).sum();
    // One line of comment, lines counted from 1.
    assert_eq!(points[0]["line"], before as u64 + 2);
    assert_eq!(points[0]["reason"], "no posture near that time");
    assert!((points[0]["time_s"].as_f64().expect("a number") - lost[0].time_s).abs() < 1e-6);
    let visits = report["unmatched_visits"].as_array().expect("a list");
    assert_eq!((visits.len(), &visits[0]["reason"]), (1, &"nothing was measured there".into()));
    assert!(visits[0]["file"].as_str().expect("a name").ends_with("joints.csv"));

    let strict = thermokin(folder.path(), &["import", "by-time.toml", "--out", "strict", "--strict"]);
    assert_eq!(strict.status.code(), Some(2));
    assert!(!folder.path().join("strict").exists(), "nothing is written");
    let words = String::from_utf8_lossy(&strict.stdout);
    assert!(words.contains("without a posture: 4 (4 rows)"), "{words}");
}

#[test]
fn keys_of_the_tracker_name_postures_that_have_none() {
    let (folder, original) = simulated();
    let mut timed = by_time(&original, None, None);
    // The tracker numbers visits its own way, and one point bears the number of another visit.
    let mut points = String::new();
    for visit in &original.visits {
        for (number, point) in visit.points.iter().enumerate() {
            let [x, y, z] = point.position.into();
            let pose = if (visit.cycle, visit.pose, number) == (1, 2, 0) { 93 } else { visit.pose + 90 };
            let (name, time) = (&original.target_names[point.target], point.time_s);
            writeln!(points, "{} {pose} {name} {x:.15} {y:.15} {z:.15} {time:.6}", visit.cycle).expect("text");
        }
    }
    timed.points = points;
    let start = timed.mapping.find("columns = { target").expect("there");
    let end = timed.mapping.find("[[joints]]").expect("there");
    timed.mapping.replace_range(
        start..end,
        "columns = { cycle = 1, pose = 2, target = 3, x = 4, y = 5, z = 6 }\ntime = { column = 7 }\n",
    );
    let (run, report) = timed.import(folder.path());
    assert!(run.visits.iter().zip(&original.visits).all(|(own, other)| own.pose == other.pose + 90));
    let missed = report["unmatched_points"].as_array().expect("a list");
    assert_eq!(
        (missed.len(), &missed[0]["reason"]),
        (1, &"most of its cycle and pose were taken at another posture".into())
    );
    assert_eq!(run.point_count(), original.point_count() - 1);
}

/// The small import of the fuzz targets on the disk, with a part of one file replaced.
fn fixture(file: &str, from: &str, to: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/fixture/import");
    for entry in fs::read_dir(source).expect("there") {
        let entry = entry.expect("readable");
        let mut text = fs::read_to_string(entry.path()).expect("text");
        if entry.file_name() == file {
            assert!(text.contains(from), "{file} has no {from:?}");
            text = text.replacen(from, to, 1);
        }
        fs::write(folder.path().join(entry.file_name()), text).expect("written");
    }
    folder
}

#[test]
fn the_fixture_is_imported_and_its_holders_registered() {
    let folder = fixture("import.toml", "", "");
    let path = folder.path();
    let words = succeeds(path, &["import", "import.toml", "--out", "run", "--json", "import.json"]);
    let report = json(path, "import.json");
    let samples = &report["samples"];
    assert_eq!(
        [&samples["read"], &samples["used"], &samples["not_seen"], &samples["dropped"], &samples["passed_over"]],
        [32, 29, 2, 1, 1],
        "{words}"
    );
    assert_eq!(report["unmatched_points"][0]["reason"], "no joints of that cycle and pose");
    assert_eq!(report["unmatched_points"][0]["line"], 36);
    assert_eq!(
        (&report["unmatched_visits"][0]["line"], &report["unmatched_visits"][0]["cycle"]),
        (&6.into(), &2.into())
    );
    assert_eq!(report["empty_readings"], 1);
    let run = run::read(&path.join("run")).expect("a run");
    assert_eq!(run.visits[0].time_s, 12.5);
    assert!((run.visits[0].joints[2] + 10.375_f64.to_radians()).abs() < 1e-15, "its sign is turned over");
    assert_eq!(run.temperatures.expect("a log").sensors, ["L0S1", "AMB"]);

    // One holder of four was seen 4 µm off: a registration takes most of that in, and the targets are where they are.
    let holders = &report["holders"];
    let rms = holders["rms_m"].as_f64().expect("a number");
    assert!((1e-7..4e-6).contains(&rms), "{rms}");
    let robot = thermokin::robot::Robot::read(&path.join("run/robot.toml")).expect("a robot");
    for (name, expected) in [("T1", [0.06, 0.0, 0.02]), ("T2", [0.0, 0.06, 0.02])] {
        let found = robot.targets[robot.target(name).expect("there")].position.expect("placed");
        assert!((found - Vector3::from(expected)).norm() < 1e-5, "{name}: {found}");
    }
}

/// The one line that refuses the fixture with a part of a file replaced, its folder left out.
fn refusal(file: &str, from: &str, to: &str) -> String {
    let folder = fixture(file, from, to);
    let output = thermokin(folder.path(), &["import", "import.toml", "--out", "run"]);
    assert_eq!(output.status.code(), Some(2), "{file}: {from} as {to}: {}", String::from_utf8_lossy(&output.stdout));
    assert!(!folder.path().join("run").exists(), "nothing is written");
    let words = String::from_utf8(output.stderr).expect("UTF-8");
    words.strip_prefix("thermokin: ").expect("its name").trim_end().to_owned()
}

#[test]
fn what_is_wrong_is_refused_with_its_line() {
    for (file, from, to, expected) in [
        ("points.txt", "1499.9980", "beam", "points.txt:4: column X: found \"beam\", expected a coordinate"),
        ("points.txt", "1499.9980", "", "points.txt:4: column X: found nothing, expected a coordinate"),
        ("points.txt", "1499.9980", "1.5e9", "points.txt:4: column X: found \"1.5e9\", expected a place within 10 km"),
        ("points.txt", ",OK,10.00", ",OK", "points.txt:4: has 5 fields; expected 6 as in the header"),
        ("points.txt", "OK,10.00", "OK,ten", "points.txt:4: column Time: found \"ten\", expected a time as a number"),
        (
            "points.txt",
            "Target,X",
            "Target,U",
            "points.txt:3: the column X is missing; found Status, Target, Time, U, Y, Z",
        ),
        ("points.txt", "Target,X,Y", "Target,X,X", "points.txt:3: the column X stands twice; expected it once"),
        ("joints.csv", "5,125", "five", "joints.csv:2: column J2: found \"five\", expected a joint's position"),
        ("joints.csv", "5,125", "5.125", "joints.csv:2: column J2: decimal points and decimal commas are mixed"),
        ("joints.csv", ";1;1;", ";1;0;", "joints.csv:3: cycle 0, pose 0 stands in joints.csv line 2 already"),
        ("joints.csv", ";1;0;", ";0;0;", "joints.csv:2: column Cycle: found \"0\", expected a whole number from 1"),
        (
            "joints.csv",
            "12.5 06.05",
            "12.5 06/05",
            "joints.csv:2: column Time: found \"07:00:12.5 06/05.2024\", expected a time of the form",
        ),
        ("temperatures.csv", "72.5", "-500", "temperatures.csv:2: column Base: found \"-500\", expected a temperature"),
        (
            "temperatures.csv",
            "07:00:00",
            "07:61:00",
            "temperatures.csv:2: found \"2024-05-06 07:61:00\", expected a time of the form",
        ),
        (
            "machine.csv",
            "H1,50,0",
            "H1,55,0",
            "import.toml:40: holder H1 is 3.750 mm from where the registration puts it",
        ),
        ("import.toml", "format = 1", "format = 2", "import.toml:1: format is 2; expected 1, the only one there is"),
        ("import.toml", "ambient", "ambiente", "import.toml:5: unknown field `ambiente`"),
        (
            "import.toml",
            "staubli-tx90",
            "staubli",
            "import.toml:3: robot is \"staubli\"; expected the path of a .toml or one of",
        ),
        ("import.toml", "staubli-tx90", "no.toml", "no.toml: cannot be read"),
        (
            "import.toml",
            "\"2024-05-06 07",
            "\"2024-05-46 07",
            "import.toml:6: start is \"2024-05-46 07:00:00\"; expected a date",
        ),
        ("import.toml", "start =", "#", "import.toml: some times are dates and others seconds since the run began"),
        (
            "import.toml",
            "sigma_m = 8.0e-6",
            "sigma_m = -1",
            "import.toml:11: sigma_m is -1.0; expected metres, not negative",
        ),
        ("import.toml", "points.txt", "p*.dat", "import.toml:14: no file is like p*.dat; expected one at least"),
        ("import.toml", "points.txt", "p.txt", "p.txt: cannot be read"),
        ("import.toml", "unit = \"mm\"", "unit = \"deg\"", "import.toml:16: unit is Deg; expected m, mm or in"),
        ("import.toml", "x = \"X\"", "x = 9", "points.txt:3: has 6 columns, but the mapping names column 9"),
        ("import.toml", "(?<target>.+)'", "(?<target>.+'", "import.toml:18: the pattern cannot be read: "),
        (
            "import.toml",
            "(?<target>.+)'",
            "(?<point>.+)'",
            "import.toml:18: the pattern has a group \"point\"; expected none but",
        ),
        ("import.toml", "(?<target>.+)'", "(?<target>x)'", "import.toml: the tracker's files hold no position"),
        (
            "import.toml",
            "signs = [1, 1,",
            "signs = [1, 2,",
            "import.toml:28: signs is [1.0, 2.0, -1.0, 1.0, 1.0, 1.0]; expected 1 or -1",
        ),
        (
            "import.toml",
            "signs = [1, 1,",
            "signs = [1,",
            "import.toml:28: signs has 5 entries for 6 joints; expected 6",
        ),
        ("import.toml", "\"J5\", \"J6\"", "\"J5\"", "import.toml:28: signs has 6 entries for 5 joints; expected 5"),
        (
            "import.toml",
            "samples = {}\ntime",
            "time",
            "points.txt:5: T1 was measured at this visit in points.txt line 4 already",
        ),
        (
            "import.toml",
            "reference_cycle = 0",
            "reference_cycle = 7",
            "import.toml: reference_cycle is 7, but no visit is of that cycle",
        ),
    ] {
        let found = refusal(file, from, to);
        assert!(found.starts_with(expected), "{file}: {from} as {to}: {found}");
        assert!(!found.contains('\n'), "{found}");
    }
}

#[test]
fn the_template_is_a_mapping_with_and_without_what_may_be_left_out() {
    let folder = tempfile::tempdir().expect("a folder");
    let template = succeeds(folder.path(), &["import", "--print-mapping"]);
    let parse = |text: &str| thermokin::import::Mapping::parse(Path::new("import.toml"), text);
    parse(&template).unwrap_or_else(|error| panic!("{error}"));
    // A setting that is left out begins with # and no blank; of two that say the same, the last stands.
    let mut seen = std::collections::HashSet::new();
    let mut lines: Vec<String> = Vec::new();
    for line in template.lines().rev() {
        let line = line.strip_prefix('#').filter(|rest| !rest.starts_with(' ')).unwrap_or(line);
        if line.starts_with('[') {
            seen.clear();
        }
        let key = line.split('=').next().unwrap_or_default().trim().to_owned();
        if line.starts_with('#') || !line.contains('=') || seen.insert(key) {
            lines.insert(0, line.to_owned());
        }
    }
    parse(&lines.join("\n")).unwrap_or_else(|error| panic!("{error}"));
}
