//! Thermal calibration: the thesis's way and all cycles at once agree, the choice from the data finds what is there
//! and next to nothing where there is nothing, and the thesis's experiment comes out on simulated runs.

mod calibrate_twin;

use calibrate_twin::{Dice, SIGMA, Strata, Twin};
use thermokin::calibrate::thermal::{ChosenBy, choose, per_cycle};
use thermokin::calibrate::{
    Campaign, Manner, ObserveOptions, Problem, Refit, Request, State, Unknown, calibrate, geometric_unknowns, identify,
    uncertainty, validate,
};
use thermokin::model::Errors;
use thermokin::robot::{Robot, shipped};
use thermokin::simulate::{Scenario, simulate};

fn comau() -> Robot {
    shipped("comau-nj-130-2.0").expect("shipped")
}

/// Rises that are not alike: each sensor warms and cools at its own pace, with a wander of its own.
fn rises(cycles: u32, sensors: usize, dice: &mut Dice) -> Vec<Vec<f64>> {
    let paces: Vec<f64> = (0..sensors).map(|_| dice.between(1.0, 12.0)).collect();
    (0..cycles)
        .map(|cycle| {
            let hours = f64::from(cycle);
            paces
                .iter()
                .map(|pace| match cycle {
                    0 => 0.0,
                    _ => {
                        12.0 * (1.0 - (-hours / pace).exp()) * (1.0 + 0.3 * (hours / pace).sin())
                            + dice.between(-1.0, 1.0)
                    }
                })
                .collect()
        })
        .collect()
}

#[test]
fn cycle_by_cycle_and_all_at_once_agree() {
    let mut dice = Dice::new("two ways");
    let mut twin = Twin::new(comau(), &mut dice);
    for (parameter, sensor, coefficient) in [
        ("d1", "L0S1", -7e-6),
        ("a1", "L1S1", 5e-6),
        ("a2", "L2S1", 9e-6),
        ("beta2", "L1S1", 2e-6),
        ("d4", "L3S1", -8e-6),
    ] {
        twin.grows(parameter, sensor, coefficient);
    }
    let rises = rises(16, twin.sensors.len(), &mut dice);
    let strata = Strata { point: SIGMA, visit: 1e-5, posture: 0.0 };
    let postures = twin.postures(15, 1.0, &mut dice);
    let campaign = twin.visit(&postures, &rises, strata, &mut dice);
    let geometry = geometric_unknowns(&campaign, &[], &[], &[]);
    let mut unknowns = geometry.clone();
    unknowns.extend((0..5).map(Unknown::Growth));
    let joint = identify(&campaign, unknowns, twin.nominal.clone(), &Manner::default());
    assert!(joint.held.is_empty() && joint.weak.is_empty());
    let state = &joint.solution.state;
    let sure = uncertainty(&Problem::new(&campaign, joint.unknowns.clone(), state), state);
    let way = per_cycle(&campaign, state, &geometry, 0);
    assert_eq!((way.cycles.len(), way.left_out.len()), (16, 0));
    let cold = Campaign { growth: Vec::new(), ..campaign.select(|visit| visit.cycle == 0) };
    let start = State { growth: Vec::new(), ..state.clone() };
    let alone = identify(&cold, geometry.clone(), start, &Manner::default());
    let alone_state = &alone.solution.state;
    let alone_problem = Problem::new(&cold, alone.unknowns.clone(), alone_state);
    let alone_sigmas = uncertainty(&alone_problem, alone_state).sigmas();
    let coefficients = way.coefficients.expect("15 cycles beside the reference");
    for (column, unknown) in joint.unknowns.iter().enumerate() {
        let &Unknown::Growth(term) = unknown else { continue };
        let (found, sigma) = (state.growth[term], sure.sigmas()[column]);
        let truth = twin.truth.growth[term];
        // Five terms at four standard deviations.
        assert!((found - truth).abs() < 4.0 * sigma, "term {term}: {found:e} ± {sigma:e} for {truth:e}");
        // The thesis's way: each change is the difference of two calibrations with one cycle's uncertainty, and the
        // reference's is in all of them.
        let parameter = campaign.growth[term].parameter;
        let column = alone.unknowns.iter().position(|&own| own == Unknown::Parameter(parameter)).expect("identified");
        let rises = rises.iter().map(|rises| rises[campaign.growth[term].sensor]);
        let (sum, squares) = rises.fold((0.0, 0.0), |(sum, squares), rise| (sum + rise, squares + rise * rise));
        let other_sigma = alone_sigmas[column] * f64::sqrt(1.0 / squares + (sum / squares).powi(2));
        let other = coefficients[term];
        println!("{term}: {truth:e}, all at once {found:e} ± {sigma:e}, cycle by cycle {other:e} ± {other_sigma:e}");
        assert!((other - truth).abs() < 4.0 * other_sigma, "term {term}: {other:e} ± {other_sigma:e} for {truth:e}");
        assert!(sigma < other_sigma, "all cycles at once are surer");
    }
}

/// The pairs that the choice from the data ends with.
fn chosen(twin: &Twin, campaign: &Campaign) -> Vec<(String, String)> {
    let plain = Campaign { growth: Vec::new(), ..campaign.clone() };
    let start = State { growth: Vec::new(), ..twin.nominal.clone() };
    let found = identify(&plain, geometric_unknowns(&plain, &[], &[], &[]), start, &Manner::default());
    let robot = Robot { thermal: Vec::new(), ..twin.robot.clone() };
    let choice = choose(&robot, &plain, &found.unknowns, &found.solution.state);
    assert_eq!(choice.by, ChosenBy::HeldOutCycles);
    let parameters = plain.chain.parameters();
    choice.terms.iter().map(|t| (parameters[t.parameter].to_string(), plain.sensors[t.sensor].clone())).collect()
}

#[test]
fn the_choice_from_the_data_finds_the_true_pairs() {
    let mut dice = Dice::new("choice");
    let mut extra = 0;
    for _ in 0..4 {
        let mut twin = Twin::new(comau(), &mut dice);
        let truth = [("d1", "L0S1"), ("a2", "L2S1"), ("d4", "L3S1")];
        for ((parameter, sensor), coefficient) in truth.into_iter().zip([-9e-6, 12e-6, -10e-6]) {
            twin.grows(parameter, sensor, coefficient);
        }
        for sensor in ["L0S2", "L1S1", "L1S2", "L2S2", "L3S2", "L4S1"] {
            twin.sensor(sensor);
        }
        let rises = rises(16, twin.sensors.len(), &mut dice);
        let strata = Strata { point: SIGMA, visit: 5e-6, posture: 0.0 };
        let postures = twin.postures(15, 1.0, &mut dice);
        let campaign = twin.visit(&postures, &rises, strata, &mut dice);
        let found = chosen(&twin, &campaign);
        println!("{found:?}");
        for (parameter, sensor) in truth {
            assert!(
                found.iter().any(|pair| pair.0 == parameter && pair.1 == sensor),
                "{parameter}({sensor}) not in {found:?}"
            );
        }
        extra += found.len() - truth.len();
    }
    // A term that is not there must beat its own standard error on held-out cycles by chance.
    assert!(extra <= 2, "{extra} pairs beyond the true ones in 4 runs");
}

#[test]
fn the_choice_from_the_data_finds_nothing_in_nothing() {
    let mut dice = Dice::new("nothing");
    let (mut terms, seeds) = (0, 6);
    for _ in 0..seeds {
        let mut twin = Twin::new(comau(), &mut dice);
        for sensor in ["L0S1", "L1S1", "L2S1", "L3S1", "L4S1"] {
            twin.sensor(sensor);
        }
        let rises = rises(12, twin.sensors.len(), &mut dice);
        let strata = Strata { point: SIGMA, visit: 5e-6, posture: 0.0 };
        let postures = twin.postures(15, 1.0, &mut dice);
        let campaign = twin.visit(&postures, &rises, strata, &mut dice);
        let found = chosen(&twin, &campaign);
        println!("{found:?}");
        terms += found.len();
    }
    // One standard error is passed by chance in every sixth trial, and some tens of pairs are tried; that the mean gain of
    // what is not there is negative leaves about one run in six with a term.
    assert!(terms <= 2, "{terms} terms out of nothing in {seeds} runs");
}

fn simulated(name: &str) -> (thermokin::run::Run, Robot) {
    let made = simulate(&Scenario::shipped(name).expect("shipped")).unwrap_or_else(|error| panic!("{error}"));
    (made.run, made.robot)
}

#[test]
fn the_thesis_experiment_comes_out() {
    let (run, robot) = simulated("thesis-75-25");
    let found = calibrate(&robot, &run, &Request::default(), |_| true).unwrap_or_else(|error| panic!("{error}"));
    let (other, other_robot) = simulated("thesis-90-30");
    let options = ObserveOptions::default();
    let judge = |run, robot| {
        validate(&found.model, run, robot, &options, Refit::default(), |_| true)
            .unwrap_or_else(|error| panic!("{error}"))
    };
    // A model without effects predicts the same extended as thermal.
    let mean =
        |[nominal, geometric, thermal, _]: [Errors; 4]| [nominal, geometric, thermal].map(|errors| errors.mean_mm);
    for (name, judged) in [("75-25", judge(&run, &robot)), ("90-30", judge(&other, &other_robot))] {
        let [nominal, geometric, thermal] = mean(judged.errors);
        println!("{name}: nominal {nominal:.3}, geometric {geometric:.3}, thermal {thermal:.3} mm");
        let cycles: Vec<[f64; 3]> = judged.cycles.iter().map(|cycle| mean(cycle.errors)).collect();
        for (cycle, [nominal, geometric, thermal]) in cycles.iter().enumerate() {
            println!("  {cycle:2}: {nominal:.3} {geometric:.3} {thermal:.3}");
        }
        // The thesis (5.2): nominal some millimetres, 0.26 mm after the geometric calibration of the cold arm, growing to
        // half a millimetre when warm, and back to about 0.26 mm throughout with the thermal correction.
        assert!((1.0..6.0).contains(&nominal), "{name}: nominal {nominal}");
        assert_eq!(cycles.len(), 24);
        let [_, cold, _] = cycles[0];
        let warmest = cycles.iter().map(|cycle| cycle[1]).fold(0.0, f64::max);
        assert!((0.18..0.34).contains(&cold), "{name}: {cold} mm at the cold reference");
        assert!((0.40..0.80).contains(&warmest), "{name}: {warmest} mm when warm");
        for (cycle, [_, _, thermal]) in cycles.iter().enumerate() {
            // Another ambient trend and warmer cycles than those identified on: a tenth of a millimetre at most is added.
            assert!(*thermal < 0.38, "{name}, cycle {cycle}: {thermal} mm with the thermal correction");
        }
        assert!(thermal < 0.33 && thermal < 0.7 * geometric, "{name}: {thermal} after {geometric}");
    }
}
