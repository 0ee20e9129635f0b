//! The linear algebra under an identification: the orthogonal factor against dense decompositions, the rows of
//! [`Problem`] against finite differences, the exact Hessian against differences of the gradient.
//!
//! # Tolerances
//! A Householder factor of m rows and n columns errs by less than about `m n u` of a column's norm (Higham, Accuracy and
//! Stability, theorem 19.4), seen in practice as a few `√n u`; a solution by that times the condition. The random problems
//! have conditions below 100. A central difference with step h errs by `h²` of the third derivative and by `u / h` of the
//! value's rounding; with values of 3 m over 10 µm (3e5 in units of noise) and h = 1e-5 both stay below 3e-5 of a column.

mod calibrate_twin;

use calibrate_twin::{Dice, Kind, Strata, Twin};
use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector3};
use thermokin::calibrate::{Campaign, OrthogonalFactor, Problem, State, Unknown, geometric_unknowns};
use thermokin::robot::shipped;

fn random_rows(rows: usize, columns: usize, dice: &mut Dice) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| dice.normal())
}

/// Pushes `[j | e]` in blocks of uneven size.
fn factor_of(j: &DMatrix<f64>, e: &DVector<f64>, capacity: usize) -> OrthogonalFactor {
    let mut factor = OrthogonalFactor::with_capacity(j.ncols(), capacity);
    let (mut row, mut size) = (0, 1);
    while row < j.nrows() {
        let count = size.min(j.nrows() - row).min(capacity);
        let mut new = factor.push(count);
        for i in 0..count {
            for k in 0..j.ncols() {
                new.set(i, k, j[(row + i, k)]);
            }
            new.set(i, j.ncols(), e[row + i]);
        }
        row += count;
        size = size % 7 + 1;
    }
    factor.fold();
    factor
}

fn close(found: &[f64], expected: &DVector<f64>, tolerance: f64) {
    let error = (DVector::from_column_slice(found) - expected).norm();
    assert!(error <= tolerance * expected.norm().max(1.0), "differs by {error:e}");
}

#[test]
fn the_factor_solves_as_a_dense_decomposition_does() {
    let mut dice = Dice::new("factor");
    for (rows, columns, capacity) in [(40, 7, 128), (1000, 31, 128), (333, 30, 9), (30, 30, 128), (64, 1, 8)] {
        let j = random_rows(rows, columns, &mut dice);
        let e = DVector::from_fn(rows, |_, _| dice.normal());
        let factor = factor_of(&j, &e, capacity);
        let svd = j.clone().svd(true, true);
        let condition = svd.singular_values.max() / svd.singular_values.min();
        let expected = svd.solve(&e, 0.0).expect("both bases");
        // 1e-13 is 500 u, far above √n u and far below any wrong entry.
        close(&factor.solve(), &expected, 1e-13 * condition * condition);
        let rest = (&e - &j * &expected).norm();
        assert!((factor.remainder() - rest).abs() < 1e-12 * e.norm(), "{} for {rest}", factor.remainder());
        assert_eq!(factor.rows(), rows);
        let r = factor.matrix();
        let gram = r.tr_mul(&r) - j.tr_mul(&j);
        assert!(gram.norm() < 1e-12 * j.norm_squared(), "R'R is not J'J");
        for (norm, column) in factor.column_norms().iter().zip(j.column_iter()) {
            assert!((norm - column.norm()).abs() < 1e-12 * column.norm());
        }
    }
}

#[test]
fn merged_factors_are_those_of_all_rows() {
    let mut dice = Dice::new("merge");
    let j = random_rows(300, 12, &mut dice);
    let e = DVector::from_fn(300, |_, _| dice.normal());
    let whole = factor_of(&j, &e, 128);
    let mut first = factor_of(&j.rows(0, 113).into_owned(), &e.rows(0, 113).into_owned(), 16);
    first.merge(&factor_of(&j.rows(113, 187).into_owned(), &e.rows(113, 187).into_owned(), 128));
    close(&first.solve(), &DVector::from_vec(whole.solve()), 1e-12);
    assert!((first.remainder() - whole.remainder()).abs() < 1e-12 * whole.remainder());
    assert_eq!(first.rows(), 300);
    // Merging nothing changes nothing.
    let before = first.solve();
    first.merge(&OrthogonalFactor::new(12));
    close(&first.solve(), &DVector::from_vec(before), 1e-14);
    assert_eq!(first.rows(), 300);
}

#[test]
fn a_choice_of_columns_is_the_smaller_problem() {
    let mut dice = Dice::new("columns");
    let j = random_rows(200, 10, &mut dice);
    let e = DVector::from_fn(200, |_, _| dice.normal());
    let whole = factor_of(&j, &e, 64);
    for chosen in [vec![0, 3, 4, 9], vec![9, 2, 7], vec![5], (0..10).rev().collect::<Vec<_>>()] {
        let part = whole.columns(&chosen);
        let own = factor_of(&j.select_columns(&chosen), &e, 64);
        close(&part.solve(), &DVector::from_vec(own.solve()), 1e-12);
        assert!((part.remainder() - own.remainder()).abs() < 1e-12 * own.remainder());
        assert_eq!(part.rows(), 200);
    }
}

#[test]
fn a_damped_step_solves_the_stacked_problem() {
    let mut dice = Dice::new("damped");
    let j = random_rows(90, 8, &mut dice);
    let e = DVector::from_fn(90, |_, _| dice.normal());
    let factor = factor_of(&j, &e, 128);
    for mu in [0.0, 1e-6, 0.3, 1e3] {
        let mut stacked = j.clone().resize_vertically(98, 0.0);
        for k in 0..8 {
            stacked[(90 + k, k)] = f64::sqrt(mu) * j.column(k).norm();
        }
        let right = e.clone().resize_vertically(98, 0.0);
        let expected = stacked.svd(true, true).solve(&right, 0.0).expect("both bases");
        close(&factor.solve_damped(mu), &expected, 1e-12);
    }
}

#[test]
fn dependent_columns_show_on_the_diagonal() {
    let mut dice = Dice::new("rank");
    let mut j = random_rows(100, 6, &mut dice);
    let third = j.column(0) - 2.0 * j.column(1);
    j.set_column(2, &third);
    j.fill_column(4, 0.0);
    let factor = factor_of(&j, &DVector::zeros(100), 32);
    for (column, norm) in factor.column_norms().into_iter().enumerate() {
        let share = factor.entry(column, column).abs() / norm.max(1.0);
        match column {
            2 | 4 => assert!(share < 1e-13, "column {column}: {share:e}"),
            _ => assert!(share > 1e-2, "column {column}: {share:e}"),
        }
    }
    // Row 4 belongs to a column of zeros; that the others stay right is what a held unknown relies on.
    let kept = factor.columns(&[0, 1, 3, 5]);
    assert!(kept.solve().iter().all(|value| value.is_finite()));
}

/// A twin that sees everything: positions, turns, distances, growth, unknown targets and anchors.
fn everything(dice: &mut Dice) -> (Twin, Campaign, Vec<Unknown>) {
    let robot = shipped("comau-nj-130-2.0").expect("shipped");
    let mut twin = Twin::new(robot, dice)
        .with_unknown_targets(3, dice)
        .with_anchor(Vector3::new(1.0, 0.3, -0.4))
        .with_anchor(Vector3::new(-0.7, -1.2, 0.2));
    for turn in &mut twin.truth.geometry.turns {
        *turn = UnitQuaternion::from_scaled_axis(dice.vector(0.5));
    }
    twin.grows("d1", "L0S1", -7e-6);
    twin.grows("a1", "L1S1", 5e-6);
    twin.grows("beta2", "L0S1", 2e-6);
    let postures = twin.postures(4, 1.0, dice);
    let rises = [vec![0.0, 0.0], vec![8.0, -3.0]];
    let strata = Strata { point: 1e-4, visit: 1e-4, posture: 0.0 };
    twin.kind = Kind::FullPoses;
    let mut campaign = twin.visit(&postures, &rises, strata, dice);
    twin.kind = Kind::Distances;
    let measured = twin.visit(&postures, &rises, strata, dice);
    for (visit, other) in campaign.visits.iter_mut().zip(measured.visits) {
        visit.distances = other.distances;
    }
    let mut unknowns = geometric_unknowns(&campaign, &[0, 1, 2], &[0, 1], &[]);
    unknowns.extend((0..3).map(Unknown::Growth));
    (twin, campaign, unknowns)
}

#[test]
fn derivatives_are_those_of_the_residuals() {
    let mut dice = Dice::new("derivatives");
    let (twin, campaign, unknowns) = everything(&mut dice);
    assert_eq!(unknowns.len(), 30 + 9 + 9 + 6 + 3);
    // Away from the truth, so that the residuals are tenths of a millimetre and no derivative is taken at zero.
    let point = State { growth: twin.truth.growth.clone(), ..twin.truth.clone() };
    let problem = Problem::new(&campaign, unknowns.clone(), &point);
    let mut rows = Vec::new();
    problem.each_visit_rows(&point, |_, part| rows.push(part));
    for (column, &unknown) in unknowns.iter().enumerate() {
        let step = if matches!(unknown, Unknown::Growth(_)) { 1e-6 } else { 1e-5 };
        let at = |by: f64| DVector::from_vec(problem.whitened(&point.moved(&[unknown], &[by])));
        // Residuals are measured minus predicted in the *moving* flange frame: their derivative is minus the column plus a
        // turn of the residual itself, which is 1e-4 m of 2 m.
        let numeric = (at(-step) - at(step)) / (2.0 * step);
        let analytic: Vec<f64> =
            rows.iter().flat_map(|part| part.jacobian.column(column).iter().copied().collect::<Vec<_>>()).collect();
        let analytic = DVector::from_vec(analytic);
        let error = (&numeric - &analytic).norm() / analytic.norm();
        let name = campaign.names().name(unknown);
        assert!(analytic.norm() > 0.0, "{name} moves nothing");
        assert!(error < 1e-3, "{name}: {error:e}");
    }
    // At the truth without noise nothing is left of that turn, and the columns are exact.
    let exact = exact(&campaign, &point);
    let problem = Problem::new(&exact, unknowns.clone(), &point);
    let mut rows = Vec::new();
    problem.each_visit_rows(&point, |_, part| rows.push(part));
    for (column, &unknown) in unknowns.iter().enumerate() {
        let step = if matches!(unknown, Unknown::Growth(_)) { 1e-6 } else { 1e-5 };
        let at = |by: f64| DVector::from_vec(problem.whitened(&point.moved(&[unknown], &[by])));
        let numeric = (at(-step) - at(step)) / (2.0 * step);
        let analytic: Vec<f64> =
            rows.iter().flat_map(|part| part.jacobian.column(column).iter().copied().collect::<Vec<_>>()).collect();
        let error = (&numeric - DVector::from_vec(analytic)).norm() / numeric.norm();
        assert!(error < 3e-5, "{}: {error:e}", exact.names().name(unknown));
    }
}

/// The campaign with everything measured exactly as a state predicts it.
fn exact(campaign: &Campaign, state: &State) -> Campaign {
    let mut exact = campaign.clone();
    for visit in &mut exact.visits {
        let mut values = state.geometry.parameters.clone();
        for (term, coefficient) in campaign.growth.iter().zip(&state.growth) {
            values[term.parameter] += coefficient * visit.rises[term.sensor];
        }
        let flange = campaign.chain.prepare(&values).flange(&visit.posture);
        for position in &mut visit.positions {
            position.at = flange.point(&state.geometry.targets[position.target]);
        }
        for turn in &mut visit.turns {
            turn.at = flange.quaternion() * state.geometry.turns[turn.target];
        }
        for distance in &mut visit.distances {
            let away = flange.point(&state.geometry.targets[distance.target]) - state.geometry.anchors[distance.anchor];
            distance.distance = away.norm();
        }
    }
    exact
}

#[test]
fn the_joints_derivatives_are_those_of_the_residuals() {
    let mut dice = Dice::new("joints");
    let (twin, campaign, _) = everything(&mut dice);
    let campaign = exact(&campaign, &twin.truth);
    let problem = Problem::new(&campaign, Vec::new(), &twin.truth);
    let mut rows = Vec::new();
    problem.each_visit_rows(&twin.truth, |visit, part| rows.push((visit.posture.clone(), part)));
    let step = 1e-5;
    for joint in 0..6 {
        let moved = |by: f64| {
            let mut other = campaign.clone();
            for visit in &mut other.visits {
                let mut q: Vec<f64> = visit.posture.joints().iter().map(|state| state.value).collect();
                q[joint] += by;
                visit.posture = thermokin::robot::Posture::new(&q);
            }
            DVector::from_vec(Problem::new(&other, Vec::new(), &twin.truth).whitened(&twin.truth))
        };
        let numeric = (moved(-step) - moved(step)) / (2.0 * step);
        let analytic: Vec<f64> =
            rows.iter().flat_map(|(_, part)| part.joints.column(joint).iter().copied().collect::<Vec<_>>()).collect();
        let error = (&numeric - DVector::from_vec(analytic)).norm() / numeric.norm();
        assert!(error < 3e-5, "joint {}: {error:e}", joint + 1);
    }
}

#[test]
fn six_rows_say_what_all_rows_say() {
    let mut dice = Dice::new("compressed");
    let mut twin = Twin::new(shipped("comau-nj-130-2.0").expect("shipped"), &mut dice);
    twin.grows("d4", "L3S1", 1e-5);
    let postures = twin.postures(15, 1.0, &mut dice);
    let strata = Strata { point: 1e-4, visit: 1e-4, posture: 0.0 };
    let mut campaign = twin.visit(&postures, &[vec![0.0], vec![9.0]], strata, &mut dice);
    // Broken beams: visits of three targets, of two, of one, beside those of four.
    campaign.visits[3].positions.remove(1);
    campaign.visits[4].positions.truncate(2);
    campaign.visits[5].positions.truncate(1);
    let mut unknowns = geometric_unknowns(&campaign, &[], &[], &[]);
    unknowns.push(Unknown::Growth(0));
    let problem = Problem::new(&campaign, unknowns.clone(), &twin.nominal);
    let mut compressed = OrthogonalFactor::new(unknowns.len());
    let loss = problem.linearise(&twin.nominal, &mut problem.scratch(), &mut compressed);
    let mut full = OrthogonalFactor::new(unknowns.len());
    problem.each_visit_rows(&twin.nominal, |_, part| {
        for row in 0..part.residual.len() {
            let mut new = full.push(1);
            for column in 0..unknowns.len() {
                new.set(0, column, part.jacobian[(row, column)]);
            }
            new.right_hand_side()[0] = part.residual[row];
        }
    });
    full.fold();
    let (r, s) = (compressed.matrix(), full.matrix());
    let scale = DMatrix::from_diagonal(&DVector::from_iterator(
        unknowns.len(),
        full.column_norms().into_iter().map(|norm| 1.0 / norm),
    ));
    let difference = &scale * (r.tr_mul(&r) - s.tr_mul(&s)) * &scale;
    assert!(difference.abs().max() < 1e-12, "J'J differs by {:e}", difference.abs().max());
    let slope =
        |factor: &OrthogonalFactor| &scale * factor.matrix().tr_mul(&DVector::from_vec(factor.right_hand_side()));
    let error = (slope(&compressed) - slope(&full)).norm() / slope(&full).norm();
    assert!(error < 1e-12, "J'e differs by {error:e}");
    // The loss holds what lies within the visits, too.
    assert!((loss - problem.loss(&twin.nominal)).abs() < 1e-12 * loss);
    let all: f64 = problem.whitened(&twin.nominal).iter().map(|value| value * value).sum();
    assert!((loss - 0.5 * all).abs() < 1e-12 * loss);
}

#[test]
fn the_exact_hessian_is_the_gradients_derivative() {
    let mut dice = Dice::new("curvature");
    let twin = Twin::new(shipped("comau-nj-130-2.0").expect("shipped"), &mut dice).with_unknown_targets(2, &mut dice);
    let postures = twin.postures(6, 1.0, &mut dice);
    let campaign = twin.cold(&postures, Strata::default(), &mut dice);
    // At targets 100 mm off, what Gauss and Newton leave out is some percent of the Hessian.
    let state = twin.nominal.clone();
    let unknowns = geometric_unknowns(&campaign, &[0, 1], &[], &[]);
    let problem = Problem::new(&campaign, unknowns.clone(), &state);
    let mut factor = OrthogonalFactor::new(unknowns.len());
    problem.linearise(&state, &mut problem.scratch(), &mut factor);
    let r = factor.matrix();
    let hessian = r.tr_mul(&r) + problem.curvature(&state);
    let gradient = |state: &State| {
        let mut factor = OrthogonalFactor::new(unknowns.len());
        problem.linearise(state, &mut problem.scratch(), &mut factor);
        factor.matrix().tr_mul(&DVector::from_vec(factor.right_hand_side()))
    };
    let largest = hessian.abs().max();
    assert!(problem.curvature(&state).abs().max() > 1e-3 * largest, "the test would not see the curvature");
    for (column, &unknown) in unknowns.iter().enumerate() {
        let step = 1e-5;
        // J'e is minus the gradient of the loss.
        let numeric =
            (gradient(&state.moved(&[unknown], &[-step])) - gradient(&state.moved(&[unknown], &[step]))) / (2.0 * step);
        let error = (numeric - hessian.column(column)).norm();
        assert!(error < 1e-7 * largest, "{}: {:e}", campaign.names().name(unknown), error / largest);
    }
}
