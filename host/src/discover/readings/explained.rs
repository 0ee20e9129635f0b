//! Least squares by projection: what other columns explain is taken away, and a shape is judged by what it explains of
//! the rest.

use crate::discover::chance::ln_likelihood_ratio;

/// A column of which less than this share is left by the columns before it adds nothing but rounding.
const FAINT: f64 = 1e-7;

/// Orthonormal columns: what is explained.
#[derive(Clone)]
pub(super) struct Explained {
    columns: Vec<Vec<f64>>,
}

impl Explained {
    /// What a constant and these columns explain.
    pub fn by(rows: usize, columns: impl IntoIterator<Item = Vec<f64>>) -> Self {
        let mut explained = Self { columns: Vec::new() };
        explained.add(vec![1.0; rows]);
        columns.into_iter().for_each(|column| explained.add(column));
        explained
    }

    /// One column more.
    pub fn add(&mut self, column: Vec<f64>) {
        let before = dot(&column, &column).sqrt();
        // Twice: after once, rounding leaves collinear columns far from orthogonal.
        let mut rest = self.rest(&self.rest(&column));
        let norm = dot(&rest, &rest).sqrt();
        if norm > FAINT * before {
            rest.iter_mut().for_each(|value| *value /= norm);
            self.columns.push(rest);
        }
    }

    /// What is not explained of a column.
    pub fn rest(&self, column: &[f64]) -> Vec<f64> {
        let mut rest = column.to_vec();
        for known in &self.columns {
            let share = dot(known, &rest);
            rest.iter_mut().zip(known).for_each(|(rest, known)| *rest -= share * known);
        }
        rest
    }

    /// For each row, the square of what is not explained of a column that is 0 before it and 1 from it on.
    pub fn step_squares(&self) -> Vec<f64> {
        let rows = self.columns.first().map_or(0, Vec::len);
        let mut squares: Vec<f64> = (0..rows).map(|row| (rows - row) as f64).collect();
        for column in &self.columns {
            let mut sum = 0.0;
            for row in (0..rows).rev() {
                sum += column[row];
                squares[row] -= sum * sum;
            }
        }
        squares
    }
}

/// A sum of products.
pub(super) fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(left, right)| left * right).sum()
}

/// A response after what is explained of it is taken away.
pub(super) struct Response {
    /// What explains.
    pub explained: Explained,
    /// What is left.
    pub rest: Vec<f64>,
    /// Its square.
    pub square: f64,
}

/// How a shape explains what is left of a response.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// The shape's coefficient.
    pub coefficient: f64,
    /// Square that it explains over the square that is then left.
    pub ratio: f64,
    /// Square of what is left after it, by row.
    pub left: f64,
}

impl Response {
    /// A response and what explains it.
    pub fn new(explained: Explained, response: &[f64]) -> Self {
        let rest = explained.rest(response);
        let square = dot(&rest, &rest);
        Self { explained, rest, square }
    }

    /// How a shape explains the rest; none where nothing is left of the shape.
    pub fn fit(&self, shape: &[f64]) -> Option<Fit> {
        let own = self.explained.rest(shape);
        let square = dot(&own, &own);
        (square > FAINT * dot(shape, shape)).then(|| self.fit_to(dot(&own, &self.rest), square))
    }

    /// The same from the shape's product with the rest and the square of its own rest.
    pub fn fit_to(&self, product: f64, square: f64) -> Fit {
        let gain = product * product / square;
        let left = (self.square - gain).max(1e-12 * self.square).max(f64::MIN_POSITIVE);
        Fit { coefficient: product / square, ratio: gain / left, left: left / self.rest.len() as f64 }
    }

    /// Coefficients of two shapes fitted together.
    pub fn fit_two(&self, shapes: [&[f64]; 2]) -> Option<[f64; 2]> {
        let own = shapes.map(|shape| self.explained.rest(shape));
        let [a, b, c] = [dot(&own[0], &own[0]), dot(&own[0], &own[1]), dot(&own[1], &own[1])];
        let [p, q] = [dot(&own[0], &self.rest), dot(&own[1], &self.rest)];
        let determinant = a * c - b * b;
        (determinant > 1e-9 * a * c).then(|| [(p * c - q * b) / determinant, (q * a - p * b) / determinant])
    }
}

/// In how many independent shapes what mates leave unexplained can lie.
///
/// The rest of a reading after its mates is not noise: it is heat that flows in finer ways than they tell, excited by the
/// same movements each cycle, and common tests of noise call it anything. It is smooth, though, and has few shapes: about
/// two a movement, and not more than this. A shape that is looked for must explain far more of it than one in so many
/// would by chance, however long the log.
#[derive(Debug, Clone, Copy)]
pub(super) struct Freedom(f64);

impl Freedom {
    /// Of a run with so many movements; none: a run without a schedule.
    pub fn of(movements: usize) -> Self {
        Self(if movements == 0 { 20.0 } else { (2 * movements).clamp(6, 20) as f64 })
    }

    /// How many.
    pub fn count(self) -> f64 {
        self.0
    }

    /// Log evidence of a fit that explains `ratio` times what it leaves.
    pub fn score(self, ratio: f64) -> f64 {
        0.5 * (self.0 + 1.0) * ratio.ln_1p()
    }

    /// `ln P` of a ratio as large in what heat leaves.
    pub fn ln_p(self, ratio: f64) -> f64 {
        ln_likelihood_ratio((self.0 + 1.0) * ratio.ln_1p(), 1, self.0 + 1.0)
    }

    /// Standard error of a fit's coefficient.
    pub fn sigma(self, fit: &Fit) -> f64 {
        fit.coefficient.abs() / (fit.ratio * self.0).sqrt().max(1e-12)
    }

    /// The quantile of Student's t that bounds 95 %, to three digits from six degrees of freedom on.
    pub fn quantile(self) -> f64 {
        let n = self.0;
        1.96 + 2.37 / n + 2.82 / (n * n) + 2.56 / (n * n * n)
    }
}
