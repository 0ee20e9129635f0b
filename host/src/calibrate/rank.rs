//! What the data can identify: unknowns that move the measurements as others already do are held, and said in words.

use nalgebra::{DMatrix, DVector};

use super::factor::OrthogonalFactor;
use super::unknown::{Names, Unknown};
use crate::robot::{ParameterId, Symbol};

/// A column whose part outside the span of the columns before it is smaller than this share of its norm is dependent on
/// them. Derivatives are exact to about 1e-15; directions weaker than 1e-7 of a parameter's own effect would need errors
/// of a parameter of 10 m or more to show above a micrometre.
const DEPENDENT: f64 = 1e-7;

/// Shares of a dependency below this are not worth a word.
const WORTH_NAMING: f64 = 1e-3;

/// An unknown that these data cannot tell from others.
#[derive(Debug, Clone, PartialEq)]
pub struct Held {
    /// The unknown that is held where it was.
    pub unknown: Unknown,
    /// The unknowns that it cannot be told from, with the share of its effect that each takes over, in units of
    /// the held unknown's effect; empty where the unknown moves nothing at all.
    pub moves_with: Vec<(Unknown, f64)>,
}

/// Splits the columns of a factor into those that the data identify and those that must be held, keeping earlier columns
/// in preference to later ones. Returns the places of the kept columns and the held unknowns.
pub fn split(factor: &OrthogonalFactor, unknowns: &[Unknown]) -> (Vec<usize>, Vec<Held>) {
    let norms = factor.column_norms();
    let largest = norms.iter().copied().fold(0.0, f64::max);
    let moves = |column: usize| norms[column] > f64::EPSILON * largest;
    // The factor's own diagonal is the distance of each column from the span of those before it.
    if (0..unknowns.len()).all(|column| moves(column) && factor.entry(column, column).abs() > DEPENDENT * norms[column])
    {
        return ((0..unknowns.len()).collect(), Vec::new());
    }
    let matrix = factor.matrix();
    let mut kept: Vec<usize> = Vec::new();
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let mut held = Vec::new();
    for (column, &unknown) in unknowns.iter().enumerate() {
        if !moves(column) {
            held.push(Held { unknown, moves_with: Vec::new() });
            continue;
        }
        let own = matrix.column(column) / norms[column];
        let mut rest = own.clone();
        // Twice is enough (Kahan, Parlett).
        for _ in 0..2 {
            for direction in &basis {
                let share = direction.dot(&rest);
                rest.axpy(-share, direction, 1.0);
            }
        }
        let distance = rest.norm();
        if distance > DEPENDENT {
            basis.push(rest / distance);
            kept.push(column);
        } else {
            held.push(Held { unknown, moves_with: dependency(&matrix, &norms, &kept, &own, unknowns) });
        }
    }
    (kept, held)
}

/// The combination of kept columns that comes nearest to another column.
pub(super) fn nearly(
    factor: &OrthogonalFactor,
    column: usize,
    kept: &[usize],
    unknowns: &[Unknown],
) -> Vec<(Unknown, f64)> {
    let (matrix, norms) = (factor.matrix(), factor.column_norms());
    let own = matrix.column(column) / norms[column];
    dependency(&matrix, &norms, kept, &own, unknowns)
}

/// The combination of kept columns, each scaled to one, that a unit column is.
fn dependency(
    matrix: &DMatrix<f64>,
    norms: &[f64],
    kept: &[usize],
    own: &DVector<f64>,
    unknowns: &[Unknown],
) -> Vec<(Unknown, f64)> {
    let scaled = DMatrix::from_fn(matrix.nrows(), kept.len(), |i, j| matrix[(i, kept[j])] / norms[kept[j]]);
    // A kept column may lie close to the others: the shortest combination is the one that reads best.
    let shares = scaled.svd(true, true).solve(own, DEPENDENT).unwrap_or_else(|_| DVector::zeros(kept.len()));
    let mut named: Vec<(Unknown, f64)> =
        kept.iter().zip(&shares).map(|(&column, &share)| (unknowns[column], share)).collect();
    named.retain(|(_, share)| share.abs() > WORTH_NAMING);
    named.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    named
}

/// The transforms whose next axis is parallel to their own, judged by their values.
fn parallel_to_next(names: &Names<'_>, values: &[f64], transform: usize) -> bool {
    let angle = |symbol| names.chain.place(ParameterId::new(symbol, transform)).map_or(0.0, |place| values[place]);
    let cosine = libm::cos(angle(Symbol::Alpha)) * libm::cos(angle(Symbol::Beta));
    1.0 - cosine.abs() < 1e-6
}

/// Says why an unknown is held. `values` are the chain's parameters.
pub fn in_words(held: &Held, names: &Names<'_>, values: &[f64]) -> String {
    let own = names.name(held.unknown);
    if held.moves_with.is_empty() {
        return format!("{own} moves nothing that was measured: held");
    }
    let partners: Vec<String> = held.moves_with.iter().map(|(unknown, _)| names.name(*unknown)).collect();
    let list = and_list(&partners);
    let last = names.chain.transform_count() - 1;
    if let Unknown::Parameter(place) = held.unknown {
        let id = names.chain.parameters()[place];
        let slides = |unknown: &Unknown| match *unknown {
            Unknown::Parameter(other) => names.chain.parameters()[other].symbol == Symbol::D,
            _ => false,
        };
        if id.symbol == Symbol::D
            && id.transform > 1
            && held.moves_with.iter().any(|(unknown, _)| slides(unknown))
            && parallel_to_next(names, values, id.transform - 1)
        {
            return format!(
                "{own} and {list} move together: axes {} and {} are parallel; {own} held",
                id.transform - 1,
                id.transform
            );
        }
        let targets_only = held.moves_with.iter().all(|(unknown, _)| {
            matches!(unknown, Unknown::Target { .. } | Unknown::Turn { .. })
                || matches!(unknown, Unknown::Parameter(other) if names.chain.parameters()[*other].transform == last)
        });
        if id.transform == last && targets_only {
            return format!(
                "{own} moves the targets in the flange frame just as {list} do: the flange itself is not measured; {own} held"
            );
        }
    }
    format!("{own} and {list} move together in these data; {own} held")
}

/// `a`, `a and b`, `a, b and c`; long lists are cut.
fn and_list(names: &[String]) -> String {
    const MOST: usize = 6;
    match names {
        [] => String::new(),
        [one] => one.clone(),
        _ if names.len() > MOST => format!("{} and {} more", names[..MOST].join(", "), names.len() - MOST),
        [all @ .., last] => format!("{} and {last}", all.join(", ")),
    }
}

/// How well conditioned an identification is.
#[derive(Debug, Clone, PartialEq)]
pub struct Observability {
    /// The number of unknowns that the data identify.
    pub rank: usize,
    /// Singular values of the Jacobian of measured coordinates by unknowns in m and rad, largest first.
    pub singular_values: Vec<f64>,
    /// Largest over smallest singular value after scaling every column to norm one, so that units do not matter.
    pub condition: f64,
    /// The observability indices O1 to O5 of the plain Jacobian (Borm and Menq 1991; Driels and Pathre 1990; Nahvi and
    /// Hollerbach 1996; Sun and Hollerbach 2008).
    pub indices: [f64; 5],
}

/// Singular values and observability indices from the factor `R` of a whitened Jacobian.
///
/// `sigma` is the standard deviation that rows were divided by (the indices are those of the Jacobian before whitening),
/// `visits` the number of poses measured.
pub fn observability(r: &DMatrix<f64>, sigma: f64, visits: usize) -> Observability {
    let plain = r * sigma;
    let mut scaled = r.clone();
    for mut column in scaled.column_iter_mut() {
        let norm = column.norm();
        column /= norm;
    }
    let sorted = |matrix: DMatrix<f64>| {
        let mut values: Vec<f64> = matrix.singular_values().iter().copied().collect();
        values.sort_by(|a, b| b.total_cmp(a));
        values
    };
    let singular_values = sorted(plain);
    let ratio = |values: &[f64]| match values {
        [] => f64::NAN,
        [first, .., last] => first / last,
        [_] => 1.0,
    };
    let condition = ratio(&sorted(scaled));
    let count = singular_values.len() as f64;
    let (largest, smallest) =
        (singular_values.first().copied().unwrap_or(f64::NAN), singular_values.last().copied().unwrap_or(f64::NAN));
    let logarithms: f64 = singular_values.iter().map(|value| value.ln()).sum();
    let indices = [
        (logarithms / count).exp() / (visits.max(1) as f64).sqrt(),
        smallest / largest,
        smallest,
        smallest * smallest / largest,
        1.0 / singular_values.iter().map(|value| 1.0 / value).sum::<f64>(),
    ];
    Observability { rank: r.ncols(), singular_values, condition, indices }
}
