//! The smallest set of temperature sensors that keeps the predicted thermal error within a bound.
//!
//! A model says how its parameters grow with all its sensors; on the run it came from, that growth `Δk` moves the targets of
//! a visit by `J Δk`. A set of sensors can at best say `C w`, with `w` the rises of its sensors and any coefficients `C`: the
//! error of the set is what is left, `J (Δk - C w)`, as a root mean square over all measured positions. `C` is found from all
//! cycles but a stretch of them and judged on that stretch, in turn, and readings are taken to err: a set that needs large
//! coefficients of opposite signs pays for the noise that they amplify.
//!
//! Everything is quadratic: with `G = JᵀJ` of a visit, the products `G ⊗ w wᵀ` are summed once, and a set costs a
//! factorisation of as many rows as it has sensors times growing parameters.

use nalgebra::{DMatrix, DVector};

use crate::calibrate::{Campaign, ObserveOptions, Problem, State, Unknown, observe};
use crate::input::InputError;
use crate::model::{Level, Model};
use crate::run::Run;

/// Why there is no choice of sensors.
#[derive(Debug, thiserror::Error)]
pub enum SensorError {
    /// The run does not fit the model.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The model does not grow.
    #[error("the model has no thermal coefficient; expected one that was calibrated with temperatures")]
    NoGrowth,
    /// There is nothing to hold out.
    #[error("the run has one cycle; expected two or more, so that sensors are judged on what they did not see")]
    OneCycle,
    /// No set is good enough.
    #[error("no set of sensors keeps the error within {bound_mm} mm: all of them leave {all_mm:.4} mm")]
    OutOfReach {
        /// The bound, mm.
        bound_mm: f64,
        /// What all sensors leave, mm.
        all_mm: f64,
    },
}

/// A set of sensors and the errors that it leaves, m.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorSet {
    /// Places of the sensors.
    pub sensors: Vec<usize>,
    /// Predicted thermal error, root mean square over all positions.
    pub rms: f64,
    /// The same of the worst visit.
    pub worst: f64,
    /// Error of the measured positions with growth by this set, root mean square.
    pub measured: f64,
    /// The error (`rms`) without each of the sensors, in their order.
    pub without: Vec<f64>,
}

/// What a choice came to.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorPlan {
    /// The best set of each size that was tried, none first, the chosen one last.
    pub by_size: Vec<SensorSet>,
    /// All sensors together.
    pub all: SensorSet,
    /// Whether every set of the sizes up to the chosen one was tried.
    pub exhaustive: bool,
    /// Error of the measured positions with the model's own growth, root mean square, m.
    pub measured_by_model: f64,
}

/// Sets of one size are all tried up to this many of them; beyond, sensors are added and exchanged one by one.
const ALL_TRIED: usize = 20_000;

/// Stretches of cycles that are held out in turn.
const MOST_GROUPS: usize = 8;

/// One visit: what growth does to its targets.
#[derive(Debug, Clone)]
struct Visit {
    group: usize,
    /// `JᵀJ` by the growing parameters.
    gram: DMatrix<f64>,
    /// `Jᵀe` with the measured residual at the reference, and `eᵀe`.
    slope: DVector<f64>,
    square: f64,
    growth: DVector<f64>,
    rises: Vec<f64>,
    positions: f64,
}

/// Sums over the visits of a stretch of cycles.
#[derive(Debug, Clone)]
struct Sums {
    /// `Σ G ⊗ (w wᵀ + σ² I)`; the entry of parameter `k` and sensor `s` stands at `s · parameters + k`.
    products: DMatrix<f64>,
    /// `Σ (G Δk) ⊗ w`.
    slope: DVector<f64>,
    /// `Σ Δkᵀ G Δk`.
    square: f64,
}

/// A model's growth on a run, ready to try sets of sensors.
#[derive(Debug, Clone)]
pub struct SensorStudy {
    names: Vec<String>,
    parameters: usize,
    visits: Vec<Visit>,
    groups: Vec<Sums>,
    total: Sums,
    positions: f64,
    reading_k: f64,
}

impl SensorStudy {
    /// Takes the growth of a model on the run that it came from. `reading_k` is 1-sigma of a reading, K.
    ///
    /// # Errors
    /// A run that does not fit, or tells nothing of growth.
    pub fn new(model: &Model, run: &Run, options: &ObserveOptions, reading_k: f64) -> Result<Self, SensorError> {
        let observed = observe(&model.robot, run, options, Some(&model.temperatures))?;
        let state = State { geometry: model.reference.clone(), growth: Vec::new() };
        Self::of_campaign(model, &observed.campaign, &state, reading_k)
    }

    /// The same of a campaign whose rises count from the model's references.
    ///
    /// # Errors
    /// A campaign that tells nothing of growth.
    pub fn of_campaign(model: &Model, campaign: &Campaign, state: &State, reading_k: f64) -> Result<Self, SensorError> {
        let grown: Vec<(usize, usize, f64)> = model
            .growth_at(Level::Thermal)
            .into_iter()
            .filter_map(|(id, name, coefficient)| {
                let sensor = campaign.sensors.iter().position(|own| own == name)?;
                Some((campaign.chain.place(id)?, sensor, coefficient))
            })
            .collect();
        let mut parameters: Vec<usize> = grown.iter().map(|(parameter, ..)| *parameter).collect();
        parameters.sort_unstable();
        parameters.dedup();
        if parameters.is_empty() {
            return Err(SensorError::NoGrowth);
        }
        let mut cycles: Vec<u32> = campaign.visits.iter().map(|visit| visit.cycle).collect();
        cycles.sort_unstable();
        cycles.dedup();
        if cycles.len() < 2 {
            return Err(SensorError::OneCycle);
        }
        let group_count = cycles.len().min(MOST_GROUPS);
        let group_of = |cycle: u32| cycles.binary_search(&cycle).unwrap_or(0) * group_count / cycles.len();
        let unknowns: Vec<Unknown> = parameters.iter().map(|&place| Unknown::Parameter(place)).collect();
        let problem = Problem::new(campaign, unknowns, state);
        let mut visits = Vec::with_capacity(campaign.visits.len());
        problem.each_visit_rows(state, |visit, part| {
            // Whitened rows back to metres: what is not a position is no error of position.
            let rows = 3 * visit.positions.len();
            let jacobian = part.jacobian.rows(0, rows) * visit.sigma;
            let residual = part.residual.rows(0, rows) * visit.sigma;
            let mut growth = DVector::zeros(parameters.len());
            for &(parameter, sensor, coefficient) in &grown {
                let place = parameters.binary_search(&parameter).unwrap_or(0);
                growth[place] += coefficient * visit.rises[sensor];
            }
            visits.push(Visit {
                group: group_of(visit.cycle),
                gram: jacobian.tr_mul(&jacobian),
                slope: jacobian.tr_mul(&residual),
                square: residual.norm_squared(),
                growth,
                rises: visit.rises.clone(),
                positions: visit.positions.len() as f64,
            });
        });
        let (sensors, count) = (campaign.sensors.len(), parameters.len());
        let empty = Sums {
            products: DMatrix::zeros(sensors * count, sensors * count),
            slope: DVector::zeros(sensors * count),
            square: 0.0,
        };
        let mut groups = vec![empty.clone(); group_count];
        for visit in &visits {
            groups[visit.group].add(visit, reading_k);
        }
        let mut total = empty;
        for group in &groups {
            total.products += &group.products;
            total.slope += &group.slope;
            total.square += group.square;
        }
        Ok(Self {
            names: campaign.sensors.clone(),
            parameters: count,
            positions: visits.iter().map(|visit| visit.positions).sum(),
            visits,
            groups,
            total,
            reading_k,
        })
    }

    /// The sensors' names, in the order of their places.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The entries of a set of sensors.
    fn entries(&self, set: &[usize]) -> Vec<usize> {
        let parameters = self.parameters;
        set.iter().flat_map(|&sensor| (0..parameters).map(move |k| sensor * parameters + k)).collect()
    }

    /// The coefficients of a set that are found without each of the groups; none where the others do not tell them.
    fn coefficients(&self, entries: &[usize]) -> Option<Vec<DVector<f64>>> {
        self.groups
            .iter()
            .map(|group| {
                let product = |i: usize, j: usize| self.total.products[(i, j)] - group.products[(i, j)];
                // Scaled to a unit diagonal: lengths and angles differ by powers of ten.
                let scale = DVector::from_iterator(
                    entries.len(),
                    entries.iter().map(|&entry| 1.0 / product(entry, entry).max(f64::MIN_POSITIVE).sqrt()),
                );
                let normal = DMatrix::from_fn(entries.len(), entries.len(), |i, j| {
                    product(entries[i], entries[j]) * scale[i] * scale[j]
                });
                let slope = DVector::from_fn(entries.len(), |i, _| {
                    (self.total.slope[entries[i]] - group.slope[entries[i]]) * scale[i]
                });
                Some(normal.cholesky()?.solve(&slope).component_mul(&scale))
            })
            .collect()
    }

    /// The predicted thermal error that a set of sensors leaves on held-out cycles, root mean square, m; infinite where the
    /// run does not tell its coefficients.
    pub fn error(&self, set: &[usize]) -> f64 {
        let entries = self.entries(set);
        let Some(coefficients) = self.coefficients(&entries) else { return f64::INFINITY };
        let mut square = 0.0;
        for (group, own) in self.groups.iter().zip(&coefficients) {
            square += group.square;
            for (i, &entry) in entries.iter().enumerate() {
                let row: f64 =
                    entries.iter().zip(own.iter()).map(|(&other, c)| group.products[(entry, other)] * c).sum();
                square += own[i] * (row - 2.0 * group.slope[entry]);
            }
        }
        (square.max(0.0) / self.positions).sqrt()
    }

    /// A set with all its errors.
    pub fn set(&self, sensors: &[usize]) -> SensorSet {
        let entries = self.entries(sensors);
        let coefficients = self.coefficients(&entries);
        let (mut worst, mut measured) = (0.0_f64, 0.0);
        for visit in &self.visits {
            let Some(coefficients) = &coefficients else { continue };
            let own = &coefficients[visit.group];
            let mut said = DVector::zeros(self.parameters);
            let mut noise = 0.0;
            for (place, &sensor) in sensors.iter().enumerate() {
                let c = own.rows(place * self.parameters, self.parameters);
                said.axpy(visit.rises[sensor], &c, 1.0);
                noise += self.reading_k.powi(2) * c.dot(&(&visit.gram * c));
            }
            let left = &visit.growth - &said;
            worst = worst.max((left.dot(&(&visit.gram * &left)) + noise) / visit.positions.max(1.0));
            measured += visit.square + said.dot(&(&visit.gram * &said - &visit.slope * 2.0));
        }
        let mut ascending = sensors.to_vec();
        ascending.sort_unstable();
        let without = (0..ascending.len())
            .map(|place| {
                let mut fewer = ascending.clone();
                fewer.remove(place);
                self.error(&fewer)
            })
            .collect();
        let known = coefficients.is_some();
        SensorSet {
            rms: self.error(&ascending),
            sensors: ascending,
            worst: if known { worst.sqrt() } else { f64::INFINITY },
            measured: if known { (measured.max(0.0) / self.positions).sqrt() } else { f64::INFINITY },
            without,
        }
    }

    /// Error of the measured positions with the model's own growth, root mean square, m.
    pub fn measured_by_model(&self) -> f64 {
        let square: f64 = self
            .visits
            .iter()
            .map(|visit| visit.square + visit.growth.dot(&(&visit.gram * &visit.growth - &visit.slope * 2.0)))
            .sum();
        (square.max(0.0) / self.positions).sqrt()
    }

    /// The smallest set whose error is within `bound`, m; of several, the best. `progress` is told of every size.
    ///
    /// # Errors
    /// A bound that no set keeps.
    pub fn smallest(&self, bound: f64, mut progress: impl FnMut(usize)) -> Result<SensorPlan, SensorError> {
        let mut by_size: Vec<SensorSet> = Vec::new();
        let mut exhaustive = true;
        let mut best: Vec<usize> = Vec::new();
        for size in 0..=self.names.len() {
            progress(size);
            if combinations(self.names.len(), size) <= ALL_TRIED {
                best = self.best_of_all(size);
            } else {
                exhaustive = false;
                best = self.exchanged(best);
            }
            let set = self.set(&best);
            let enough = set.rms <= bound;
            by_size.push(set);
            if enough {
                let all: Vec<usize> = (0..self.names.len()).collect();
                return Ok(SensorPlan {
                    by_size,
                    all: self.set(&all),
                    exhaustive,
                    measured_by_model: self.measured_by_model(),
                });
            }
        }
        let least = by_size.iter().map(|set| set.rms).fold(f64::INFINITY, f64::min);
        Err(SensorError::OutOfReach { bound_mm: bound * 1e3, all_mm: least * 1e3 })
    }

    /// The best of all sets of a size.
    fn best_of_all(&self, size: usize) -> Vec<usize> {
        let count = self.names.len();
        let mut set: Vec<usize> = (0..size).collect();
        let mut best = (self.error(&set), set.clone());
        loop {
            // The next combination in the order of the dictionary.
            let Some(place) = (0..size).rev().find(|&place| set[place] < count - size + place) else { return best.1 };
            set[place] += 1;
            for later in place + 1..size {
                set[later] = set[later - 1] + 1;
            }
            let error = self.error(&set);
            if error < best.0 {
                best = (error, set.clone());
            }
        }
    }

    /// A set with one sensor more, then with sensors exchanged one by one as long as that helps.
    fn exchanged(&self, mut set: Vec<usize>) -> Vec<usize> {
        let others = |set: &[usize]| (0..self.names.len()).filter(|sensor| !set.contains(sensor)).collect::<Vec<_>>();
        let best = |sets: Vec<Vec<usize>>| {
            let judged = sets.into_iter().map(|set| (self.error(&set), set));
            judged.min_by(|one, other| one.0.total_cmp(&other.0))
        };
        let with = |set: &[usize], sensor: usize| set.iter().copied().chain([sensor]).collect::<Vec<_>>();
        let mut error = f64::INFINITY;
        if let Some((least, larger)) = best(others(&set).into_iter().map(|sensor| with(&set, sensor)).collect()) {
            (error, set) = (least, larger);
        }
        loop {
            let exchanges = (0..set.len())
                .flat_map(|place| others(&set).into_iter().map(move |sensor| (place, sensor)))
                .map(|(place, sensor)| {
                    let mut other = set.clone();
                    other[place] = sensor;
                    other
                })
                .collect();
            match best(exchanges) {
                Some((least, other)) if least < error => (error, set) = (least, other),
                _ => return set,
            }
        }
    }
}

impl Sums {
    fn add(&mut self, visit: &Visit, reading_k: f64) {
        let count = visit.gram.ncols();
        let pulled = &visit.gram * &visit.growth;
        for (s, own) in visit.rises.iter().enumerate() {
            for (t, other) in visit.rises.iter().enumerate() {
                let weight = own * other + if s == t { reading_k * reading_k } else { 0.0 };
                let mut block = self.products.view_mut((s * count, t * count), (count, count));
                block.zip_apply(&visit.gram, |sum, value| *sum += weight * value);
            }
            self.slope.rows_mut(s * count, count).axpy(*own, &pulled, 1.0);
        }
        self.square += visit.growth.dot(&pulled);
    }
}

/// How many sets of `size` there are of `count`; the largest number where there are more.
fn combinations(count: usize, size: usize) -> usize {
    (0..size)
        .try_fold(1_usize, |sets, place| Some(sets.checked_mul(count - place)? / (place + 1)))
        .unwrap_or(usize::MAX)
}
