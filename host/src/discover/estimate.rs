//! The numbers of a found effect by the contract's names, with 95 % intervals.

use nalgebra::DVector;
use serde::Serialize;

use super::fit::EffectCovariance;
use crate::effect::Instance;

/// A number with its interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimate {
    /// The contract's name.
    pub name: String,
    /// The value, SI units.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// Half the width of a 95 % interval in standard deviations: the strata of noise follow from hundreds of numbers.
const HALF_WIDTH: f64 = 1.959_963_984_540_054;

/// The estimates of an effect from the covariance of its coefficients and nonlinear numbers. Where a step's time was found
/// between two visits, `bounds` gives the times between which it may lie, by the place in the shape.
pub fn estimates(effect: &Instance, covariance: &EffectCovariance, bounds: &[(usize, f64, f64)]) -> Vec<Estimate> {
    let values = effect.parameters();
    let moved = |change: &dyn Fn(&mut Instance)| {
        let mut other = effect.clone();
        change(&mut other);
        other.parameters()
    };
    let count = covariance.coefficients.len() + covariance.shape.len();
    let deviations: Vec<f64> = covariance.matrix.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect();
    let slopes: Vec<Vec<f64>> = (0..count)
        .map(|rank| {
            // A hundredth of a standard deviation: small against what bends, large against rounding.
            let step = 1e-2 * deviations[rank].max(1e-300);
            let by = |sign: f64| {
                moved(&|other: &mut Instance| match covariance.coefficients.get(rank) {
                    Some(&place) => other.coefficients[place] += sign * step,
                    None => other.shape[covariance.shape[rank - covariance.coefficients.len()]] += sign * step,
                })
            };
            by(1.0)
                .iter()
                .zip(by(-1.0))
                .map(|(up, down)| {
                    let mut change = up.value - down.value;
                    // A phase may go once round between the two.
                    if up.name.starts_with("phase") {
                        change -= std::f64::consts::TAU * (change / std::f64::consts::TAU).round();
                    }
                    change / (2.0 * step)
                })
                .collect()
        })
        .collect();
    values
        .into_iter()
        .enumerate()
        .map(|(number, named)| {
            let slope = DVector::from_fn(count, |rank, _| slopes[rank][number]);
            let half = HALF_WIDTH * slope.dot(&(&covariance.matrix * &slope)).max(0.0).sqrt();
            let bound = bounds.iter().find(|(place, ..)| named.value == effect.shape[*place] && named.name == "time_s");
            let (low, high) = bound.map_or((named.value - half, named.value + half), |&(_, low, high)| (low, high));
            Estimate { name: named.name, value: named.value, low, high }
        })
        .collect()
}
