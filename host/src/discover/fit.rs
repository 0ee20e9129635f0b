//! Fits a model with effects: geometry, growth, coefficients and nonlinear numbers together, under all strata of noise.

use nalgebra::DMatrix;

use super::noise::strata;
use super::normal::{Rows, Strata, System};
use super::stage::{Column, Point, Stage};
use crate::calibrate::{Campaign, Unknown};
use crate::effect::{Instance, Scene};

/// What a column of the fit belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    Unknown(usize),
    Coefficient { effect: usize, place: usize },
    Shape { effect: usize, place: usize },
}

/// A fitted model.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The values.
    pub point: Point,
    /// The run linearised about them, effects and their nonlinear numbers among the nuisance.
    pub stage: Stage,
    /// The strata of noise that are left.
    pub strata: Strata,
    /// Restricted log likelihood, but for a constant that depends on the run alone.
    pub log_likelihood: f64,
    /// Covariance of each effect's coefficients, then of those of its nonlinear numbers that were fitted.
    pub covariances: Vec<EffectCovariance>,
}

/// How sure an effect's numbers are.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectCovariance {
    /// Coefficients that were fitted, by place.
    pub coefficients: Vec<usize>,
    /// Nonlinear numbers that were fitted, by place.
    pub shape: Vec<usize>,
    /// Of the two together.
    pub matrix: DMatrix<f64>,
}

/// Rounds of Gauss and Newton.
const ROUNDS: usize = 12;

/// Shares of a step that are tried one after another.
const SHARES: [f64; 4] = [1.0, 0.25, 0.06, 0.015];

/// A step whose square, in units of the noise, is below this has arrived.
const ARRIVED: f64 = 1e-4;

/// The unknowns that can be fitted here: orientations and distances are not looked at.
pub fn positional(unknowns: &[Unknown]) -> Vec<Unknown> {
    let seen =
        |unknown: &&Unknown| matches!(unknown, Unknown::Parameter(_) | Unknown::Target { .. } | Unknown::Growth(_));
    unknowns.iter().filter(seen).copied().collect()
}

/// Brings the thermal coefficients that effects see up to those of a point.
pub fn update_growth(scene: &mut Scene, campaign: &Campaign, point: &Point) {
    scene.growth = campaign.growing(&point.state.growth);
}

/// The derivative of an effect by one of its nonlinear numbers, as a column.
fn by_shape(stage: &Stage, scene: &Scene, effect: &Instance, place: usize) -> Column {
    let step = 1e-3 * effect.shape[place].abs().max(1e-3);
    let moved = |by: f64| {
        let mut shape = effect.shape.clone();
        shape[place] += by;
        effect.effect.terms(scene, &effect.site, &shape)
    };
    let mut column: Column = Vec::new();
    for (terms, sign) in [(moved(step), 1.0), (moved(-step), -1.0)] {
        for (term, coefficient) in terms.iter().zip(&effect.coefficients) {
            for (place, amounts) in stage.column(scene, term) {
                let factor = sign * coefficient / (2.0 * step);
                match column.iter_mut().find(|(known, _)| *known == place) {
                    Some((_, sum)) => {
                        sum.iter_mut().zip(&amounts).for_each(|(sum, amount)| *sum += factor * amount);
                    }
                    None => column.push((place, amounts.iter().map(|amount| factor * amount).collect())),
                }
            }
        }
    }
    column
}

fn linearise(campaign: &Campaign, scene: &Scene, point: &Point, unknowns: &[Unknown]) -> (Stage, Vec<Owner>) {
    let mut stage = Stage::new(campaign, scene, point, unknowns);
    let mut owners: Vec<Owner> = (0..unknowns.len()).map(Owner::Unknown).collect();
    for (rank, effect) in point.effects.iter().enumerate() {
        if effect.effect.fixed_coefficient().is_none() {
            for (place, term) in effect.terms(scene).iter().enumerate() {
                let column = stage.column(scene, term);
                stage.nuisance.push(column);
                owners.push(Owner::Coefficient { effect: rank, place });
            }
        }
        let reach = effect.effect.refine(scene, &effect.shape);
        if effect.effect.is_smooth() {
            for place in (0..reach.len()).filter(|&place| reach[place] > 0.0) {
                let column = by_shape(&stage, scene, effect, place);
                stage.nuisance.push(column);
                owners.push(Owner::Shape { effect: rank, place });
            }
        }
    }
    (stage, owners)
}

/// Fits all values from a point near them; the noise from that of a model near it, where there is one. `scene` follows the
/// thermal coefficients.
pub fn fit(
    campaign: &Campaign,
    scene: &mut Scene,
    start: Point,
    unknowns: &[Unknown],
    noise: Option<Strata>,
) -> Option<Fit> {
    let mut point = start;
    for effect in &mut point.effects {
        if let Some(one) = effect.effect.fixed_coefficient() {
            effect.coefficients.fill(one);
        }
    }
    update_growth(scene, campaign, &point);
    let (mut stage, mut owners) = linearise(campaign, scene, &point, unknowns);
    // Weighed once a new effect has found its size: before, what it explains would count as noise.
    let first = if point.effects.is_empty() { 0 } else { 1 };
    let mut is_weighed = false;
    let mut noise = noise.unwrap_or_else(|| strata(&stage, None));
    let mut system = System::new(&stage, &Rows::new(&stage), &noise);
    for round in 0..ROUNDS {
        let factor = system.factor(noise.posture, noise.cycle)?;
        let (step, covariance) = factor.solution(owners.len());
        let length = step.dot(&system.right.rows(0, owners.len()));
        let merit = system.merit(noise.posture, noise.cycle)?;
        // A step that makes the errors larger is too long for what is linear about it, most often along a harmonic.
        let taken = (length.abs() >= ARRIVED && round + 1 < ROUNDS)
            .then(|| {
                SHARES.iter().find_map(|share| {
                    let mut next = point.clone();
                    apply(&mut next, unknowns, &owners, (&step * *share).as_slice());
                    update_growth(scene, campaign, &next);
                    let (stage, owners) = linearise(campaign, scene, &next, unknowns);
                    let system = System::new(&stage, &Rows::new(&stage), &noise);
                    (system.merit(noise.posture, noise.cycle)? <= merit + ARRIVED)
                        .then_some((next, stage, owners, system))
                })
            })
            .flatten();
        let Some(next) = taken else {
            if !is_weighed {
                noise = strata(&stage, Some(&noise));
                system = System::new(&stage, &Rows::new(&stage), &noise);
                is_weighed = true;
                continue;
            }
            update_growth(scene, campaign, &point);
            let covariances =
                (0..point.effects.len()).map(|effect| own_covariance(effect, &owners, &covariance)).collect();
            let log_likelihood = factor.log_likelihood;
            return Some(Fit { point, stage, strata: noise, log_likelihood, covariances });
        };
        (point, stage, owners, system) = next;
        if round >= first && !is_weighed {
            is_weighed = true;
            noise = strata(&stage, Some(&noise));
            system = System::new(&stage, &Rows::new(&stage), &noise);
        }
    }
    None
}

fn apply(point: &mut Point, unknowns: &[Unknown], owners: &[Owner], step: &[f64]) {
    let own: Vec<f64> = step[..unknowns.len()].to_vec();
    point.state = point.state.moved(unknowns, &own);
    for (owner, step) in owners.iter().zip(step) {
        match *owner {
            Owner::Unknown(_) => {}
            Owner::Coefficient { effect, place } => point.effects[effect].coefficients[place] += step,
            Owner::Shape { effect, place } => {
                // A time constant or a harmonic may neither run away nor change its sign in one step.
                let value = &mut point.effects[effect].shape[place];
                let most = 0.3 * value.abs().max(1e-3);
                *value += step.clamp(-most, most);
            }
        }
    }
}

fn own_covariance(effect: usize, owners: &[Owner], covariance: &DMatrix<f64>) -> EffectCovariance {
    let mut places = Vec::new();
    let (mut coefficients, mut shape) = (Vec::new(), Vec::new());
    for (rank, owner) in owners.iter().enumerate() {
        match *owner {
            Owner::Coefficient { effect: own, place } if own == effect => {
                coefficients.push(place);
                places.push(rank);
            }
            Owner::Shape { effect: own, place } if own == effect => {
                shape.push(place);
                places.push(rank);
            }
            _ => {}
        }
    }
    EffectCovariance { coefficients, shape, matrix: covariance.select_rows(&places).select_columns(&places) }
}
