//! `thermokin compensate` through the real binary, on a model of the measured example: tables in, tables out, and bad input
//! refused in one line with nothing written.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const JOINTS: &str = "q1,q2,q3,q4,q5,q6\n0.3,-1.2,0.9,0.5,0.8,-0.2\n-0.7,-0.8,1.4,-0.3,-1.1,2.0\n";

struct Folder(tempfile::TempDir);

impl Folder {
    /// A folder with a model of the UR10.
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().expect("a folder"));
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/ur10");
        let model = folder.path("model.json");
        let output = Command::new(env!("CARGO_BIN_EXE_thermokin"))
            .args(["calibrate", "--poses", "every:10", "--out"])
            .args([&model, &data])
            .output()
            .expect("runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        folder
    }

    fn path(&self, file: &str) -> PathBuf {
        self.0.path().join(file)
    }

    fn write(&self, file: &str, text: &str) {
        fs::write(self.path(file), text).expect("written");
    }

    fn compensate(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_thermokin"))
            .current_dir(self.0.path())
            .args(["compensate", "model.json"])
            .args(arguments)
            .output()
            .expect("runs")
    }

    /// The columns of a table, as numbers.
    fn columns(&self, file: &str, names: &[&str]) -> Vec<Vec<f64>> {
        let text = fs::read_to_string(self.path(file)).expect("there");
        let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
        let header = lines.next().expect("a header");
        let places: Vec<usize> =
            names.iter().map(|name| header.iter().position(|own| own == name).expect("a column")).collect();
        lines.map(|cells| places.iter().map(|&place| cells[place].parse().expect("a number")).collect()).collect()
    }
}

#[test]
fn tables_go_forward_and_back_and_corrections_bring_the_arm_where_it_should_be() {
    let folder = Folder::new();
    folder.write("joints.csv", JOINTS);
    let done = |arguments: &[&str]| {
        let output = folder.compensate(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        output
    };
    done(&["--forward", "joints.csv", "--out", "places.csv"]);
    done(&["--inverse", "places.csv", "--all", "--out", "branches.csv"]);
    let joints = ["q1", "q2", "q3", "q4", "q5", "q6"];
    let (given, found) = (folder.columns("joints.csv", &joints), folder.columns("branches.csv", &joints));
    assert!(found.len() > given.len(), "a UR10 has branches: {}", found.len());
    for posture in &given {
        let near = |other: &Vec<f64>| posture.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-8);
        assert!(found.iter().any(near), "{posture:?} is among {found:?}");
    }
    // The real arm at the corrected joints stands where the nominal one does at those that were asked for.
    done(&["--correct", "joints.csv", "--out", "corrected.csv"]);
    done(&["--forward", "corrected.csv", "--out", "stands.csv"]);
    done(&["--forward", "joints.csv", "--level", "nominal", "--out", "believed.csv"]);
    let place = ["x_m", "y_m", "z_m"];
    for (stands, believed) in folder.columns("stands.csv", &place).iter().zip(folder.columns("believed.csv", &place)) {
        for (one, other) in stands.iter().zip(&believed) {
            assert!((one - other).abs() < 1e-9, "{stands:?} {believed:?}");
        }
    }
    let output = done(&["--correct", "joints.csv", "--out", "again.csv", "--json", "-"]);
    let result: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((&result["rows"], &result["failed"]), (&serde_json::json!(2), &serde_json::json!(0)));
}

#[test]
fn what_cannot_be_reached_is_a_row_with_its_reason_and_exit_code_1() {
    let folder = Folder::new();
    folder.write("places.csv", "x_m,y_m,z_m,qw,qx,qy,qz\n90,0,0,1,0,0,0\n");
    let output = folder.compensate(&["--inverse", "places.csv", "--out", "out.csv"]);
    assert_eq!(output.status.code(), Some(1));
    let text = fs::read_to_string(folder.path("out.csv")).expect("written");
    assert!(text.contains("unreachable: the nearest pose found is"), "{text}");
}

#[test]
fn bad_input_is_one_line_with_its_place_and_nothing_is_written() {
    let folder = Folder::new();
    folder.write("joints.csv", JOINTS);
    folder.write("word.csv", "q1,q2,q3,q4,q5,q6\n0,0,0,0,0,0\n0,0,zero,0,0,0\n");
    folder.write("turn.csv", "x_m,y_m,z_m,qw,qx,qy,qz\n1,0,0,1,1,0,0\n");
    folder.write("few.csv", "q1,q2\n0,0\n");
    for (arguments, expected) in [
        (&["--forward", "word.csv"][..], "thermokin: word.csv:3: column q3: found \"zero\", expected a number"),
        (&["--inverse", "turn.csv"], "thermokin: turn.csv:2: qw, qx, qy, qz: expected a quaternion of length 1"),
        (&["--correct", "few.csv"], "thermokin: few.csv:1: the columns q3, q4, q5, q6 are missing"),
        (&["--correct", "none.csv"], "thermokin: none.csv: cannot be read"),
        (&["--correct", "joints.csv", "--temperature", "L9=20"], "thermokin: --temperature L9=20: no such sensor"),
        (&["--live", "0.0.0.0:0"], "thermokin: 0.0.0.0:0: expected an address of this machine alone"),
    ] {
        let output = folder.compensate(&[arguments, &["--out", "out.csv"]].concat());
        let words = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {words}");
        assert!(words.lines().last().is_some_and(|line| line.starts_with(expected)), "{arguments:?}: {words}");
        assert!(!folder.path("out.csv").exists(), "{arguments:?}");
    }
}
