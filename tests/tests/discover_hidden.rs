//! Effects hidden in runs by a simulator that shares no code with what finds them: names, places, intervals, held-out gains,
//! and silence where nothing is hidden. The seeds are fixed; how many of a set must be right follows from the rate that is
//! promised and the number of runs.

use std::path::Path;

use thermokin_tests::hidden::arms::Model;
use thermokin_tests::hidden::floor::floor;
use thermokin_tests::hidden::folder::Form;
use thermokin_tests::judged::{Examined, Hidden};

/// Examines a run in the folder for tests' files.
fn examine(hidden: &Hidden) -> Examined {
    hidden.examine(Path::new(env!("CARGO_TARGET_TMPDIR"))).expect("a run that can be examined")
}

/// The fewest successes of so many that a rate gives in 99 of 100 cases.
fn fewest(rate: f64, count: usize) -> usize {
    let mut chance = (1.0 - rate).powi(count as i32);
    let (mut below, mut successes) = (0.0, 0);
    while below + chance < 0.01 {
        below += chance;
        chance *= (count - successes) as f64 / (successes + 1) as f64 * rate / (1.0 - rate);
        successes += 1;
    }
    successes
}

#[test]
fn hidden_effects_are_named_with_intervals_that_hold() {
    let each: [&[&str]; 22] = [
        &["gear_eccentricity"],
        &["encoder_gain"],
        &["backlash"],
        &["lost_motion"],
        &["joint_log_early"],
        &["joint_compliance"],
        &["joint_coupling"],
        &["thermal_growth"],
        &["thermal_lag"],
        &["thermal_nonlinearity"],
        &["unsensed_heat"],
        &["frame_drift"],
        &["frame_jump"],
        &["scale_error"],
        &["target_shift"],
        &["target_swap"],
        &["tool_slip"],
        &["sensor_chill"],
        &["sensor_bias"],
        &["sensor_swap"],
        &["sensor_detached"],
        &["clock_offset"],
    ];
    let (mut right, mut held, mut all) = (0, 0, 0);
    for (seed, effects) in (501..).zip(each) {
        let examined = examine(&Hidden::new(seed, effects, 12.0));
        right += usize::from(examined.is_right());
        let (own_held, own_all) = examined.intervals();
        held += own_held;
        all += own_all;
    }
    println!("{right} of {} right, {held} of {all} intervals hold", each.len());
    // 98 % at 12, and intervals of 95 %.
    assert!(right >= fewest(0.98, each.len()), "{right} right of {}", each.len());
    assert!(held >= fewest(0.95, all), "{held} of {all} intervals hold");
}

#[test]
fn nothing_is_named_where_nothing_is_hidden() {
    let runs = [
        Hidden::new(601, &[], 0.0),
        Hidden { model: Model::Ur, ..Hidden::new(602, &[], 0.0) },
        Hidden { payload_changes: true, missing: 0.1, ..Hidden::new(603, &[], 0.0) },
        Hidden { form: Form { motion: false, approach: false, payload: true }, ..Hidden::new(604, &[], 0.0) },
    ];
    let wrong = runs.iter().filter(|run| !examine(run).is_right()).count();
    // One run in a hundred may be wrong; of four, by bad luck, one.
    assert!(wrong <= 1, "{wrong}");
}

#[test]
fn several_effects_are_named_at_once() {
    let runs: [&[&str]; 4] = [
        &["backlash", "thermal_growth"],
        &["gear_eccentricity", "frame_jump"],
        &["target_swap", "joint_coupling"],
        &["encoder_gain", "sensor_chill", "tool_slip"],
    ];
    let right =
        (701..).zip(runs).filter(|(seed, effects)| examine(&Hidden::new(*seed, effects, 12.0)).is_right()).count();
    // Nine in ten for pairs, 83 % for triples.
    assert!(right >= fewest(0.88, runs.len()), "{right}");
}

#[test]
fn what_no_effect_makes_is_owned_as_unexplained() {
    let runs: [&[&str]; 3] = [&["off_joint_product"], &["off_cross_wave"], &["off_override"]];
    let owned = (801..).zip(runs).filter(|(seed, effects)| {
        let examined = examine(&Hidden::new(*seed, effects, 24.0));
        let unexplained = &examined.discovery.unexplained;
        println!("{}: {:?}, named {:?}", examined.name, unexplained.follows(), examined.named());
        unexplained.significant
    });
    let owned = owned.count();
    assert!(owned >= fewest(0.9, runs.len()), "{owned}");
}

#[test]
fn what_is_gained_on_held_out_data_is_what_the_true_model_gains() {
    for (seed, effect) in [(901, &["joint_compliance"]), (902, &["thermal_lag"])] {
        let examined = examine(&Hidden { hold_out: true, ..Hidden::new(seed, effect, 30.0) });
        assert!(examined.is_right());
        let said = examined.discovery.extended.held_out.expect("held out").rms_mm;
        let floor = floor(&examined.case);
        // The same folds; each point is held out once with its pose and once with its cycle.
        let (poses, cycles) = (floor.poses * 1e3, floor.cycles * 1e3);
        let true_model = (0.5 * (poses * poses + cycles * cycles)).sqrt();
        println!("{}: held out {said:.5} mm, the true model {true_model:.5} mm", examined.name);
        assert!((said / true_model - 1.0).abs() < 0.03, "{said} against {true_model}");
    }
}
