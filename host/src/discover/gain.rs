//! What an extension gains on data that it was not fitted to: whole cycles and whole poses held out, the choice of effects
//! held out with them.

use rayon::prelude::*;

use super::candidates::{Candidate, Trials};
use super::fit::{Fit, fit};
use super::normal::Strata;
use super::search::Quest;
use super::stage::{Point, errors};
use crate::calibrate::{Campaign, Unknown};
use crate::effect::Scene;
use crate::model::ErrorTally;

/// One fold: the places of the visits that are held out.
pub type Fold = Vec<usize>;

/// Parts into which cycles and poses are split: a pose that is held out takes more of what tells the geometry with it.
const PARTS_OF_CYCLES: usize = 3;
const PARTS_OF_POSES: usize = 5;

/// Folds by whole poses and by whole cycles, as far as there are enough of them. Neighbouring cycles are alike and are held
/// out together; poses are taken in turn.
pub fn folds(campaign: &Campaign) -> Vec<Fold> {
    let split = |key: &dyn Fn(usize) -> u32, parts: usize, in_turn: bool| -> Vec<Fold> {
        let mut keys: Vec<u32> = (0..campaign.visits.len()).map(key).collect();
        keys.sort_unstable();
        keys.dedup();
        if keys.len() < 2 * parts {
            return Vec::new();
        }
        let part = |number: u32| {
            let rank = keys.binary_search(&number).unwrap_or(0);
            if in_turn { rank % parts } else { rank * parts / keys.len() }
        };
        (0..parts).map(|own| (0..campaign.visits.len()).filter(|&place| part(key(place)) == own).collect()).collect()
    };
    let by_cycle = split(&|place| campaign.visits[place].cycle, PARTS_OF_CYCLES, false);
    let mut all = split(&|place| campaign.visits[place].pose, PARTS_OF_POSES, true);
    all.extend(by_cycle);
    all
}

/// Errors over everything that was held out.
#[derive(Debug, Clone, Copy, Default)]
pub struct HeldOut {
    /// Without effects.
    pub before: ErrorTally,
    /// With the effects chosen anew in every fold.
    pub after: ErrorTally,
}

/// What held-out errors are computed from.
pub struct Question<'a> {
    /// All visits.
    pub campaign: &'a Campaign,
    /// Their scene.
    pub scene: &'a Scene,
    /// What calibration estimates.
    pub unknowns: &'a [Unknown],
    /// A start near the solution.
    pub start: &'a Point,
    /// The candidates of the search.
    pub candidates: &'a [Candidate],
    /// How many tests the search amounts to.
    pub trials: &'a Trials,
    /// A start near the strata of noise.
    pub noise: Option<Strata>,
}

impl Question<'_> {
    /// All visits but those held out, with their scene.
    fn without(&self, fold: &Fold) -> (Campaign, Scene) {
        let rest: Vec<usize> =
            (0..self.campaign.visits.len()).filter(|place| fold.binary_search(place).is_err()).collect();
        let visits = rest.iter().map(|&place| self.campaign.visits[place].clone()).collect();
        (Campaign { visits, ..self.campaign.select(|_| false) }, self.scene.select(&rest))
    }

    /// The errors of a fit on the visits held out.
    fn errors(&self, fold: &Fold, fitted: &Fit) -> ErrorTally {
        let mut whole = self.scene.clone();
        super::fit::update_growth(&mut whole, self.campaign, &fitted.point);
        let mut tally = ErrorTally::default();
        errors(self.campaign, &whole, &fitted.point, |visit, _, error| {
            if fold.binary_search(&visit).is_ok() {
                tally.add(error.norm());
            }
        });
        tally
    }

    /// Errors with given effects in the model, values fitted anew in every fold. None where a fold cannot be fitted.
    pub fn with(&self, point: &Point, folds: &[Fold]) -> Option<ErrorTally> {
        let of_fold = |fold: &Fold| {
            let (campaign, mut scene) = self.without(fold);
            let fitted = fit(&campaign, &mut scene, point.clone(), self.unknowns, self.noise.clone())?;
            Some(self.errors(fold, &fitted))
        };
        let tallies: Option<Vec<ErrorTally>> = folds.par_iter().map(of_fold).collect();
        let mut sum = ErrorTally::default();
        tallies?.iter().for_each(|tally| sum.merge(tally));
        Some(sum)
    }

    /// Errors without effects, and with effects searched for anew in every fold.
    pub fn nested(&self, folds: &[Fold]) -> Option<HeldOut> {
        let bare = Point { effects: Vec::new(), ..self.start.clone() };
        let of_fold = |fold: &Fold| {
            let (campaign, mut scene) = self.without(fold);
            let baseline = fit(&campaign, &mut scene, bare.clone(), self.unknowns, self.noise.clone())?;
            let before = self.errors(fold, &baseline);
            let Question { unknowns, candidates, trials, .. } = *self;
            let quest = Quest { campaign: &campaign, unknowns, candidates, trials };
            let extended = quest.climb(&mut scene, baseline);
            Some((before, self.errors(fold, &extended)))
        };
        let tallies: Option<Vec<_>> = folds.par_iter().map(of_fold).collect();
        let mut sum = HeldOut::default();
        for (before, after) in tallies? {
            sum.before.merge(&before);
            sum.after.merge(&after);
        }
        Some(sum)
    }
}
