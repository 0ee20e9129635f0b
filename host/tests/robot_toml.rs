//! `robot.toml`: the shipped arms, writing and reading back, and the line and words of every refusal.

use std::path::Path;

use nalgebra::Vector3;
use proptest::prelude::*;
use thermokin::robot::{
    Body, Convention, Joint, JointKind, ParameterId, Robot, SHIPPED, Sensor, Target, ThermalChoice, Transform, shipped,
};

#[test]
fn shipped_robots_are_complete_and_without_remarks() {
    for (name, text) in SHIPPED {
        let robot = Robot::parse(Path::new(name), text).expect("a shipped robot is valid");
        assert_eq!(shipped(name).as_ref(), Some(&robot));
        assert_eq!(robot.remarks(), Vec::<String>::new(), "{name}");
        // A complete 6R arm has 4r + 6 parameters (contract robot.md).
        assert_eq!(robot.joint_count(), 6, "{name}");
        assert_eq!(robot.chain().parameters().len(), 30, "{name}");
        assert_eq!(robot.transforms.last().map(|transform| transform.convention), Some(Convention::Full), "{name}");
        assert!(!robot.targets.is_empty(), "{name} has a target");
    }
    assert_eq!(shipped("no such arm"), None);
}

#[test]
fn the_nominal_values_are_those_of_table_4_1() {
    use std::f64::consts::{FRAC_PI_2, PI};
    let robot = shipped("comau-nj-130-2.0").expect("shipped");
    let nominal = robot.nominal();
    let chain = robot.chain();
    let table = [
        [("theta0", -FRAC_PI_2), ("a0", -2.0), ("alpha0", PI), ("beta0", 0.0)],
        [("d1", -0.550), ("theta1", 0.0), ("alpha1", FRAC_PI_2), ("a1", 0.4)],
        [("theta2", -FRAC_PI_2), ("a2", 0.86), ("alpha2", PI), ("beta2", 0.0)],
        [("d3", 0.0), ("theta3", FRAC_PI_2), ("alpha3", -FRAC_PI_2), ("a3", 0.21)],
        [("d4", -0.76158), ("theta4", 0.0), ("alpha4", -FRAC_PI_2), ("a4", 0.0)],
        [("d5", 0.0), ("theta5", 0.0), ("alpha5", FRAC_PI_2), ("a5", 0.0)],
        [("d6", -0.21), ("theta6", PI), ("alpha6", PI), ("a6", 0.0)],
    ];
    for (name, value) in table.into_iter().flatten().chain([("b6", 0.0), ("beta6", 0.0)]) {
        let id: ParameterId = name.parse().expect("a parameter's name");
        assert_eq!(chain.place(id).map(|place| nominal[place]), Some(value), "{name}");
    }
}

#[test]
fn unsuitable_conventions_are_remarked() {
    let mut robot = shipped("comau-nj-130-2.0").expect("shipped");
    // Axes 2 and 3 are parallel, axes 1 and 2 perpendicular: the other convention is singular at each.
    robot.transforms[1].convention = Convention::Hayati;
    robot.transforms[1].values = vec![0.0, 0.4, std::f64::consts::FRAC_PI_2, 0.0];
    robot.transforms[2].convention = Convention::Dh;
    robot.transforms[2].values = vec![0.0, 0.0, 0.86, std::f64::consts::PI];
    robot.transforms[6].convention = Convention::Dh;
    robot.transforms[6].values.truncate(4);
    let remarks = robot.remarks();
    assert_eq!(remarks.len(), 3, "{remarks:?}");
    assert!(remarks[0].contains("transform 1") && remarks[0].contains("singular"), "{remarks:?}");
    assert!(remarks[1].contains("axes 2 and 3") && remarks[1].contains("parallel"), "{remarks:?}");
    assert!(remarks[2].contains("last transform (6)"), "{remarks:?}");
}

const LENGTHS: std::ops::Range<f64> = -2.0..2.0;

fn transform(kind: Option<JointKind>) -> impl Strategy<Value = Transform> {
    let convention = prop_oneof![Just(Convention::Dh), Just(Convention::Hayati), Just(Convention::Full)];
    let limits = prop_oneof![
        Just((None, None)),
        (-4.0..0.0).prop_map(|min| (Some(min), None)),
        (-4.0..-0.1, 0.1..4.0).prop_map(|(min, max)| (Some(min), Some(max))),
    ];
    let gear = proptest::option::of(prop_oneof![-300.0..-1.0, 1.0..300.0]);
    (convention, proptest::collection::vec(LENGTHS, 6), limits, gear).prop_map(
        move |(convention, mut values, (min, max), gear_ratio)| {
            values.truncate(convention.symbols().len());
            Transform { convention, joint: kind.map(|kind| Joint { kind, min, max, gear_ratio }), values }
        },
    )
}

fn vector() -> impl Strategy<Value = Vector3<f64>> {
    proptest::array::uniform3(LENGTHS).prop_map(Vector3::from)
}

prop_compose! {
    fn any_robot()(
        base in transform(None),
        moved in proptest::collection::vec(transform(Some(JointKind::Revolute)), 1..4),
        slid in proptest::collection::vec(transform(Some(JointKind::Prismatic)), 1..3),
        fixed in proptest::collection::vec(transform(None), 0..2),
        name in "[ -~äß°]{1,12}",
        gravity in vector(),
        targets in proptest::collection::vec(proptest::option::of(vector()), 0..4),
        bodies in proptest::collection::vec((0_usize..3, 0.0..500.0, vector()), 0..3),
        sensors in proptest::collection::vec((0_usize..3, proptest::option::of(0_u32..5)), 0..4),
        monuments in 0_usize..3,
    ) -> Robot {
        let transforms: Vec<Transform> = [base].into_iter().chain(moved).chain(fixed).chain(slid).collect();
        let sensors: Vec<Sensor> = sensors
            .into_iter()
            .enumerate()
            .map(|(k, (link, board))| {
                Sensor { name: format!("S{k}"), link, board, address: board.map(|_| 0x48 + k as u8) }
            })
            .collect();
        let parameter = ParameterId::new(transforms[1].convention.symbols()[0], 1);
        let names: Vec<String> = sensors.iter().map(|sensor| sensor.name.clone()).collect();
        let thermal = if names.is_empty() { vec![] } else { vec![ThermalChoice { parameter, sensors: names }] };
        Robot {
            name,
            gravity,
            transforms,
            targets: targets
                .into_iter()
                .enumerate()
                .map(|(k, position)| Target { name: format!("T{k}"), position })
                .collect(),
            monuments: (0..monuments).map(|k| format!("BASE{k}")).collect(),
            bodies: bodies
                .into_iter()
                .map(|(transform, mass_kg, center)| Body { transform, mass_kg, center })
                .collect(),
            sensors,
            thermal,
        }
    }
}

proptest! {
    #[test]
    fn what_is_written_is_read_back(robot in any_robot()) {
        let text = robot.to_toml();
        let again = Robot::parse(Path::new("robot.toml"), &text);
        prop_assert_eq!(again, Ok(robot), "{}", text);
    }
}

/// A small arm that is right, one key a line; the tests spoil it at one place.
const RIGHT: &str = r#"format = 1
name = "two axes"
[[transform]]
convention = "hayati"
theta = 0.0
a = 1.0
alpha = 0.0
beta = 0.0
[[transform]]
convention = "dh"
joint = "revolute"
min = -1.0
max = 1.0
d = 0.5
theta = 0.0
a = 0.3
alpha = 1.5
[[target]]
name = "T1"
position = [0.1, 0.0, 0.0]
[[monument]]
name = "BASE1"
[[body]]
transform = 1
mass_kg = 10.0
center = [0.0, 0.0, 0.0]
[[sensor]]
name = "S1"
link = 1
board = 0
address = 0x48
[[sensor]]
name = "S2"
link = 1
board = 0
address = 0x49
[[thermal]]
parameter = "d1"
sensors = ["S1"]
"#;

/// The line of the `occurrence`th (from 0) line that reads `line`.
fn line_of(line: &str, occurrence: usize) -> usize {
    let found = RIGHT.lines().enumerate().filter(|(_, own)| *own == line).nth(occurrence);
    found.map(|(number, _)| number + 1).expect("the line is in the file")
}

/// Replaces one line; gives the error as (line, message).
fn spoiled(line: &str, occurrence: usize, with: &str) -> (Option<usize>, String) {
    let target = line_of(line, occurrence);
    let text: String = RIGHT
        .lines()
        .enumerate()
        .map(|(number, own)| format!("{}\n", if number + 1 == target { with } else { own }))
        .collect();
    let error = Robot::parse(Path::new("arm.toml"), &text).expect_err(with);
    assert!(!error.message.contains('\n'), "one line: {}", error.message);
    let place = error.line.map(|line| format!("arm.toml:{line}: ")).unwrap_or("arm.toml: ".to_owned());
    assert!(error.to_string().starts_with(&place), "{error}");
    (error.line, error.message)
}

fn assert_refused(found: (Option<usize>, String), line: usize, words: &[&str]) {
    assert_eq!(found.0, Some(line), "{}", found.1);
    for word in words {
        assert!(found.1.contains(word), "'{word}' is missing in: {}", found.1);
    }
}

#[test]
fn the_right_file_is_accepted() {
    Robot::parse(Path::new("arm.toml"), RIGHT).expect("the file that the others spoil");
    let with_mark = format!("\u{feff}{}", RIGHT.replace('\n', "\r\n"));
    Robot::parse(Path::new("arm.toml"), &with_mark).expect("a byte-order mark and CRLF do not matter");
}

#[test]
fn unknown_keys_are_refused_at_their_line() {
    assert_refused(spoiled("a = 0.3", 0, "a = 0.3\nlength = 1.0"), line_of("a = 0.3", 0) + 1, &["length"]);
    assert_refused(spoiled("format = 1", 0, "format = 1\nspeed = 2"), 2, &["speed"]);
    assert_refused(spoiled("[[body]]", 0, "[[bodies]]"), line_of("[[body]]", 0), &["bodies"]);
}

#[test]
fn broken_toml_is_refused_at_its_line() {
    let line = line_of("a = 0.3", 0);
    assert_refused(spoiled("a = 0.3", 0, "a = "), line, &[]);
    assert_refused(spoiled("a = 0.3", 0, "a = \"long\""), line, &["string"]);
    assert_refused(
        spoiled("convention = \"dh\"", 0, "convention = \"DH\""),
        line_of("convention = \"dh\"", 0),
        &["DH"],
    );
}

#[test]
fn parameters_that_do_not_fit_the_convention_are_refused_at_the_transform() {
    let (first, second) = (line_of("[[transform]]", 0), line_of("[[transform]]", 1));
    assert_refused(spoiled("alpha = 1.5", 0, "alpha = 1.5\nbeta = 0.0"), second, &["transform 1", "'dh' has no beta"]);
    assert_refused(spoiled("beta = 0.0", 0, "d = 0.0"), first, &["transform 0", "'hayati' has no d"]);
    assert_refused(spoiled("d = 0.5", 0, ""), second, &["transform 1", "needs d", "missing"]);
    assert_refused(spoiled("a = 0.3", 0, "a = nan"), second, &["a is NaN", "finite"]);
    assert_refused(spoiled("alpha = 1.5", 0, "alpha = inf"), second, &["alpha is inf", "finite"]);
}

#[test]
fn joints_that_cannot_be_are_refused() {
    let (first, second) = (line_of("[[transform]]", 0), line_of("[[transform]]", 1));
    assert_refused(spoiled("beta = 0.0", 0, "beta = 0.0\njoint = \"revolute\""), first, &["never moves"]);
    assert_refused(spoiled("beta = 0.0", 0, "beta = 0.0\nmin = 0.0"), first, &["min", "no joint"]);
    assert_refused(spoiled("min = -1.0", 0, "min = 2.0"), second, &["min < max"]);
    assert_refused(spoiled("max = 1.0", 0, "gear_ratio = 0.0"), second, &["gear_ratio"]);
    let without: String = RIGHT
        .lines()
        .filter(|line| !["joint", "min", "max"].iter().any(|key| line.starts_with(key)))
        .fold(String::new(), |text, line| text + line + "\n");
    let error = Robot::parse(Path::new("arm.toml"), &without).expect_err("no joint");
    assert_eq!((error.line, error.message.contains("at least one")), (None, true), "{error}");
}

#[test]
fn names_used_twice_are_refused_at_the_second() {
    let line = line_of("[[monument]]", 0);
    assert_refused(spoiled("name = \"BASE1\"", 0, "name = \"T1\""), line, &["'T1'", "used before"]);
    assert_refused(spoiled("name = \"S2\"", 0, "name = \"S1\""), line_of("[[sensor]]", 1), &["'S1'", "used before"]);
    assert_refused(spoiled("name = \"T1\"", 0, "name = \" \""), line_of("[[target]]", 0), &["empty name"]);
    assert_refused(spoiled("address = 0x49", 0, "address = 0x48"), line_of("[[sensor]]", 1), &["board", "S1"]);
}

#[test]
fn what_refers_to_nothing_is_refused() {
    let thermal = line_of("[[thermal]]", 0);
    assert_refused(spoiled("sensors = [\"S1\"]", 0, "sensors = [\"S9\"]"), thermal, &["S9"]);
    assert_refused(spoiled("sensors = [\"S1\"]", 0, "sensors = [\"S1\", \"S1\"]"), thermal, &["S1", "twice"]);
    assert_refused(spoiled("parameter = \"d1\"", 0, "parameter = \"beta1\""), thermal, &["beta1"]);
    assert_refused(spoiled("parameter = \"d1\"", 0, "parameter = \"length\""), thermal, &["length", "d1"]);
    assert_refused(spoiled("transform = 1", 0, "transform = 2"), line_of("[[body]]", 0), &["transform 2", "last is 1"]);
    assert_refused(spoiled("link = 1", 1, "link = 7"), line_of("[[sensor]]", 1), &["link 7", "last is 1"]);
    assert_refused(spoiled("address = 0x48", 0, "address = 0x80"), line_of("[[sensor]]", 0), &["0x80", "7 bits"]);
    assert_refused(spoiled("mass_kg = 10.0", 0, "mass_kg = -1.0"), line_of("[[body]]", 0), &["mass_kg"]);
    assert_refused(spoiled("format = 1", 0, "format = 2"), 1, &["format 2", "expected 1"]);
}

#[test]
fn an_arm_of_no_length_and_one_in_millimetres_are_refused() {
    let text = RIGHT.replace("d = 0.5", "d = 0.0").replace("a = 0.3", "a = 0.0");
    let error = Robot::parse(Path::new("arm.toml"), &text).expect_err("no length");
    assert!(error.message.contains("without any length"), "{error}");
    let text = RIGHT.replace("d = 0.5", "d = 500.0").replace("a = 0.3", "a = 300.0");
    let error = Robot::parse(Path::new("arm.toml"), &text).expect_err("millimetres");
    assert!(error.message.contains("800 m") && error.message.contains("millimetres"), "{error}");
}

#[test]
fn a_file_that_cannot_be_read_is_named() {
    let error = Robot::read(Path::new("/no/such/robot.toml")).expect_err("no file");
    assert!(error.to_string().starts_with("/no/such/robot.toml: cannot be read"), "{error}");
}
