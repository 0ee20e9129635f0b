//! Normal equations of a stage under strata of noise.
//!
//! The covariance of all rows is `s_t² I + s_v² K Kᵀ` within a visit, plus errors of the joints that all visits of a posture
//! share (s_p) and that all visits of a cycle share (s_c). The first part whitens each visit by itself; the shared errors
//! stand beside the nuisance unknowns as columns with a prior, so that changing their size costs one small factor.

use nalgebra::{DMatrix, DVector};

use super::factor::Factor;
use super::stage::{Column, Stage};

/// Standard deviations of the strata.
#[derive(Debug, Clone, PartialEq)]
pub struct Strata {
    /// Of one coordinate of one point, in units of the instrument's.
    pub point: f64,
    /// Of each joint from visit to visit, radians.
    pub visit: Vec<f64>,
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
}

/// The rows `[nuisance | joints | residual]` of every visit of a stage, before whitening: the same whatever the noise.
pub struct Rows(pub(super) Vec<DMatrix<f64>>);

impl Rows {
    /// The rows of a stage.
    pub fn new(stage: &Stage) -> Self {
        let (own, joints) = (stage.nuisance.len(), stage.places.joints());
        let of_visit = |(visit, block): (usize, &super::stage::Block)| {
            let mut left = DMatrix::zeros(block.residual.len(), own + joints + 1);
            for (rank, column) in stage.nuisance.iter().enumerate() {
                for (place, amounts) in column {
                    left.column_mut(rank).axpy(amounts[visit], &block.places.column(*place), 1.0);
                }
            }
            left.columns_mut(own, joints).copy_from(&block.places.columns(0, joints));
            left.set_column(own + joints, &block.residual);
            left
        };
        Self(stage.blocks.iter().enumerate().map(of_visit).collect())
    }
}

impl super::stage::Block {
    /// The lower factor of the covariance of a visit's rows under the noise of points and visits, and the logarithm of its
    /// determinant.
    pub(super) fn noise_factor(&self, strata: &Strata) -> (DMatrix<f64>, f64) {
        let mut spread = self.places.columns(0, strata.visit.len()).into_owned();
        for (mut column, sigma) in spread.column_iter_mut().zip(&strata.visit) {
            column.scale_mut(*sigma);
        }
        let mut covariance = &spread * spread.transpose();
        for row in 0..covariance.nrows() {
            covariance[(row, row)] += strata.point.powi(2);
        }
        // The noise of a point is positive, so that the covariance has a factor.
        let lower = covariance.cholesky().map_or_else(
            || DMatrix::from_diagonal_element(self.residual.len(), self.residual.len(), strata.point),
            |factor| factor.unpack(),
        );
        let log_determinant = lower.diagonal().iter().map(|value| 2.0 * value.ln()).sum();
        (lower, log_determinant)
    }
}

impl<'a> Whitened<'a> {
    /// Whitens a stage by the noise of points and visits.
    pub fn new(stage: &'a Stage, strata: &Strata) -> Self {
        let blocks = stage
            .blocks
            .iter()
            .map(|block| {
                let (lower, _) = block.noise_factor(strata);
                let mut white = WhiteBlock { places: block.places.clone(), residual: block.residual.clone() };
                lower.solve_lower_triangular_mut(&mut white.places);
                lower.solve_lower_triangular_mut(&mut white.residual);
                white
            })
            .collect();
        Self { stage, blocks }
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

/// Of the square of a scaled column, what is added to it: columns that others make but for less than this would take steps
/// of nothing but rounding. Steps along them become shorter; where they lead stays.
const DAMPING: f64 = 1e-8;

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

    /// Where the errors that a visit shares begin.
    pub(super) fn shared(&self, block: &super::stage::Block) -> impl Iterator<Item = usize> + Clone {
        [self.posture(block.posture), self.cycle(block.cycle)].into_iter().flatten()
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

/// Normal equations of nuisance and shared errors.
pub struct System {
    /// The layout of the columns.
    pub layout: Layout,
    /// Products of all columns.
    pub matrix: DMatrix<f64>,
    /// Products with the residual.
    pub right: DVector<f64>,
    /// Sum of squares of the residual.
    square: f64,
    /// Logarithm of the determinant of the visits' covariance.
    log_determinant: f64,
}

impl System {
    /// The normal equations of a stage's rows under given noise of points and visits.
    pub fn new(stage: &Stage, rows: &Rows, strata: &Strata) -> Self {
        let layout = Layout::new(stage);
        let (own, joints) = (layout.nuisance, layout.joints);
        let count = layout.count();
        let mut system = System {
            layout,
            matrix: DMatrix::zeros(count, count),
            right: DVector::zeros(count),
            square: 0.0,
            log_determinant: 0.0,
        };
        for (block, raw) in stage.blocks.iter().zip(&rows.0) {
            let mut left = raw.clone();
            let (lower, log_determinant) = block.noise_factor(strata);
            system.log_determinant += log_determinant;
            lower.solve_lower_triangular_mut(&mut left);
            // By the general product, which is blocked; the transposed one is not.
            let gram = left.transpose() * &left;
            system.square += gram[(own + joints, own + joints)];
            let shared = layout.shared(block);
            let mut add = |to: (usize, usize), from: (usize, usize), shape: (usize, usize)| {
                let mut part = system.matrix.view_mut(to, shape);
                part += gram.view(from, shape);
            };
            add((0, 0), (0, 0), (own, own));
            for place in shared.clone() {
                add((0, place), (0, own), (own, joints));
                add((place, 0), (own, 0), (joints, own));
                for other in shared.clone() {
                    add((place, other), (own, own), (joints, joints));
                }
            }
            let mut right = system.right.rows_mut(0, own);
            right += gram.view((0, own + joints), (own, 1));
            for place in shared {
                let mut right = system.right.rows_mut(place, joints);
                right += gram.view((own, own + joints), (joints, 1));
            }
        }
        system
    }

    /// Columns that take part under given sizes of the shared errors, their scaled lower factor and their scale; with the
    /// logarithms of the determinants of prior and factor.
    fn triangle(&self, posture: f64, cycle: f64) -> Option<Triangle> {
        let Layout { nuisance, joints, postures, cycles } = self.layout;
        let with_postures = if posture > 0.0 { joints * postures } else { 0 };
        let with_cycles = if cycle > 0.0 { joints * cycles } else { 0 };
        let chosen: Vec<usize> = (0..nuisance + with_postures)
            .chain((0..with_cycles).map(|rank| nuisance + joints * postures + rank))
            .collect();
        let prior = |rank: usize| match rank.checked_sub(nuisance) {
            None => None,
            Some(rank) if rank < with_postures => Some(posture),
            Some(_) => Some(cycle),
        };
        let log_prior: f64 = (0..chosen.len()).filter_map(prior).map(|sigma| 2.0 * sigma.ln()).sum();
        let own = |rank: usize| {
            self.matrix[(chosen[rank], chosen[rank])] + prior(rank).map_or(0.0, |sigma: f64| sigma.powi(-2))
        };
        let scale: Vec<f64> = (0..chosen.len()).map(|rank| 1.0 / own(rank).max(f64::MIN_POSITIVE).sqrt()).collect();
        let matrix = DMatrix::from_fn(chosen.len(), chosen.len(), |i, j| match i == j {
            true => own(i) * scale[i] * scale[i] + DAMPING,
            false => self.matrix[(chosen[i], chosen[j])] * scale[i] * scale[j],
        });
        let lower = matrix.cholesky()?.unpack();
        let log_factor: f64 =
            lower.diagonal().iter().zip(&scale).map(|(value, scale)| 2.0 * (value.ln() - scale.ln())).sum();
        Some(Triangle { chosen, lower, scale, log_determinants: log_prior + log_factor })
    }

    /// The square of the residual as it stands, in units of the noise, errors that postures and cycles share included.
    pub fn merit(&self, posture: f64, cycle: f64) -> Option<f64> {
        let Layout { nuisance, joints, postures, .. } = self.layout;
        let first_cycle = nuisance + joints * postures;
        let sigma = |place: usize| if place < first_cycle { posture } else { cycle };
        let shared: Vec<usize> = (nuisance..self.layout.count()).filter(|&place| sigma(place) > 0.0).collect();
        if shared.is_empty() {
            return Some(self.square);
        }
        // In units of the shared errors' own sizes: what is visited once changes nothing.
        let matrix = DMatrix::from_fn(shared.len(), shared.len(), |i, j| {
            let own = self.matrix[(shared[i], shared[j])] * sigma(shared[i]) * sigma(shared[j]);
            if i == j { own + 1.0 } else { own }
        });
        let right = DVector::from_fn(shared.len(), |i, _| self.right[shared[i]] * sigma(shared[i]));
        Some(self.square - right.dot(&matrix.cholesky()?.solve(&right)))
    }

    fn likelihood_with(&self, log_determinants: f64, square: f64) -> f64 {
        -0.5 * (self.log_determinant + log_determinants + square)
    }

    /// The restricted log likelihood under given sizes of the shared errors, but for a constant.
    pub fn log_likelihood(&self, posture: f64, cycle: f64) -> f64 {
        let Some(triangle) = self.triangle(posture, cycle) else { return f64::NEG_INFINITY };
        let right = DVector::from_fn(triangle.chosen.len(), |i, _| self.right[triangle.chosen[i]] * triangle.scale[i]);
        match triangle.lower.solve_lower_triangular(&right) {
            Some(right) => self.likelihood_with(triangle.log_determinants, self.square - right.norm_squared()),
            None => f64::NEG_INFINITY,
        }
    }

    /// The inverse factor under given sizes of the shared errors; none where it is singular.
    pub fn factor(&self, posture: f64, cycle: f64) -> Option<Factor> {
        let Triangle { chosen, lower, scale, log_determinants } = self.triangle(posture, cycle)?;
        let mut inverse = lower.solve_lower_triangular(&DMatrix::identity(chosen.len(), chosen.len()))?;
        for (j, scale) in scale.iter().enumerate() {
            inverse.column_mut(j).scale_mut(*scale);
        }
        let right = &inverse * self.right.select_rows(&chosen);
        let log_likelihood = self.likelihood_with(log_determinants, self.square - right.norm_squared());
        Some(Factor { chosen, inverse, right, log_likelihood, posture, cycle })
    }
}

struct Triangle {
    chosen: Vec<usize>,
    lower: DMatrix<f64>,
    scale: Vec<f64>,
    log_determinants: f64,
}

/// A system with what is needed for the products of any further column.
pub struct Normal<'a> {
    /// The whitened stage.
    pub white: Whitened<'a>,
    /// The normal equations.
    pub system: System,
    /// For each visit `[nuisance | joints | residual]ᵀ places`.
    products: Vec<DMatrix<f64>>,
    /// For each visit the draws' products with the places: draws by places.
    drawn: Vec<DMatrix<f64>>,
    /// Products of all columns with the draws.
    pub drawn_right: DMatrix<f64>,
}

impl<'a> Normal<'a> {
    /// The normal equations of a stage.
    pub fn new(stage: &'a Stage, strata: &Strata) -> Self {
        Self::with_draws(stage, strata, 0, |_| DMatrix::zeros(0, 0))
    }

    /// The same with draws of noise: `noise` gives for so many rows white noise, one column a draw.
    pub fn with_draws(
        stage: &'a Stage,
        strata: &Strata,
        draws: usize,
        mut noise: impl FnMut(usize) -> DMatrix<f64>,
    ) -> Self {
        let white = Whitened::new(stage, strata);
        let rows = Rows::new(stage);
        let system = System::new(stage, &rows, strata);
        let (own, joints) = (system.layout.nuisance, system.layout.joints);
        let mut drawn_right = DMatrix::zeros(system.layout.count(), draws);
        let mut drawn = Vec::new();
        let mut products = Vec::with_capacity(stage.blocks.len());
        for ((block, raw), white) in stage.blocks.iter().zip(&rows.0).zip(&white.blocks) {
            let mut left = raw.clone();
            block.noise_factor(strata).0.solve_lower_triangular_mut(&mut left);
            let transposed = left.transpose();
            if draws > 0 {
                let noise = noise(left.nrows());
                let with = transposed.rows(0, own + joints) * &noise;
                let mut part = drawn_right.rows_mut(0, own);
                part += with.rows(0, own);
                for place in system.layout.shared(block) {
                    let mut part = drawn_right.rows_mut(place, joints);
                    part += with.rows(own, joints);
                }
                drawn.push(noise.transpose() * &white.places);
            }
            products.push(transposed * &white.places);
        }
        Self { white, system, products, drawn, drawn_right }
    }

    /// The products of one place's unit amounts, a column for each posture. Those among themselves are diagonal.
    pub fn cross_at_postures(&self, place: usize) -> Cross {
        let layout = self.system.layout;
        let (own, joints) = (layout.nuisance, layout.joints);
        let (draws, postures) = (self.drawn_right.ncols(), self.white.stage.postures);
        let mut cross = Cross {
            with: DMatrix::zeros(layout.count(), postures),
            own: DMatrix::zeros(postures, postures),
            response: DVector::zeros(postures),
            drawn: DMatrix::zeros(postures, draws),
        };
        for (visit, block) in self.white.stage.blocks.iter().enumerate() {
            let rank = block.posture;
            let product = self.products[visit].column(place);
            let mut with = cross.with.column_mut(rank);
            with.rows_mut(0, own).axpy(1.0, &product.rows(0, own), 1.0);
            for shared in layout.shared(block) {
                with.rows_mut(shared, joints).axpy(1.0, &product.rows(own, joints), 1.0);
            }
            cross.response[rank] += product[own + joints];
            cross.own[(rank, rank)] += self.white.blocks[visit].places.column(place).norm_squared();
            if draws > 0 {
                let mut drawn = cross.drawn.row_mut(rank);
                drawn += self.drawn[visit].column(place).transpose();
            }
        }
        cross
    }

    /// The products of an hypothesis' columns.
    pub fn cross(&self, columns: &[Column]) -> Cross {
        let layout = self.system.layout;
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
                    for place in layout.shared(block) {
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
        self.own_products(columns, &mut cross.own);
        cross.own.fill_upper_triangle_with_lower_triangle();
        cross
    }

    /// The lower triangle of the products of columns among themselves.
    fn own_products(&self, columns: &[Column], own: &mut DMatrix<f64>) {
        let single: Option<Vec<(usize, &[f64])>> = columns
            .iter()
            .map(|column| match column.as_slice() {
                [(place, amounts)] => Some((*place, amounts.as_slice())),
                _ => None,
            })
            .collect();
        for (visit, block) in self.white.blocks.iter().enumerate() {
            if columns.iter().all(|column| column.iter().all(|(_, amounts)| amounts[visit] == 0.0)) {
                continue;
            }
            // Most hypotheses act in one place each; their rows need not be laid out.
            if let Some(single) = &single {
                for (i, (one, amounts)) in single.iter().enumerate() {
                    for (j, (other, others)) in single[..=i].iter().enumerate() {
                        let amount = amounts[visit] * others[visit];
                        if amount != 0.0 {
                            own[(i, j)] += amount * block.places.column(*one).dot(&block.places.column(*other));
                        }
                    }
                }
                continue;
            }
            let rows: Vec<DVector<f64>> = columns.iter().map(|column| self.white.rows_of(column, visit)).collect();
            for i in 0..rows.len() {
                for j in 0..=i {
                    own[(i, j)] += rows[i].dot(&rows[j]);
                }
            }
        }
    }
}
