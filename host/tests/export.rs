//! `thermokin export` through the real binary: every form is run by the program that it is for and held against
//! `thermokin compensate --forward` on the same model, with temperatures, directions and effects of joints.

use std::fmt::Write as _;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::{Value, json};

/// What is promised of an export, m and of the components of unit vectors.
const PROMISED: f64 = 1e-9;

const WARMER_K: f64 = 7.5;

struct Folder {
    folder: tempfile::TempDir,
    /// Sensors and the temperatures that are asked for.
    celsius: Vec<(String, f64)>,
}

fn thermokin(folder: &std::path::Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_thermokin")).current_dir(folder).args(arguments).output().expect("runs")
}

impl Folder {
    /// A folder with a model of a simulated COMAU, to which effects are added as discover would.
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        for arguments in [&["simulate", "small", "--out", "run"][..], &["calibrate", "run", "--out", "thermal.json"]] {
            let output = thermokin(folder.path(), arguments);
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
        let text = fs::read_to_string(folder.path().join("thermal.json")).expect("there");
        let mut model: Value = serde_json::from_str(&text).expect("JSON");
        let pick = |rows: &Value, keys: &[&str]| -> Value {
            let rows = rows.as_array().expect("a list").iter();
            rows.map(|row| {
                keys.iter().map(|&key| (key.to_owned(), row[key].clone())).collect::<serde_json::Map<_, _>>()
            })
            .map(Value::Object)
            .collect()
        };
        let growth = pick(&model["thermal_coefficients"], &["parameter", "sensor", "unit", "value"]);
        let effect = |name: &str, place: Value, shape: &[f64], coefficients: &[f64]| json!({ "effect": name, "where": place, "parameters": [], "shape": shape, "coefficients": coefficients });
        let squared = json!({ "parameter": growth[0]["parameter"], "sensor": growth[0]["sensor"] });
        model["extended"] = json!({
            "how_to_apply": "",
            "parameters": pick(&model["parameters"], &["name", "unit", "value"]),
            "targets": pick(&model["targets"], &["name", "position"]),
            "thermal_coefficients": growth,
            "effects": [
                effect("gear_eccentricity", json!({ "joint": 2 }), &[3.0], &[1e-3, 5e-4]),
                effect("encoder_gain", json!({ "joint": 4 }), &[], &[1e-3]),
                effect("backlash", json!({ "joint": 1 }), &[], &[2e-3]),
                effect("joint_coupling", json!({ "from": 5, "joint": 6 }), &[], &[1e-3]),
                effect("thermal_nonlinearity", squared, &[], &[2e-6]),
            ],
        });
        fs::write(folder.path().join("model.json"), model.to_string()).expect("written");
        let sensors = model["temperatures"].as_array().expect("a list").iter();
        let celsius = sensors.enumerate().map(|(number, sensor)| {
            let reference = sensor["reference_c"].as_f64().expect("a number");
            (sensor["sensor"].as_str().expect("a name").to_owned(), reference + WARMER_K + number as f64)
        });
        let celsius = celsius.collect();
        Self { folder, celsius }
    }

    fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        thermokin(self.folder.path(), arguments)
    }

    fn export(&self, form: &str, out: &str, more: &[&str]) -> Output {
        self.run(&[&["export", "model.json", "--form", form, "--out", out], more].concat())
    }

    /// Temperatures as the command line takes them.
    fn given(&self) -> Vec<String> {
        self.celsius
            .iter()
            .flat_map(|(name, celsius)| ["--temperature".to_owned(), format!("{name}={celsius}")])
            .collect()
    }

    /// Where the binary says that the flange stands at the postures, as rows x, y, z, qw, qx, qy, qz.
    fn expected(&self) -> Vec<[f64; 7]> {
        let mut table = String::from("q1,q2,q3,q4,q5,q6,approach1,approach2,approach3,approach4,approach5,approach6\n");
        for (joints, approach) in postures() {
            writeln!(table, "{},{}", list(&joints), list(&approach)).expect("text");
        }
        fs::write(self.path("joints.csv"), table).expect("written");
        let given = self.given();
        let mut arguments = vec!["compensate", "model.json", "--forward", "joints.csv"];
        arguments.extend(given.iter().map(String::as_str));
        let output = self.run(&arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8(output.stdout).expect("text");
        let row = |line: &str| -> [f64; 7] {
            let cells: Vec<f64> = line.split(',').skip(1).take(7).map(|cell| cell.parse().expect("a number")).collect();
            cells.try_into().expect("seven numbers")
        };
        text.lines().skip(1).map(row).collect()
    }

    /// Holds what a program prints, twelve numbers a posture (three rows of rotation and origin), against the binary.
    fn hold(&self, form: &str, output: &Output) {
        assert!(output.status.success(), "{form}: {}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8_lossy(&output.stdout);
        let numbers: Vec<f64> = text.split_whitespace().map(|word| word.parse().expect("a number")).collect();
        let expected = self.expected();
        assert_eq!(numbers.len(), 12 * expected.len(), "{form}: {text}");
        let mut worst = 0.0_f64;
        for (place, expected) in numbers.chunks(12).zip(&expected) {
            let &[x, y, z, w, i, j, k] = expected;
            let rotation = [
                [1.0 - 2.0 * (j * j + k * k), 2.0 * (i * j - k * w), 2.0 * (i * k + j * w)],
                [2.0 * (i * j + k * w), 1.0 - 2.0 * (i * i + k * k), 2.0 * (j * k - i * w)],
                [2.0 * (i * k - j * w), 2.0 * (j * k + i * w), 1.0 - 2.0 * (i * i + j * j)],
            ];
            for (row, origin) in [x, y, z].into_iter().enumerate() {
                worst = worst.max((place[4 * row + 3] - origin).abs());
                for column in 0..3 {
                    worst = worst.max((place[4 * row + column] - rotation[row][column]).abs());
                }
            }
        }
        println!("{form}: within {worst:.1e}");
        assert!(worst <= PROMISED, "{form}: {worst}");
    }
}

fn list(values: &[f64]) -> String {
    values.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
}

/// Postures with directions of approach.
fn postures() -> Vec<([f64; 6], [f64; 6])> {
    let posture = |number: usize| {
        let joints = std::array::from_fn(|joint| 1.3 * (1.7 * number as f64 + 0.9 * joint as f64).sin());
        (joints, std::array::from_fn(|joint| [-1.0, 0.0, 1.0][(number + joint) % 3]))
    };
    (0..20).map(posture).collect()
}

#[test]
fn python_and_c_and_matlab_stand_where_the_binary_stands() {
    let folder = Folder::new();
    let rows =
        postures().iter().map(|(q, approach)| format!("[[{}],[{}]]", list(q), list(approach))).collect::<Vec<_>>();

    let output = folder.export("python", "arm.py", &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let celsius: Value =
        folder.celsius.iter().map(|(name, c)| (name.clone(), json!(c))).collect::<serde_json::Map<_, _>>().into();
    let program = format!(
        "import arm\nfor q, a in [{}]:\n    print(*(repr(float(x)) for x in arm.forward(q, {celsius}, a)[:3].flat))\n",
        rows.join(",")
    );
    folder.hold(
        "python",
        &Command::new("python3").current_dir(folder.folder.path()).args(["-c", &program]).output().expect("python3"),
    );

    let output = folder.export("c", "arm.h", &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rows = |open: &str, close: &str| {
        let row = |(q, approach): &([f64; 6], [f64; 6])| format!("{open}{},{}{close}", list(q), list(approach));
        postures().iter().map(row).collect::<Vec<_>>()
    };
    let celsius: Vec<f64> = folder.celsius.iter().map(|(_, celsius)| *celsius).collect();
    let program = format!(
        "#include <stdio.h>\n#include \"arm.h\"\nstatic const double rows[][12] = {{{}}};\n\
         static const double celsius[] = {{{}}};\nint main(void) {{\n  double m[3][4];\n  \
         for (unsigned n = 0; n < sizeof rows / sizeof *rows; n++) {{\n    \
         thermokin_forward(rows[n], celsius, rows[n] + 6, m);\n    \
         for (int k = 0; k < 12; k++) printf(\"%.17g \", m[k / 4][k % 4]);\n  }}\n  return 0;\n}}\n",
        rows("{", "}").join(","),
        list(&celsius)
    );
    fs::write(folder.path("main.c"), program).expect("written");
    let built = Command::new("cc")
        .current_dir(folder.folder.path())
        .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-o", "arm", "main.c", "-lm"])
        .output()
        .expect("a C compiler, which Rust needs too");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    folder.hold("c", &Command::new(folder.path("arm")).output().expect("runs"));

    let output = folder.export("matlab", "arm_model.m", &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let program = format!(
        "rows = [{}]; for n = 1:size(rows, 1), m = arm_model(rows(n, 1:6), [{}], rows(n, 7:12)); \
         printf('%.17g ', m(1:3, :)'); end",
        rows("", "").join(";"),
        list(&celsius)
    );
    match Command::new("octave")
        .current_dir(folder.folder.path())
        .args(["--quiet", "--no-gui", "--eval", &program])
        .output()
    {
        Ok(output) => folder.hold("matlab", &output),
        // Octave is large, and .ci/setup does not ask for it.
        Err(error) => println!("matlab: not run, there is no octave here: {error}"),
    }
}

#[test]
fn geometry_is_read_back_before_it_is_written_and_what_is_singular_is_refused() {
    let folder = Folder::new();
    let given = folder.given();
    let given: Vec<&str> = given.iter().map(String::as_str).collect();
    for (form, out) in [("urdf", "arm.urdf"), ("table", "arm.csv")] {
        let output = folder.export(form, out, &given);
        let words = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{form}: {}", String::from_utf8_lossy(&output.stderr));
        assert!(words.contains("backlash: adds to a joint at every posture"), "{words}");
        assert!(words.contains("read back: the flange stands within"), "{words}");
        assert!(folder.path(out).exists());
    }
    // The COMAU's axes 2 and 3 are parallel but for an error of alignment.
    let output = folder.export("dh", "dh.csv", &given);
    let words = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{words}");
    assert!(words.starts_with("thermokin: the axes of joints 2 and 3 are "), "{words}");
    assert!(!folder.path("dh.csv").exists());
    for (form, out, expected) in [
        ("matlab", "1arm.m", "thermokin: --out 1arm.m: expected NAME.m"),
        ("python", "nowhere/arm.py", "thermokin: nowhere/arm.py: cannot be written"),
    ] {
        let words = String::from_utf8_lossy(&folder.export(form, out, &[]).stderr).into_owned();
        assert!(words.starts_with(expected), "{words}");
    }
}

/// The rows of a Parquet file, each as JSON by column.
fn parquet_rows(file: &std::path::Path) -> Vec<Value> {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::Field;
    let reader = SerializedFileReader::new(fs::File::open(file).expect("there")).expect("Parquet");
    let cell = |field: &Field| match field {
        Field::Double(value) => json!(value),
        Field::Long(value) => json!(value),
        Field::Str(value) => json!(value),
        Field::Null => Value::Null,
        other => panic!("{other} is of another type than the columns have"),
    };
    let rows = reader.get_row_iter(None).expect("rows").map(|row| row.expect("a row"));
    rows.map(|row| row.get_column_iter().map(|(name, field)| (name.clone(), cell(field))).collect()).collect()
}

#[test]
fn tables_for_analysis_hold_the_run_and_what_the_model_leaves() {
    let folder = Folder::new();
    let at = folder.folder.path();
    for arguments in [
        &["export", "model.json", "--form", "parquet", "--run", "run", "--out", "tables"][..],
        &["validate", "model.json", "run", "--json", "validate.json"],
    ] {
        let output = thermokin(at, arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let validated: Value =
        serde_json::from_str(&fs::read_to_string(at.join("validate.json")).expect("there")).expect("JSON");
    let residuals = parquet_rows(&at.join("tables/residuals.parquet"));
    for level in ["nominal", "geometric", "thermal", "extended"] {
        let own: Vec<f64> = residuals
            .iter()
            .filter(|row| row["level"] == level)
            .map(|row| row["distance_m"].as_f64().expect("a number"))
            .collect();
        assert_eq!(own.len() as u64, validated["points"].as_u64().expect("a number"), "{level}");
        let rms_mm = (own.iter().map(|error| error * error).sum::<f64>() / own.len() as f64).sqrt() * 1e3;
        let expected = validated[level]["rms_mm"].as_f64().expect("a number");
        // Sums of so many squares in another order.
        assert!((rms_mm / expected - 1.0).abs() < 1e-12, "{level}: {rms_mm} and {expected}");
    }
    let poses = fs::read_to_string(at.join("run/poses.csv")).expect("there");
    let lines: Vec<Vec<&str>> = poses.lines().map(|line| line.split(',').collect()).collect();
    let rows = parquet_rows(&at.join("tables/poses.parquet"));
    assert_eq!(rows.len(), lines.len() - 1);
    for (row, line) in rows.iter().zip(&lines[1..]) {
        for (name, cell) in lines[0].iter().zip(line) {
            assert_eq!(row[*name].as_f64(), cell.parse().ok(), "{name}");
        }
        assert!(row["celsius_L1S1"].as_f64().is_some_and(|celsius| (10.0..60.0).contains(&celsius)), "{row}");
    }
    assert_eq!(
        parquet_rows(&at.join("tables/points.parquet")).len() as u64,
        validated["points"].as_u64().expect("one")
    );
    assert_eq!(fs::read_dir(at.join("tables")).expect("there").count(), 5, "nothing else is left");
    let refused = thermokin(at, &["export", "model.json", "--form", "parquet", "--out", "more"]);
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
    assert!(!at.join("more").exists());
}
