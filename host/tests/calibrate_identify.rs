//! Identification from data without noise, from too few data, and with outliers: what is found, what is held and what is
//! said about it.
//!
//! # Tolerances
//! Without noise a fit ends at the rounding of its residuals: coordinates of 3 m carry `3 m × eps` = 7e-16 m, a few of
//! which add up along the chain to some 1e-15 m. A parameter errs by that times the largest singular value of the pseudo-
//! inverse with unit columns, the condition, which each test states: some 1e-13 for conditions near 100. A fit ends where
//! the loss would change by 1e-9, 4e-5 standard deviations of some 10 µm and µrad, and its last step leaves a hundredth of that or less: below 1e-10.

mod calibrate_twin;

use std::collections::HashSet;

use calibrate_twin::{Dice, Kind, SIGMA, Strata, Twin, names};
use nalgebra::{Rotation3, Vector3};
use thermokin::calibrate::methods::{self, Method};
use thermokin::calibrate::{
    Campaign, Identification, Loss, Manner, OrthogonalFactor, Problem, Recursive, State, Stopping, Unknown, align,
    geometric_unknowns, identifiable, identify, in_words, solve, uncertainty,
};
use thermokin::model::Geometry;
use thermokin::robot::{Convention, Robot, Transform, shipped};

fn comau() -> Robot {
    shipped("comau-nj-130-2.0").expect("shipped")
}

/// Root mean square and largest of the distances between measured and predicted positions, m.
fn position_errors(campaign: &Campaign, state: &State) -> (f64, f64) {
    let (mut squares, mut count, mut most) = (0.0, 0.0, 0.0_f64);
    Problem::new(campaign, Vec::new(), state).distances(state, |_, _, error| {
        squares += error.norm_squared();
        count += 1.0;
        most = most.max(error.norm());
    });
    ((squares / count).sqrt(), most)
}

/// All geometry of a twin, from a start.
fn identify_all(twin: &Twin, campaign: &Campaign, start: State) -> Identification {
    let targets: Vec<usize> =
        (0..twin.robot.targets.len()).filter(|&target| twin.robot.targets[target].position.is_none()).collect();
    let unknowns = geometric_unknowns(campaign, &targets, &[], &[]);
    identify(campaign, unknowns, start, &Manner::default())
}

/// Every parameter of the arm is found.
fn assert_found(twin: &Twin, found: &State, tolerance: f64) {
    let chain = twin.robot.chain();
    for (place, id) in chain.parameters().iter().enumerate() {
        let error = found.geometry.parameters[place] - twin.truth.geometry.parameters[place];
        assert!(error.abs() < tolerance, "{id} errs by {error:e}");
    }
}

/// Poses that were not measured are predicted.
fn assert_predicts(twin: &Twin, found: &State, range: f64, tolerance: f64, dice: &mut Dice) {
    let postures = twin.postures(50, range, dice);
    let (_, most) = position_errors(&twin.cold(&postures, Strata::default(), dice), found);
    assert!(most < tolerance, "poses that were not measured err by {most:e} m");
}

#[test]
fn four_known_targets_give_every_parameter_of_the_comau() {
    let mut dice = Dice::new("comau");
    let twin = Twin::new(comau(), &mut dice);
    let campaign = twin.cold(&twin.postures(15, 1.0, &mut dice), Strata::default(), &mut dice);
    assert!(align(&twin.robot, &campaign, &twin.nominal, &[]).is_none(), "a good nominal needs no alignment");
    let found = identify_all(&twin, &campaign, twin.nominal.clone());
    assert_eq!((found.unknowns.len(), found.held.len(), found.weak.len()), (30, 0, 0));
    assert!(found.solution.stop.converged(), "{:?}", found.solution.stop);
    // The thesis needs 4 to 6 iterations (table 5.2).
    assert!(found.solution.steps <= 6, "{} steps", found.solution.steps);
    assert!(found.observability(&campaign).condition < 300.0, "condition {}", found.observability(&campaign).condition);
    assert_found(&twin, &found.solution.state, 1e-10);
}

#[test]
fn parallel_axes_in_hayatis_form_are_no_obstacle() {
    let mut dice = Dice::new("ur10");
    let mut twin =
        Twin::new(shipped("universal-robots-ur10").expect("shipped"), &mut dice).with_unknown_targets(4, &mut dice);
    for (target, place) in twin.truth.geometry.targets.clone().into_iter().enumerate() {
        twin.robot.targets[target].position = Some(place);
        twin.nominal.geometry.targets[target] = place;
    }
    let campaign = twin.cold(&twin.postures(30, 2.0, &mut dice), Strata::default(), &mut dice);
    let found = identify_all(&twin, &campaign, twin.nominal.clone());
    assert_eq!((found.unknowns.len(), found.held.len()), (30, 0));
    // Its last transforms are nearly singular (alpha5, d5 and a5): condition some thousand.
    assert!(found.observability(&campaign).condition < 1e4, "condition {}", found.observability(&campaign).condition);
    assert_found(&twin, &found.solution.state, 1e-10);
}

/// The COMAU with its second transform in Denavit and Hartenberg's form although axes 2 and 3 are parallel.
fn comau_by_dh_alone() -> Robot {
    let mut robot = comau();
    let second = &robot.transforms[2];
    let values = vec![0.0, second.values[0], second.values[1], second.values[2]];
    robot.transforms[2] = Transform { convention: Convention::Dh, values, joint: second.joint.clone() };
    robot
}

#[test]
fn parallel_axes_by_dh_hold_one_offset_and_say_why() {
    let mut dice = Dice::new("parallel");
    let mut twin = Twin::new(comau_by_dh_alone(), &mut dice);
    // Truly parallel in the truth, too: only then does the one offset do the work of both.
    let alpha = twin.place("alpha2");
    twin.truth.geometry.parameters[alpha] = twin.nominal.geometry.parameters[alpha];
    let campaign = twin.cold(&twin.postures(20, 1.0, &mut dice), Strata::default(), &mut dice);
    let found = identify_all(&twin, &campaign, twin.nominal.clone());
    assert_eq!(found.held.len(), 1);
    let words = in_words(&found.held[0], &campaign.names(), &twin.nominal.geometry.parameters);
    assert_eq!(words, "d3 and d2 move together: axes 2 and 3 are parallel; d3 held");
    assert_predicts(&twin, &found.solution.state, 1.0, 1e-11, &mut dice);
}

#[test]
fn unknown_targets_take_the_last_transforms_part() {
    let mut dice = Dice::new("unknown targets");
    for (count, unknowns, rank) in [(1, 33, 27), (3, 39, 33)] {
        let twin = Twin::new(comau(), &mut dice).with_unknown_targets(count, &mut dice);
        let campaign = twin.cold(&twin.postures(40, 1.2, &mut dice), Strata::default(), &mut dice);
        let targets: Vec<usize> = (0..count).collect();
        let aligned = align(&twin.robot, &campaign, &twin.nominal, &targets).expect("unknown targets are aligned");
        let found = identify_all(&twin, &campaign, aligned);
        assert_eq!(found.unknowns.len() + found.held.len(), unknowns);
        assert_eq!(found.unknowns.len(), rank, "held: {:?}", found.held);
        let held: HashSet<String> =
            names(&campaign.names(), &found.held.iter().map(|held| held.unknown).collect::<Vec<_>>())
                .into_iter()
                .collect();
        let last = ["d6", "theta6", "a6", "alpha6", "b6", "beta6"].map(String::from);
        assert_eq!(held, HashSet::from(last), "{count} targets");
        for held in &found.held {
            let words = in_words(held, &campaign.names(), &twin.nominal.geometry.parameters);
            assert!(words.contains("the flange itself is not measured"), "{words}");
        }
        assert!(found.solution.stop.converged());
        // The arm's own parameters cannot be compared, because the truth's last transform is off nominal: predictions can.
        assert_predicts(&twin, &found.solution.state, 1.2, 1e-10, &mut dice);
    }
}

#[test]
fn full_poses_give_a_targets_orientation_too() {
    let mut dice = Dice::new("full poses");
    let mut twin = Twin::new(comau(), &mut dice).with_unknown_targets(1, &mut dice);
    let place = twin.truth.geometry.targets[0];
    twin.robot.targets[0].position = Some(place);
    twin.nominal.geometry.targets[0] = place;
    twin.kind = Kind::FullPoses;
    // The orientation of the target starts at the flange's: half a radian off.
    twin.truth.geometry.turns[0] = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.4, 0.2));
    let campaign = twin.cold(&twin.postures(25, 1.0, &mut dice), Strata::default(), &mut dice);
    let found = identify_all(&twin, &campaign, twin.nominal.clone());
    assert!(found.solution.stop.converged());
    // 30 parameters and three turns of the target, of which three turn the flange as the last transform does.
    assert_eq!((found.unknowns.len(), found.held.len()), (30, 3), "{:?}", found.held);
    let flange = |state: &State, q: &[f64]| {
        campaign.chain.prepare(&state.geometry.parameters).flange(&thermokin::robot::Posture::new(q))
    };
    for q in twin.postures(20, 1.0, &mut dice) {
        let (found, truth) = (flange(&found.solution.state, &q), flange(&twin.truth, &q));
        assert!((found.point(&place) - truth.point(&place)).norm() < 1e-11);
    }
    let turn = |state: &State, q: &[f64]| flange(state, q).quaternion() * state.geometry.turns[0];
    for q in twin.postures(20, 1.0, &mut dice) {
        let angle = turn(&found.solution.state, &q).angle_to(&turn(&twin.truth, &q));
        assert!(angle < 1e-7, "{angle:e} rad");
    }
}

#[test]
fn distances_from_anchors_calibrate_an_arm() {
    let mut dice = Dice::new("distances");
    let places = [Vector3::new(1.5, -1.0, 0.5), Vector3::new(-1.5, -1.5, 0.2), Vector3::new(0.2, -0.4, 1.1)];
    for (anchors, known, held) in [(1, true, 3), (1, false, 6), (3, true, 0), (3, false, 6)] {
        let mut twin = Twin::new(comau(), &mut dice);
        twin.kind = Kind::Distances;
        for place in &places[..anchors] {
            twin = twin.with_anchor(*place);
        }
        if !known {
            for anchor in &mut twin.truth.geometry.anchors {
                *anchor += dice.vector(0.01);
            }
        }
        let campaign = twin.cold(&twin.postures(60, 1.0, &mut dice), Strata::default(), &mut dice);
        let unknown: Vec<usize> = if known { Vec::new() } else { (0..anchors).collect() };
        let unknowns = geometric_unknowns(&campaign, &[], &unknown, &[]);
        let found = identify(&campaign, unknowns, twin.nominal.clone(), &Manner::default());
        let case = format!("{anchors} anchors, known: {known}");
        assert!(found.solution.stop.converged(), "{case}: {:?}", found.solution.stop);
        // A turn about a known anchor, or any motion of arm and unknown anchors together, changes no distance.
        assert_eq!(found.held.len(), held, "{case}: {:?}", found.held);
        // New postures: distances are predicted, whatever frame the arm was found in.
        let fresh = twin.cold(&twin.postures(40, 1.0, &mut dice), Strata::default(), &mut dice);
        let whitened = Problem::new(&fresh, Vec::new(), &found.solution.state).whitened(&found.solution.state);
        let worst = whitened.iter().fold(0.0_f64, |most, value| most.max(value.abs())) * SIGMA;
        assert!(worst < 1e-9, "{case}: distances of new postures err by {worst:e} m");
    }
}

#[test]
fn a_base_far_off_is_aligned_and_found() {
    let mut dice = Dice::new("base");
    for round in 0..6 {
        let unknown = round % 2 == 1;
        let mut twin = Twin::new(comau(), &mut dice);
        if unknown {
            twin = twin.with_unknown_targets(3, &mut dice);
        }
        let base = twin.robot.transforms[0].clone();
        // The nominal base is anywhere: turned by up to half a turn about the vertical, tilted, metres away.
        let mut wrong = twin.nominal.clone();
        for (place, by) in [(0, 3.0), (1, 1.5), (2, 0.5), (3, 0.5)] {
            wrong.geometry.parameters[place] += dice.between(-by, by);
        }
        let theta1 = twin.place("theta1");
        wrong.geometry.parameters[theta1] += dice.between(-3.0, 3.0);
        let mut robot = twin.robot.clone();
        robot.set_values(&wrong.geometry.parameters);
        assert_ne!(robot.transforms[0], base);
        let targets: Vec<usize> = if unknown { (0..3).collect() } else { Vec::new() };
        let campaign = twin.cold(&twin.postures(30, 1.0, &mut dice), Strata::default(), &mut dice);
        let aligned = align(&robot, &campaign, &wrong, &targets).expect("aligned");
        let (rms, _) = position_errors(&campaign, &aligned);
        // What is left is the arm's own half millimetres and half milliradians, six joints over two metres.
        assert!(rms < 0.01, "round {round}: {rms} m after alignment");
        let unknowns = geometric_unknowns(&campaign, &targets, &[], &[]);
        let found = identify(&campaign, unknowns, aligned, &Manner::default());
        assert!(found.solution.stop.converged(), "round {round}: {:?}", found.solution.stop);
        assert_predicts(&twin, &found.solution.state, 1.0, 1e-10, &mut dice);
    }
}

#[test]
fn three_poses_do_not_find_thirty_parameters_but_what_they_can() {
    let mut dice = Dice::new("three poses");
    let twin = Twin::new(comau(), &mut dice);
    let campaign = twin.cold(&twin.postures(3, 1.0, &mut dice), Strata::default(), &mut dice);
    let found = identify_all(&twin, &campaign, twin.nominal.clone());
    // Three rigid poses are 18 numbers.
    assert_eq!(found.observability(&campaign).rank, 18);
    assert_eq!(found.held.len(), 12);
    assert_eq!(found.unknowns.len() + found.weak.len(), 18);
    assert!(found.solution.stop.converged());
    for held in &found.held {
        let words = in_words(held, &campaign.names(), &twin.nominal.geometry.parameters);
        assert!(words.ends_with("held"), "{words}");
        let Unknown::Parameter(place) = held.unknown else { panic!("only parameters are unknown here") };
        assert_eq!(found.solution.state.geometry.parameters[place], twin.nominal.geometry.parameters[place]);
    }
    let (rms, _) = position_errors(&campaign, &found.solution.state);
    let (before, _) = position_errors(&campaign, &twin.nominal);
    // Weak unknowns are held as well, so that the three poses are met nearly, not exactly.
    println!("rms {rms:e} of {before:e}, {} weak", found.weak.len());
    assert!(rms < 0.2 * before, "{rms:e} m of {before:e}");
    // Hardly any noise can be told from so close a fit: numbers stay numbers.
    let problem = Problem::new(&campaign, found.unknowns.clone(), &found.solution.state);
    let sure = uncertainty(&problem, &found.solution.state);
    assert!(sure.sigmas().iter().all(|sigma| sigma.is_finite()), "{:?}", sure.sigmas());
    assert!(sure.coverage_factor().is_finite());
}

#[test]
fn a_joint_that_never_moves_is_named() {
    let mut dice = Dice::new("still joint");
    let twin = Twin::new(comau(), &mut dice);
    let mut postures = twin.postures(20, 1.0, &mut dice);
    for posture in &mut postures {
        posture[3] = 0.4;
    }
    let campaign = twin.cold(&postures, Strata::default(), &mut dice);
    let found = identify_all(&twin, &campaign, twin.nominal.clone());
    // Frames 3 and 4 are one rigid body then: of their eight numbers four place axis 5, as in any pair of axes.
    assert_eq!(
        found.held.len(),
        4,
        "{:?}",
        names(&campaign.names(), &found.held.iter().map(|held| held.unknown).collect::<Vec<_>>())
    );
    for held in &found.held {
        let Unknown::Parameter(place) = held.unknown else { panic!("only parameters are unknown here") };
        let id = campaign.chain.parameters()[place];
        assert!((3..=5).contains(&id.transform), "{id} is held");
        assert!(!held.moves_with.is_empty());
    }
    let (rms, _) = position_errors(&campaign, &found.solution.state);
    assert!(rms < 1e-11, "{rms:e} m");
}

#[test]
fn growth_that_never_shows_is_held_and_named() {
    let mut dice = Dice::new("no rise");
    let mut twin = Twin::new(comau(), &mut dice);
    twin.grows("d1", "L0S1", -7e-6);
    twin.grows("a2", "L2S1", 9e-6);
    let postures = twin.postures(15, 1.0, &mut dice);
    // The second sensor never warms.
    let campaign = twin.visit(&postures, &[vec![0.0, 0.0], vec![6.0, 0.0]], Strata::default(), &mut dice);
    let mut unknowns = geometric_unknowns(&campaign, &[], &[], &[]);
    unknowns.extend([Unknown::Growth(0), Unknown::Growth(1)]);
    let found = identify(&campaign, unknowns, twin.nominal.clone(), &Manner::default());
    assert_eq!(found.held.len(), 1);
    assert_eq!(found.held[0].unknown, Unknown::Growth(1));
    let words = in_words(&found.held[0], &campaign.names(), &twin.nominal.geometry.parameters);
    assert_eq!(words, "a2(L2S1) moves nothing that was measured: held");
    assert_eq!(found.solution.state.growth[1], 0.0);
    assert!((found.solution.state.growth[0] + 7e-6).abs() < 1e-12);
    // Two sensors that always agree: one coefficient does for both, and it is said which.
    let mut both = twin.nominal.clone();
    twin.grows("d1", "L0S2", 0.0);
    both.growth.push(0.0);
    let rises = [vec![0.0, 0.0, 0.0], vec![6.0, 2.0, 6.0]];
    let campaign = twin.visit(&postures, &rises, Strata::default(), &mut dice);
    let mut unknowns = geometric_unknowns(&campaign, &[], &[], &[]);
    unknowns.extend((0..3).map(Unknown::Growth));
    let found = identify(&campaign, unknowns, both, &Manner::default());
    let words: Vec<String> =
        found.held.iter().map(|held| in_words(held, &campaign.names(), &twin.nominal.geometry.parameters)).collect();
    assert_eq!(words, ["d1(L0S2) and d1(L0S1) move together in these data; d1(L0S2) held"]);
}

#[test]
fn fixed_parameters_stay_exactly_nominal() {
    let mut dice = Dice::new("fix");
    let twin = Twin::new(comau(), &mut dice);
    let campaign = twin.cold(&twin.postures(20, 1.0, &mut dice), Strata::default(), &mut dice);
    let fixed = [twin.place("a2"), twin.place("beta6")];
    let unknowns = geometric_unknowns(&campaign, &[], &[], &fixed);
    assert_eq!(unknowns.len(), 28);
    let found = identify(&campaign, unknowns, twin.nominal.clone(), &Manner::default());
    for place in fixed {
        assert_eq!(found.solution.state.geometry.parameters[place], twin.nominal.geometry.parameters[place]);
    }
    assert!(found.solution.stop.converged());
}

#[test]
fn robust_losses_come_back_from_gross_errors() {
    let mut dice = Dice::new("outliers");
    let twin = Twin::new(comau(), &mut dice);
    let noise = Strata { point: SIGMA, ..Strata::default() };
    let clean = twin.cold(&twin.postures(40, 1.0, &mut dice), noise, &mut dice);
    let mut dirty = clean.clone();
    // One point of twenty is 5 mm off: 500 standard deviations.
    let positions = dirty.visits.iter_mut().flat_map(|visit| &mut visit.positions);
    for position in positions.skip(7).step_by(20) {
        position.at += dice.vector(5e-3);
    }
    let unknowns = geometric_unknowns(&clean, &[], &[], &[]);
    let with = |campaign: &Campaign, loss: Loss| {
        let manner = Manner { loss, ..Manner::default() };
        identify(campaign, unknowns.clone(), twin.nominal.clone(), &manner)
    };
    let reference = with(&clean, Loss::Squares);
    // The distance of two states in units of the clean fit's standard deviations, over all 30 directions at once: two
    // independent fits of equal noise would differ by √60.
    let distance = |found: &Identification| {
        assert!(found.solution.stop.converged());
        let state = &found.solution.state;
        let step: Vec<f64> = reference
            .unknowns
            .iter()
            .map(|&unknown| state.value(unknown) - reference.solution.state.value(unknown))
            .collect();
        (reference.solution.factor.matrix() * nalgebra::DVector::from_vec(step)).norm()
    };
    let plain = distance(&with(&dirty, Loss::Squares));
    assert!(plain > 100.0, "least squares should suffer: {plain}");
    // Huber's loss lets each outlier pull with 1.345 standard deviations, Cauchy's lets it go.
    let huber = distance(&with(&dirty, Loss::Huber));
    let cauchy = distance(&with(&dirty, Loss::Cauchy));
    assert!(huber < 60f64.sqrt(), "Huber: {huber}");
    assert!(cauchy < 0.5 * 60f64.sqrt(), "Cauchy: {cauchy}");
}

#[test]
fn poses_one_by_one_end_where_the_batch_ends() {
    let mut dice = Dice::new("recursive");
    let mut twin = Twin::new(comau(), &mut dice);
    twin.grows("d1", "L0S1", -7e-6);
    let noise = Strata { point: SIGMA, visit: 1e-5, posture: 0.0 };
    let campaign = twin.visit(&twin.postures(15, 1.0, &mut dice), &[vec![0.0], vec![5.0], vec![9.0]], noise, &mut dice);
    let mut unknowns = geometric_unknowns(&campaign, &[], &[], &[]);
    unknowns.push(Unknown::Growth(0));
    let problem = Problem::new(&campaign, unknowns.clone(), &twin.nominal);
    let batch = solve(&problem, twin.nominal.clone(), &Stopping::default());
    assert!(batch.stop.converged());
    // The batch stops where the loss would change by 1e-9: two more steps of Gauss and Newton take it to the rounding.
    let mut factor = OrthogonalFactor::new(unknowns.len());
    let mut minimum = batch.state.clone();
    for _ in 0..2 {
        problem.linearise(&minimum, &mut problem.scratch(), &mut factor);
        minimum = minimum.moved(&unknowns, &factor.solve());
    }
    for backwards in [false, true] {
        let mut recursive = Recursive::new(&campaign, unknowns.clone(), twin.nominal.clone());
        assert!(recursive.estimate().is_none());
        let mut visits = campaign.visits.clone();
        if backwards {
            visits.reverse();
        }
        for (number, visit) in visits.into_iter().enumerate() {
            recursive.push(visit);
            // Two visits are twelve numbers for 31 unknowns.
            assert!(number > 2 || recursive.estimate().is_none());
        }
        let running = recursive.estimate().expect("all determined");
        let settled = recursive.settle().expect("all determined");
        assert_eq!(recursive.visits(), campaign.visits.len());
        let away = |state: &State| {
            let step = unknowns.iter().map(|&unknown| state.value(unknown) - minimum.value(unknown));
            (factor.matrix() * nalgebra::DVector::from_iterator(unknowns.len(), step)).norm()
        };
        // A coordinate's rounding is 4e-16 m, 4e-11 of its noise; some 500 of them make 1e-9, and both sides have it.
        assert!(away(&batch.state) < 1e-4, "batch: {:e} standard deviations away", away(&batch.state));
        assert!(away(&settled) < 1e-8, "settled: {:e} standard deviations away", away(&settled));
        // Before that, the neglected second order may show, but not above the noise.
        assert!(away(&running) < 1.0, "running: {:e} standard deviations away", away(&running));
    }
}

#[test]
fn all_methods_reach_the_same_minimum() {
    let mut dice = Dice::new("methods");
    let twin = Twin::new(comau(), &mut dice);
    let noise = Strata { point: SIGMA, visit: 2e-5, posture: 0.0 };
    let campaign = twin.cold(&twin.postures(15, 1.0, &mut dice), noise, &mut dice);
    let unknowns = identifiable(&campaign, geometric_unknowns(&campaign, &[], &[], &[]), &twin.nominal).0;
    let problem = Problem::new(&campaign, unknowns, &twin.nominal);
    let trials = methods::compare(&problem, &twin.nominal, 3000);
    let of = |method: Method| trials.iter().find(|trial| trial.method == method).expect("all methods");
    let newton = of(Method::GaussNewton);
    for trial in &trials {
        println!("{:20} {:5} steps, loss {}", trial.method.words(), trial.steps, trial.loss);
        if trial.method != Method::SteepestDescent {
            assert!(trial.reached, "{}: {} after {} steps", trial.method.words(), trial.loss, trial.steps);
            assert!((trial.loss / newton.loss - 1.0).abs() < 2e-6);
        }
    }
    // The thesis (table 5.2): Gauss-Newton and Newton-Raphson in a handful, steepest descent in thousands.
    assert!(newton.steps <= 5);
    assert!(of(Method::NewtonRaphson).steps <= newton.steps + 3);
    assert!(of(Method::LevenbergMarquardt).steps <= newton.steps + 5);
    assert!(of(Method::SteepestDescent).steps > 10 * newton.steps);
    assert!(of(Method::SteepestDescent).loss < 1e-3 * problem.loss(&twin.nominal), "it descends, at least");
}

#[test]
fn a_base_in_every_convention_can_be_placed() {
    let mut dice = Dice::new("conventions");
    let mut robot = comau();
    // The thesis's base as a full transform: Rz(-90°) Tx(-2) Rx(180°).
    robot.transforms[0] = Transform {
        convention: Convention::Full,
        values: vec![0.0, -std::f64::consts::FRAC_PI_2, -2.0, 0.0, 0.0, 0.0],
        joint: None,
    };
    let twin = Twin::new(robot, &mut dice);
    let campaign = twin.cold(&twin.postures(30, 1.0, &mut dice), Strata::default(), &mut dice);
    let turned = Rotation3::from_euler_angles(0.4, -0.3, 2.0);
    let mut moved = campaign.clone();
    for visit in &mut moved.visits {
        for position in &mut visit.positions {
            position.at = turned * position.at + Vector3::new(3.0, -1.0, 2.0);
        }
    }
    let nominal = State { geometry: Geometry::nominal(&twin.robot), growth: Vec::new() };
    let aligned = align(&twin.robot, &moved, &nominal, &[]).expect("the base is far off");
    let (rms, _) = position_errors(&moved, &aligned);
    assert!(rms < 0.01, "{rms} m after alignment");
    let found = identify(&moved, geometric_unknowns(&moved, &[], &[], &[]), aligned, &Manner::default());
    let (rms, _) = position_errors(&moved, &found.solution.state);
    assert!(rms < 1e-11, "{rms:e} m");
    // A full base and the first joint's slide and turn are two parameters too many.
    assert_eq!(found.held.len(), 2, "{:?}", found.held);
}
