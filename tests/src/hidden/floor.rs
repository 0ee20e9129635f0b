//! What the true model would get on data it did not fit: its own form, its sizes estimated from the other folds. The yardstick
//! of an extension's held-out error.

use nalgebra::{DMatrix, DVector, Vector3};

use super::case::{Case, tangents};
use super::oracle::{Oracle, length};
use super::readings;
use super::world::Influence;

/// Root-mean-square distances, m.
#[derive(Debug, Clone, Copy)]
pub struct Floor {
    /// True model, nothing estimated: the noise.
    pub known: f64,
    /// True form, fitted with calibration's unknowns; whole cycles held out.
    pub cycles: f64,
    /// The same, whole postures held out.
    pub poses: f64,
    /// Calibration without the effects, whole cycles held out.
    pub baseline_cycles: f64,
    /// The same, whole postures held out.
    pub baseline_poses: f64,
}

/// Folds of poses, in turn, and of cycles, neighbours together.
const OF_POSES: usize = 5;
const OF_CYCLES: usize = 3;

/// The floors of a run; gross errors are taken out.
pub fn floor(case: &Case) -> Floor {
    let world = &case.world;
    let effects = case.effects();
    let seen: Vec<bool> =
        (0..world.points.len()).map(|p| case.measured[p].is_some() && !case.outliers.contains(&p)).collect();
    let oracle = Oracle::new(world, &readings::said_rises(world, &[]), &seen);
    let rises = readings::said_rises(world, &[]);
    let mut influences: Vec<Influence> = (0..world.values.len())
        .map(|parameter| Influence {
            parameters: vec![(parameter, vec![1.0; world.points.len()])],
            ..Influence::default()
        })
        .collect();
    for pair in &world.arm.thermal {
        for &sensor in &pair.sensors {
            let parameters = vec![(pair.parameter, rises[sensor].clone())];
            influences.push(Influence { parameters, ..Influence::default() });
        }
    }
    let baseline = influences.len();
    effects.iter().for_each(|effect| influences.extend(tangents(world, effect)));
    let clean = case.clean.iter();
    let errors = |truth: &Vec<Vector3<f64>>| -> Vec<Vector3<f64>> {
        let zero = Vector3::zeros();
        case.measured.iter().zip(truth).map(|(at, truth)| at.map_or(zero, |at| at - truth)).collect()
    };
    let about_truth = errors(&clean.copied().collect());
    let about_none = errors(&world.positions(&Influence::default(), &[]));
    let columns: Vec<Vec<Vector3<f64>>> = influences.iter().map(|one| oracle.displacements(one)).collect();
    let visit = |p: usize| &world.schedule.visits[world.points[p].visit];
    let cycles = world.schedule.visits.iter().map(|visit| visit.cycle + 1).max().unwrap_or(1);
    let cycle = |p: usize| visit(p).cycle * OF_CYCLES / cycles;
    let pose = |p: usize| visit(p).pose % OF_POSES;
    let data = Data { oracle: &oracle, seen: &seen, columns: &columns };
    let square: f64 = (0..seen.len()).filter(|&p| seen[p]).map(|p| about_truth[p].norm_squared()).sum();
    let count = seen.iter().filter(|seen| **seen).count() as f64;
    Floor {
        known: libm::sqrt(square / count),
        cycles: data.held_out(&about_truth, columns.len(), OF_CYCLES, cycle),
        poses: data.held_out(&about_truth, columns.len(), OF_POSES, pose),
        baseline_cycles: data.held_out(&about_none, baseline, OF_CYCLES, cycle),
        baseline_poses: data.held_out(&about_none, baseline, OF_POSES, pose),
    }
}

struct Data<'a> {
    oracle: &'a Oracle,
    seen: &'a [bool],
    columns: &'a [Vec<Vector3<f64>>],
}

impl Data<'_> {
    /// Held-out error of a linear fit of the first columns, by the folds that points belong to.
    fn held_out(&self, errors: &[Vector3<f64>], unknowns: usize, folds: usize, of: impl Fn(usize) -> usize) -> f64 {
        let (mut square, mut count) = (0.0, 0.0);
        for fold in 0..folds {
            let held = |p: usize| of(p) == fold;
            let solution = self.fit(errors, unknowns, |p| !held(p));
            for p in (0..self.seen.len()).filter(|&p| self.seen[p] && held(p)) {
                let mut left = errors[p];
                for (column, x) in self.columns.iter().zip(solution.iter()) {
                    left -= column[p] * *x;
                }
                square += left.norm_squared();
                count += 1.0;
            }
        }
        libm::sqrt(square / count)
    }

    /// Weighted least squares over the points of a fold; directions that it does not tell stay at zero.
    fn fit(&self, errors: &[Vector3<f64>], unknowns: usize, used: impl Fn(usize) -> bool) -> Vec<f64> {
        const UNTOLD: f64 = 1e-9;
        let only = |values: &[Vector3<f64>]| -> DVector<f64> {
            let kept: Vec<Vector3<f64>> =
                values.iter().enumerate().map(|(p, v)| if used(p) { *v } else { Vector3::zeros() }).collect();
            self.oracle.whiten(&kept)
        };
        let columns: Vec<DVector<f64>> = self.columns[..unknowns].iter().map(|column| only(column)).collect();
        let scales: Vec<f64> = columns.iter().map(|column| length(column).max(f64::MIN_POSITIVE)).collect();
        let scaled: Vec<DVector<f64>> = columns.iter().zip(&scales).map(|(column, scale)| column / *scale).collect();
        // The triangle of a QR keeps the condition that a normal matrix would square; its SVD drops what is not told.
        let (q, r) = DMatrix::from_columns(&scaled).qr().unpack();
        let right = q.tr_mul(&only(errors));
        let solved = r.svd(true, true).solve(&right, UNTOLD).unwrap_or_else(|_| DVector::zeros(unknowns));
        solved.iter().zip(&scales).map(|(x, scale)| x / scale).collect()
    }
}
