//! Normal equations of a stage under strata of noise.
//!
//! The covariance of all rows is `s_t² I + s_v² K Kᵀ` within a visit, plus errors of the joints that all visits of a posture
//! share (s_p) and that all visits of a cycle share (s_c). The first part whitens each visit by itself; the shared errors
//! stand beside the nuisance unknowns as columns with a prior, so that changing their size costs one small factor.

use nalgebra::{DMatrix, DVector};

use super::stage::{Column, Stage};

/// Standard deviations of the strata.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strata {
    /// Of one coordinate of one point, in units of the instrument's.
    pub point: f64,
    /// Of each joint at each visit, radians.
    pub visit: f64,
    /// Of each joint at each posture, shared by its visits, radians.
    pub posture: f64,
    /// Of each joint in each cycle, shared by its visits, radians.
    pub cycle: f64,
}

/// The rows of one visit, white but for what visits share.
#[derive(Debug, Clone)]
pub struct WhiteBlock {
    /// Rows by places.
    pub places: DMatrix<f64>,
    /// The residual.
    pub residual: DVector<f64>,
}

/// A stage whitened within its visits.
pub struct Whitened<'a> {
    /// The stage.
    pub stage: &'a Stage,
    /// The visits.
    pub blocks: Vec<WhiteBlock>,
    /// Logarithm of the determinant of the visits' covariance.
    log_determinant: f64,
}

impl<'a> Whitened<'a> {
    /// Whitens a stage by the noise of points and visits.
    pub fn new(stage: &'a Stage, strata: &Strata) -> Self {
        let mut log_determinant = 0.0;
        let blocks = stage
            .blocks
            .iter()
            .map(|block| {
                let mut white = WhiteBlock { places: block.places.clone(), residual: block.residual.clone() };
                for (row, &reach) in block.spectrum.iter().enumerate() {
                    let variance = strata.point.powi(2) + strata.visit.powi(2) * reach;
                    log_determinant += variance.ln();
                    let factor = 1.0 / variance.sqrt();
                    white.places.row_mut(row).scale_mut(factor);
                    white.residual[row] *= factor;
                }
                white
            })
            .collect();
        Self { stage, blocks, log_determinant }
    }

    /// A column's rows at a visit.
    pub fn rows_of(&self, column: &Column, visit: usize) -> DVector<f64> {
        let block = &self.blocks[visit];
        let mut rows = DVector::zeros(block.residual.len());
        for (place, amounts) in column {
            if amounts[visit] != 0.0 {
                rows.axpy(amounts[visit], &block.places.column(*place), 1.0);
            }
        }
        rows
    }

    fn nuisance_rows(&self, visit: usize) -> DMatrix<f64> {
        let columns: Vec<DVector<f64>> = self.stage.nuisance.iter().map(|column| self.rows_of(column, visit)).collect();
        match columns.is_empty() {
            true => DMatrix::zeros(self.blocks[visit].residual.len(), 0),
            false => DMatrix::from_columns(&columns),
        }
    }
}

/// Where shared errors stand among the columns: nuisance first, then posture by posture, then cycle by cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Nuisance columns.
    pub nuisance: usize,
    /// Joints.
    pub joints: usize,
    /// Postures with shared errors; zero where none is visited twice.
    pub postures: usize,
    /// Cycles with shared errors; zero where there are too few to tell.
    pub cycles: usize,
}

/// Cycles below this number cannot have a variance of their own.
const FEWEST_CYCLES: usize = 4;

impl Layout {
    fn new(stage: &Stage) -> Self {
        Self {
            nuisance: stage.nuisance.len(),
            joints: stage.places.joints(),
            postures: if stage.repeats() { stage.postures } else { 0 },
            cycles: if stage.repeats() && stage.cycles >= FEWEST_CYCLES { stage.cycles } else { 0 },
        }
    }

    /// All columns.
    pub fn count(&self) -> usize {
        self.nuisance + self.joints * (self.postures + self.cycles)
    }

    fn posture(&self, posture: usize) -> Option<usize> {
        (posture < self.postures).then(|| self.nuisance + self.joints * posture)
    }

    fn cycle(&self, cycle: usize) -> Option<usize> {
        (cycle < self.cycles).then(|| self.nuisance + self.joints * (self.postures + cycle))
    }
}

/// What an hypothesis' columns have in common with everything else.
#[derive(Debug, Clone)]
pub struct Cross {
    /// With nuisance and shared errors: rows of the layout by columns.
    pub with: DMatrix<f64>,
    /// Among themselves.
    pub own: DMatrix<f64>,
    /// With the residual.
    pub response: DVector<f64>,
    /// With each draw of white noise: columns by draws.
    pub drawn: DMatrix<f64>,
}

/// Normal equations of nuisance and shared errors, and what is needed for those of any further column.
pub struct Normal<'a> {
    /// The whitened stage.
    pub white: &'a Whitened<'a>,
    /// The layout of the columns.
    pub layout: Layout,
    /// Products of all columns.
    pub matrix: DMatrix<f64>,
    /// Products with the residual.
    pub right: DVector<f64>,
    /// Sum of squares of the residual.
    pub square: f64,
    /// Rows.
    pub rows: usize,
    /// For each visit `[nuisance | joints]ᵀ places`, and below it the residual's.
    products: Vec<DMatrix<f64>>,
    /// For each visit the draws' products with the places: draws by places.
    drawn: Vec<DMatrix<f64>>,
    /// Products of all columns with the draws.
    pub drawn_right: DMatrix<f64>,
}

impl<'a> Normal<'a> {
    /// The normal equations over the visits that are picked; `noise` gives for each visit rows of white noise, one column a
    /// draw.
    pub fn new(white: &'a Whitened<'a>, draws: usize, mut noise: impl FnMut(usize, usize) -> DMatrix<f64>) -> Self {
        let layout = Layout::new(white.stage);
        let (own, joints) = (layout.nuisance, layout.joints);
        let count = layout.count();
        let mut normal = Normal {
            white,
            layout,
            matrix: DMatrix::zeros(count, count),
            right: DVector::zeros(count),
            square: 0.0,
            rows: 0,
            products: Vec::with_capacity(white.blocks.len()),
            drawn: Vec::with_capacity(white.blocks.len()),
            drawn_right: DMatrix::zeros(count, draws),
        };
        for (visit, block) in white.blocks.iter().enumerate() {
            let rows = block.residual.len();
            normal.rows += rows;
            normal.square += block.residual.norm_squared();
            let mut left = DMatrix::zeros(rows, own + joints + 1);
            left.columns_mut(0, own).copy_from(&white.nuisance_rows(visit));
            left.columns_mut(own, joints).copy_from(&block.places.columns(0, joints));
            left.set_column(own + joints, &block.residual);
            let gram = left.tr_mul(&left);
            let shared: Vec<usize> =
                [layout.posture(white.stage.blocks[visit].posture), layout.cycle(white.stage.blocks[visit].cycle)]
                    .into_iter()
                    .flatten()
                    .collect();
            let mut add = |to: (usize, usize), from: (usize, usize), shape: (usize, usize)| {
                let mut part = normal.matrix.view_mut(to, shape);
                part += gram.view(from, shape);
            };
            add((0, 0), (0, 0), (own, own));
            for &place in &shared {
                add((0, place), (0, own), (own, joints));
                add((place, 0), (own, 0), (joints, own));
                for &other in &shared {
                    add((place, other), (own, own), (joints, joints));
                }
            }
            let mut right = normal.right.rows_mut(0, own);
            right += gram.view((0, own + joints), (own, 1));
            for &place in &shared {
                let mut right = normal.right.rows_mut(place, joints);
                right += gram.view((own, own + joints), (joints, 1));
            }
            if draws > 0 {
                let noise = noise(visit, rows);
                let with = left.columns(0, own + joints).tr_mul(&noise);
                let mut part = normal.drawn_right.rows_mut(0, own);
                part += with.rows(0, own);
                for &place in &shared {
                    let mut part = normal.drawn_right.rows_mut(place, joints);
                    part += with.rows(own, joints);
                }
                normal.drawn.push(noise.tr_mul(&block.places));
            }
            normal.products.push(left.tr_mul(&block.places));
        }
        normal
    }

    /// The products of an hypothesis' columns.
    pub fn cross(&self, columns: &[Column]) -> Cross {
        let layout = self.layout;
        let (own, joints) = (layout.nuisance, layout.joints);
        let draws = self.drawn_right.ncols();
        let mut cross = Cross {
            with: DMatrix::zeros(layout.count(), columns.len()),
            own: DMatrix::zeros(columns.len(), columns.len()),
            response: DVector::zeros(columns.len()),
            drawn: DMatrix::zeros(columns.len(), draws),
        };
        let mut drawn = DVector::zeros(draws);
        for (rank, column) in columns.iter().enumerate() {
            drawn.fill(0.0);
            for (place, amounts) in column {
                for (visit, &amount) in amounts.iter().enumerate().filter(|(_, amount)| **amount != 0.0) {
                    let product = self.products[visit].column(*place);
                    let block = &self.white.stage.blocks[visit];
                    let mut with = cross.with.column_mut(rank);
                    with.rows_mut(0, own).axpy(amount, &product.rows(0, own), 1.0);
                    for place in [layout.posture(block.posture), layout.cycle(block.cycle)].into_iter().flatten() {
                        with.rows_mut(place, joints).axpy(amount, &product.rows(own, joints), 1.0);
                    }
                    cross.response[rank] += amount * product[own + joints];
                    if draws > 0 {
                        drawn.axpy(amount, &self.drawn[visit].column(*place), 1.0);
                    }
                }
            }
            cross.drawn.row_mut(rank).copy_from(&drawn.transpose());
        }
        for visit in 0..self.white.blocks.len() {
            if columns.iter().all(|column| column.iter().all(|(_, amounts)| amounts[visit] == 0.0)) {
                continue;
            }
            let rows: Vec<DVector<f64>> = columns.iter().map(|column| self.white.rows_of(column, visit)).collect();
            for i in 0..rows.len() {
                for j in 0..=i {
                    cross.own[(i, j)] += rows[i].dot(&rows[j]);
                }
            }
        }
        cross.own.fill_upper_triangle_with_lower_triangle();
        cross
    }

    /// The factor under given sizes of the shared errors; none where it is singular.
    pub fn factor(&self, posture: f64, cycle: f64) -> Option<Factor> {
        let Layout { nuisance, joints, postures, cycles } = self.layout;
        let with_postures = if posture > 0.0 { joints * postures } else { 0 };
        let with_cycles = if cycle > 0.0 { joints * cycles } else { 0 };
        let chosen: Vec<usize> = (0..nuisance + with_postures)
            .chain((0..with_cycles).map(|rank| nuisance + joints * postures + rank))
            .collect();
        let mut matrix = self.matrix.select_rows(&chosen).select_columns(&chosen);
        let mut log_prior = 0.0;
        for rank in 0..with_postures + with_cycles {
            let sigma = if rank < with_postures { posture } else { cycle };
            matrix[(nuisance + rank, nuisance + rank)] += sigma.powi(-2);
            log_prior += 2.0 * sigma.ln();
        }
        let scale: Vec<f64> = (0..chosen.len()).map(|i| 1.0 / matrix[(i, i)].max(f64::MIN_POSITIVE).sqrt()).collect();
        for i in 0..chosen.len() {
            for j in 0..chosen.len() {
                matrix[(i, j)] *= scale[i] * scale[j];
            }
        }
        let lower = matrix.cholesky()?.unpack();
        let log_factor: f64 =
            lower.diagonal().iter().zip(&scale).map(|(value, scale)| 2.0 * (value.ln() - scale.ln())).sum();
        let mut inverse = lower.solve_lower_triangular(&DMatrix::identity(chosen.len(), chosen.len()))?;
        for (j, scale) in scale.iter().enumerate() {
            inverse.column_mut(j).scale_mut(*scale);
        }
        let right = &inverse * self.right.select_rows(&chosen);
        let square = self.square - right.norm_squared();
        let log_likelihood = -0.5 * (self.white.log_determinant + log_prior + log_factor + square);
        Some(Factor { chosen, inverse, right, square, log_likelihood, posture, cycle })
    }
}

/// The inverse factor of the normal equations under given sizes of the shared errors.
pub struct Factor {
    chosen: Vec<usize>,
    /// `L⁻¹` of `L Lᵀ`, unscaled.
    inverse: DMatrix<f64>,
    right: DVector<f64>,
    /// Sum of squares that is left.
    pub square: f64,
    /// Restricted log likelihood, but for a constant.
    pub log_likelihood: f64,
    /// Size of the postures' errors.
    pub posture: f64,
    /// Size of the cycles' errors.
    pub cycle: f64,
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
    fn chosen_rows(&self, with: &DMatrix<f64>) -> DMatrix<f64> {
        if self.chosen.len() == with.nrows() { with.clone() } else { with.select_rows(&self.chosen) }
    }

    /// Projects an hypothesis.
    pub fn project(&self, cross: &Cross) -> Projected {
        let turned = &self.inverse * self.chosen_rows(&cross.with);
        Projected {
            own: &cross.own - turned.tr_mul(&turned),
            response: &cross.response - turned.tr_mul(&self.right),
            before: cross.own.diagonal().iter().map(|value| value.sqrt()).collect(),
        }
    }

    /// The projected products of an hypothesis with draws of noise whose shared errors are `shared` (rows of the layout by
    /// draws, zero for the nuisance): columns by draws.
    pub fn project_draws(&self, cross: &Cross, drawn: &DMatrix<f64>, shared: &DMatrix<f64>) -> DMatrix<f64> {
        let turned = &self.inverse * self.chosen_rows(&cross.with);
        &cross.drawn + cross.with.tr_mul(shared) - turned.tr_mul(drawn)
    }

    /// `L⁻¹` times the draws' products: what [`Factor::project_draws`] needs, once for all hypotheses.
    pub fn turn_draws(&self, normal: &Normal<'_>, shared: &DMatrix<f64>) -> DMatrix<f64> {
        let all = &normal.drawn_right + &normal.matrix * shared;
        &self.inverse * self.chosen_rows(&all)
    }

    /// The solution for nuisance and shared errors, and the covariance of the first `count` of them.
    pub fn solution(&self, count: usize) -> (DVector<f64>, DMatrix<f64>) {
        let solution = self.inverse.tr_mul(&self.right);
        let first = self.inverse.columns(0, count);
        (solution.rows(0, count).into_owned(), first.tr_mul(&first))
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
        let along = self.basis.tr_mul(responses);
        along.column_iter().map(|column| column.norm_squared()).collect()
    }
}
