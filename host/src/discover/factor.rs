//! What is left of hypotheses when nuisance and shared errors are projected out, and the directions in which they can be
//! tested.

use std::borrow::Cow;

use nalgebra::{DMatrix, DMatrixView, DVector};

use super::normal::{Cross, Layout, Normal, Rows, Strata};
use super::stage::Stage;

/// Rows of a triangle that are multiplied together.
const ROWS_AT_ONCE: usize = 48;

/// The inverse factor of the normal equations under given sizes of the shared errors.
pub struct Factor {
    pub(super) chosen: Vec<usize>,
    /// `L⁻¹` of `L Lᵀ`, unscaled.
    pub(super) inverse: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    /// Restricted log likelihood, but for a constant.
    pub log_likelihood: f64,
    /// Size of the postures' errors.
    pub posture: f64,
    /// Size of the cycles' errors.
    pub cycle: f64,
}

/// Draws of noise as [`Factor::project_draws`] takes them.
pub struct Draws<'a> {
    /// [`Factor::turn_draws`].
    pub turned: &'a DMatrix<f64>,
    /// Their shared errors: rows of the layout by draws, zero for the nuisance.
    pub shared: &'a DMatrix<f64>,
}

/// Hypotheses side by side: one large product costs a fraction of many small ones.
pub struct Batch {
    crosses: Vec<Cross>,
    /// Their products with nuisance and shared errors in one matrix.
    with: DMatrix<f64>,
}

impl Batch {
    /// Puts hypotheses side by side.
    pub fn new(crosses: Vec<Cross>) -> Self {
        let rows = crosses.first().map_or(0, |cross| cross.with.nrows());
        let mut with = DMatrix::zeros(rows, crosses.iter().map(|cross| cross.with.ncols()).sum());
        let mut first = 0;
        for cross in &crosses {
            with.columns_mut(first, cross.with.ncols()).copy_from(&cross.with);
            first += cross.with.ncols();
        }
        Self { crosses, with }
    }

    /// Each hypothesis with its first column.
    fn each(&self) -> impl Iterator<Item = (&Cross, usize)> {
        self.crosses.iter().scan(0, |next, cross| {
            let first = *next;
            *next += cross.own.ncols();
            Some((cross, first))
        })
    }
}

/// An hypothesis after nuisance and shared errors are projected out.
pub struct Projected {
    /// What is left of its columns' products.
    pub own: DMatrix<f64>,
    /// What is left of its products with the residual.
    pub response: DVector<f64>,
    /// The columns' norms before.
    pub before: Vec<f64>,
}

impl Factor {
    /// Whether neither postures nor cycles share errors.
    pub fn is_unshared(&self) -> bool {
        self.posture == 0.0 && self.cycle == 0.0
    }

    fn chosen_rows<'m>(&self, with: &'m DMatrix<f64>) -> Cow<'m, DMatrix<f64>> {
        if self.chosen.len() == with.nrows() { Cow::Borrowed(with) } else { Cow::Owned(with.select_rows(&self.chosen)) }
    }

    fn turned(&self, with: &DMatrix<f64>) -> DMatrix<f64> {
        let with = self.chosen_rows(with);
        let mut turned = DMatrix::zeros(with.nrows(), with.ncols());
        // Of a triangle only what is below its diagonal counts.
        for first in (0..with.nrows()).step_by(ROWS_AT_ONCE) {
            let rows = ROWS_AT_ONCE.min(with.nrows() - first);
            let left = self.inverse.view((first, 0), (rows, first + rows));
            turned.rows_mut(first, rows).gemm(1.0, &left, &with.rows(0, first + rows), 0.0);
        }
        turned
    }

    /// Projects an hypothesis.
    pub fn project(&self, cross: &Cross) -> Projected {
        let turned = self.turned(&cross.with);
        self.left(cross, turned.columns(0, turned.ncols()))
    }

    /// Projects hypotheses side by side.
    pub fn project_all(&self, batch: &Batch) -> Vec<Projected> {
        if batch.crosses.is_empty() {
            return Vec::new();
        }
        let turned = self.turned(&batch.with);
        batch.each().map(|(cross, first)| self.left(cross, turned.columns(first, cross.own.ncols()))).collect()
    }

    fn left(&self, cross: &Cross, turned: DMatrixView<'_, f64>) -> Projected {
        Projected {
            own: &cross.own - turned.transpose() * turned,
            response: &cross.response - turned.tr_mul(&self.right),
            before: cross.own.diagonal().iter().map(|value| value.sqrt()).collect(),
        }
    }

    /// The projected products of hypotheses with draws of noise: each's columns by draws.
    pub fn project_draws(&self, batch: &Batch, draws: &Draws<'_>) -> Vec<DMatrix<f64>> {
        if batch.crosses.is_empty() {
            return Vec::new();
        }
        let left = batch.with.transpose() * draws.shared - self.turned(&batch.with).transpose() * draws.turned;
        batch.each().map(|(cross, first)| &cross.drawn + left.rows(first, cross.own.ncols())).collect()
    }

    /// `L⁻¹` times the draws' products: what [`Factor::project_draws`] needs, once for all hypotheses.
    pub fn turn_draws(&self, normal: &Normal<'_>, shared: &DMatrix<f64>) -> DMatrix<f64> {
        self.turned(&(&normal.drawn_right + &normal.system.matrix * shared))
    }

    /// For each joint, over all visits: the sum of squares of what the residual says of its errors, and what noise of the
    /// present size would make of it (the score of a restricted likelihood, in two parts).
    pub fn joint_scores(&self, stage: &Stage, rows: &Rows, layout: &Layout, strata: &Strata) -> Vec<(f64, f64)> {
        let (own, joints) = (layout.nuisance, layout.joints);
        let covariance = self.inverse.transpose() * &self.inverse;
        let solution = self.inverse.transpose() * &self.right;
        let place_of = |column: usize| self.chosen.binary_search(&column).ok();
        let mut scores = vec![(0.0, 0.0); joints];
        for (block, raw) in stage.blocks.iter().zip(&rows.0) {
            let mut left = raw.clone();
            block.noise_factor(strata).0.solve_lower_triangular_mut(&mut left);
            let k = left.columns(own, joints);
            let mut columns: Vec<usize> = (0..own).collect();
            let mut parts = left.columns(0, own).into_owned();
            for place in layout.shared(block) {
                if let Some(place) = place_of(place) {
                    columns.extend(place..place + joints);
                    let width = parts.ncols();
                    parts = parts.resize_horizontally(width + joints, 0.0);
                    parts.columns_mut(width, joints).copy_from(&k);
                }
            }
            let own_covariance = covariance.select_rows(&columns).select_columns(&columns);
            let transposed = parts.transpose();
            let cross = &transposed * k;
            let left_over = left.column(own + joints) - &parts * solution.select_rows(&columns);
            let response = k.transpose() * left_over;
            let taken = &own_covariance * &cross;
            for joint in 0..joints {
                let expected = k.column(joint).norm_squared() - cross.column(joint).dot(&taken.column(joint));
                scores[joint].0 += response[joint].powi(2);
                scores[joint].1 += expected;
            }
        }
        scores
    }

    /// The solution for nuisance and shared errors, and the covariance of the first `count` of them.
    pub fn solution(&self, count: usize) -> (DVector<f64>, DMatrix<f64>) {
        let solution = self.inverse.tr_mul(&self.right);
        let first = self.inverse.columns(0, count);
        (solution.rows(0, count).into_owned(), first.transpose() * first)
    }
}

/// Of the square of a column that nuisance takes away all but this, the rest is rounding and linearisation.
const FAINT: f64 = 1e-6;

/// An hypothesis' directions that nuisance leaves, each of unit length: what turns responses into independent numbers.
pub struct Directions {
    /// Columns by directions.
    basis: DMatrix<f64>,
}

impl Projected {
    /// The directions that bear a test: those of which less than a part in `1 / FAINT` is left are given up.
    pub fn directions(&self) -> Directions {
        let scale: Vec<f64> = self.before.iter().map(|norm| if *norm > 0.0 { 1.0 / norm } else { 0.0 }).collect();
        let count = scale.len();
        let scaled = DMatrix::from_fn(count, count, |i, j| self.own[(i, j)] * scale[i] * scale[j]);
        let eigen = scaled.symmetric_eigen();
        let bearing: Vec<usize> = (0..count).filter(|&place| eigen.eigenvalues[place] > FAINT).collect();
        let basis = DMatrix::from_fn(count, bearing.len(), |i, j| {
            let place = bearing[j];
            scale[i] * eigen.eigenvectors[(i, place)] / eigen.eigenvalues[place].sqrt()
        });
        Directions { basis }
    }

    /// The drop of the sum of squares, how many directions bear it, and the coefficients.
    pub fn drop(&self) -> (f64, usize, DVector<f64>) {
        let directions = self.directions();
        let along = directions.basis.tr_mul(&self.response);
        (along.norm_squared(), directions.count(), &directions.basis * along)
    }
}

impl Directions {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.basis.ncols()
    }

    /// The drops of the sum of squares for many responses, one a column.
    pub fn drops(&self, responses: &DMatrix<f64>) -> Vec<f64> {
        let along = self.basis.transpose() * responses;
        along.column_iter().map(|column| column.norm_squared()).collect()
    }
}
