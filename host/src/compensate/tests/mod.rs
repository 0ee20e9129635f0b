//! Round trips at random postures, singular ones among them; bounds; and the live mode against everything that can go wrong
//! around it. Seeds are printed.

mod live;

use nalgebra::{UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};

use super::{Arm, Conditions, Corrected, Corrector, InverseError, Present};
use crate::effect::SiteNames;
use crate::model::{
    CorrectionBounds, Extended, ExtendedGrowth, Geometry, Growth, Level, Model, ModelEffect, ReferenceTemperature,
};
use crate::robot::{Body, Frame, shipped};

/// The arms of the round trip: a spherical wrist without and with offsets, and three parallel axes.
const ARMS: [&str; 3] = ["comau-nj-130-2.0", "staubli-tx90", "universal-robots-ur10"];

struct Dice(ChaCha8Rng);

impl Dice {
    fn new(test: &str) -> Self {
        let seed: u64 = std::env::var("THERMOKIN_TEST_SEED").ok().and_then(|text| text.parse().ok()).unwrap_or(7_202);
        println!("{test}: THERMOKIN_TEST_SEED={seed}");
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64)
    }
}

/// A calibrated arm with errors of a millimetre and a milliradian, two sensors, and one effect of each kind that acts now.
fn calibrated(name: &str, dice: &mut Dice) -> Model {
    let mut robot = shipped(name).expect("shipped");
    robot.bodies = vec![
        Body { transform: 2, mass_kg: 90.0, center: Vector3::new(-0.3, 0.0, 0.1) },
        Body { transform: 4, mass_kg: 40.0, center: Vector3::new(0.0, 0.05, 0.1) },
    ];
    let nominal = Geometry::nominal(&robot);
    let mut wrong = || {
        let parameters = nominal.parameters.iter().map(|value| value + dice.between(-1e-3, 1e-3)).collect();
        Geometry { parameters, ..nominal.clone() }
    };
    let (reference, extended) = (wrong(), wrong());
    let temperatures = ["L1", "L2"].map(|sensor| ReferenceTemperature {
        sensor: sensor.to_owned(),
        celsius: 21.0,
        lowest: 20.0,
        highest: 45.0,
    });
    let grown = [("d1", "L1", -7e-6), ("d4", "L2", 9e-6)];
    let effect = |effect, place, shape: &[f64], coefficients: &[f64]| ModelEffect {
        effect,
        place,
        shape: shape.to_vec(),
        coefficients: coefficients.to_vec(),
        parameters: Vec::new(),
    };
    let joint = |number| SiteNames { joint: Some(number), ..SiteNames::default() };
    let squared = SiteNames { parameter: Some("d1".to_owned()), sensor: Some("L1".to_owned()), ..SiteNames::default() };
    let lagging = SiteNames { parameter: Some("d4".to_owned()), ..SiteNames::default() };
    let effects = vec![
        effect("gear_eccentricity", joint(2), &[3.0], &[1e-4, 5e-5]),
        effect("backlash", joint(1), &[], &[2e-4]),
        effect("joint_compliance", joint(3), &[], &[2e-7]),
        effect("joint_coupling", SiteNames { from: Some(5), ..joint(6) }, &[], &[1e-4]),
        effect("thermal_nonlinearity", squared, &[], &[2e-8]),
        effect("thermal_lag", lagging, &[600.0], &[1.0]),
        effect("scale_error", SiteNames::default(), &[], &[1e-5]),
    ];
    Model {
        nominal: nominal.clone(),
        geometric: reference.clone(),
        growth: grown
            .iter()
            .map(|&(parameter, sensor, coefficient)| Growth {
                parameter: parameter.parse().expect("a parameter"),
                sensor: sensor.to_owned(),
                coefficient,
                sigma: 1e-7,
            })
            .collect(),
        reference,
        temperatures: temperatures.to_vec(),
        anchors: Vec::new(),
        estimates: Vec::new(),
        correction_bounds: CorrectionBounds::default(),
        extended: Some(Extended {
            geometry: extended,
            growth: grown
                .iter()
                .map(|&(parameter, sensor, coefficient)| ExtendedGrowth {
                    parameter: parameter.parse().expect("a parameter"),
                    sensor: sensor.to_owned(),
                    coefficient,
                })
                .collect(),
            air_reference_c: None,
            effects,
            noise: None,
        }),
        robot,
    }
}

fn warm() -> Conditions {
    Conditions { celsius: vec![Some(33.0), Some(40.0)], approach: vec![1.0; 6], ..Conditions::default() }
}

/// Joints within the limits, some of them at or near what makes the arm singular: a straight wrist, a straight elbow.
fn posture(arm: &Present, number: usize, dice: &mut Dice) -> Vec<f64> {
    let mut joints: Vec<f64> = arm
        .limits
        .iter()
        .map(|limit| {
            let (low, high) = limit.range();
            dice.between(low, high)
        })
        .collect();
    let near = [0.0, 1e-9, 1e-6, 1e-4, 1e-2];
    match number % 10 {
        0 => joints[4] = near[number / 10 % near.len()],
        1 => joints[2] = near[number / 10 % near.len()],
        _ => {}
    }
    joints.iter_mut().zip(&arm.limits).for_each(|(joint, limit)| *joint = joint.clamp(limit.min, limit.max));
    joints
}

fn error(one: &Frame, other: &Frame) -> (f64, f64) {
    let turn = UnitQuaternion::from_matrix_eps(
        &(one.rotation.transpose() * other.rotation),
        1e-15,
        100,
        UnitQuaternion::identity(),
    );
    ((one.origin - other.origin).norm(), turn.angle())
}

#[test]
fn inverse_then_forward_comes_back_at_ten_thousand_postures_of_three_arms() {
    let mut dice = Dice::new("round trip");
    // What is promised (issue 7): metres and radians.
    let promised = 1e-9;
    for name in ARMS {
        let model = calibrated(name, &mut dice);
        let mut arm = Arm::new(&model, Level::Extended).under(&warm());
        let (mut worst, mut failures, mut steps) = (0.0_f64, Vec::new(), 0);
        let (mut astray, count) = (0, 10_000);
        for number in 0..count {
            let joints = posture(&arm, number, &mut dice);
            let goal = arm.forward(&joints);
            // From nearby, as a controller asks; the search that knows nothing is the fallback that the batch has too.
            let seed: Vec<f64> = joints.iter().map(|joint| joint + dice.between(-0.05, 0.05)).collect();
            let outcome = arm.inverse_near(&goal, &seed).or_else(|_| {
                astray += 1;
                arm.inverse(&goal)
            });
            match outcome {
                Ok(solution) => {
                    let (distance, angle) = error(&arm.forward(&solution.joints), &goal);
                    worst = worst.max(distance).max(angle);
                    steps += solution.steps;
                    let held = solution.joints.iter().zip(&arm.limits).all(|(joint, limit)| limit.holds(*joint));
                    assert!(held, "{name}: {joints:?} came back outside the limits: {:?}", solution.joints);
                }
                Err(InverseError::Unreachable { nearest, .. }) => failures.push((joints, nearest)),
            }
        }
        println!(
            "{name}: worst {worst:.1e} m or rad, {} failures, {astray} not from nearby, {:.1} steps on average",
            failures.len(),
            steps as f64 / f64::from(count as u32)
        );
        assert!(worst <= promised, "{name}: {worst}");
        assert!(failures.is_empty(), "{name}: {} failed, the first {:?}", failures.len(), failures[0]);
    }
}

#[test]
fn a_search_without_a_seed_finds_what_can_be_reached() {
    let mut dice = Dice::new("no seed");
    for name in ARMS {
        let model = calibrated(name, &mut dice);
        let mut arm = Arm::new(&model, Level::Extended).under(&warm());
        let mut failed = 0;
        for number in 0..300 {
            let joints = posture(&arm, number, &mut dice);
            let goal = arm.forward(&joints);
            match arm.inverse(&goal) {
                Ok(solution) => {
                    let (distance, angle) = error(&arm.forward(&solution.joints), &goal);
                    assert!(distance <= 1e-9 && angle <= 1e-9, "{name}: {distance} m, {angle} rad");
                }
                Err(_) => failed += 1,
            }
        }
        println!("{name}: {failed} of 300 not found");
        // Postures with a joint within a hair of its limit have a solution in a corner that seeds may miss: a few at most.
        assert!(failed <= 3, "{name}: {failed}");
    }
}

#[test]
fn branches_are_those_that_a_far_longer_search_finds() {
    let mut dice = Dice::new("branches");
    for name in ARMS {
        let model = calibrated(name, &mut dice);
        let mut arm = Arm::new(&model, Level::Thermal).under(&warm());
        let (mut found, mut there) = (0, 0);
        for _ in 0..20 {
            let joints = posture(&arm, 5, &mut dice);
            let goal = arm.forward(&joints);
            let branches = arm.branches(&goal).expect("reachable").solutions;
            let mut all: Vec<Vec<f64>> = Vec::new();
            for _ in 0..1_500 {
                let seed = posture(&arm, 5, &mut dice);
                let Ok(solution) = arm.inverse_near(&goal, &seed) else { continue };
                if !all.iter().any(|other| same_posture(other, &solution.joints)) {
                    all.push(solution.joints);
                }
            }
            there += all.len();
            found += all.iter().filter(|one| branches.iter().any(|own| same_posture(&own.joints, one))).count();
            for branch in &branches {
                let (distance, angle) = error(&arm.forward(&branch.joints), &goal);
                assert!(distance <= 1e-9 && angle <= 1e-9, "{name}: {distance} m, {angle} rad");
            }
        }
        println!("{name}: {found} of {there} branches");
        assert!(found as f64 >= 0.98 * there as f64, "{name}: {found} of {there}");
    }
}

fn same_posture(one: &[f64], other: &[f64]) -> bool {
    let turns = |a: f64, b: f64| super::seeds::nearest_turn(a, b) - b;
    one.iter().zip(other).all(|(a, b)| turns(*a, *b).abs() < 1e-4)
}

#[test]
fn what_is_out_of_reach_is_said_with_the_nearest_pose() {
    let mut dice = Dice::new("unreachable");
    for name in ARMS {
        let model = calibrated(name, &mut dice);
        let mut arm = Arm::new(&model, Level::Extended).under(&warm());
        let mut goal = arm.forward(&posture(&arm.clone(), 5, &mut dice));
        goal.origin += Vector3::new(0.0, 0.0, 30.0);
        let error = arm.inverse(&goal).expect_err("30 m up");
        let InverseError::Unreachable { nearest, .. } = &error;
        assert!(error.to_string().starts_with("unreachable: the nearest pose found is 2"), "{error}");
        let stands = arm.forward(&nearest.joints);
        assert!(((stands.origin - goal.origin).norm() - nearest.distance_m).abs() < 1e-9);
        // No arm is longer than the sum of its lengths: what is nearest is nearly that far up.
        assert!(nearest.distance_m > 24.0 && nearest.distance_m < 30.0 + 4.0, "{}", nearest.distance_m);
        for (joint, limit) in nearest.joints.iter().zip(&arm.limits) {
            assert!(limit.holds(*joint), "{name}: nearest pose outside the limits");
        }
    }
}

#[test]
fn a_limit_that_bars_a_branch_is_kept() {
    let mut dice = Dice::new("limits");
    let mut model = calibrated("staubli-tx90", &mut dice);
    let fifth = model.robot.transforms[5].joint.as_mut().expect("a joint");
    (fifth.min, fifth.max) = (Some(0.0), Some(2.0));
    let mut arm = Arm::new(&model, Level::Extended).under(&warm());
    let joints = [0.3, -0.4, 0.9, 0.5, 0.8, -0.2];
    let goal = arm.forward(&joints);
    // The wrist turned over is beyond the limit: whatever the seed, the answer is not.
    for seed in super::seeds::mirrored(&joints, &arm.limits.clone()) {
        if let Ok(solution) = arm.inverse_near(&goal, &seed) {
            assert!(solution.joints[4] >= -1e-9, "{:?}", solution.joints);
        }
    }
    for branch in arm.branches(&goal).expect("reachable").solutions {
        assert!(branch.joints[4] >= -1e-9, "{:?}", branch.joints);
    }
}

#[test]
fn effects_of_the_model_move_the_arm_by_what_they_say() {
    let mut dice = Dice::new("effects");
    let model = calibrated("comau-nj-130-2.0", &mut dice);
    let arm = Arm::new(&model, Level::Extended);
    assert!(arm.notes().iter().any(|note| note.starts_with("scale_error")), "{:?}", arm.notes());
    assert_eq!(arm.effects_on_joints().len(), 4);
    let (mut from_below, mut from_above) = (arm.under(&warm()), arm.under(&warm()));
    from_above.load(0.0, &[-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
    let joints = [0.3, -0.4, 0.9, 0.5, 0.8, -0.2];
    // Backlash of 0.2 mrad about the first axis turns the whole arm by just that.
    let (one, other) = (from_below.forward(&joints), from_above.forward(&joints));
    let (_, angle) = error(&one, &other);
    assert!((angle - 2e-4).abs() < 1e-12, "{angle}");
    // Parameters: growth, its square, and the lag, which has had no time to lag.
    let chain = model.robot.chain();
    let values = arm.parameters(&warm());
    let place = |name: &str| chain.place(name.parse().expect("a parameter")).expect("there");
    let base = &model.geometry(Level::Extended).parameters;
    assert!((values[place("d1")] - base[place("d1")] - (-7e-6 * 12.0 + 2e-8 * 144.0)).abs() < 1e-15);
    assert!((values[place("d4")] - base[place("d4")] - 9e-6 * 19.0).abs() < 1e-15);
}

#[test]
fn a_corrected_arm_stands_where_the_nominal_one_would() {
    let mut dice = Dice::new("correction");
    let model = calibrated("comau-nj-130-2.0", &mut dice);
    let mut arm = Arm::new(&model, Level::Extended).under(&warm());
    let mut corrector = Corrector::new(&model);
    let mut whole = 0;
    for _ in 0..200 {
        let joints = posture(&arm, 5, &mut dice);
        let goal = corrector.believed(&joints);
        let Ok(Corrected { joints: commanded, correction, bounded }) = corrector.correct(&mut arm, &joints) else {
            continue;
        };
        let largest = correction.iter().fold(0.0_f64, |most, one| most.max(one.abs()));
        assert!(largest <= model.correction_bounds.size_rad);
        if !bounded {
            whole += 1;
            let (distance, angle) = error(&arm.forward(&commanded), &goal);
            assert!(distance < 1e-9 && angle < 1e-9);
        }
    }
    assert!(whole > 150, "{whole} of 200 corrections are whole");
}

#[test]
fn a_guard_lets_no_correction_change_faster_than_its_bound() {
    let mut dice = Dice::new("guard");
    let model = calibrated("comau-nj-130-2.0", &mut dice);
    let corrector = Corrector::new(&model);
    let mut guard = corrector.guard();
    let rate = model.correction_bounds.rate_rad_per_s;
    let (mut before, mut now) = (None::<Vec<f64>>, 0.0);
    for _ in 0..5_000 {
        // Time stands still now and then, as two requests in one tick of a clock do.
        let elapsed = if dice.between(0.0, 1.0) < 0.2 { 0.0 } else { dice.between(0.0, 2e-3) };
        now += elapsed;
        let correction: Vec<f64> = (0..6).map(|_| dice.between(-0.05, 0.05)).collect();
        let joints = vec![0.0; 6];
        let wanted = Corrected { joints: correction.clone(), correction, bounded: false };
        let passed = guard.pass(&joints, wanted, now);
        if let Some(before) = before {
            for (to, from) in passed.correction.iter().zip(&before) {
                // The subtraction of two numbers below 0.05 and the clock's own difference round.
                assert!((to - from).abs() <= rate * elapsed + 1e-15, "{} in {elapsed} s", to - from);
            }
        }
        before = Some(passed.correction);
    }
}

#[test]
fn a_model_keeps_its_bounds_in_its_file_and_refuses_those_that_bound_nothing() {
    let mut dice = Dice::new("bounds");
    let mut model = calibrated("comau-nj-130-2.0", &mut dice);
    model.correction_bounds.size_rad = 0.01;
    let file = std::path::Path::new("model.json");
    let text = model.to_json();
    assert_eq!(Model::parse(file, &text).expect("whole").correction_bounds, model.correction_bounds);
    let without = {
        let mut value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        value.as_object_mut().expect("an object").remove("correction_bounds");
        value.to_string()
    };
    let read = Model::parse(file, &without).expect("an earlier version's");
    assert_eq!(read.correction_bounds, CorrectionBounds::default());
    let wrong = text.replace("\"size_rad\": 0.01", "\"size_rad\": -0.01");
    let error = Model::parse(file, &wrong).expect_err("bounds nothing").to_string();
    assert_eq!(error, "model.json: correction_bounds: size_rad is -0.01, expected a number above 0");
}
