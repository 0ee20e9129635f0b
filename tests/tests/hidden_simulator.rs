//! The simulator of hidden effects judged by itself: closed forms, scaling, and runs in which nothing is hidden.

use nalgebra::Vector3;
use thermokin_tests::hidden::arms::Model;
use thermokin_tests::hidden::case::{Case, Options};
use thermokin_tests::hidden::draw::Request;
use thermokin_tests::hidden::random::{Purpose, Stream};
use thermokin_tests::hidden::schedule::Plan;

fn options(seed: u64, effects: &[&str], rho: Option<f64>) -> Options {
    Options {
        seed,
        model: Model::Nj130,
        plan: Plan {
            cycles: 5,
            poses: 12,
            targets: None,
            shuffled: false,
            mixed_overrides: false,
            payload_changes: false,
        },
        effects: effects.iter().map(|text| Request::parse(text).expect("a known effect")).collect(),
        rho,
        point_sigma_m: None,
        joint_sigma_rad: None,
        posture_share: 0.0,
        missing: 0.0,
    }
}

fn made(options: Options) -> Case {
    Case::make(options).expect("a run")
}

/// Table 4.1 written out by hand as vectors that each joint turns, from the flange inwards: no matrix product in common
/// with the simulator's chain.
fn by_hand(q: &[f64], at: Vector3<f64>) -> Vector3<f64> {
    let about_z = |angle: f64, v: Vector3<f64>| {
        let (s, c) = angle.sin_cos();
        Vector3::new(c * v.x - s * v.y, s * v.x + c * v.y, v.z)
    };
    // Rx(±90°), Rx(180°): what alpha does.
    let up = |v: Vector3<f64>| Vector3::new(v.x, -v.z, v.y);
    let down = |v: Vector3<f64>| Vector3::new(v.x, v.z, -v.y);
    let over = |v: Vector3<f64>| Vector3::new(v.x, -v.y, -v.z);
    let half = std::f64::consts::FRAC_PI_2;
    let v = about_z(2.0 * half + q[5], over(at)) + Vector3::new(0.0, 0.0, -0.21);
    let v = about_z(q[4], up(v));
    let v = about_z(q[3], down(v)) + Vector3::new(0.0, 0.0, -0.76158);
    let v = about_z(half + q[2], down(v) + Vector3::new(0.21, 0.0, 0.0));
    let v = about_z(-half + q[1], over(v) + Vector3::new(0.86, 0.0, 0.0));
    let v = about_z(q[0], up(v) + Vector3::new(0.4, 0.0, 0.0)) + Vector3::new(0.0, 0.0, -0.55);
    about_z(-half, over(v) + Vector3::new(-2.0, 0.0, 0.0))
}

#[test]
fn the_chain_is_table_4_1_by_hand() {
    let mut stream = Stream::new(1, Purpose::Geometry);
    let arm = Model::Nj130.arm(&mut stream);
    for _ in 0..50 {
        let q: Vec<f64> = (0..6).map(|_| stream.between(-3.0, 3.0)).collect();
        let target = Vector3::new(stream.normal(), stream.normal(), stream.normal());
        let flange = arm.flange(&arm.nominal(), &q);
        let at = (flange * target.push(1.0)).xyz();
        let error = (at - by_hand(&q, target)).norm();
        assert!(error < 1e-12, "{error:e} at {q:?}");
    }
}

#[test]
fn the_same_seed_gives_the_same_run_and_another_seed_another() {
    let measured = |seed| made(options(seed, &["backlash"], Some(6.0))).measured;
    assert_eq!(measured(3), measured(3));
    assert_ne!(measured(3), measured(4));
}

#[test]
fn the_signal_grows_with_the_amplitude_and_is_what_was_asked_for() {
    for effect in ["gear_eccentricity", "backlash", "frame_jump", "target_shift", "thermal_growth", "off_cross_wave"] {
        let (small, large) = (made(options(11, &[effect], Some(4.0))), made(options(11, &[effect], Some(12.0))));
        for (case, rho) in [(&small, 4.0), (&large, 12.0)] {
            let found = case.hidden[0].rho.expect("a size");
            assert!((found - rho).abs() < 1e-9 * rho, "{effect}: {found} for {rho}");
        }
        for (a, b) in small.hidden[0].effect.size.iter().zip(&large.hidden[0].effect.size) {
            assert!((3.0 * a - b).abs() <= 1e-9 * b.abs(), "{effect}: {a} {b}");
        }
    }
}
