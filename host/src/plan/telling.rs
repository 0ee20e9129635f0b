//! What a pose would tell: the rows that a calibration would get of it, whitened by the noise that is expected.
//!
//! The derivatives are those of `calibrate::Problem`. Noise is the instrument's, of each coordinate by itself, and where it
//! is given the arm's: an error of each joint at each visit, which moves all targets of the visit together. With `K` the
//! whitened derivative by the joints and `s` their standard deviation, rows are multiplied by `(I + s² K Kᵀ)^(-1/2)`.
//!
//! Unknowns are metres and radians, and some move the arm more than others: columns are scaled to a root mean square of one
//! over the poses that could be measured, so that no index depends on units.

use nalgebra::{DMatrix, Vector3};

use crate::calibrate::{
    Campaign, Held, Manner, Names, ObservedPosition, ObservedVisit, Problem, State, Unknown, Weak, geometric_unknowns,
    identify,
};
use crate::robot::{Posture, Prepared, Robot, Symbol};
use crate::run::Instrument;

/// The arm, the instrument and the noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// The arm, with the targets that will be measured.
    pub robot: Robot,
    /// Where it and its targets are believed to be.
    pub state: State,
    /// Targets whose place on the flange is to be identified.
    pub unknown_targets: Vec<usize>,
    /// Places of parameters that are not identified.
    pub fixed: Vec<usize>,
    /// The tracker.
    pub instrument: Instrument,
    /// 1-sigma of each joint from visit to visit, rad or m.
    pub joint_sigma: f64,
}

/// Where an instrument states no noise, m: as `calibrate::observe` has it.
const SMALLEST_SIGMA: f64 = 1e-9;

/// Rows whose singular values are below this share of the largest tell nothing.
const NOTHING: f64 = 1e-12;

impl Setup {
    /// The arm as it is believed to be.
    pub fn prepared(&self) -> Prepared {
        self.robot.chain().prepare(&self.state.geometry.parameters)
    }

    /// What would be measured at postures, were there no noise.
    pub fn campaign(&self, postures: &[Vec<f64>]) -> Campaign {
        let arm = self.prepared();
        let station = Vector3::from(self.instrument.position);
        let targets = &self.state.geometry.targets;
        let visit = |(place, joints): (usize, &Vec<f64>)| {
            let posture = Posture::new(joints);
            let flange = arm.flange(&posture);
            let positions: Vec<ObservedPosition> = targets
                .iter()
                .enumerate()
                .map(|(target, at)| ObservedPosition { target, at: flange.point(at) })
                .collect();
            let away = positions.iter().map(|position| (position.at - station).norm()).sum::<f64>();
            let away = away / positions.len().max(1) as f64;
            ObservedVisit {
                place,
                cycle: 0,
                pose: place as u32,
                posture,
                rises: Vec::new(),
                positions,
                sigma: (self.instrument.sigma_m + self.instrument.sigma_per_m * away).max(SMALLEST_SIGMA),
                turns: Vec::new(),
                turn_sigma: 1.0,
                distances: Vec::new(),
            }
        };
        Campaign {
            chain: self.robot.chain(),
            targets: self.robot.targets.iter().map(|target| target.name.clone()).collect(),
            anchors: Vec::new(),
            sensors: Vec::new(),
            growth: Vec::new(),
            visits: postures.iter().enumerate().map(visit).collect(),
        }
    }
}

/// What poses tell of the unknowns that can be told at all.
#[derive(Debug, Clone)]
pub struct Telling {
    setup: Setup,
    unknowns: Vec<Unknown>,
    /// Each unknown's unit in the scaled columns, m or rad.
    scale: Vec<f64>,
    /// Unknowns that no choice of these poses tells from others.
    pub held: Vec<Held>,
    /// Unknowns that all of these poses together would tell worse than 10 mm or 10 mrad.
    pub weak: Vec<Weak>,
}

impl Telling {
    /// Finds out what `pool`, postures that could be measured, can tell, and scales by it.
    pub fn new(setup: Setup, pool: &[Vec<f64>]) -> Self {
        let campaign = setup.campaign(pool);
        let asked = geometric_unknowns(&campaign, &setup.unknown_targets, &[], &setup.fixed);
        let found = identify(&campaign, asked, setup.state.clone(), &Manner::default());
        let mut telling = Self {
            setup,
            scale: vec![1.0; found.unknowns.len()],
            unknowns: found.unknowns,
            held: found.held,
            weak: found.weak,
        };
        let mut squares = vec![0.0; telling.unknowns.len()];
        for rows in telling.rows(pool) {
            for (square, column) in squares.iter_mut().zip(rows.column_iter()) {
                *square += column.norm_squared();
            }
        }
        for (scale, square) in telling.scale.iter_mut().zip(squares) {
            *scale = (pool.len() as f64 / square).sqrt();
        }
        telling
    }

    /// The arm, the instrument and the noise.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// The unknowns, one a column.
    pub fn unknowns(&self) -> &[Unknown] {
        &self.unknowns
    }

    /// Each unknown's unit in the scaled columns, m or rad: a scaled standard deviation times this is the unknown's.
    pub fn scale(&self) -> &[f64] {
        &self.scale
    }

    /// Whether each unknown is an angle.
    pub fn angles(&self) -> Vec<bool> {
        let chain = self.setup.robot.chain();
        let angle = |symbol: Symbol| symbol.is_angle();
        self.unknowns
            .iter()
            .map(|unknown| match *unknown {
                Unknown::Parameter(place) => angle(chain.parameters()[place].symbol),
                Unknown::Turn { .. } => true,
                _ => false,
            })
            .collect()
    }

    /// The names of the unknowns.
    pub fn names(&self) -> Vec<String> {
        let campaign = self.setup.campaign(&[]);
        let names: Names<'_> = campaign.names();
        self.unknowns.iter().map(|&unknown| names.name(unknown)).collect()
    }

    /// What each posture tells: whitened and scaled rows, as few as hold it (six where the targets' places are known).
    pub fn rows(&self, postures: &[Vec<f64>]) -> Vec<DMatrix<f64>> {
        let joint_variance = self.setup.joint_sigma.powi(2);
        self.each(postures, |_, jacobian, joints| {
            let mut rows = jacobian;
            if joint_variance > 0.0 {
                let covariance =
                    DMatrix::identity(rows.nrows(), rows.nrows()) + &joints * joints.transpose() * joint_variance;
                // The identity plus a square: always positive definite.
                if let Some(cholesky) = covariance.cholesky() {
                    cholesky.l_dirty().solve_lower_triangular_mut(&mut rows);
                }
            }
            compressed(&rows)
        })
    }

    /// The derivative of each target's position at each posture by the scaled unknowns, m.
    pub fn positions(&self, postures: &[Vec<f64>]) -> Vec<DMatrix<f64>> {
        self.each(postures, |sigma, jacobian, _| jacobian * sigma)
    }

    fn each(
        &self,
        postures: &[Vec<f64>],
        mut make: impl FnMut(f64, DMatrix<f64>, DMatrix<f64>) -> DMatrix<f64>,
    ) -> Vec<DMatrix<f64>> {
        let campaign = self.setup.campaign(postures);
        let problem = Problem::new(&campaign, self.unknowns.clone(), &self.setup.state);
        let mut all = Vec::with_capacity(postures.len());
        problem.each_visit_rows(&self.setup.state, |visit, part| {
            let mut jacobian = part.jacobian;
            for (mut column, scale) in jacobian.column_iter_mut().zip(&self.scale) {
                column *= *scale;
            }
            all.push(make(visit.sigma, jacobian, part.joints));
        });
        all
    }
}

/// The fewest rows with the same information `JᵀJ`.
fn compressed(rows: &DMatrix<f64>) -> DMatrix<f64> {
    let svd = rows.clone().svd(false, true);
    let Some(v_t) = svd.v_t else { return rows.clone() };
    let largest = svd.singular_values.iter().copied().fold(0.0, f64::max);
    let kept: Vec<usize> =
        (0..svd.singular_values.len()).filter(|&place| svd.singular_values[place] > NOTHING * largest).collect();
    DMatrix::from_fn(kept.len(), rows.ncols(), |row, column| svd.singular_values[kept[row]] * v_t[(kept[row], column)])
}
