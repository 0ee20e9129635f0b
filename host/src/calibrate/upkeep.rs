//! Keeping a calibration true: a Kalman filter that takes occasional checks of single targets.
//!
//! What a run has found drifts over months: thermal coefficients with paint, cables and wear, and the lengths and angles that
//! they belong to with bearings and screws. The state is both, for every parameter that the model lets grow. Between checks it
//! stays, and its variance grows with time (a random walk); at a check, the measured position corrects it.
//!
//! A posture has errors of its own that no parameter describes, far larger than the tracker's noise, and the same at every
//! visit: each posture and target that is checked brings three states more, in the flange frame, with the model's error as
//! their prior. What a check says is therefore mostly how a position has changed since the last one there, at another
//! temperature.
//!
//! A check whose innovation is improbable is refused: the square of the innovation, whitened by its own covariance (NIS),
//! follows χ² with as many degrees of freedom as it has coordinates. Positions are in the frame of the calibration: a tracker
//! that was moved must be registered to it first.

use std::collections::HashMap;

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::campaign::{Campaign, ObservedVisit};
use super::problem::Problem;
use super::unknown::{State, Unknown};

/// What is believed of an arm between checks. Standard deviations of a random walk grow with the root of time: these are
/// after one day.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// Of a thermal coefficient, as a share of itself.
    pub coefficient_share: f64,
    /// Of a length, m.
    pub length_m: f64,
    /// Of an angle, rad.
    pub angle_rad: f64,
    /// Error of a position that stays with a posture, one coordinate, m: what calibration left.
    pub posture_m: f64,
    /// Repeatability: 1-sigma of each joint from visit to visit, rad or m.
    pub joint_sigma: f64,
    /// The probability by which a good check may be refused.
    pub refused_share: f64,
}

impl Default for Drift {
    /// Over half a year: a tenth of a coefficient, 40 µm and 40 µrad.
    fn default() -> Self {
        Self {
            coefficient_share: 0.0075,
            length_m: 3e-6,
            angle_rad: 3e-6,
            posture_m: 2e-4,
            joint_sigma: 2e-5,
            refused_share: 1e-3,
        }
    }
}

/// What came of one check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation {
    /// The visit's place among those of its run.
    pub place: usize,
    /// Seconds on the run's clock.
    pub time_s: f64,
    /// The distance between measured and predicted position, root mean square over its targets, m.
    pub distance_m: f64,
    /// The squared innovation, whitened.
    pub nis: f64,
    /// Its degrees of freedom.
    pub freedom: usize,
    /// Whether the check was refused.
    pub refused: bool,
}

/// The filter.
#[derive(Debug, Clone)]
pub struct Upkeep {
    campaign: Campaign,
    unknowns: Vec<Unknown>,
    state: State,
    covariance: DMatrix<f64>,
    /// Where the errors of a posture (by number) and target stand in the state.
    postures: HashMap<(u32, usize), usize>,
    /// Their estimates, m.
    errors: Vec<[f64; 3]>,
    /// Variance that a day adds to each unknown.
    daily: Vec<f64>,
    drift: Drift,
    time_s: Option<f64>,
}

const DAY_S: f64 = 86_400.0;

impl Upkeep {
    /// Begins where a calibration ended. `campaign` gives the chain, names and growth terms; its visits are not used. `sigmas`
    /// are the standard deviations of the growth terms' coefficients and of their parameters (metres, radians), as `state`
    /// has them.
    ///
    /// # Panics
    /// When `sigmas` has not two numbers a growth term.
    pub fn new(campaign: &Campaign, state: State, sigmas: &[[f64; 2]], drift: Drift) -> Self {
        assert_eq!(sigmas.len(), campaign.growth.len(), "two standard deviations a growth term");
        let mut unknowns = Vec::new();
        let mut variances = Vec::new();
        let mut daily = Vec::new();
        for (term, [coefficient, _]) in sigmas.iter().enumerate() {
            unknowns.push(Unknown::Growth(term));
            variances.push(coefficient * coefficient);
            daily.push((drift.coefficient_share * state.growth[term]).powi(2));
        }
        for (growth, [_, parameter]) in campaign.growth.iter().zip(sigmas) {
            let unknown = Unknown::Parameter(growth.parameter);
            if unknowns.contains(&unknown) {
                continue;
            }
            unknowns.push(unknown);
            variances.push(parameter * parameter);
            let angle = campaign.chain.parameters()[growth.parameter].symbol.is_angle();
            daily.push(if angle { drift.angle_rad.powi(2) } else { drift.length_m.powi(2) });
        }
        Self {
            covariance: DMatrix::from_diagonal(&DVector::from_vec(variances)),
            campaign: campaign.select(|_| false),
            unknowns,
            state,
            postures: HashMap::new(),
            errors: Vec::new(),
            daily,
            drift,
            time_s: None,
        }
    }

    /// The present state.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The unknowns that are followed, coefficients first.
    pub fn unknowns(&self) -> &[Unknown] {
        &self.unknowns
    }

    /// Standard deviation of each unknown.
    pub fn sigmas(&self) -> Vec<f64> {
        (0..self.unknowns.len()).map(|place| self.covariance[(place, place)].max(0.0).sqrt()).collect()
    }

    /// Lets time pass until `time_s`, on the clock of the checks.
    fn pass(&mut self, time_s: f64) {
        let days = self.time_s.map_or(0.0, |before| ((time_s - before) / DAY_S).max(0.0));
        self.time_s = Some(time_s);
        for (place, variance) in self.daily.iter().enumerate() {
            self.covariance[(place, place)] += variance * days;
        }
    }

    /// Takes one check. Checks come in the order of their times.
    pub fn take(&mut self, visit: &ObservedVisit, time_s: f64) -> Innovation {
        self.pass(time_s);
        let alone = Campaign { visits: vec![visit.clone()], ..self.campaign.clone() };
        let problem = Problem::new(&alone, self.unknowns.clone(), &self.state);
        let mut rows = None;
        problem.each_visit_rows(&self.state, |_, part| rows = Some(part));
        let count = 3 * visit.positions.len();
        let Some(part) = rows.filter(|_| count > 0) else {
            return Innovation { place: visit.place, time_s, distance_m: 0.0, nis: 0.0, freedom: 0, refused: true };
        };
        let places: Vec<usize> =
            visit.positions.iter().map(|position| self.place_of(visit.pose, position.target)).collect();
        // Rows in units of the instrument's noise; a posture's own error moves its target as it is.
        let size = self.covariance.ncols();
        let mut h = DMatrix::zeros(count, size);
        h.columns_mut(0, self.unknowns.len()).copy_from(&part.jacobian.rows(0, count));
        let mut innovation = part.residual.rows(0, count).into_owned();
        for (position, &place) in places.iter().enumerate() {
            for axis in 0..3 {
                let column = self.unknowns.len() + 3 * place + axis;
                h[(3 * position + axis, column)] = 1.0 / visit.sigma;
                innovation[3 * position + axis] -= self.errors[place][axis] / visit.sigma;
            }
        }
        let joints = part.joints.rows(0, count);
        let noise = DMatrix::identity(count, count) + joints * joints.transpose() * self.drift.joint_sigma.powi(2);
        let crossed = &self.covariance * h.transpose();
        let spread = &h * &crossed + &noise;
        let distance_m = visit.sigma * innovation.norm() / (visit.positions.len() as f64).sqrt();
        let Some(cholesky) = spread.cholesky() else {
            return Innovation {
                place: visit.place,
                time_s,
                distance_m,
                nis: f64::INFINITY,
                freedom: count,
                refused: true,
            };
        };
        let nis = innovation.dot(&cholesky.solve(&innovation));
        let refused = nis > self.largest(count);
        if !refused {
            let gain = cholesky.solve(&crossed.transpose()).transpose();
            let step = &gain * &innovation;
            self.state = self.state.moved(&self.unknowns, step.rows(0, self.unknowns.len()).as_slice());
            for (place, error) in self.errors.iter_mut().enumerate() {
                for (axis, value) in error.iter_mut().enumerate() {
                    *value += step[self.unknowns.len() + 3 * place + axis];
                }
            }
            // Joseph's form: symmetric and positive whatever rounding does.
            let left = DMatrix::identity(size, size) - &gain * &h;
            self.covariance = &left * &self.covariance * left.transpose() + &gain * noise * gain.transpose();
        }
        Innovation { place: visit.place, time_s, distance_m, nis, freedom: count, refused }
    }

    /// The NIS beyond which a check is refused.
    fn largest(&self, freedom: usize) -> f64 {
        ChiSquared::new(freedom as f64).map_or(f64::INFINITY, |chi| chi.inverse_cdf(1.0 - self.drift.refused_share))
    }

    /// Where the errors of a posture's target stand, which are made where there are none yet.
    fn place_of(&mut self, pose: u32, target: usize) -> usize {
        let next = self.errors.len();
        let place = *self.postures.entry((pose, target)).or_insert(next);
        if place == next {
            self.errors.push([0.0; 3]);
            let size = self.covariance.ncols();
            let mut larger =
                std::mem::replace(&mut self.covariance, DMatrix::zeros(0, 0)).resize(size + 3, size + 3, 0.0);
            for axis in size..size + 3 {
                larger[(axis, axis)] = self.drift.posture_m.powi(2);
            }
            self.covariance = larger;
        }
        place
    }
}
