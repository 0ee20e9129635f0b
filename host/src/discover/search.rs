//! The search: one effect after another, each confirmed in the presence of the others, dropped when they make it needless,
//! and exchanged where another explains more in its place.

use std::collections::BTreeSet;

use super::candidates::{Candidate, Ground, Score, Trials, candidates, is_pattern, trials};
use super::chance::ln_chi_square;
use super::fit::{EffectCovariance, Fit, fit, update_growth};
use super::stage::Point;
use crate::calibrate::{Campaign, Unknown};
use crate::effect::{Instance, Scene};

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
    /// All candidates on top of the baseline, best first.
    on_baseline: Vec<Score>,
}

/// An effect that was found.
#[derive(Clone)]
pub struct Named {
    /// Its score without it and with all others.
    pub score: Score,
    /// Logarithm of the chance that the whole search would find as much in noise.
    pub ln_p: f64,
    /// The other candidates in its place, best first.
    pub rivals: Vec<Score>,
    /// The times between which a step lies with 95 % confidence; none where the effect has no step.
    pub between: Option<(f64, f64)>,
}

/// The chance of a false name over a whole run that is allowed to the search for a first effect, and for each one after it:
/// what the fit of an effect's form leaves is more than noise.
const FALSE_NAME: f64 = 0.005;
const FALSE_NEXT: f64 = 0.0005;

/// Effects that are looked for at most.
const MOST_EFFECTS: usize = 24;

/// Exchanges at most: rivals that fit alike would change places for long.
const MOST_EXCHANGES: usize = 3;

/// An exchange must be better by this, in log evidence.
const LEAST_BETTER: f64 = 0.5;

/// Rivals that are kept.
const KEPT: usize = 12;

/// A pattern outside the catalogue must be this much less likely to be noise than the best of the catalogue (logarithm).
const HANDICAP: f64 = 4.0;

/// How many of the best are looked at between the points of their grids.
const LOOKED_AT: usize = 6;

/// What stays the same all through a search.
pub struct Quest<'a> {
    /// The measurements.
    pub campaign: &'a Campaign,
    /// What calibration estimates.
    pub unknowns: &'a [Unknown],
    /// What is looked for.
    pub candidates: &'a [Candidate],
    /// How many tests the search amounts to.
    pub trials: &'a Trials,
}

/// Searches for effects on top of a calibrated model.
/// `done` is called twice as it goes on.
pub fn search(
    campaign: &Campaign,
    scene: &mut Scene,
    start: Point,
    unknowns: &[Unknown],
    seed: u64,
    done: &dyn Fn(),
) -> Option<Search> {
    let baseline = fit(campaign, scene, start, unknowns, None)?;
    let candidates = candidates(scene);
    let trials = trials(&baseline.stage, &baseline.strata, scene, &candidates, seed);
    let quest = Quest { campaign, unknowns, candidates: &candidates, trials: &trials };
    let on_baseline = quest.scores(&baseline, scene);
    done();
    let last = quest.climb_by(scene, baseline.clone(), on_baseline.clone());
    done();
    let mut search = Search { baseline, last, named: Vec::new(), trials: trials.clone(), on_baseline };
    search.judge(&quest, scene);
    Some(search)
}

/// The candidates that a model does not have yet.
fn left<'a>(all: &'a [Candidate], effects: &'a [Instance]) -> Vec<Candidate> {
    let has = |candidate: &Candidate| {
        effects.iter().any(|own| {
            own.effect.name() == candidate.effect.name()
                && own.site == candidate.site
                // A joint may err in more than one way that has no name.
                && !is_pattern(own.effect)
        })
    };
    all.iter().filter(|candidate| !has(candidate)).cloned().collect()
}

impl Quest<'_> {
    /// The scores on top of a fit of all candidates that its model does not have yet, best first; patterns with their handicap.
    fn scores(&self, fit: &Fit, scene: &Scene) -> Vec<Score> {
        let ground = Ground::new(&fit.stage, &fit.strata, scene, self.trials);
        let mut best = ground.score(&left(self.candidates, &fit.point.effects));
        let level = |score: &Score| score.ln_p + if is_pattern(score.instance.effect) { HANDICAP } else { 0.0 };
        best.sort_by(|a, b| level(a).total_cmp(&level(b)));
        for place in 0..best.len().min(LOOKED_AT) {
            best[place] = ground.refine(&best[place]);
        }
        best.sort_by(|a, b| level(a).total_cmp(&level(b)));
        best
    }

    fn fit(&self, scene: &mut Scene, point: Point, near: &Fit) -> Option<Fit> {
        fit(self.campaign, scene, point, self.unknowns, Some(near.strata.clone()))
    }

    /// Adds effects to a fit as long as the data ask for them.
    pub fn climb(&self, scene: &mut Scene, from: Fit) -> Fit {
        update_growth(scene, self.campaign, &from.point);
        let scores = self.scores(&from, scene);
        self.climb_by(scene, from, scores)
    }

    /// The same where the scores on top of the fit are known.
    fn climb_by(&self, scene: &mut Scene, from: Fit, mut scores: Vec<Score>) -> Fit {
        let mut last = from;
        // Effects that take turns in driving each other out would be added and dropped for ever.
        let mut seen: Vec<Vec<Instance>> = Vec::new();
        while last.point.effects.len() < MOST_EFFECTS {
            let limit = if last.point.effects.is_empty() { FALSE_NAME.ln() } else { FALSE_NEXT.ln() };
            let likely = |best: &&Score| self.trials.over_all(&best.instance, best.ln_p) < limit;
            let Some(best) = scores.first().filter(likely) else { break };
            let mut point = last.point.clone();
            point.effects.push(best.instance.clone());
            let Some(next) = self.fit(scene, point, &last) else { break };
            last = self.prune(scene, next);
            let same = |known: &Vec<Instance>| {
                let now = &last.point.effects;
                known.len() == now.len() && now.iter().all(|own| known.iter().any(|other| other.same_name(own)))
            };
            if seen.iter().any(same) {
                break;
            }
            seen.push(last.point.effects.clone());
            update_growth(scene, self.campaign, &last.point);
            scores = self.scores(&last, scene);
        }
        update_growth(scene, self.campaign, &last.point);
        last
    }

    /// Drops effects that the others make needless.
    fn prune(&self, scene: &mut Scene, mut fitted: Fit) -> Fit {
        while fitted.point.effects.len() > 1 {
            let effects = fitted.point.effects.iter().zip(&fitted.covariances).enumerate();
            let chances = effects.filter_map(|(place, (effect, covariance))| {
                let (ratio, freedom) = worth(effect, covariance)?;
                let candidate = Candidate { effect: effect.effect, site: effect.site.clone() };
                let own = ln_chi_square(ratio, freedom);
                let ln_p = self.trials.over_shapes(&candidate, &effect.shape, own, ratio);
                Some((place, self.trials.over_all(effect, ln_p)))
            });
            let weakest = chances.max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((place, _)) = weakest.filter(|(_, ln_p)| *ln_p > FALSE_NAME.ln()) else { break };
            let mut point = fitted.point.clone();
            point.effects.remove(place);
            let Some(next) = self.fit(scene, point, &fitted) else { break };
            fitted = next;
        }
        fitted
    }
}

/// Twice the log likelihood that an effect's coefficients are worth in the presence of all others (Wald).
fn worth(effect: &Instance, covariance: &EffectCovariance) -> Option<(f64, usize)> {
    let count = covariance.coefficients.len();
    if count == 0 {
        return None;
    }
    let own = covariance.matrix.view((0, 0), (count, count)).into_owned();
    let values = nalgebra::DVector::from_iterator(
        count,
        covariance.coefficients.iter().map(|&place| effect.coefficients[place]),
    );
    let solved = own.cholesky()?.solve(&values);
    Some((values.dot(&solved), count))
}

impl Search {
    /// The best candidate of each effect on top of the baseline, the least likely to be noise first.
    pub fn tests(&self) -> Vec<&Score> {
        let mut seen = BTreeSet::new();
        self.on_baseline.iter().filter(|score| seen.insert(score.instance.effect.name())).collect()
    }

    /// How each effect stands among its rivals with all others kept; one that a rival beats there gives way to it.
    fn judge(&mut self, quest: &Quest<'_>, scene: &mut Scene) {
        let mut exchanges = 0;
        'again: loop {
            self.named.clear();
            for place in 0..self.last.point.effects.len() {
                let mut point = self.last.point.clone();
                let own = point.effects.remove(place);
                let without = match point.effects.is_empty() {
                    true => Some(self.baseline.clone()),
                    false => quest.fit(scene, point, &self.last),
                };
                let Some(without) = without else { continue };
                update_growth(scene, quest.campaign, &without.point);
                let scores = match without.point.effects.is_empty() {
                    true => self.on_baseline.clone(),
                    false => quest.scores(&without, scene),
                };
                let Some(mine) = scores.iter().find(|score| score.instance.same_name(&own)).cloned() else {
                    // Without it nothing speaks for it any more: it was another's shadow.
                    if let Some(next) = (exchanges < MOST_EXCHANGES).then_some(without) {
                        exchanges += 1;
                        self.last = next;
                        continue 'again;
                    }
                    continue;
                };
                if let Some(best) =
                    scores.first().filter(|best| !best.instance.same_name(&own) && exchanges < MOST_EXCHANGES)
                {
                    let mut point = without.point.clone();
                    point.effects.insert(place, best.instance.clone());
                    // What the rival gains by having fewer numbers and shapes counts beside what it fits.
                    let simpler = (mine.ln_p - best.ln_p) - 0.5 * (best.ratio - mine.ratio);
                    let least = self.last.log_likelihood - simpler + LEAST_BETTER;
                    if let Some(next) = quest.fit(scene, point, &self.last).filter(|next| next.log_likelihood > least) {
                        exchanges += 1;
                        self.last = quest.climb(scene, next);
                        continue 'again;
                    }
                }
                let rivals = scores.into_iter().filter(|score| !score.instance.same_name(&own)).take(KEPT).collect();
                let ln_p = self.trials.over_all(&own, mine.ln_p);
                let between = (!own.effect.is_smooth())
                    .then(|| Ground::new(&without.stage, &without.strata, scene, &self.trials).step_between(&own))
                    .flatten();
                self.named.push(Named { score: mine, ln_p, rivals, between });
            }
            break;
        }
        update_growth(scene, quest.campaign, &self.last.point);
    }
}
