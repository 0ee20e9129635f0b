//! Several samples of one target become one point: which of them count, their mean, and how well the mean is known.

use nalgebra::Vector3;

use super::mapping::SamplesToml;

/// What makes the deviation of normal numbers of the median of their distances from their median.
const MAD_TO_SIGMA: f64 = 1.4826;

/// So many times the usual scatter may an arm that has not come to rest add; beyond it the samples contradict each other.
const MOST_RESTLESS: f64 = 10.0;

/// Samples of one target at one visit, averaged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Average {
    /// m.
    pub(super) position: Vector3<f64>,
    /// How many samples it is the mean of.
    pub(super) used: usize,
    /// 1-sigma of one coordinate of a sample, m, root mean square over the three; none for a single sample.
    pub(super) spread_m: Option<f64>,
}

impl Average {
    /// 1-sigma of one coordinate of the mean, m.
    pub(super) fn sigma_m(&self) -> Option<f64> {
        self.spread_m.map(|spread| spread / (self.used as f64).sqrt())
    }
}

/// The middle value; for an even count the mean of the two in the middle. `values` are put in order.
///
/// # Panics
/// Without values.
pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { 0.5 * (values[middle - 1] + values[middle]) }
}

/// The median of each coordinate, and its robust deviation, both m.
fn middle(samples: &[Vector3<f64>]) -> (Vector3<f64>, Vector3<f64>) {
    let mut values = vec![0.0; samples.len()];
    let mut of = |axis: usize, shift: f64, absolute: bool| {
        for (value, sample) in values.iter_mut().zip(samples) {
            *value = sample[axis] - shift;
            if absolute {
                *value = value.abs();
            }
        }
        median(&mut values)
    };
    let center = Vector3::from([0, 1, 2].map(|axis| of(axis, 0.0, false)));
    let spread = Vector3::from([0, 1, 2].map(|axis| MAD_TO_SIGMA * of(axis, center[axis], true)));
    (center, spread)
}

/// What samples of this instrument usually scatter by, m: the median over all points of their robust deviations. A handful of
/// samples tells its own scatter too badly to judge by it alone.
pub(super) fn usual_spread<'s>(points: impl Iterator<Item = &'s [Vector3<f64>]>) -> Vector3<f64> {
    let spreads: Vec<Vector3<f64>> =
        points.filter(|samples| samples.len() > 2).map(|samples| middle(samples).1).collect();
    if spreads.is_empty() {
        return Vector3::zeros();
    }
    Vector3::from([0, 1, 2].map(|axis| median(&mut spreads.iter().map(|spread| spread[axis]).collect::<Vec<_>>())))
}

/// The mean of the samples that count; none where fewer than half of them, or than the rule's least number, do.
///
/// A sample does not count when one of its coordinates is further from the median than `rule.sigmas` deviations: the samples'
/// own robust one, but never less than the instrument's usual one (itself at least the rule's floor), and never more than
/// ten times that. A beam that breaks and is caught again begins at another distance: such samples are millimetres away
/// and leave the median alone as long as they are fewer than half.
pub(super) fn average(samples: &[Vector3<f64>], usual: &Vector3<f64>, rule: &SamplesToml) -> Option<Average> {
    if samples.is_empty() {
        return None;
    }
    let (center, own) = middle(samples);
    let limit = own.zip_map(usual, |own, usual| {
        let usual = usual.max(rule.floor_m);
        rule.sigmas * own.clamp(usual, MOST_RESTLESS * usual)
    });
    let good: Vec<&Vector3<f64>> =
        samples.iter().filter(|sample| (0..3).all(|axis| (sample[axis] - center[axis]).abs() <= limit[axis])).collect();
    if good.len() < rule.least || 2 * good.len() < samples.len() {
        return None;
    }
    let count = good.len() as f64;
    // The mean of what is left after the median is taken off: coordinates are metres, their scatter micrometres.
    let above = good.iter().fold(Vector3::zeros(), |sum, sample| sum + (*sample - center)) / count;
    let position = center + above;
    let squares: f64 = good.iter().map(|sample| (*sample - center - above).norm_squared()).sum();
    let spread_m = (good.len() > 1).then(|| (squares / (3.0 * (count - 1.0))).sqrt());
    Some(Average { position, used: good.len(), spread_m })
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: SamplesToml = SamplesToml { least: 1, sigmas: 5.0, floor_m: 1e-6 };

    /// Samples that scatter by micrometres about a place, in a pattern whose mean is the place.
    fn scattered(count: usize) -> Vec<Vector3<f64>> {
        let place = Vector3::new(1.0, -2.0, 0.5);
        (0..count)
            .map(|index| {
                let sign = if index % 2 == 0 { 1.0 } else { -1.0 };
                place + Vector3::new(sign, -sign, sign * 0.5) * 1e-6 * (1 + index / 2 % 3) as f64
            })
            .collect()
    }

    #[test]
    fn the_mean_and_its_noise_are_those_of_the_textbook() {
        let samples = scattered(12);
        let found = average(&samples, &Vector3::zeros(), &RULE).expect("all count");
        assert_eq!(found.used, 12);
        assert!((found.position - Vector3::new(1.0, -2.0, 0.5)).norm() < 1e-15, "{}", found.position);
        // Each of 1, 2, 3 µm stands four times in x and y, half of it in z.
        let squares: f64 = 4.0 * (1.0 + 4.0 + 9.0) * (1.0 + 1.0 + 0.25);
        let spread = (squares / (3.0 * 11.0)).sqrt() * 1e-6;
        assert!((found.spread_m.expect("many") - spread).abs() < 1e-15);
        assert!((found.sigma_m().expect("many") - spread / 12_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn a_beam_that_was_caught_again_elsewhere_is_dropped() {
        let clean = scattered(50);
        let mut samples = clean.clone();
        // 20 of 70 after a break: the interferometer counts from another fringe, all of them millimetres away.
        samples.extend(scattered(20).iter().map(|sample| sample + Vector3::new(3e-3, 0.0, -1e-3)));
        let found = average(&samples, &Vector3::zeros(), &RULE).expect("50 count");
        assert_eq!(found.used, 50);
        let alone = average(&clean, &Vector3::zeros(), &RULE).expect("all count");
        // Both are sums of the same 50 numbers about nearly the same median.
        assert!((found.position - alone.position).norm() < 1e-14);
    }

    #[test]
    fn two_that_contradict_each_other_are_no_point() {
        let samples = [Vector3::zeros(), Vector3::new(1e-3, 0.0, 0.0)];
        assert_eq!(average(&samples, &Vector3::repeat(2e-6), &RULE), None);
        assert_eq!(average(&samples, &Vector3::repeat(2e-5), &RULE).expect("within what is usual").used, 2);
    }

    #[test]
    fn too_few_are_a_broken_beam() {
        assert_eq!(average(&[], &Vector3::zeros(), &RULE), None);
        assert_eq!(average(&scattered(4), &Vector3::zeros(), &SamplesToml { least: 5, ..RULE }), None);
    }

    #[test]
    fn few_samples_are_judged_by_what_is_usual() {
        let groups = [scattered(12), scattered(8), scattered(10)];
        let usual = usual_spread(groups.iter().map(Vec::as_slice));
        assert!((usual.x - MAD_TO_SIGMA * 2e-6).abs() < 1e-12, "{usual}");
        // Of three, two happen to be equal: their own deviation is none, and the third would be an outlier.
        let place = Vector3::new(1.0, 1.0, 1.0);
        let samples = [place, place, place + Vector3::new(8e-6, 0.0, 0.0)];
        assert_eq!(average(&samples, &usual, &RULE).expect("all count").used, 3);
        assert_eq!(average(&samples, &Vector3::zeros(), &RULE).expect("two count").used, 2);
    }
}
