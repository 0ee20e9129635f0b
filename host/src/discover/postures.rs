//! Hypotheses that depend on the posture alone, by the short way.
//!
//! What moves one joint or one parameter by an amount that is the same at every visit of a posture is a combination of as
//! many columns as there are postures. These are projected once; thousands of harmonics and products of angles then cost a
//! small product each.

use std::sync::OnceLock;

use nalgebra::DMatrix;

use super::normal::{Cross, Factor, Normal, Projected};
use super::stage::Column;

/// Beyond so many postures the short way is none.
const MOST_POSTURES: usize = 800;

/// Up to so many postures every shape is looked at closely.
const FEW_POSTURES: usize = 60;

/// Amounts that differ within a posture by less than this share of the largest count as the same: joints never come back to
/// the last digit, and what is found this way is refined the long way.
const SAME: f64 = 0.02;

/// Draws of noise as [`Factor::project_draws`] takes them.
pub struct Draws<'a> {
    /// [`Factor::turn_draws`].
    pub turned: &'a DMatrix<f64>,
    /// Shared errors.
    pub shared: &'a DMatrix<f64>,
}

/// One place's columns, posture by posture, projected by every factor.
struct AtPlace {
    /// Products among themselves before projection: nothing beside the diagonal.
    before: Vec<f64>,
    projected: Vec<Projected>,
    drawn: Option<DMatrix<f64>>,
}

/// The short way, place by place as it is needed.
pub struct AtPostures<'a> {
    normal: &'a Normal<'a>,
    factors: &'a [Factor],
    draws: Option<Draws<'a>>,
    places: Vec<OnceLock<AtPlace>>,
}

/// An hypothesis with its products, by the long way or the short one.
pub enum Products<'a> {
    /// Any columns.
    Columns(Cross),
    /// Amounts at postures, postures by columns.
    Amounts(&'a AtPostures<'a>, usize, DMatrix<f64>),
}

impl<'a> AtPostures<'a> {
    /// The short way under some factors, with draws of noise for the first of them.
    pub fn new(normal: &'a Normal<'a>, factors: &'a [Factor], draws: Option<Draws<'a>>) -> Self {
        let places = (0..normal.white.stage.places.count()).map(|_| OnceLock::new()).collect();
        Self { normal, factors, draws, places }
    }

    fn at(&self, place: usize) -> &AtPlace {
        self.places[place].get_or_init(|| {
            let cross = self.normal.cross_at_postures(place);
            AtPlace {
                before: cross.own.diagonal().iter().copied().collect(),
                projected: self.factors.iter().map(|factor| factor.project(&cross)).collect(),
                drawn: self
                    .draws
                    .as_ref()
                    .map(|draws| self.factors[0].project_draws(&cross, draws.turned, draws.shared)),
            }
        })
    }

    /// The amounts of columns at every posture, where they are all at one place and depend on nothing else.
    fn amounts(&self, columns: &[Column]) -> Option<(usize, DMatrix<f64>)> {
        let stage = self.normal.white.stage;
        if stage.postures > MOST_POSTURES {
            return None;
        }
        let [(place, _)] = columns.first()?.as_slice() else { return None };
        let mut amounts = DMatrix::from_element(stage.postures, columns.len(), f64::NAN);
        for (rank, column) in columns.iter().enumerate() {
            let [(own, by_visit)] = column.as_slice() else { return None };
            if own != place {
                return None;
            }
            let allowed = SAME * by_visit.iter().fold(0.0_f64, |most, amount| most.max(amount.abs()));
            for (&amount, block) in by_visit.iter().zip(&stage.blocks) {
                let known = &mut amounts[(block.posture, rank)];
                if known.is_nan() {
                    *known = amount;
                } else if (*known - amount).abs() > allowed {
                    return None;
                }
            }
        }
        Some((*place, amounts))
    }

    /// About how much an hypothesis explains, as if its columns had nothing in common and calibration took from each posture's
    /// amount what it takes from all: enough to choose what is worth a closer look among many. None where there are few
    /// postures, which cost little, and where the short way is not open.
    pub fn rough(&self, columns: &[Column]) -> Option<f64> {
        if self.normal.white.stage.postures <= FEW_POSTURES {
            return None;
        }
        let (place, amounts) = self.amounts(columns)?;
        let all = self.at(place).projected.first()?;
        let of_column = |rank: usize| {
            let column = amounts.column(rank);
            let own: f64 =
                column.iter().zip(all.own.diagonal().iter()).map(|(amount, own)| amount * amount * own).sum();
            if own > 0.0 { column.dot(&all.response).powi(2) / own } else { 0.0 }
        };
        Some((0..amounts.ncols()).map(of_column).sum())
    }

    /// The products of an hypothesis, the short way where it is open.
    pub fn products(&'a self, columns: &[Column]) -> Products<'a> {
        match self.amounts(columns) {
            Some((place, amounts)) => Products::Amounts(self, place, amounts),
            None => Products::Columns(self.normal.cross(columns)),
        }
    }
}

impl Products<'_> {
    /// The hypothesis projected by a factor, which is that of the given rank where the short way was prepared.
    pub fn project(&self, rank: usize, factor: &Factor) -> Projected {
        match self {
            Products::Columns(cross) => factor.project(cross),
            Products::Amounts(at, place, amounts) => {
                let place = at.at(*place);
                let all = &place.projected[rank];
                let square = |column: usize| -> f64 {
                    amounts.column(column).iter().zip(&place.before).map(|(amount, own)| amount * amount * own).sum()
                };
                Projected {
                    own: amounts.transpose() * (&all.own * amounts),
                    response: amounts.tr_mul(&all.response),
                    before: (0..amounts.ncols()).map(|column| square(column).sqrt()).collect(),
                }
            }
        }
    }

    /// The projected products with draws of noise: columns by draws.
    pub fn project_draws(&self, factor: &Factor, draws: &Draws<'_>) -> DMatrix<f64> {
        match self {
            Products::Columns(cross) => factor.project_draws(cross, draws.turned, draws.shared),
            Products::Amounts(at, place, amounts) => match &at.at(*place).drawn {
                Some(drawn) => amounts.transpose() * drawn,
                None => DMatrix::zeros(amounts.ncols(), 0),
            },
        }
    }
}
