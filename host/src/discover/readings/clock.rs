//! A log whose clock runs early or late: the kinks that starts and stops make in all readings lie beside motion.csv's by one
//! common time.
//!
//! Between two edges of movement temperatures are smooth, whatever heat does; at an edge they kink. So readings are fitted
//! by a cubic between each two edges, edges shifted by a trial offset, and the offset that leaves least is where the kinks
//! are. No heat can answer before its cause; it can answer late, though, and where no sensor sits near a drive all of
//! them answer late: how far the sensors of different links agree says how far the offset can be trusted.

use super::candidate::{Candidate, Context, Estimate, Undo};
use super::explained::{Explained, dot};
use crate::discover::chance::ln_likelihood_ratio;

/// Offsets up to this are tried, s.
const FARTHEST_S: f64 = 900.0;

/// Coefficients between two edges.
const ORDER: usize = 4;

/// Fewer movements than this may all be matched by chance at some offset.
const FEWEST_MOVEMENTS: usize = 6;

/// No offset is known better than this, s, nor than this share of the readings' period.
const LEAST_SIGMA_S: f64 = 3.0;
const LEAST_SIGMA_PERIODS: f64 = 0.4;

/// How much worse no offset must be than the best, as a share of how much worse an arbitrary offset is. Kinks of sensors
/// far from drives are blunt and seem late by as much as they are blunt, and then no offset is nearly as good; only a sharp
/// kink beside its edge is a clock's. Nothing seems early.
const LEAST_DEPTH_LATE: f64 = 0.5;
const LEAST_DEPTH_EARLY: f64 = 0.25;

/// Share of an offset's blunt width that it may be off by, standard error.
const BLUNT: f64 = 0.3;

/// Finest step of the offset, s.
const FINE_S: f64 = 2.0;

/// The common offset of the log.
pub(super) fn find(context: &Context<'_>) -> Option<Candidate> {
    let grid = context.grid;
    let mut links: Vec<usize> = grid.sensors.iter().map(|sensor| sensor.link).collect();
    links.sort_unstable();
    links.dedup();
    if context.movements() < FEWEST_MOVEMENTS || links.len() < 3 {
        return None;
    }
    let kinks = Kinks::new(context);
    let coarse_s = grid.period_s.max(5.0);
    let trials = (FARTHEST_S / coarse_s) as i32;
    let offsets: Vec<f64> = (-trials..=trials).map(|step| f64::from(step) * coarse_s).collect();
    let profile: Vec<Vec<f64>> = offsets.iter().map(|&offset| kinks.left(offset)).collect();
    let all = |left: &[f64], without: Option<usize>| -> f64 {
        left.iter().zip(&grid.sensors).filter(|(_, sensor)| Some(sensor.link) != without).map(|(left, _)| left).sum()
    };
    let best_of = |profile: &[Vec<f64>], without: Option<usize>| -> usize {
        let sums: Vec<f64> = profile.iter().map(|left| all(left, without)).collect();
        (0..sums.len()).min_by(|&a, &b| sums[a].total_cmp(&sums[b])).unwrap_or(0)
    };
    let rough_s = offsets[best_of(&profile, None)];
    if rough_s.abs() < 1.5 * coarse_s {
        return None;
    }
    // Every link left out in turn: where they do not agree, the offset is not common.
    let fine: Vec<f64> = (-12..=12).map(|step| rough_s + f64::from(step) * FINE_S).collect();
    let fine_profile: Vec<Vec<f64>> = fine.iter().map(|&offset| kinks.left(offset)).collect();
    let offset_s = fine[best_of(&fine_profile, None)];
    let without: Vec<f64> = links
        .iter()
        .map(|&link| {
            let rough = offsets[best_of(&profile, Some(link))];
            if (rough - rough_s).abs() > 2.0 * coarse_s { rough } else { fine[best_of(&fine_profile, Some(link))] }
        })
        .collect();
    let count = links.len() as f64;
    let mean = without.iter().sum::<f64>() / count;
    let spread = without.iter().map(|offset| (offset - mean).powi(2)).sum::<f64>();
    let jackknife_s = ((count - 1.0) / count * spread).sqrt();
    let least_s = LEAST_SIGMA_S.max(LEAST_SIGMA_PERIODS * grid.period_s);
    let sigma_s = jackknife_s.hypot(least_s);
    let at_zero = kinks.left(0.0);
    let rows = context.times_s.len() as f64;
    let gain = 0.5 * rows * (all(&at_zero, None) - all(&kinks.left(offset_s), None));
    let mut sums: Vec<f64> = profile.iter().map(|left| all(left, None)).collect();
    sums.sort_by(f64::total_cmp);
    let depth = 0.5 * rows * (sums[sums.len() / 2] - all(&kinks.left(offset_s), None));
    let least_depth = if offset_s > 0.0 { LEAST_DEPTH_LATE } else { LEAST_DEPTH_EARLY };
    if gain < least_depth * depth {
        return None;
    }
    let freedom = 2.0 * count;
    let t = offset_s.abs() / sigma_s;
    let ln_p = ln_likelihood_ratio((freedom + 1.0) * (t * t / freedom).ln_1p(), 1, freedom + 1.0);
    // How far from the best offset a quarter of the depth is lost: the kinks' bluntness.
    let lost = |offset: f64| 0.5 * rows * (all(&kinks.left(offset), None) - all(&kinks.left(offset_s), None));
    let blunt_s = (1..20)
        .map(|step| f64::from(step) * coarse_s)
        .find(|width| lost(offset_s - width).min(lost(offset_s + width)) > 0.25 * depth)
        .unwrap_or(20.0 * coarse_s);
    let reach = 2.0 * sigma_s.hypot(BLUNT * blunt_s);
    let (late, size) = (if offset_s > 0.0 { "late" } else { "early" }, offset_s.abs());
    Some(Candidate {
        effect: "clock_offset",
        sensors: Vec::new(),
        score: gain,
        ln_p,
        parameters: vec![Estimate::new("offset_s", offset_s, offset_s - reach, offset_s + reach)],
        evidence: format!(
            "all {} sensors answer {} starts and stops of the arm {size:.0} s {late}, whichever link is left out (to {:.0} s)",
            grid.sensors.len(),
            2 * context.movements(),
            sigma_s,
        ),
        undo: Undo::Clock { offset_s },
    })
}

/// The readings and the edges of movement.
struct Kinks<'a> {
    times_s: &'a [f64],
    edges_s: Vec<f64>,
    readings: Vec<Vec<f64>>,
}

impl<'a> Kinks<'a> {
    fn new(context: &'a Context<'_>) -> Self {
        let edges_s = context.motion.spans.iter().flat_map(|&(start, end)| [start, end]).collect();
        let readings = context.grid.sensors.iter().map(|sensor| context.grid.take(&sensor.celsius)).collect();
        Self { times_s: &context.times_s, edges_s, readings }
    }

    /// For each sensor, the logarithm of the variance that smooth pieces between the shifted edges leave.
    fn left(&self, offset_s: f64) -> Vec<f64> {
        let mut cuts: Vec<usize> =
            self.edges_s.iter().map(|edge| self.times_s.partition_point(|time| *time < edge + offset_s)).collect();
        cuts.insert(0, 0);
        cuts.push(self.times_s.len());
        let mut squares = vec![0.0; self.readings.len()];
        let mut free = 0.0;
        for piece in cuts.windows(2).filter(|piece| piece[1] > piece[0] + ORDER) {
            let times = &self.times_s[piece[0]..piece[1]];
            let (first, last) = (times[0], times[times.len() - 1]);
            let place = |time: &f64| (2.0 * time - first - last) / (last - first);
            let powers = (1..ORDER as i32).map(|power| times.iter().map(|time| place(time).powi(power)).collect());
            let smooth = Explained::by(times.len(), powers);
            free += (times.len() - ORDER) as f64;
            for (square, readings) in squares.iter_mut().zip(&self.readings) {
                let rest = smooth.rest(&readings[piece[0]..piece[1]]);
                *square += dot(&rest, &rest);
            }
        }
        squares.iter().map(|square| (square / f64::max(free, 1.0)).max(1e-12).ln()).collect()
    }
}
