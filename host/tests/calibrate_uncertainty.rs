//! Whether the intervals of identified values hold what they promise: the share of 95 % intervals that contain the truth,
//! over many simulated runs, and the strata of noise beside those that were put in.
//!
//! # Tolerances
//! The estimates of one run are correlated, so a run counts as one draw: the mean over runs of the share of its
//! parameters that are covered has the standard error `s / √runs`. It must not lie below 95 % by more than three of these;
//! above, up to 97.5 %, because a stratum that is absent is estimated as zero or more, never less. A single parameter is
//! a binomial draw a run: with some 30 of them the bound lies at four standard deviations, and 1 % below, because the
//! degrees of freedom are those of all parameters together.

mod calibrate_twin;

use calibrate_twin::{Dice, SIGMA, Strata, Twin};
use thermokin::calibrate::{
    Campaign, Noise, Problem, Stopping, Unknown, geometric_unknowns, solve, uncertainty, weighed_growth,
};
use thermokin::robot::shipped;

/// What many runs came to.
struct Runs {
    covered: Vec<Vec<bool>>,
    noise: Vec<Noise>,
    names: Vec<String>,
}

fn many(twin: &Twin, runs: usize, dice: &mut Dice, mut make: impl FnMut(&mut Dice) -> Campaign) -> Runs {
    let mut result = Runs { covered: Vec::new(), noise: Vec::new(), names: Vec::new() };
    for _ in 0..runs {
        let campaign = make(dice);
        let mut unknowns = geometric_unknowns(&campaign, &[], &[], &[]);
        unknowns.extend((0..campaign.growth.len()).map(Unknown::Growth));
        let problem = Problem::new(&campaign, unknowns.clone(), &twin.nominal);
        // The truth is a legitimate start: the minimum near it is the same.
        let found = solve(&problem, twin.truth.clone(), &Stopping::default());
        assert!(found.stop.converged(), "{:?}", found.stop);
        let sure = uncertainty(&problem, &found.state);
        let factor = sure.coverage_factor();
        let covered = unknowns
            .iter()
            .zip(sure.sigmas())
            .map(|(&unknown, sigma)| (found.state.value(unknown) - twin.truth.value(unknown)).abs() <= factor * sigma);
        result.covered.push(covered.collect());
        result.noise.push(sure.noise);
        result.names = calibrate_twin::names(&campaign.names(), &unknowns);
    }
    result
}

fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (mean, (variance / count).sqrt())
}

fn assert_covered(case: &str, runs: &Runs) {
    let share = |covered: &[bool]| covered.iter().filter(|covered| **covered).count() as f64 / covered.len() as f64;
    let (mean, error) = mean_and_error(&runs.covered.iter().map(|run| share(run)).collect::<Vec<_>>());
    println!("{case}: {:.1} ± {:.1} % of the intervals hold the truth", 100.0 * mean, 100.0 * error);
    assert!(mean > 0.95 - 3.0 * error && mean < 0.975, "{case}: {mean} ± {error}");
    let count = runs.covered.len() as f64;
    let least = 0.95 - 0.01 - 4.0 * (0.95 * 0.05 / count).sqrt();
    for (column, name) in runs.names.iter().enumerate() {
        let own = runs.covered.iter().filter(|run| run[column]).count() as f64 / count;
        assert!(own > least, "{case}: {name} is covered in {:.1} % of {count} runs", 100.0 * own);
    }
}

/// A stratum's *variance* is what is estimated without bias, as long as it is not cut off at zero.
fn assert_stratum(case: &str, what: &str, found: &[f64], put_in: f64) {
    let (mean, error) = mean_and_error(&found.iter().map(|sigma| sigma * sigma).collect::<Vec<_>>());
    println!("{case}: {what} {:.3e} ± {:.0e} for {:.3e}", mean, error, put_in * put_in);
    assert!((mean - put_in * put_in).abs() < 4.0 * error + 0.01 * put_in * put_in, "{case}: {what}");
}

#[test]
fn intervals_of_one_cycle_hold_the_truth() {
    for (poses, strata) in [
        (15, Strata { point: SIGMA, visit: 2e-5, posture: 0.0 }),
        (40, Strata { point: SIGMA, visit: 2e-5, posture: 0.0 }),
        // The arm repeats perfectly, and the instrument is twice as bad as it says.
        (20, Strata { point: 2.0 * SIGMA, visit: 0.0, posture: 0.0 }),
        // Repeatability and errors of the posture cannot be told apart in one cycle: they are one stratum there.
        (20, Strata { point: 0.5 * SIGMA, visit: 3e-5, posture: 4e-5 }),
    ] {
        let case = format!("{poses} poses, visit {:.0e}, posture {:.0e}", strata.visit, strata.posture);
        let mut dice = Dice::new(&case);
        let twin = Twin::new(shipped("comau-nj-130-2.0").expect("shipped"), &mut dice);
        let runs = many(&twin, 250, &mut dice, |dice| {
            let postures = twin.postures(poses, 1.0, dice);
            twin.cold(&postures, strata, dice)
        });
        assert_covered(&case, &runs);
        assert!(runs.noise.iter().all(|noise| noise.point_estimated && noise.posture == 0.0));
        let points: Vec<f64> = runs.noise.iter().map(|noise| noise.point).collect();
        assert_stratum(&case, "point", &points, strata.point / SIGMA);
        if strata.visit > 0.0 {
            let visits: Vec<f64> = runs.noise.iter().map(|noise| noise.visit).collect();
            assert_stratum(&case, "visit", &visits, strata.visit.hypot(strata.posture));
        }
    }
}

#[test]
fn intervals_of_many_cycles_hold_the_truth() {
    many_cycles(Strata { point: SIGMA, visit: 2e-5, posture: 0.0 });
}

#[test]
fn intervals_of_many_cycles_with_errors_of_the_posture_hold_the_truth() {
    many_cycles(Strata { point: SIGMA, visit: 1e-5, posture: 4e-5 });
}

fn many_cycles(strata: Strata) {
    let case = format!("24 cycles, visit {:.0e}, posture {:.0e}", strata.visit, strata.posture);
    let mut dice = Dice::new(&case);
    let mut twin = Twin::new(shipped("comau-nj-130-2.0").expect("shipped"), &mut dice);
    for (parameter, sensor, coefficient) in
        [("d1", "A", -7e-6), ("a1", "B", 5e-6), ("a2", "C", 9e-6), ("beta2", "A", 2e-6), ("d4", "D", -8e-6)]
    {
        twin.grows(parameter, sensor, coefficient);
    }
    let rises: Vec<Vec<f64>> = (0..24)
        .map(|cycle| {
            let warm = 1.0 - f64::exp(-f64::from(cycle) / 8.0);
            (0..4).map(|sensor| 12.0 * warm + f64::from(cycle * (sensor + 1) % 7) * 0.4).collect()
        })
        .collect();
    let postures = twin.postures(15, 1.0, &mut dice);
    let runs = many(&twin, 200, &mut dice, |dice| twin.visit(&postures, &rises, strata, dice));
    assert_covered(&case, &runs);
    let of = |stratum: fn(&Noise) -> f64| runs.noise.iter().map(stratum).collect::<Vec<f64>>();
    assert_stratum(&case, "point", &of(|noise| noise.point), strata.point / SIGMA);
    assert_stratum(&case, "visit", &of(|noise| noise.visit), strata.visit);
    if strata.posture > 0.0 {
        assert_stratum(&case, "posture", &of(|noise| noise.posture), strata.posture);
    } else {
        // A variance of nothing is cut off at zero half of the time and small in the other half.
        let (mean, _) = mean_and_error(&of(|noise| noise.posture * noise.posture));
        assert!(mean.sqrt() < 0.2 * strata.visit, "posture noise {:e} out of nothing", mean.sqrt());
    }
}

#[test]
fn growth_weighed_by_all_strata_is_surer_and_as_honest() {
    let mut dice = Dice::new("weighed growth");
    let mut twin = Twin::new(shipped("comau-nj-130-2.0").expect("shipped"), &mut dice);
    for (parameter, sensor, coefficient) in [("d1", "A", -7e-6), ("a2", "B", 9e-6), ("d4", "A", -8e-6)] {
        twin.grows(parameter, sensor, coefficient);
    }
    let rises: Vec<Vec<f64>> =
        (0..8).map(|cycle| vec![f64::from(cycle), 9.0 * (1.0 - f64::exp(-f64::from(cycle) / 2.0))]).collect();
    let postures = twin.postures(15, 1.0, &mut dice);
    let strata = Strata { point: SIGMA, visit: 1e-5, posture: 5e-5 };
    let (runs, mut covered, mut squares, mut surer) = (100, 0, Vec::new(), 0);
    for _ in 0..runs {
        let campaign = twin.visit(&postures, &rises, strata, &mut dice);
        let mut unknowns = geometric_unknowns(&campaign, &[], &[], &[]);
        unknowns.extend((0..3).map(Unknown::Growth));
        let problem = Problem::new(&campaign, unknowns.clone(), &twin.nominal);
        let found = solve(&problem, twin.truth.clone(), &Stopping::default());
        let plain = uncertainty(&problem, &found.state);
        let weighed = weighed_growth(&campaign, &unknowns, &found.state, &plain.noise).expect("growth is unknown");
        for term in 0..3 {
            let z = (weighed.coefficients[term] - twin.truth.growth[term]) / weighed.covariance[(term, term)].sqrt();
            covered += usize::from(z.abs() < 1.96);
            squares.push(z * z);
            surer += usize::from(weighed.covariance[(term, term)].sqrt() < plain.sigmas()[30 + term]);
        }
    }
    // 300 normal numbers, three of a run correlated at most: their mean square errs by √(2 / 100), their coverage by
    // √(0.95 × 0.05 / 100); the variance of the visits' noise is estimated to 5 % on top.
    let (mean, _) = mean_and_error(&squares);
    let share = f64::from(covered as u32) / (3.0 * f64::from(runs));
    println!("mean square {mean:.3}, covered {:.1} %, surer in {surer} of {}", 100.0 * share, 3 * runs);
    assert!((mean - 1.0).abs() < 4.0 * f64::sqrt(2.0 / f64::from(runs)) + 0.05, "mean square {mean}");
    assert!(share > 0.95 - 4.0 * f64::sqrt(0.95 * 0.05 / f64::from(runs)), "{share} covered");
    assert_eq!(surer, 3 * runs as usize, "weights by all strata tell growth better than the instrument's alone");
}

#[test]
fn correlations_are_those_of_many_runs() {
    let mut dice = Dice::new("correlations");
    let twin = Twin::new(shipped("comau-nj-130-2.0").expect("shipped"), &mut dice);
    let postures = twin.postures(30, 1.0, &mut dice);
    let strata = Strata { point: SIGMA, visit: 1e-5, posture: 0.0 };
    let (runs, mut errors) = (400, Vec::new());
    let mut stated = None;
    for _ in 0..runs {
        let campaign = twin.cold(&postures, strata, &mut dice);
        let unknowns = geometric_unknowns(&campaign, &[], &[], &[]);
        let problem = Problem::new(&campaign, unknowns.clone(), &twin.nominal);
        let found = solve(&problem, twin.truth.clone(), &Stopping::default());
        errors.push(unknowns.iter().map(|&u| found.state.value(u) - twin.truth.value(u)).collect::<Vec<f64>>());
        stated = Some(uncertainty(&problem, &found.state));
    }
    let stated = stated.expect("some runs");
    let sum = |i: usize, j: usize| errors.iter().map(|run| run[i] * run[j]).sum::<f64>();
    // A correlation of n draws errs by (1 - ρ²) / √n; the stated one by the error of two strata, a few percent.
    for i in 0..errors[0].len() {
        for j in 0..i {
            let seen = sum(i, j) / (sum(i, i) * sum(j, j)).sqrt();
            let told = stated.correlation(i, j);
            let tolerance = 5.0 * (1.0 - told * told) / f64::from(runs).sqrt() + 0.03;
            assert!((seen - told).abs() < tolerance, "{i}, {j}: {seen} seen, {told} stated");
        }
    }
}
