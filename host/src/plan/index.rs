//! What "best" means: observability indices of the whitened and scaled Jacobian `J` of a set of poses, and what a pose more
//! or less does to them.
//!
//! With the information `M = JᵀJ`, its inverse `C` (the covariance of the scaled unknowns) and `p` unknowns:
//!
//! | criterion | index (larger is better) | also known as |
//! | --- | --- | --- |
//! | D | `(det M)^(1/2p)` | O1 times the root of the number of poses (Borm and Menq 1991): the volume of the confidence region |
//! | A | `(p / tr C)^(1/2)` | the root mean square standard deviation |
//! | E | `λ_min(M)^(1/2)` | O3 (Nahvi and Hollerbach 1996): the worst known combination of unknowns |
//! | V | `(1 / tr(W C))^(1/2)` | the predicted position, root mean square over the working volume |
//!
//! A pose adds `JₓᵀJₓ` of rank six or so: `det` and traces of the changed inverse follow from the `6 × 6` matrix
//! `I ± Jₓ C Jₓᵀ`. The smallest eigenvalue has no such formula; it is computed for the poses that promise most to first order.

use nalgebra::{Cholesky, DMatrix, Dyn};

/// What "best" means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Criterion {
    /// The determinant.
    #[default]
    D,
    /// The mean variance of the unknowns.
    A,
    /// The smallest eigenvalue.
    E,
    /// The mean variance of predicted positions.
    V,
}

impl Criterion {
    /// Its letter.
    pub fn letter(self) -> char {
        match self {
            Criterion::D => 'D',
            Criterion::A => 'A',
            Criterion::E => 'E',
            Criterion::V => 'V',
        }
    }
}

/// A criterion ready to be asked.
#[derive(Debug, Clone)]
pub struct Index {
    criterion: Criterion,
    /// The weights of variances, for A and V.
    weights: DMatrix<f64>,
}

/// Poses that the smallest eigenvalue is computed for, of all that could be added.
const SHORT_LIST: usize = 16;

/// A set's information with what follows from it.
#[derive(Debug, Clone)]
pub struct Information {
    matrix: DMatrix<f64>,
    covariance: DMatrix<f64>,
    /// The logarithm of the index, times two (times 2p for D): what is compared.
    pub(super) value: f64,
    /// What the first order of the smallest eigenvalue needs: its vector, for E.
    weakest: Option<DMatrix<f64>>,
    /// `C W C`, for A and V.
    spread: Option<DMatrix<f64>>,
}

impl Information {
    /// The covariance of the scaled unknowns.
    pub fn covariance(&self) -> &DMatrix<f64> {
        &self.covariance
    }
}

fn log_determinant(cholesky: &Cholesky<f64, Dyn>) -> f64 {
    2.0 * cholesky.l_dirty().diagonal().iter().map(|entry| entry.ln()).sum::<f64>()
}

fn smallest_eigenvalue(matrix: &DMatrix<f64>) -> f64 {
    matrix.symmetric_eigenvalues().iter().copied().fold(f64::INFINITY, f64::min)
}

impl Index {
    /// A criterion for `unknowns` columns. `positions` are the derivatives of positions in the working volume by the scaled
    /// unknowns: what V weighs by.
    pub fn new(criterion: Criterion, unknowns: usize, positions: &[DMatrix<f64>]) -> Self {
        let weights = match criterion {
            Criterion::V => {
                let sum = positions.iter().fold(DMatrix::zeros(unknowns, unknowns), |sum, own| sum + own.tr_mul(own));
                let targets = positions.iter().map(|own| own.nrows() / 3).sum::<usize>().max(1);
                sum / targets as f64
            }
            _ => DMatrix::identity(unknowns, unknowns) / unknowns as f64,
        };
        Self { criterion, weights }
    }

    /// The criterion.
    pub fn criterion(&self) -> Criterion {
        self.criterion
    }

    /// The information of a set; none where it does not tell all unknowns.
    pub fn of<'r>(&self, rows: impl Iterator<Item = &'r DMatrix<f64>>) -> Option<Information> {
        let unknowns = self.weights.ncols();
        let matrix = rows.fold(DMatrix::zeros(unknowns, unknowns), |mut sum, own| {
            sum.gemm_tr(1.0, own, own, 1.0);
            sum
        });
        self.of_matrix(matrix)
    }

    pub(super) fn of_matrix(&self, matrix: DMatrix<f64>) -> Option<Information> {
        // Squares of 1e-7, below which `calibrate::rank` calls unknowns dependent.
        const DEPENDENT: f64 = 1e-14;
        let cholesky = Cholesky::new(matrix.clone())?;
        let own = cholesky.l_dirty().diagonal();
        if own.iter().zip(&matrix.diagonal()).any(|(left, all)| left * left <= DEPENDENT * all) {
            return None;
        }
        let covariance = cholesky.inverse();
        let (mut weakest, mut spread) = (None, None);
        let value = match self.criterion {
            Criterion::D => log_determinant(&cholesky),
            Criterion::A | Criterion::V => {
                spread = Some(&covariance * &self.weights * &covariance);
                -self.weights.dot(&covariance).ln()
            }
            Criterion::E => {
                let eigen = matrix.clone().symmetric_eigen();
                let (place, smallest) = eigen.eigenvalues.argmin();
                weakest = Some(DMatrix::from_column_slice(
                    eigen.eigenvectors.nrows(),
                    1,
                    eigen.eigenvectors.column(place).as_slice(),
                ));
                smallest.ln()
            }
        };
        value.is_finite().then_some(Information { matrix, covariance, value, weakest, spread })
    }

    /// The index as the table above has it, from its logarithm.
    pub fn index(&self, information: &Information) -> f64 {
        let halves = match self.criterion {
            Criterion::D => 0.5 / self.weights.ncols() as f64,
            _ => 0.5,
        };
        (halves * information.value).exp()
    }

    /// The logarithm after a pose is added (`sign` 1) or removed (`sign` -1); none where too little would be left.
    pub(super) fn after(&self, information: &Information, rows: &DMatrix<f64>, sign: f64) -> Option<f64> {
        let half = rows * &information.covariance;
        let mut inner = DMatrix::identity(rows.nrows(), rows.nrows());
        inner.gemm(sign, &half, &rows.transpose(), 1.0);
        let cholesky = Cholesky::new(inner)?;
        let after = match (self.criterion, &information.spread) {
            (Criterion::D, _) => information.value + log_determinant(&cholesky),
            (Criterion::A | Criterion::V, Some(spread)) => {
                let change = cholesky.solve(&(rows * spread * rows.transpose())).trace();
                let variance = (-information.value).exp() - sign * change;
                if variance <= 0.0 {
                    return None;
                }
                -variance.ln()
            }
            _ => {
                let mut matrix = information.matrix.clone();
                matrix.gemm_tr(sign, rows, rows, 1.0);
                let smallest = smallest_eigenvalue(&matrix);
                if smallest <= 0.0 {
                    return None;
                }
                smallest.ln()
            }
        };
        after.is_finite().then_some(after)
    }

    /// The pose among `poses` that raises the index most, with the logarithm after it is added.
    pub(super) fn best_to_add(
        &self,
        information: &Information,
        rows: &[DMatrix<f64>],
        poses: impl Iterator<Item = usize>,
    ) -> Option<(usize, f64)> {
        let mut poses: Vec<usize> = poses.collect();
        if let Some(weakest) = &information.weakest {
            let promises = |pose: &usize| (&rows[*pose] * weakest).norm_squared();
            poses.sort_by(|one, other| promises(other).total_cmp(&promises(one)));
            poses.truncate(SHORT_LIST);
        }
        poses
            .into_iter()
            .filter_map(|pose| Some((pose, self.after(information, &rows[pose], 1.0)?)))
            .max_by(|one, other| one.1.total_cmp(&other.1))
    }

    /// The smallest share of the best index that any set of as many of these poses (with repetition) can have missed, for D:
    /// `p / max tr(Jₓ (M/n)⁻¹ Jₓᵀ)`, by the arithmetic and the geometric mean of the eigenvalues of `M⁻¹ M*`.
    pub(super) fn least_efficiency(
        &self,
        information: &Information,
        count: usize,
        rows: &[DMatrix<f64>],
    ) -> Option<f64> {
        if self.criterion != Criterion::D {
            return None;
        }
        let most = rows.iter().map(|own| (own * &information.covariance).dot(own)).fold(0.0, f64::max);
        // The root of the index's own exponent: det M to the power 1/2p.
        Some((self.weights.ncols() as f64 / (count as f64 * most)).sqrt().min(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows that look random and are the same everywhere.
    fn rows(seed: u32, count: usize, unknowns: usize) -> DMatrix<f64> {
        let mut state = seed;
        DMatrix::from_fn(count, unknowns, |_, _| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 23) - 1.0
        })
    }

    #[test]
    fn what_an_exchange_promises_is_what_the_changed_set_has() {
        let all: Vec<DMatrix<f64>> = (0..12).map(|seed| rows(seed, 3, 7)).collect();
        let volume: Vec<DMatrix<f64>> = (50..60).map(|seed| rows(seed, 3, 7)).collect();
        for criterion in [Criterion::D, Criterion::A, Criterion::E, Criterion::V] {
            let index = Index::new(criterion, 7, &volume);
            let set = index.of(all[..8].iter()).expect("24 rows of 7 unknowns");
            for (place, sign) in [(9, 1.0), (11, 1.0), (3, -1.0), (6, -1.0)] {
                let promised = index.after(&set, &all[place], sign).expect("enough is left");
                let changed: Vec<&DMatrix<f64>> = if sign > 0.0 {
                    all[..8].iter().chain([&all[place]]).collect()
                } else {
                    (0..8).filter(|&own| own != place).map(|own| &all[own]).collect()
                };
                let had = index.of(changed.into_iter()).expect("enough is left").value;
                // Matrices of order seven and condition below a thousand.
                assert!((promised - had).abs() < 1e-10, "{criterion:?}: {promised} {had}");
            }
            // Index 1 is one standard deviation, whatever the criterion.
            let (value, exact) = (index.index(&set), set.covariance().trace());
            if criterion == Criterion::A {
                assert!((value - (7.0 / exact).sqrt()).abs() < 1e-12 * value);
            }
        }
    }

    #[test]
    fn a_set_that_does_not_tell_all_has_no_index() {
        let all: Vec<DMatrix<f64>> = (0..2).map(|seed| rows(seed, 3, 7)).collect();
        assert!(Index::new(Criterion::D, 7, &[]).of(all.iter()).is_none());
    }
}
