//! The command line from end to end through the real binary: exit codes, one line that names file and line, nothing
//! written where nothing may be, and results that say what the contract says.

mod calibrate_twin;

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use calibrate_twin::{Dice, Strata, Twin};
use serde_json::Value;
use thermokin::model::Model;
use thermokin::robot::{Robot, ThermalChoice, shipped};

/// A folder with a run of the COMAU: 16 poses of four targets in each of three cycles, two sensors.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new(warm: bool) -> Self {
        let mut dice = Dice::new("command line");
        let mut robot = shipped("comau-nj-130-2.0").expect("shipped");
        robot.sensors.retain(|sensor| ["L0S1", "L2S1"].contains(&sensor.name.as_str()));
        let choice = |parameter: &str, sensor: &str| ThermalChoice {
            parameter: parameter.parse().expect("a parameter"),
            sensors: vec![sensor.to_owned()],
        };
        robot.thermal = vec![choice("d1", "L0S1"), choice("a2", "L2S1")];
        let mut twin = Twin::new(robot, &mut dice);
        twin.grows("d1", "L0S1", -7e-6);
        twin.grows("a2", "L2S1", 9e-6);
        let rises: Vec<Vec<f64>> = match warm {
            true => vec![vec![0.0, 0.0], vec![6.0, 11.0], vec![9.0, 13.0]],
            false => vec![vec![0.0, 0.0]; 3],
        };
        let postures = twin.postures(16, 1.0, &mut dice);
        let strata = Strata { point: 10e-6, visit: 1e-5, posture: 0.0 };
        let campaign = twin.visit(&postures, &rises, strata, &mut dice);
        let folder = Self(tempfile::tempdir().expect("a folder"));
        let mut poses = String::from("time_s,cycle,pose,q1,q2,q3,q4,q5,q6\n");
        let mut points = String::from("time_s,cycle,pose,target,x_m,y_m,z_m\n");
        let mut temperatures = String::from("time_s,sensor,celsius\n");
        for (number, visit) in campaign.visits.iter().enumerate() {
            let time = 60 * number;
            let q: Vec<String> = visit.posture.joints().iter().map(|joint| joint.value.to_string()).collect();
            writeln!(poses, "{time},{},{},{}", visit.cycle, visit.pose, q.join(",")).expect("text");
            for position in &visit.positions {
                let (target, at) = (&campaign.targets[position.target], position.at);
                writeln!(points, "{time},{},{},{target},{},{},{}", visit.cycle, visit.pose, at.x, at.y, at.z)
                    .expect("text");
            }
            for (sensor, rise) in campaign.sensors.iter().zip(&visit.rises) {
                writeln!(temperatures, "{time},{sensor},{}", 21.0 + rise).expect("text");
            }
        }
        folder.write("poses.csv", &poses);
        folder.write("points.csv", &points);
        folder.write("temperatures.csv", &temperatures);
        folder.write("robot.toml", &twin.robot.to_toml());
        folder.write(
            "run.toml",
            "format = 1\nname = \"twin\"\nrobot = \"robot.toml\"\nreference_cycle = 0\n\n[instrument]\nname = \"tracker\"\n\
             position = [0.0, 0.0, 0.0]\nsigma_m = 10e-6\nsigma_per_m = 0.0\n",
        );
        folder
    }

    fn path(&self, file: &str) -> PathBuf {
        self.0.path().join(file)
    }

    fn write(&self, file: &str, text: &str) {
        fs::write(self.path(file), text).expect("written");
    }

    fn edit(&self, file: &str, from: &str, to: &str) {
        let text = fs::read_to_string(self.path(file)).expect("there");
        assert!(text.contains(from), "{file} has no {from:?}");
        self.write(file, &text.replacen(from, to, 1));
    }

    /// Runs the binary in this folder.
    fn run(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_thermokin")).current_dir(self.0.path()).args(arguments).output().expect("runs")
    }

    /// The one line of a refusal.
    fn refusal(&self, code: i32, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let words = String::from_utf8(output.stderr).expect("text");
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {words}");
        assert_eq!(words.trim_end().lines().count(), 1, "{words}");
        assert!(output.stdout.is_empty(), "words on standard output beside a refusal");
        assert!(!self.path("model.json").exists(), "a model was written although the command failed");
        assert!(!self.path("model.json.part").exists(), "half a model was left");
        words.trim_end().to_owned()
    }

    fn json(&self, arguments: &[&str]) -> Value {
        let output = self.run(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).expect("exactly one JSON object and no words")
    }
}

const CALIBRATE: [&str; 4] = ["calibrate", ".", "--out", "model.json"];

fn with<'a>(base: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
    base.iter().chain(more).copied().collect()
}

#[test]
fn bad_input_is_refused_in_one_line_that_names_its_place() {
    for (file, from, to, line) in [
        ("robot.toml", "convention = \"hayati\"", "convention = \"denavit\"", Some("robot.toml:")),
        ("run.toml", "sigma_m = 10e-6", "sigma_m = -1.0", Some("run.toml:9:")),
        ("run.toml", "reference_cycle = 0", "reference_cycle = 77", Some("run.toml:4:")),
        ("poses.csv", "\n60,0,1,", "\n60,0,NaN,", Some("poses.csv:3:")),
        ("points.csv", "\n0,0,0,T2,", "\n0,0,0,T1,", Some("points.csv:3:")),
        ("temperatures.csv", "\n0,L2S1,21", "\n0,L2S1,warm", Some("temperatures.csv:3:")),
        ("points.csv", "T1", "XYZ", None),
    ] {
        let folder = Folder::new(true);
        folder.edit(file, from, to);
        let words = folder.refusal(2, &CALIBRATE);
        assert!(words.contains(line.unwrap_or(file)), "{words}");
    }
}

#[test]
fn a_run_without_points_is_refused() {
    let folder = Folder::new(true);
    folder.write("points.csv", "time_s,cycle,pose,target,x_m,y_m,z_m\n");
    assert!(folder.refusal(2, &CALIBRATE).contains("points.csv"));
    fs::remove_file(folder.path("points.csv")).expect("removed");
    assert!(folder.refusal(2, &CALIBRATE).contains("points.csv"));
}

#[test]
fn choices_that_cannot_be_are_refused() {
    let folder = Folder::new(true);
    assert!(folder.refusal(2, &with(&CALIBRATE, &["--fix", "d2"])).contains("no parameter d2"));
    assert!(folder.refusal(2, &with(&CALIBRATE, &["--poses", "cycles:7-9"])).contains("leaves none"));
    let words = folder.refusal(2, &with(&CALIBRATE, &["--folds", "17"]));
    assert!(words.contains("16") && words.contains("--folds"), "{words}");
    let words = folder.refusal(2, &with(&CALIBRATE, &["--joints", "commanded"]));
    assert!(words.contains("cmd1"), "{words}");
    let words = folder.refusal(2, &with(&CALIBRATE, &["--orientations"]));
    assert!(words.contains("sigma_rad"), "{words}");
    // What the argument parser refuses takes more than a line, and the same code.
    for arguments in [&["--fix", "gamma3"][..], &["--poses", "some"], &["--folds", "1"], &["--loss", "l1"]] {
        let output = folder.run(&with(&CALIBRATE, arguments));
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!folder.path("model.json").exists());
    }
}

#[test]
fn an_output_folder_that_is_not_there_fails_the_work() {
    let folder = Folder::new(true);
    let words = folder.refusal(1, &["calibrate", ".", "--out", "nowhere/model.json", "--json", "-"]);
    assert!(words.contains("nowhere/model.json"), "{words}");
    assert!(!folder.path("nowhere").exists());
}

#[test]
fn models_that_are_none_are_refused() {
    let folder = Folder::new(true);
    assert!(folder.run(&CALIBRATE).status.success());
    let text = fs::read_to_string(folder.path("model.json")).expect("a model");
    let try_text = |text: &str| {
        folder.write("other.json", text);
        let output = folder.run(&["validate", "other.json", "."]);
        let words = String::from_utf8(output.stderr).expect("text");
        assert_eq!(output.status.code(), Some(2), "{words}");
        assert_eq!(words.trim_end().lines().count(), 1, "{words}");
        assert!(words.contains("other.json"), "{words}");
        words
    };
    assert!(try_text(&text[..text.len() / 2]).contains("other.json:"));
    assert!(try_text(&text.replacen("\"format\": 1", "\"format\": 2", 1)).contains("format 2"));
    assert!(try_text(&text.replacen("thermokin model", "another model", 1)).contains("another model"));
    assert!(try_text(&text.replacen("\"name\": \"a1\"", "\"name\": \"a9\"", 1)).contains("expected"));
    try_text("");
    try_text("[]");
    assert!(folder.run(&["validate", "missing.json", "."]).status.code() == Some(2));
}

/// Every number of a result is one: JSON has no NaN, and an unexpected null would stand for it.
fn no_nulls(value: &Value, place: &str, allowed: &[&str]) {
    match value {
        Value::Null => assert!(allowed.iter().any(|end| place.ends_with(end)), "{place} is null"),
        Value::Array(all) => {
            all.iter().enumerate().for_each(|(n, one)| no_nulls(one, &format!("{place}[{n}]"), allowed))
        }
        Value::Object(all) => all.iter().for_each(|(name, one)| no_nulls(one, &format!("{place}.{name}"), allowed)),
        _ => {}
    }
}

fn errors_at(result: &Value, level: &str) -> [f64; 3] {
    ["mean_mm", "rms_mm", "max_mm"].map(|name| result[level][name].as_f64().unwrap_or_else(|| panic!("{level}.{name}")))
}

#[test]
fn results_have_the_contracts_form() {
    let folder = Folder::new(true);
    let result =
        folder.json(&with(&CALIBRATE, &["--json", "-", "--folds", "4", "--correlations", "--compare-methods"]));
    no_nulls(&result, "result", &[]);
    assert_eq!((&result["format"], &result["command"]), (&Value::from(1), &Value::from("calibrate")));
    assert_eq!(
        (&result["poses"], &result["points"], &result["cycles"]),
        (&Value::from(16), &Value::from(192), &Value::from(3))
    );
    let [nominal, geometric, thermal] = ["nominal", "geometric", "thermal"].map(|level| errors_at(&result, level));
    assert!(nominal[0] > 1.0 && geometric[0] < 0.3 && thermal[0] < 0.05, "{nominal:?} {geometric:?} {thermal:?}");
    let robot = Robot::read(&folder.path("robot.toml")).expect("a robot");
    let names: Vec<String> = robot.chain().parameters().iter().map(ToString::to_string).collect();
    let parameters = result["parameters"].as_array().expect("parameters");
    assert_eq!(parameters.len(), 30);
    for (entry, (name, nominal)) in parameters.iter().zip(names.iter().zip(robot.nominal())) {
        assert_eq!(entry["name"], **name);
        assert_eq!(entry["nominal"], nominal);
        assert_eq!(
            entry["unit"],
            if name.starts_with(['a', 'd', 'b']) && !name.contains("alpha") && !name.contains("beta") {
                "m"
            } else {
                "rad"
            }
        );
        assert!(entry["value"].is_f64() && entry["sigma"].as_f64().is_some_and(|sigma| sigma > 0.0));
    }
    let coefficients = result["thermal_coefficients"].as_array().expect("coefficients");
    let found: Vec<(&str, &str, &str)> = coefficients
        .iter()
        .map(|entry| {
            let text = |name: &str| entry[name].as_str().expect("text");
            (text("parameter"), text("sensor"), text("unit"))
        })
        .collect();
    assert_eq!(found, [("d1", "L0S1", "m/K"), ("a2", "L2S1", "m/K")]);
    for (entry, truth) in coefficients.iter().zip([-7e-6, 9e-6]) {
        let (value, sigma) = (entry["value"].as_f64().expect("value"), entry["sigma"].as_f64().expect("sigma"));
        assert!((value - truth).abs() < 4.0 * sigma && sigma < 3e-6, "{value} ± {sigma} for {truth}");
    }
    assert_eq!(result["observability"]["rank"], 30);
    assert!(result["observability"]["condition"].as_f64().is_some_and(|condition| condition > 1.0));
    assert_eq!(result["observability"]["unidentifiable"], Value::Array(Vec::new()));
    assert_eq!(result["folds"]["folds"], 4);
    assert_eq!(result["methods"].as_array().map(Vec::len), Some(4));
}

#[test]
fn a_model_judged_on_its_own_run_errs_as_calibrate_said() {
    let folder = Folder::new(true);
    let calibrated = folder.json(&with(&CALIBRATE, &["--json", "-"]));
    let judged = folder.json(&["validate", "model.json", ".", "--json", "-"]);
    no_nulls(&judged, "result", &[]);
    assert_eq!((&judged["format"], &judged["command"]), (&Value::from(1), &Value::from("validate")));
    for level in ["nominal", "geometric", "thermal"] {
        for (own, other) in errors_at(&calibrated, level).iter().zip(errors_at(&judged, level)) {
            // The file holds every bit of a number; only the order of sums may differ.
            assert!((own - other).abs() < 1e-12 * own, "{level}: {own} and {other}");
        }
    }
    let cycles = judged["cycles"].as_array().expect("cycles");
    assert_eq!(cycles.len(), 3);
    for (number, cycle) in cycles.iter().enumerate() {
        assert_eq!(cycle["cycle"], number);
        assert_eq!(cycle["time_s"], 960.0 * number as f64);
        for name in ["temperature_c", "nominal_mm", "geometric_mm", "thermal_mm"] {
            assert!(cycle[name].is_f64(), "{name}");
        }
    }
    // 8.5 K and 11 K: the mean of the two sensors.
    assert!((cycles[1]["temperature_c"].as_f64().expect("a number") - 29.5).abs() < 1e-9);
    let warm = |name: &str| cycles[2][name].as_f64().expect("a number");
    assert!(warm("geometric_mm") > 2.0 * warm("thermal_mm"));
}

#[test]
fn a_model_file_gives_back_the_model() {
    let folder = Folder::new(true);
    assert!(folder.run(&CALIBRATE).status.success());
    let text = fs::read_to_string(folder.path("model.json")).expect("a model");
    let model = Model::parse(Path::new("model.json"), &text).expect("read");
    assert_eq!(model.to_json(), text);
    let copy = folder.path("copy.json");
    model.write(&copy).expect("written");
    assert_eq!(Model::read(&copy).expect("read"), model);
    // An earlier model is replaced.
    model.write(&copy).expect("written again");
    assert_eq!(fs::read_to_string(&copy).expect("there"), text);
}

#[test]
fn words_name_the_result_and_json_goes_to_its_file() {
    let folder = Folder::new(true);
    let output = folder.run(&with(&CALIBRATE, &["--json", "result.json", "--correlations"]));
    assert!(output.status.success());
    let words = String::from_utf8(output.stdout).expect("text");
    for part in
        ["nominal", "geometric", "thermal", "converged", "30", "± 95 %", "d1", "L2S1", "correlations", "correction"]
    {
        assert!(words.contains(part), "no {part:?} in\n{words}");
    }
    let result: Value =
        serde_json::from_str(&fs::read_to_string(folder.path("result.json")).expect("written")).expect("JSON");
    assert_eq!(result["command"], "calibrate");
    for command in ["calibrate", "validate"] {
        let help = folder.run(&[command, "--help"]);
        assert!(help.status.success() && String::from_utf8_lossy(&help.stdout).contains("Example"));
    }
}

#[test]
fn fixed_parameters_come_out_nominal() {
    let folder = Folder::new(true);
    let result = folder.json(&["calibrate", ".", "--fix", "a2,beta6", "--json", "-"]);
    for entry in result["parameters"].as_array().expect("parameters") {
        let held = ["a2", "beta6"].contains(&entry["name"].as_str().expect("a name"));
        assert_eq!(entry["sigma"].is_null(), held);
        assert!(!held || entry["value"] == entry["nominal"]);
    }
}

#[test]
fn whole_poses_and_whole_cycles_are_held_out() {
    let folder = Folder::new(true);
    let by = |what: &str, folds: &str, seed: &str| {
        let arguments = ["calibrate", ".", "--folds", folds, "--fold-by", what, "--fold-seed", seed, "--json", "-"];
        folder.json(&arguments)
    };
    let cycles = by("cycle", "3", "1");
    assert_eq!((&cycles["folds"]["by"], &cycles["folds"]["folds"]), (&Value::from("cycle"), &Value::from(3)));
    // Three cycles in three folds can be dealt in one way only, whatever the seed.
    assert_eq!(cycles["folds"]["mean_mm"], by("cycle", "3", "2")["folds"]["mean_mm"]);
    let poses = by("pose", "4", "1");
    let of = |result: &Value, level: &str| result[level]["rms_mm"].as_f64().expect("a number");
    // Sixteen poses hardly suffice for thirty parameters: poses that were not seen err more than those that were.
    assert!(of(&poses, "folds") > of(&poses, "thermal"), "{poses}");
    let held = folder.json(&["calibrate", ".", "--hold-out", "poses:0-3", "--json", "-"]);
    assert_eq!((&held["held_out"]["points"], &held["points"], &held["poses"]), (&48.into(), &144.into(), &12.into()));
    assert!(of(&held, "held_out") > of(&held, "thermal"), "{held}");
    let words = folder.refusal(2, &["calibrate", ".", "--folds", "4", "--fold-by", "cycle"]);
    assert!(words.contains("3 cycles into 4 folds"), "{words}");
}

#[test]
fn equal_temperatures_are_said_and_no_number_is_lost() {
    let folder = Folder::new(false);
    let result = folder.json(&with(&CALIBRATE, &["--json", "-"]));
    // A coefficient that nothing tells has no value and no sigma to state: it is not listed, but named.
    assert_eq!(result["thermal_coefficients"], Value::Array(Vec::new()));
    no_nulls(&result, "result", &[]);
    let words = result["observability"]["unidentifiable"].to_string();
    assert!(words.contains("d1(L0S1) moves nothing") && words.contains("a2(L2S1) moves nothing"), "{words}");
    let judged = folder.json(&["validate", "model.json", ".", "--json", "-"]);
    no_nulls(&judged, "result", &[]);
}

#[test]
fn missing_sensors_gaps_and_cycles_are_counted() {
    // A sensor without any reading: its parameter follows nothing, the rest is found.
    let folder = Folder::new(true);
    let text = fs::read_to_string(folder.path("temperatures.csv")).expect("there");
    let lines = |keep: &dyn Fn(&str) -> bool| {
        text.lines().filter(|line| keep(line)).fold(String::new(), |all, line| all + line + "\n")
    };
    folder.write("temperatures.csv", &lines(&|line| !line.contains("L2S1")));
    let result = folder.json(&with(&CALIBRATE, &["--json", "-"]));
    assert!(result["notes"].to_string().contains("no readings of sensor L2S1"), "{}", result["notes"]);
    assert_eq!(result["thermal_coefficients"].as_array().map(Vec::len), Some(1));
    // A gap of eleven minutes in both logs of the last cycle.
    folder.write(
        "temperatures.csv",
        &lines(&|line| {
            let time: f64 = line.split(',').next().and_then(|time| time.parse().ok()).unwrap_or(0.0);
            !(2000.0..2700.0).contains(&time)
        }),
    );
    let result = folder.json(&with(&CALIBRATE, &["--json", "-"]));
    let notes = result["notes"].to_string();
    assert!(notes.contains("left out"), "{notes}");
    assert!(result["points"].as_u64().is_some_and(|points| (130..192).contains(&points)), "{}", result["points"]);
    // A cycle with four poses cannot be calibrated alone, but serves with the others.
    let folder = Folder::new(true);
    let poses = fs::read_to_string(folder.path("poses.csv")).expect("there");
    let kept = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        fields[1] != "1" || fields[2].parse::<u32>().is_ok_and(|pose| pose < 4)
    };
    let only = |text: &str| text.lines().filter(|line| kept(line)).fold(String::new(), |all, line| all + line + "\n");
    folder.write("poses.csv", &only(&poses));
    folder.write("points.csv", &only(&fs::read_to_string(folder.path("points.csv")).expect("there")));
    let output = folder.run(&CALIBRATE);
    let words = String::from_utf8(output.stdout).expect("text");
    assert!(output.status.success());
    assert!(words.contains("cycles with too few poses for a calibration of their own: [1]"), "{words}");
    // And none at all of that cycle: the two others are left.
    let without = |line: &str| line.split(',').nth(1) != Some("1");
    let only =
        |text: &str| text.lines().filter(|line| without(line)).fold(String::new(), |all, line| all + line + "\n");
    for file in ["poses.csv", "points.csv"] {
        folder.write(file, &only(&fs::read_to_string(folder.path(file)).expect("there")));
    }
    let result = folder.json(&["calibrate", ".", "--json", "-"]);
    assert_eq!(result["cycles"], 2);
}
