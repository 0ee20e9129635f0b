//! Robust losses: how much a measurement that disagrees with the rest still counts.

use super::campaign::Campaign;

/// The loss of a residual.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Loss {
    /// Half the square: least squares.
    #[default]
    Squares,
    /// Huber's: quadratic near zero, linear beyond.
    Huber,
    /// Cauchy's: logarithmic far out.
    Cauchy,
}

impl Loss {
    /// The weight of a residual of `t` robust standard deviations: the loss's derivative over `t`. The constants give 95 %
    /// efficiency on Gaussian noise.
    fn weight(self, t: f64) -> f64 {
        match self {
            Loss::Squares => 1.0,
            Loss::Huber => (1.345 / t).min(1.0),
            Loss::Cauchy => 1.0 / (1.0 + (t / 2.385).powi(2)),
        }
    }
}

/// Calls `each` with the range of rows of every measurement: three for a position or orientation, one for a distance.
fn measurements(campaign: &Campaign, mut each: impl FnMut(std::ops::Range<usize>)) {
    let mut row = 0;
    for visit in &campaign.visits {
        for _ in 0..visit.positions.len() + visit.turns.len() {
            each(row..row + 3);
            row += 3;
        }
        for _ in &visit.distances {
            each(row..row + 1);
            row += 1;
        }
    }
}

/// The root mean square of one scalar of a measurement's residual.
fn size(residuals: &[f64]) -> f64 {
    (residuals.iter().map(|value| value * value).sum::<f64>() / residuals.len() as f64).sqrt()
}

/// A spread of residuals that outliers do not move: the median of the measurements' sizes, over the median of the same for
/// Gaussian noise (√(χ²₃ median / 3) for positions).
pub fn spread(campaign: &Campaign, residuals: &[f64]) -> f64 {
    const MEDIAN_OF_THREE: f64 = 0.888_07;
    let mut sizes = Vec::new();
    measurements(campaign, |rows| sizes.push(size(&residuals[rows])));
    if sizes.is_empty() {
        return 1.0;
    }
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    (*median / MEDIAN_OF_THREE).max(f64::MIN_POSITIVE)
}

/// Factors for all rows: the square root of each measurement's weight.
pub fn weights(campaign: &Campaign, residuals: &[f64], spread: f64, loss: Loss) -> Vec<f64> {
    let mut weights = vec![1.0; residuals.len()];
    measurements(campaign, |rows| {
        let weight = loss.weight(size(&residuals[rows.clone()]) / spread).sqrt();
        weights[rows].fill(weight);
    });
    weights
}
