//! An orthogonal factor that grows row by row: least squares without the normal matrix and without keeping the rows.
//!
//! Rows `[J | e]` are collected in a small buffer and folded by Householder reflections into an upper triangle
//! `[R z; 0 ρ]`, whose size depends on the unknowns alone. `R` is the factor of all rows so far, `z = Qᵀe`, and `ρ²` the
//! sum of squares that no unknown can reach.

use pulp::Arch;

/// Rows that are collected before a fold: 128 rows of 31 columns just fill a first-level cache of 32 KiB.
const BUFFER_ROWS: usize = 128;

/// The triangular factor of all rows `[J | e]` that were pushed.
#[derive(Debug, Clone)]
pub struct OrthogonalFactor {
    /// Unknowns, plus one for the right-hand side.
    columns: usize,
    /// The upper triangle by rows: row i at `i * columns`, entries below the diagonal unused.
    triangle: Vec<f64>,
    /// Rows that wait to be folded, by columns of `capacity`.
    buffer: Vec<f64>,
    capacity: usize,
    waiting: usize,
    rows: usize,
    arch: Arch,
}

impl OrthogonalFactor {
    /// The factor of no rows, for `unknowns` columns of `J`.
    pub fn new(unknowns: usize) -> Self {
        Self::with_capacity(unknowns, BUFFER_ROWS)
    }

    /// The factor of no rows that can hold `capacity` rows before it folds.
    pub fn with_capacity(unknowns: usize, capacity: usize) -> Self {
        let columns = unknowns + 1;
        Self {
            columns,
            triangle: vec![0.0; columns * columns],
            buffer: vec![0.0; columns * capacity],
            capacity,
            waiting: 0,
            rows: 0,
            arch: Arch::new(),
        }
    }

    /// Forgets all rows.
    pub fn clear(&mut self) {
        self.triangle.fill(0.0);
        self.waiting = 0;
        self.rows = 0;
    }

    /// The number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.columns - 1
    }

    /// The number of rows pushed.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Room for `count` more rows, all zero, to be filled in.
    ///
    /// # Panics
    /// When `count` is larger than the buffer, 128 unless asked otherwise.
    #[inline]
    pub fn push(&mut self, count: usize) -> NewRows<'_> {
        assert!(count <= self.capacity, "at most {} rows at once", self.capacity);
        if self.waiting + count > self.capacity {
            self.fold();
        }
        let first = self.waiting;
        self.waiting += count;
        self.rows += count;
        for column in self.buffer.chunks_exact_mut(self.capacity) {
            column[first..first + count].fill(0.0);
        }
        NewRows { buffer: &mut self.buffer, capacity: self.capacity, first, count, last: self.columns - 1 }
    }

    /// Takes in the rows that wait in the buffer.
    pub fn fold(&mut self) {
        if self.waiting == 0 {
            return;
        }
        let Self { columns, triangle, buffer, capacity, waiting, arch, .. } = self;
        match arch {
            // Without the instruction, a fused multiply-add would be a slow call.
            Arch::Scalar => fold_rows::<false>(*columns, triangle, buffer, *capacity, *waiting),
            arch => arch.dispatch(
                #[inline(always)]
                || fold_rows::<true>(*columns, triangle, buffer, *capacity, *waiting),
            ),
        }
        *waiting = 0;
    }

    /// The rows that wait to be folded, `[J | e]`, as a dense matrix.
    pub fn waiting_rows(&self) -> nalgebra::DMatrix<f64> {
        nalgebra::DMatrix::from_fn(self.waiting, self.columns, |row, column| self.buffer[column * self.capacity + row])
    }

    /// Row `i` of `[R z]` from its diagonal on. Call [`OrthogonalFactor::fold`] first.
    #[inline]
    pub fn row(&self, i: usize) -> &[f64] {
        debug_assert_eq!(self.waiting, 0, "fold before reading");
        &self.triangle[i * self.columns + i..(i + 1) * self.columns]
    }

    /// The entry of `R` at row `i` and column `j`.
    #[inline]
    pub fn entry(&self, i: usize, j: usize) -> f64 {
        debug_assert_eq!(self.waiting, 0, "fold before reading");
        if i <= j { self.triangle[i * self.columns + j] } else { 0.0 }
    }

    /// The right-hand side `z = Qᵀe`.
    pub fn right_hand_side(&self) -> Vec<f64> {
        (0..self.unknowns()).map(|i| self.entry(i, self.columns - 1)).collect()
    }

    /// Puts another right-hand side beside `R`: `z = R⁻ᵀ Jᵀe` from a gradient `Jᵀe` at a state nearby.
    ///
    /// A Gauss-Newton step from there needs no new factor as long as `J` has hardly changed.
    pub fn set_gradient(&mut self, gradient: &[f64]) {
        let last = self.columns - 1;
        let mut z = gradient.to_vec();
        for i in 0..last {
            let row = &self.triangle[i * self.columns..(i + 1) * self.columns];
            let value = z[i] / row[i];
            z[i] = value;
            for (rest, entry) in z[i + 1..].iter_mut().zip(&row[i + 1..last]) {
                *rest -= entry * value;
            }
        }
        self.set_right_hand_side(&z);
    }

    /// Puts another `z` beside `R`.
    pub fn set_right_hand_side(&mut self, z: &[f64]) {
        let last = self.columns - 1;
        for (row, value) in self.triangle.chunks_exact_mut(self.columns).zip(z) {
            row[last] = *value;
        }
    }

    /// The norm of what no unknown can reach, `ρ`.
    pub fn remainder(&self) -> f64 {
        self.entry(self.columns - 1, self.columns - 1).abs()
    }

    /// `R` as a dense matrix.
    pub fn matrix(&self) -> nalgebra::DMatrix<f64> {
        nalgebra::DMatrix::from_fn(self.unknowns(), self.unknowns(), |i, j| self.entry(i, j))
    }

    /// The Euclidean norm of each column of `J`.
    pub fn column_norms(&self) -> Vec<f64> {
        let mut squares = vec![0.0; self.unknowns()];
        for i in 0..self.unknowns() {
            for (square, entry) in squares[i..].iter_mut().zip(self.row(i)) {
                *square += entry * entry;
            }
        }
        squares.into_iter().map(f64::sqrt).collect()
    }

    /// The Euclidean norm of each row of `R⁻¹`: the standard deviations of the unknowns for rows of variance one.
    pub fn inverse_row_norms(&self) -> Vec<f64> {
        let unknowns = self.unknowns();
        let mut squares = vec![0.0; unknowns];
        // Column j of R⁻¹ by back substitution on a unit vector, which leaves the rows below j zero.
        let mut column = vec![0.0; unknowns];
        for j in 0..unknowns {
            column[j] = 1.0 / self.entry(j, j);
            squares[j] += column[j] * column[j];
            for i in (0..j).rev() {
                let row = self.row(i);
                let sum: f64 = row[1..=j - i].iter().zip(&column[i + 1..=j]).map(|(entry, known)| entry * known).sum();
                column[i] = -sum / row[0];
                squares[i] += column[i] * column[i];
            }
        }
        squares.into_iter().map(f64::sqrt).collect()
    }

    /// Takes in another factor of the same unknowns, as if its rows had been pushed here.
    ///
    /// # Panics
    /// When the other has other unknowns.
    pub fn merge(&mut self, other: &OrthogonalFactor) {
        assert_eq!(self.columns, other.columns, "factors of the same unknowns");
        let rows = other.rows;
        let before = self.rows;
        for i in 0..other.columns {
            let mut new = self.push(1);
            for j in i..other.columns {
                new.set(0, j, other.entry(i, j));
            }
        }
        self.rows = before + rows;
        self.fold();
    }

    /// Takes in what another factor says of the columns from `first` on, which are the columns here: the others are
    /// eliminated from it by leaving out their rows.
    ///
    /// # Panics
    /// When the other has not `first` unknowns more.
    pub fn push_rows_below(&mut self, other: &OrthogonalFactor, first: usize) {
        assert_eq!(self.columns + first, other.columns, "the columns from the first on");
        for i in first..other.columns {
            let row = other.row(i);
            if row.iter().all(|&entry| entry == 0.0) {
                continue;
            }
            let mut new = self.push(1);
            for (j, &entry) in row.iter().enumerate() {
                new.set(0, i - first + j, entry);
            }
        }
    }

    /// The factor of a choice of columns, in the order given: as if only these had been pushed.
    pub fn columns(&self, chosen: &[usize]) -> OrthogonalFactor {
        let mut part = OrthogonalFactor::with_capacity(chosen.len(), self.columns);
        let mut rows = part.push(self.columns);
        for (to, &from) in chosen.iter().chain([&self.unknowns()]).enumerate() {
            for i in 0..=from {
                rows.set(i, to, self.entry(i, from));
            }
        }
        part.rows = self.rows;
        part.fold();
        part
    }

    /// The least-squares solution for the unknowns, by back substitution.
    ///
    /// A zero on the diagonal gives infinities: rank is the caller's business.
    pub fn solve(&self) -> Vec<f64> {
        let mut x = self.right_hand_side();
        for i in (0..x.len()).rev() {
            let row = self.row(i);
            let mut value = x[i];
            for (entry, known) in row[1..].iter().zip(&x[i + 1..]) {
                value -= entry * known;
            }
            x[i] = value / row[0];
        }
        x
    }

    /// The solution of the damped problem, Levenberg and Marquardt's: `[R; √μ D] x = [z; 0]` with `D` the column norms.
    pub fn solve_damped(&self, mu: f64) -> Vec<f64> {
        let mut damped = self.clone();
        let root = mu.sqrt();
        for (j, norm) in self.column_norms().into_iter().enumerate() {
            damped.push(1).set(0, j, root * norm);
        }
        damped.fold();
        damped.solve()
    }
}

/// Rows being written into the buffer of an [`OrthogonalFactor`].
pub struct NewRows<'a> {
    buffer: &'a mut [f64],
    capacity: usize,
    first: usize,
    count: usize,
    last: usize,
}

impl NewRows<'_> {
    /// The new rows' entries in column `j` of `J`.
    #[inline(always)]
    pub fn column(&mut self, j: usize) -> &mut [f64] {
        let start = j * self.capacity + self.first;
        &mut self.buffer[start..start + self.count]
    }

    /// The new rows' entries in the right-hand side.
    #[inline(always)]
    pub fn right_hand_side(&mut self) -> &mut [f64] {
        self.column(self.last)
    }

    /// Sets one entry; column `unknowns` is the right-hand side.
    #[inline(always)]
    pub fn set(&mut self, row: usize, column: usize, value: f64) {
        self.column(column)[row] = value;
    }
}

#[inline(always)]
fn multiply_add<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// Independent partial sums of a dot product: strict floating point would otherwise forbid to vectorise it.
const LANES: usize = 8;

/// The dot products of `v` with `N` columns of the same length.
#[inline(always)]
fn dots<const FUSED: bool, const N: usize>(v: &[f64], columns: [&[f64]; N]) -> [f64; N] {
    let mut sums = [[0.0; LANES]; N];
    let whole = v.len() / LANES * LANES;
    let mut at = 0;
    while at < whole {
        for n in 0..N {
            for lane in 0..LANES {
                sums[n][lane] = multiply_add::<FUSED>(v[at + lane], columns[n][at + lane], sums[n][lane]);
            }
        }
        at += LANES;
    }
    let mut totals = [0.0; N];
    for n in 0..N {
        let s = sums[n];
        totals[n] = ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]));
        for k in whole..v.len() {
            totals[n] = multiply_add::<FUSED>(v[k], columns[n][k], totals[n]);
        }
    }
    totals
}

/// Applies the reflector `[lead; v]` to `N` columns whose entries in the triangle are `tops`.
#[inline(always)]
fn reflect<const FUSED: bool, const N: usize>(
    lead: f64,
    scale: f64,
    v: &[f64],
    tops: &mut [f64],
    columns: &mut [f64],
    capacity: usize,
    rows: usize,
) {
    let mut parts = columns.chunks_exact_mut(capacity);
    let columns: [&mut [f64]; N] = std::array::from_fn(|_| match parts.next() {
        Some(part) => &mut part[..rows],
        None => &mut [],
    });
    let sums = dots::<FUSED, N>(v, std::array::from_fn(|n| &*columns[n]));
    for n in 0..N {
        let weight = -(lead * tops[n] + sums[n]) * scale;
        tops[n] = multiply_add::<FUSED>(weight, lead, tops[n]);
        for (entry, part) in columns[n].iter_mut().zip(v) {
            *entry = multiply_add::<FUSED>(weight, *part, *entry);
        }
    }
}

/// Folds `rows` buffered rows into the triangle: for each column a Householder reflection of its diagonal entry and its
/// part of the buffer. Entries of the triangle below and beside the diagonal stay untouched (LAPACK's `tpqrt`).
#[inline(always)]
fn fold_rows<const FUSED: bool>(
    columns: usize,
    triangle: &mut [f64],
    buffer: &mut [f64],
    capacity: usize,
    rows: usize,
) {
    for j in 0..columns {
        let (done, rest) = buffer.split_at_mut((j + 1) * capacity);
        let v = &done[j * capacity..j * capacity + rows];
        let [square] = dots::<FUSED, 1>(v, [v]);
        if square == 0.0 {
            continue;
        }
        let (diagonal, tops) = triangle[j * columns + j..(j + 1) * columns].split_at_mut(1);
        let alpha = diagonal[0];
        let norm = (alpha * alpha + square).sqrt();
        let beta = if alpha > 0.0 { -norm } else { norm };
        let lead = alpha - beta;
        // 2 / (uᵀu) of the reflector u = [lead; v].
        let scale = -1.0 / (beta * lead);
        diagonal[0] = beta;
        let mut tops = tops.chunks_exact_mut(4);
        let mut rest = rest.chunks_exact_mut(4 * capacity);
        for (tops, columns) in tops.by_ref().zip(rest.by_ref()) {
            reflect::<FUSED, 4>(lead, scale, v, tops, columns, capacity, rows);
        }
        let columns = rest.into_remainder();
        for (top, column) in tops.into_remainder().iter_mut().zip(columns.chunks_exact_mut(capacity)) {
            reflect::<FUSED, 1>(lead, scale, v, std::slice::from_mut(top), column, capacity, rows);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Machines without fused multiply-add take the other path: both fold the same rows to the same triangle, but for
    /// rounding. 40 rows of entries below 1 round by less than 40 u = 5e-15 a column; signs are those of the same rule.
    #[test]
    fn fused_and_plain_arithmetic_agree() {
        let (columns, capacity, rows) = (9, 40, 37);
        // Numbers without a pattern, from the fractional parts of multiples of the golden ratio.
        let entry = |k: usize| (k as f64 * 0.618_033_988_749_895).fract() - 0.5;
        let mut triangles = [vec![0.0; columns * columns], vec![0.0; columns * columns]];
        for round in 0..3 {
            let buffer: Vec<f64> = (0..columns * capacity).map(|k| entry(k + 1000 * round)).collect();
            fold_rows::<false>(columns, &mut triangles[0], &mut buffer.clone(), capacity, rows);
            fold_rows::<true>(columns, &mut triangles[1], &mut buffer.clone(), capacity, rows);
        }
        let [plain, fused] = triangles;
        for (plain, fused) in plain.iter().zip(&fused) {
            assert!((plain - fused).abs() < 1e-13, "{plain} and {fused}");
        }
        assert!((0..columns).all(|k| plain[k * columns + k].abs() > 0.1), "the rows have full rank");
    }
}
