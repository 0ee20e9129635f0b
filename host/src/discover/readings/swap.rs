//! Two sensors that carry each other's names: each fits the other's link far better than its own, and on one link it
//! makes no difference.

use super::candidate::{Candidate, Context, Undo};
use super::explained::{Response, dot};
use super::mates::Mates;

/// Each of the two must leave at least this many times less square in the other's place.
const LEAST_RATIO: f64 = 2.5;

/// After the exchange each is explained no worse than this many times the median sensor, RMS.
const MOST_LEFT: f64 = 4.0;

/// The best exchanges of two sensors, best first.
pub(super) fn find(context: &Context<'_>, mates: &Mates<'_>) -> Vec<Candidate> {
    let sensors = &context.grid.sensors;
    let explained: Vec<Option<_>> = (0..sensors.len())
        .map(|sensor| {
            let of_link = mates.of_link(sensor);
            // By weights that sum to one: free ones would follow a sensor of another link half the way.
            (!of_link.is_empty()).then(|| mates.interpolated(sensor, &of_link))
        })
        .collect();
    let mut all: Vec<f64> = explained.iter().flatten().map(|(own, _)| own.square).collect();
    all.sort_by(f64::total_cmp);
    let Some(&median) = all.get(all.len() / 2) else { return Vec::new() };
    let mut found = Vec::new();
    let pairs = (sensors.len() * (sensors.len() - 1) / 2) as f64;
    for one in 0..sensors.len() {
        for other in one + 1..sensors.len() {
            let (Some((at_one, mean_one)), Some((at_other, mean_other))) = (&explained[one], &explained[other]) else {
                continue;
            };
            if sensors[one].link == sensors[other].link {
                continue;
            }
            let left = |at: &Response, mean: &[f64], read: usize| {
                let above: Vec<f64> = mates.read(read).iter().zip(mean).map(|(value, mean)| value - mean).collect();
                let rest = at.explained.rest(&above);
                dot(&rest, &rest).max(f64::MIN_POSITIVE)
            };
            let (left_one, left_other) = (left(at_one, mean_one, other), left(at_other, mean_other, one));
            let ratios = [at_one.square / left_one, at_other.square / left_other];
            let most_left = MOST_LEFT * MOST_LEFT * median;
            if ratios.iter().any(|ratio| *ratio < LEAST_RATIO) || left_one.max(left_other) > most_left {
                continue;
            }
            let freedom = context.freedom;
            let ln_p = ratios.iter().map(|ratio| freedom.ln_p(ratio - 1.0)).sum::<f64>() + pairs.ln();
            if ln_p > context.hopeless(1.0) {
                continue;
            }
            let (a, b) = (&sensors[one], &sensors[other]);
            let rms = |square: f64| (square / context.times_s.len() as f64).sqrt();
            found.push(Candidate {
                effect: "sensor_swap",
                sensors: vec![one, other],
                score: ratios.iter().map(|ratio| freedom.score(ratio - 1.0)).sum(),
                ln_p,
                parameters: Vec::new(),
                evidence: format!(
                    "what {} and {} read fits links {} and {} to {:.3} and {:.3} K, and to {:.3} and {:.3} K with the names \
                     exchanged",
                    a.name,
                    b.name,
                    a.link,
                    b.link,
                    rms(at_one.square),
                    rms(at_other.square),
                    rms(left_one),
                    rms(left_other),
                ),
                undo: Undo::Swap { one, other },
            });
        }
    }
    found.sort_by(|left, right| right.score.total_cmp(&left.score));
    found
}
