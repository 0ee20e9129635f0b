//! A run linearised about a model with effects: for every visit, what each place where anything can act does to the
//! measured positions, and what is left of them.
//!
//! Rows are positions in the flange frame in units of the instrument's standard deviation. A *place* is a joint, a
//! parameter, an axis of the world or the tool, a target's coordinate or the scale; every column that is ever tested is a
//! sum over places of an amount a visit, so that one small matrix a visit holds all there is to know.

use nalgebra::{DMatrix, DVector, Vector3};

use crate::calibrate::{Campaign, State, Unknown};
use crate::effect::{Acts, Adjustment, Instance, Scene, Term};
use crate::robot::{Posture, Twist};

/// The places where anything can act, as columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Places {
    joints: usize,
    parameters: usize,
    targets: usize,
}

impl Places {
    /// The places of an arm and its targets.
    pub fn new(joints: usize, parameters: usize, targets: usize) -> Self {
        Self { joints, parameters, targets }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.joints + self.parameters + 6 + 1 + 6 + 3 * self.targets
    }

    /// How many joints.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// How many targets.
    pub fn targets(&self) -> usize {
        self.targets
    }

    fn parameter(&self, place: usize) -> usize {
        self.joints + place
    }

    fn world(&self, axis: usize) -> usize {
        self.joints + self.parameters + axis
    }

    fn scale(&self) -> usize {
        self.joints + self.parameters + 6
    }

    fn tool(&self, axis: usize) -> usize {
        self.joints + self.parameters + 7 + axis
    }

    fn target(&self, target: usize, axis: usize) -> usize {
        self.joints + self.parameters + 13 + 3 * target + axis
    }
}

/// A column of the linear model: places with an amount a visit.
pub type Column = Vec<(usize, Vec<f64>)>;

/// One visit's rows.
#[derive(Debug, Clone)]
pub struct Block {
    /// The posture, counted from 0 among the postures of the run.
    pub posture: usize,
    /// The cycle, counted from 0 among the cycles of the run.
    pub cycle: usize,
    /// Rows by places, in units of the instrument's standard deviation.
    pub places: DMatrix<f64>,
    /// What is left, in the same units.
    pub residual: DVector<f64>,
    /// The axes along which independent errors of all joints would move the points independently, as columns.
    pub axes: DMatrix<f64>,
    /// What errors of 1 rad do along each of these axes: variances.
    pub spectrum: Vec<f64>,
    /// The instrument's standard deviation, metres.
    pub sigma: f64,
}

/// A run linearised about a model with effects.
#[derive(Debug, Clone)]
pub struct Stage {
    /// The places.
    pub places: Places,
    /// The visits.
    pub blocks: Vec<Block>,
    /// Columns of what calibration would estimate anyway, in the order of the unknowns.
    pub nuisance: Vec<Column>,
    /// How many postures.
    pub postures: usize,
    /// How many cycles.
    pub cycles: usize,
}

/// A model as the stage is built about it: calibrated state and effects.
#[derive(Debug, Clone)]
pub struct Point {
    /// Geometry and growth.
    pub state: State,
    /// The effects.
    pub effects: Vec<Instance>,
}

/// The sum of what the effects do at every visit.
pub fn adjustments(scene: &Scene, point: &Point) -> Vec<Adjustment> {
    crate::effect::adjustments(scene, &point.effects, &point.state.geometry.targets)
}

/// The chain's parameters at a visit.
pub fn parameters_at(campaign: &Campaign, state: &State, visit: usize, adjustment: &Adjustment) -> Vec<f64> {
    let mut values = state.geometry.parameters.clone();
    for (term, coefficient) in campaign.growth.iter().zip(&state.growth) {
        let rise = campaign.visits[visit].rises[term.sensor] + adjustment.rises[term.sensor];
        values[term.parameter] += coefficient * rise;
    }
    for (value, more) in values.iter_mut().zip(&adjustment.parameters) {
        *value += more;
    }
    values
}

/// Measured less predicted positions at every visit, world frame, metres: visit, then each of its positions.
pub fn errors(campaign: &Campaign, scene: &Scene, point: &Point, mut each: impl FnMut(usize, usize, Vector3<f64>)) {
    let adjustments = adjustments(scene, point);
    for (place, (visit, adjustment)) in campaign.visits.iter().zip(&adjustments).enumerate() {
        let prepared = campaign.chain.prepare(&parameters_at(campaign, &point.state, place, adjustment));
        let joints: Vec<f64> =
            scene.visits[place].joints.iter().zip(&adjustment.joints).map(|(q, more)| q + more).collect();
        let flange = prepared.flange(&Posture::new(&joints));
        for position in &visit.positions {
            let local = point.state.geometry.targets[position.target] + adjustment.targets[position.target];
            let predicted = adjustment.seen(&flange.point(&local), &scene.station);
            each(place, position.target, position.at - predicted);
        }
    }
}

impl Stage {
    /// Linearises a campaign about a point. The scene's visits are the campaign's.
    pub fn new(campaign: &Campaign, scene: &Scene, point: &Point, unknowns: &[Unknown]) -> Stage {
        let chain = &campaign.chain;
        let places = Places::new(chain.joint_count(), chain.parameters().len(), campaign.targets.len());
        let adjustments = adjustments(scene, point);
        let number = |of: fn(&crate::calibrate::ObservedVisit) -> u32| {
            let mut numbers: Vec<u32> = campaign.visits.iter().map(of).collect();
            numbers.sort_unstable();
            numbers.dedup();
            numbers
        };
        let (postures, cycles) = (number(|visit| visit.pose), number(|visit| visit.cycle));
        let mut twists = vec![Twist::default(); chain.parameters().len()];
        let mut joint_twists = vec![Twist::default(); chain.joint_count()];
        let mut blocks = Vec::with_capacity(campaign.visits.len());
        for (place, (visit, adjustment)) in campaign.visits.iter().zip(&adjustments).enumerate() {
            let prepared = chain.prepare(&parameters_at(campaign, &point.state, place, adjustment));
            let joints: Vec<f64> =
                scene.visits[place].joints.iter().zip(&adjustment.joints).map(|(q, more)| q + more).collect();
            let flange = prepared.twists(&Posture::new(&joints), &mut twists, &mut joint_twists);
            let scale = 1.0 / visit.sigma;
            let mut block = DMatrix::zeros(3 * visit.positions.len(), places.count());
            let mut residual = DVector::zeros(3 * visit.positions.len());
            for (rank, position) in visit.positions.iter().enumerate() {
                let nominal = point.state.geometry.targets[position.target];
                let local = nominal + adjustment.targets[position.target];
                let at = flange.point(&local);
                let left = flange.rotation.tr_mul(&(position.at - adjustment.seen(&at, &scene.station)));
                let mut rows = block.rows_mut(3 * rank, 3);
                let mut put = |column: usize, values: Vector3<f64>| rows.set_column(column, &(values * scale));
                let spot: [f64; 3] = local.into();
                for (joint, twist) in joint_twists.iter().enumerate() {
                    put(joint, Vector3::from(twist.at(&spot)));
                }
                for (parameter, twist) in twists.iter().enumerate() {
                    put(places.parameter(parameter), Vector3::from(twist.at(&spot)));
                }
                for axis in 0..3 {
                    let unit = Vector3::ith(axis, 1.0);
                    put(places.world(axis), flange.rotation.tr_mul(&unit));
                    put(places.world(axis + 3), flange.rotation.tr_mul(&unit.cross(&at)));
                    put(places.target(position.target, axis), unit);
                }
                for axis in 0..6 {
                    put(places.tool(axis), crate::effect::tool_motion(axis, &nominal));
                }
                put(places.scale(), flange.rotation.tr_mul(&(at - scene.station)));
                residual.rows_mut(3 * rank, 3).copy_from(&(left * scale));
            }
            let joint_part = block.columns(0, places.joints()).into_owned();
            let turned = (&joint_part * joint_part.transpose()).symmetric_eigen();
            let spectrum: Vec<f64> = turned.eigenvalues.iter().map(|value| value.max(0.0)).collect();
            blocks.push(Block {
                posture: postures.binary_search(&visit.pose).unwrap_or(0),
                cycle: cycles.binary_search(&visit.cycle).unwrap_or(0),
                places: block,
                residual,
                axes: turned.eigenvectors,
                spectrum,
                sigma: visit.sigma,
            });
        }
        let mut stage = Stage { places, blocks, nuisance: Vec::new(), postures: postures.len(), cycles: cycles.len() };
        stage.nuisance = unknowns
            .iter()
            .filter_map(|&unknown| stage.unknown_column(campaign, scene, point, &adjustments, unknown))
            .collect();
        stage
    }

    fn unknown_column(
        &self,
        campaign: &Campaign,
        scene: &Scene,
        point: &Point,
        adjustments: &[Adjustment],
        unknown: Unknown,
    ) -> Option<Column> {
        let ones = || vec![1.0; campaign.visits.len()];
        match unknown {
            Unknown::Parameter(place) => Some(vec![(self.places.parameter(place), ones())]),
            Unknown::Target { target, axis } => Some(vec![(self.places.target(target, axis), ones())]),
            Unknown::Growth(term) => {
                let growth = campaign.growth[term];
                let mut amounts: Vec<f64> = campaign
                    .visits
                    .iter()
                    .zip(adjustments)
                    .map(|(visit, adjustment)| visit.rises[growth.sensor] + adjustment.rises[growth.sensor])
                    .collect();
                for effect in &point.effects {
                    if let Some(more) = effect.effect.growth_derivative(scene, &effect.site, &effect.shape, term) {
                        let share = effect.coefficients.first().copied().unwrap_or(0.0);
                        amounts.iter_mut().zip(more).for_each(|(amount, more)| *amount += share * more);
                    }
                }
                Some(vec![(self.places.parameter(growth.parameter), amounts)])
            }
            // Orientations and distances are not looked at here.
            Unknown::Turn { .. } | Unknown::Anchor { .. } => None,
        }
    }

    /// A term of an effect as a column.
    pub fn column(&self, scene: &Scene, term: &Term) -> Column {
        let mut column: Column = Vec::new();
        let mut add = |place: usize, amounts: &mut dyn Iterator<Item = f64>| match column
            .iter_mut()
            .find(|(known, _)| *known == place)
        {
            Some((_, sum)) => sum.iter_mut().zip(amounts).for_each(|(sum, amount)| *sum += amount),
            None => column.push((place, amounts.collect())),
        };
        for act in term {
            let amounts = act.amounts();
            match *act {
                Acts::Joint(joint, _) => add(joint, &mut amounts.iter().copied()),
                Acts::Parameter(place, _) => add(self.places.parameter(place), &mut amounts.iter().copied()),
                Acts::World(axis, _) => add(self.places.world(axis), &mut amounts.iter().copied()),
                Acts::Scale(_) => add(self.places.scale(), &mut amounts.iter().copied()),
                Acts::Target(target, axis, _) => {
                    add(self.places.target(target, axis), &mut amounts.iter().copied());
                }
                Acts::Tool(axis, _) => add(self.places.tool(axis), &mut amounts.iter().copied()),
                Acts::Reading(sensor, _) => {
                    for growing in scene.growth.iter().filter(|growing| growing.sensor == sensor) {
                        let place = self.places.parameter(growing.parameter);
                        add(place, &mut amounts.iter().map(|amount| growing.coefficient * amount));
                    }
                }
            }
        }
        column
    }

    /// Whether any posture was visited more than once.
    pub fn repeats(&self) -> bool {
        self.postures < self.blocks.len()
    }
}
