//! `thermokin robot`: arms from URDF and from tables come out complete, minimal and proportional, and stand where the source
//! says; a drawing changes with a sign.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use nalgebra::Vector3;
use thermokin::robot::{Between, JointKind, Posture, Robot, SHIPPED, drawing, from_urdf, parametrise, shipped, urdf};

fn thermokin(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_thermokin"))
        .current_dir(folder)
        .arg("robot")
        .args(arguments)
        .output()
        .expect("runs")
}

fn flange(robot: &Robot, joints: &[f64]) -> (Vector3<f64>, nalgebra::Matrix3<f64>) {
    let frame = robot.chain().prepare(&robot.nominal()).flange(&Posture::new(joints));
    (frame.origin, frame.rotation)
}

/// Sines and cosines of some fifty motions, each rounded, over lengths of metres.
const ROUNDED: f64 = 1e-12;

fn assert_same(name: &str, one: &Robot, other: &Robot) {
    for number in 0..25 {
        let joints: Vec<f64> =
            (0..one.joint_count()).map(|joint| 2.0 * (1.3 * number as f64 + 0.8 * joint as f64).sin()).collect();
        let ((p, r), (q, s)) = (flange(one, &joints), flange(other, &joints));
        assert!((p - q).norm() < ROUNDED && (r - s).norm() < ROUNDED, "{name} at {joints:?}: {p} {q}");
    }
}

#[test]
fn every_shipped_arm_comes_back_from_its_urdf_with_as_few_parameters_as_can_be() {
    for (name, _) in SHIPPED {
        let robot = shipped(name).expect("shipped");
        let text = urdf(&robot, &robot.nominal()).expect("an arm");
        let (own, axes) = from_urdf(&text, None).expect("its own text");
        assert_eq!(own, robot.name);
        let transforms = parametrise(&axes, Between::Proportional).expect("proportional");
        let back = Robot { transforms, ..robot.clone() };
        assert_same(name, &robot, &back);
        let kinds = |kind| axes.joints.iter().filter(|(_, joint)| joint.kind == kind).count();
        let fewest = 2 * kinds(JointKind::Prismatic) + 4 * kinds(JointKind::Revolute) + 6;
        assert_eq!(back.nominal().len(), fewest, "{name}");
        assert!(back.remarks().is_empty(), "{name}: {:?}", back.remarks());
    }
}

/// The Stäubli TX90's parameters as its maker prints them.
const TABLE: &str = "d_mm,theta_deg,a_mm,alpha_deg,min,max\n478,0,50,-90,-180,180\n0,-90,425,0,-130,147.5\n\
                     50,90,0,90,-145,145\n425,0,0,-90,-270,270\n0,0,0,90,-115,140\n100,0,0,0,-270,270\n";

fn folder() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().to_owned();
    (folder, path)
}

#[test]
fn a_table_in_millimetres_and_degrees_is_the_arm_that_ships() {
    let (_kept, path) = folder();
    fs::write(path.join("dh.csv"), TABLE).expect("written");
    let output = thermokin(&path, &["dh.csv", "--name", "TX90", "--out", "robot.toml", "--svg", "arm.svg"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).starts_with("TX90: 6 joints, 30 parameters"));
    let made = Robot::read(&path.join("robot.toml")).expect("valid");
    // The shipped one stands before a tracker; without its first transform it is the same arm.
    let mut ships = shipped("staubli-tx90").expect("shipped");
    ships.transforms[0].values.fill(0.0);
    assert_same("tx90", &ships, &made);
    for (one, other) in made.transforms.iter().zip(&ships.transforms) {
        let limits = |joint: &thermokin::robot::Joint| (joint.min, joint.max);
        let (one, other) = (one.joint.as_ref().map(limits), other.joint.as_ref().map(limits));
        let near = |(a, b): (Option<f64>, Option<f64>)| (a.unwrap_or(9.0) - b.unwrap_or(9.0)).abs() < 1e-12;
        if let (Some(one), Some(other)) = (one, other) {
            assert!(near((one.0, other.0)) && near((one.1, other.1)), "{one:?} {other:?}");
        }
    }
    assert!(fs::read_to_string(path.join("arm.svg")).expect("drawn").contains("joint 6 at +0.5 rad"));
}

#[test]
fn modified_parameters_are_those_of_the_link_before() {
    // Two links in a plane: standard has a with the link's own joint, modified with the next.
    let (_kept, path) = folder();
    fs::write(path.join("standard.csv"), "d_m,theta_rad,a_m,alpha_rad\n0,0,0.5,1.2\n0.1,0.3,0.4,0\n").expect("written");
    fs::write(path.join("modified.csv"), "d_m,theta_rad,a_m,alpha_rad\n0,0,0,0\n0.1,0.3,0.5,1.2\n").expect("written");
    for (table, more) in [("standard.csv", None), ("modified.csv", Some("--modified"))] {
        let mut arguments = vec![table, "--out"];
        let out = table.replace("csv", "toml");
        arguments.push(&out);
        arguments.extend(more);
        let output = thermokin(&path, &arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let standard = Robot::read(&path.join("standard.toml")).expect("valid");
    let modified = Robot::read(&path.join("modified.toml")).expect("valid");
    // The last link of 0.4 m is only in the first.
    let joints = [0.7, -0.4];
    let ((p, r), (q, s)) = (flange(&standard, &joints), flange(&modified, &joints));
    assert!((r - s).norm() < ROUNDED);
    assert!((p - (q + s * Vector3::new(0.4, 0.0, 0.0))).norm() < ROUNDED, "{p} {q}");
}

#[test]
fn a_wrong_sign_is_seen_in_the_drawing() {
    let robot = shipped("staubli-tx90").expect("shipped");
    let right = drawing(&robot);
    assert_eq!(right.matches("<polyline").count(), 3 + 2 * 6);
    for number in 1..=5 {
        let mut wrong = robot.clone();
        let values = &mut wrong.transforms[number].values;
        let alpha = values.iter_mut().rev().find(|value| value.abs() > 1.0);
        if let Some(alpha) = alpha {
            *alpha = -*alpha;
            assert_ne!(drawing(&wrong), right, "transform {number}");
        }
    }
}

#[test]
fn bad_sources_are_refused_in_one_line_and_nothing_is_written() {
    let (_kept, path) = folder();
    let write = |file: &str, text: &str| fs::write(path.join(file), text).expect("written");
    write("short.csv", "d_m,theta_rad,a_m\n0,0,1\n");
    write("word.csv", &TABLE.replace("425,0,0,-90", "425,0,0,up"));
    write("empty.csv", "d_m,theta_rad,a_m,alpha_rad\n");
    write("slides.csv", "d_m,theta_rad,a_m,alpha_rad,joint\n0,0,1,0,bends\n");
    write("broken.urdf", "<robot name=\"x\"><link");
    write(
        "forked.urdf",
        "<robot name=\"x\"><link name=\"a\"/><link name=\"b\"/><link name=\"c\"/>\
         <joint name=\"p\" type=\"continuous\"><parent link=\"a\"/><child link=\"b\"/><axis xyz=\"0 0 1\"/></joint>\
         <joint name=\"q\" type=\"continuous\"><parent link=\"a\"/><child link=\"c\"/><axis xyz=\"0 0 1\"/></joint></robot>",
    );
    write("fixed.urdf", "<robot name=\"x\"><link name=\"a\"/></robot>");
    for (source, expected) in [
        ("short.csv", "thermokin: short.csv:1: expected the column alpha_rad or alpha_deg"),
        ("word.csv", "thermokin: word.csv:5: column alpha_deg: found \"up\", expected an angle"),
        ("empty.csv", "thermokin: empty.csv: holds no row; expected one a joint"),
        ("slides.csv", "thermokin: slides.csv:2: column joint: found \"bends\", expected revolute or prismatic"),
        ("broken.urdf", "thermokin: broken.urdf: is no URDF"),
        ("forked.urdf", "thermokin: forked.urdf: ends in several links: name one of b, c as --tip"),
        ("fixed.urdf", "thermokin: fixed.urdf: has no joint that moves"),
        ("none.urdf", "thermokin: none.urdf: cannot be read"),
        ("no-such-arm", "thermokin: no-such-arm: expected a .urdf"),
    ] {
        let output = thermokin(&path, &[source, "--out", "robot.toml"]);
        let words = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{source}: {words}");
        assert!(words.starts_with(expected), "{source}: {words}");
        assert_eq!(words.lines().count(), 1, "{source}: {words}");
        assert!(!path.join("robot.toml").exists());
    }
}
