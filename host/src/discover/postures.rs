//! Hypotheses that depend on the posture alone, by the short way.
//!
//! What moves one joint or one parameter by an amount that is the same at every visit of a posture is a combination of as
//! many columns as there are postures. These are projected once; thousands of harmonics and products of angles then cost a
//! small product each.

use std::sync::OnceLock;

use nalgebra::DMatrix;

use super::factor::{Batch, Draws, Factor, Projected};
use super::normal::Normal;
use super::stage::Column;

/// Beyond so many postures the short way is none.
const MOST_POSTURES: usize = 800;

/// Up to so many postures every shape is looked at closely.
const FEW_POSTURES: usize = 60;

/// Amounts that differ within a posture by less than this share of the largest count as the same: joints never come back to
/// the last digit, and what is found this way is refined the long way.
const SAME: f64 = 0.02;

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
                drawn: self.draws.as_ref().and_then(|draws| {
                    self.factors[0].project_draws(&Batch::new(vec![cross]), draws).into_iter().next()
                }),
            }
        })
    }

    /// The amounts of columns at every posture, where they are all at one place and depend on nothing else.
    fn amounts(&self, columns: &[Column]) -> Option<Amounts> {
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
        Some(Amounts { place: *place, amounts })
    }

    /// About how much an hypothesis explains, as if its columns had nothing in common and calibration took from each posture's
    /// amount what it takes from all: enough to choose what is worth a closer look among many. None where there are few
    /// postures, which cost little, and where the short way is not open.
    pub fn rough(&self, columns: &[Column]) -> Option<f64> {
        if self.normal.white.stage.postures <= FEW_POSTURES {
            return None;
        }
        let Amounts { place, amounts } = self.amounts(columns)?;
        let all = self.at(place).projected.first()?;
        let of_column = |rank: usize| {
            let column = amounts.column(rank);
            let own: f64 =
                column.iter().zip(all.own.diagonal().iter()).map(|(amount, own)| amount * amount * own).sum();
            if own > 0.0 { column.dot(&all.response).powi(2) / own } else { 0.0 }
        };
        Some((0..amounts.ncols()).map(of_column).sum())
    }

    /// For every hypothesis its projections by the factors, in their order.
    pub fn projected(&self, hypotheses: &[&[Column]]) -> Vec<Vec<Projected>> {
        let Split { short, long } = self.split(hypotheses);
        let mut all: Vec<Vec<Projected>> = hypotheses.iter().map(|_| Vec::with_capacity(self.factors.len())).collect();
        for (rank, factor) in self.factors.iter().enumerate() {
            let mut long = factor.project_all(&long).into_iter();
            for (own, short) in all.iter_mut().zip(&short) {
                own.extend(short.as_ref().map(|short| self.of_amounts(short, rank)).or_else(|| long.next()));
            }
        }
        all
    }

    /// For every hypothesis its projection by the first factor, and its projected products with the draws: columns by draws.
    pub fn drawn(&self, hypotheses: &[&[Column]]) -> Vec<(Projected, DMatrix<f64>)> {
        let (Some(factor), Some(draws)) = (self.factors.first(), &self.draws) else { return Vec::new() };
        let Split { short, long } = self.split(hypotheses);
        let mut long = factor.project_all(&long).into_iter().zip(factor.project_draws(&long, draws));
        let of_short = |short: &Amounts| {
            let drawn = self.at(short.place).drawn.as_ref()?;
            Some((self.of_amounts(short, 0), short.amounts.transpose() * drawn))
        };
        short.iter().filter_map(|short| short.as_ref().map_or_else(|| long.next(), of_short)).collect()
    }

    fn split(&self, hypotheses: &[&[Column]]) -> Split {
        let short: Vec<Option<Amounts>> = hypotheses.iter().map(|columns| self.amounts(columns)).collect();
        let long = hypotheses.iter().zip(&short).filter(|(_, short)| short.is_none());
        let long = Batch::new(long.map(|(columns, _)| self.normal.cross(columns)).collect());
        Split { short, long }
    }

    /// What is left of amounts at postures, by the factor of a rank.
    fn of_amounts(&self, Amounts { place, amounts }: &Amounts, rank: usize) -> Projected {
        let place = self.at(*place);
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

/// Amounts of one place at every posture, postures by columns.
struct Amounts {
    place: usize,
    amounts: DMatrix<f64>,
}

/// Hypotheses by the way they go.
struct Split {
    /// The short way; none where it is not open.
    short: Vec<Option<Amounts>>,
    /// The others, in their order.
    long: Batch,
}
