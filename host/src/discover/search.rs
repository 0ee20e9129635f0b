//! The search: one effect after another, each confirmed in the presence of the others.

use super::candidates::{Candidate, Rivals, Score, Trials, candidates, refine, score, trials};
use super::fit::{Fit, fit};
use super::normal::{Normal, Whitened};
use super::stage::Point;
use crate::calibrate::{Campaign, Unknown};
use crate::effect::Scene;

/// What a search found.
#[derive(Clone)]
pub struct Search {
    /// The model without effects.
    pub baseline: Fit,
    /// The model with all that was found.
    pub last: Fit,
    /// For each effect found, in the order of the model, how it stands among its rivals.
    pub named: Vec<Named>,
    /// How many tests the search amounts to.
    pub trials: Trials,
}

/// An effect that was named.
#[derive(Clone)]
pub struct Named {
    /// Its score without it and with all others.
    pub score: Score,
    /// Logarithm of the chance that the whole search would find as much in noise.
    pub ln_p: f64,
    /// The next best candidates in its place, best first.
    pub rivals: Vec<Score>,
}

/// The chance of a false name over a whole run that is allowed to the search.
const FALSE_NAME: f64 = 0.005;

/// Effects that are looked for at most.
const MOST_EFFECTS: usize = 8;

/// Rivals that are kept.
const KEPT: usize = 12;

/// The scores of all candidates on top of a fit.
pub fn scores(fit: &Fit, scene: &Scene, all: &[Candidate], trials: &Trials) -> Vec<Score> {
    let white = Whitened::new(&fit.stage, &fit.strata);
    let normal = Normal::new(&white, 0, |_, _| unreachable!("no draws were asked for"));
    let rivals = Rivals::new(&normal, &fit.strata);
    let mut best = score(&normal, &rivals, scene, all, trials);
    // Between points of the grid lies more: the first few are looked at more closely.
    for place in 0..best.len().min(6) {
        best[place] = refine(&normal, &rivals, scene, &best[place], trials);
    }
    best.sort_by(|a, b| a.ln_p.total_cmp(&b.ln_p));
    best
}

/// Searches for effects.
pub fn search(campaign: &Campaign, scene: &mut Scene, start: Point, unknowns: &[Unknown], seed: u64) -> Option<Search> {
    let baseline = fit(campaign, scene, start, unknowns, None)?;
    let all = candidates(scene);
    let trials = trials(&baseline.stage, &baseline.strata, scene, &all, seed);
    let limit = FALSE_NAME.ln();
    let mut last = baseline.clone();
    let mut named: Vec<Named> = Vec::new();
    while named.len() < MOST_EFFECTS {
        let known = |candidate: &Candidate| {
            named.iter().any(|known| {
                known.score.instance.effect.name() == candidate.effect.name()
                    && known.score.instance.site == candidate.site
            })
        };
        let left: Vec<Candidate> = all.iter().filter(|candidate| !known(candidate)).cloned().collect();
        let scores = scores(&last, scene, &left, &trials);
        let Some(best) = scores.first().filter(|best| trials.over_all(best.ln_p) < limit) else { break };
        let mut point = last.point.clone();
        point.effects.push(best.instance.clone());
        let Some(next) = fit(campaign, scene, point, unknowns, None) else { break };
        named.push(Named {
            score: best.clone(),
            ln_p: trials.over_all(best.ln_p),
            rivals: scores.into_iter().skip(1).take(KEPT).collect(),
        });
        last = next;
    }
    Some(Search { baseline, last, named, trials })
}
