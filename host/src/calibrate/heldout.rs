//! How accurate a calibration is on data that it did not see: whole poses, or whole cycles, held out in turn.

use super::calibration::{CalibrationError, Request, position_errors, start};
use super::campaign::{Campaign, ObservedVisit};
use super::identify::{geometric_unknowns, identify};
use super::unknown::{State, Unknown};
use crate::model::{ErrorTally, Errors};
use crate::robot::Robot;
use crate::run::{FoldError, Run, folds_by_cycle, folds_by_pose};

/// What is held out together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeldOutBy {
    /// All visits of a posture.
    Pose,
    /// All visits of a cycle.
    Cycle,
}

/// Errors of position on held-out visits, over all folds together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldOut {
    /// What was held out.
    pub by: HeldOutBy,
    /// The number of folds.
    pub folds: usize,
    /// The seed that dealt poses or cycles out to the folds.
    pub seed: u64,
    /// The errors.
    pub errors: Errors,
}

/// How folds are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Folds {
    /// What is held out together.
    pub by: HeldOutBy,
    /// How many.
    pub count: usize,
    /// Which poses or cycles come together is drawn from this seed.
    pub seed: u64,
}

/// Why nothing could be held out.
#[derive(Debug, thiserror::Error)]
pub enum HeldOutError {
    /// The run does not have that many poses or cycles.
    #[error(transparent)]
    Folds(#[from] FoldError),
    /// A fold could not be calibrated.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
}

/// Calibrates on all folds but one and predicts that one, in turn, with the growth terms of `growth_of`, a calibration of
/// the whole run. Alignment and every value are found anew in each fold.
///
/// # Errors
/// More folds than there are poses or cycles, or a fold that cannot be calibrated.
pub fn held_out(
    robot: &Robot,
    run: &Run,
    request: &Request,
    growth_of: &Campaign,
    Folds { by, count: folds, seed }: Folds,
    mut progress: impl FnMut(usize),
) -> Result<HeldOut, HeldOutError> {
    // Only visits that the calibration itself uses are dealt out.
    let used: Vec<&crate::run::Visit> = growth_of.visits.iter().map(|visit| &run.visits[visit.place]).collect();
    let visits: Vec<crate::run::Visit> = used.into_iter().cloned().collect();
    let dealt = match by {
        HeldOutBy::Pose => folds_by_pose(&visits, folds, seed)?,
        HeldOutBy::Cycle => folds_by_cycle(&visits, folds, seed)?,
    };
    let mut fold_of = vec![None; run.visits.len()];
    for (visit, fold) in growth_of.visits.iter().zip(dealt) {
        fold_of[visit.place] = Some(fold);
    }
    let mut tally = ErrorTally::default();
    for fold in 0..folds {
        progress(fold);
        let learnt = |visit: &ObservedVisit| fold_of[visit.place].is_some_and(|own| own != fold);
        let begun = start(robot, run, request, learnt).map_err(CalibrationError::from)?;
        let observed = &begun.observed;
        let campaign = Campaign { growth: growth_of.growth.clone(), ..observed.campaign.clone() };
        let mut unknowns =
            geometric_unknowns(&campaign, &observed.unknown_targets, &observed.unknown_anchors, &begun.fixed);
        unknowns.extend((0..campaign.growth.len()).map(Unknown::Growth));
        let nominal = State { growth: vec![0.0; campaign.growth.len()], ..begun.nominal };
        let found = identify(&campaign, unknowns, nominal, &request.manner);
        if !found.solution.stop.converged() {
            return Err(CalibrationError::NotConverged(found.solution.stop.words().to_owned()).into());
        }
        let unseen = growth_of.select(|visit| fold_of[visit.place] == Some(fold));
        tally.merge(&position_errors(&unseen, &found.solution.state));
    }
    Ok(HeldOut { by, folds, seed, errors: tally.errors() })
}
