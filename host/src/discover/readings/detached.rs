//! A sensor that has come off: against its mates it stays short of every rise by one share, and has the air's changes by
//! the same.

use super::candidate::{Candidate, Context, Estimate, Undo};
use super::mates::Mates;

/// Smallest share that is named.
const LEAST_SHARE: f64 = 0.08;

/// Standard error of the share that comes of bodies not interpolating between their neighbours, by the number of mates on
/// the link: a link loses heat to the air between them. Fewer than two mates do not interpolate.
fn unlikeness(mates: usize) -> f64 {
    if mates >= 3 { 0.018 } else { 0.035 }
}

/// Fewest mates.
const FEWEST_MATES: usize = 2;

/// The air's changes alone tell a share as well; it must agree within so many of its own standard errors.
const AGREEMENT: f64 = 3.5;

/// The share of air in a sensor.
pub(super) fn find(context: &Context<'_>, mates: &Mates<'_>, sensor: usize) -> Option<Candidate> {
    let air = mates.air()?;
    let of_link = mates.of_link(sensor);
    if of_link.len() < FEWEST_MATES {
        return None;
    }
    let (response, mean) = mates.interpolated(sensor, &of_link);
    let above: Vec<f64> = air.iter().zip(&mean).map(|(air, mean)| air - mean).collect();
    let fit = response.fit(&above)?;
    let share = fit.coefficient;
    if !(LEAST_SHARE..1.0).contains(&share) {
        return None;
    }
    let sigma = context.freedom.sigma(&fit).hypot(unlikeness(of_link.len()));
    let ratio = (share / sigma).powi(2) / context.freedom.count();
    if context.freedom.ln_p(ratio) > context.hopeless(1.0) {
        return None;
    }
    let free = super::explained::Response::new(mates.free(&of_link), mates.read(sensor));
    if let Some(alone) = free.fit(air)
        && (alone.coefficient - share).abs() > AGREEMENT * context.freedom.sigma(&alone).hypot(sigma)
    {
        return None;
    }
    let reach = context.freedom.quantile() * sigma;
    let name = &context.grid.sensors[sensor].name;
    Some(Candidate {
        effect: "sensor_detached",
        sensors: vec![sensor],
        score: context.freedom.score(fit.ratio),
        ln_p: context.freedom.ln_p(ratio) + context.sensors().ln(),
        parameters: vec![Estimate::new("air_share", share, share - reach, share + reach)],
        evidence: format!(
            "{name} reads {:.0} % of the air in what the {} other sensors of its link say of the body; with that they \
             explain it to {:.3} K",
            100.0 * share,
            of_link.len(),
            fit.left.sqrt(),
        ),
        undo: Undo::Detached { sensor, share },
    })
}
