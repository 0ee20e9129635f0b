//! A run as a model has it: the same visits at the same temperatures, measured on an arm that is as the model says, effects
//! included, with noise of the sizes that discovery found. Its residuals look like those of the run that was measured, as far
//! as the model is right: what differs between the two is what the model does not know.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::candidates::white_noise;
use super::stage::parameters_at;
use crate::calibrate::{ObserveOptions, State, growth_and_scene, observe};
use crate::effect::{Instance, adjustments};
use crate::input::InputError;
use crate::model::{ExtendedNoise, Level, Model};
use crate::robot::{Posture, Robot};
use crate::run::{Point, Run};

/// A run that was made of another.
#[derive(Debug, Clone)]
pub struct Replayed {
    /// The run: points of the same targets at the same visits, at the places where the model has them.
    pub run: Run,
    /// What of the model does not act in it, and what noise it has, in words.
    pub notes: Vec<String>,
}

/// Measures the visits of a run on an arm that is as a model says. Distances and orientations are left out: a model says
/// nothing of their noise.
///
/// # Errors
/// A run that does not fit the model's arm.
pub fn replay(
    model: &Model,
    run: &Run,
    run_robot: &Robot,
    options: &ObserveOptions,
    seed: u64,
) -> Result<Replayed, InputError> {
    let mut robot = model.robot.clone();
    robot.monuments = run_robot.monuments.clone();
    let observed = observe(&robot, run, options, Some(&model.temperatures))?;
    let mut notes = observed.notes.clone();
    let level = if model.extended.is_some() { Level::Extended } else { Level::Thermal };
    let mut campaign = observed.campaign.clone();
    let (growth, scene) = growth_and_scene(model, run, &observed, &mut campaign, level, &mut notes);
    let state = State { geometry: model.geometry(level).clone(), growth };
    let mut effects: Vec<Instance> = Vec::new();
    for effect in model.effects() {
        let missing = match effect.instance(&scene, &campaign.targets) {
            Ok(instance) => match instance.lacks(&scene) {
                None => {
                    effects.push(instance);
                    continue;
                }
                Some(what) => format!("the run lacks {what}"),
            },
            Err(error) => error.to_string(),
        };
        notes.push(format!("{}: left out, {missing}", effect.words()));
    }
    let noise = model.extended.as_ref().and_then(|extended| extended.noise.clone()).unwrap_or_else(|| {
        notes.push("the model does not say how large noise is: the instrument's alone".to_owned());
        ExtendedNoise::of_instrument(campaign.chain.joint_count())
    });
    let adjustments = adjustments(&scene, &effects, &state.geometry.targets);
    let mut errors = JointErrors::new(&noise, seed);
    let mut replayed = run.clone();
    for visit in &mut replayed.visits {
        visit.points.clear();
        visit.distances.clear();
    }
    for (place, (visit, adjustment)) in campaign.visits.iter().zip(&adjustments).enumerate() {
        let prepared = campaign.chain.prepare(&parameters_at(&campaign, &state, place, adjustment));
        let moved = errors.of_visit(visit.pose, visit.cycle);
        let joints: Vec<f64> = (scene.visits[place].joints.iter())
            .zip(adjustment.joints.iter().zip(moved))
            .map(|(q, (more, error))| q + more + error)
            .collect();
        let flange = prepared.flange(&Posture::new(&joints));
        for point in &run.visits[visit.place].points {
            let Some(target) = campaign.targets.iter().position(|name| *name == run.target_names[point.target]) else {
                continue;
            };
            let local = state.geometry.targets[target] + adjustment.targets[target];
            let seen = adjustment.seen(&flange.point(&local), &scene.station);
            let position = seen + errors.of_point() * (noise.point * visit.sigma);
            replayed.visits[visit.place].points.push(Point { position, orientation: None, ..*point });
        }
    }
    Ok(Replayed { run: replayed, notes })
}

/// Errors of joints that visits have by themselves and that postures and cycles share; those of points.
struct JointErrors<'a> {
    noise: &'a ExtendedNoise,
    random: ChaCha8Rng,
    /// By whether a posture or a cycle shares them, and its number.
    shared: BTreeMap<(bool, u32), Vec<f64>>,
}

impl<'a> JointErrors<'a> {
    fn new(noise: &'a ExtendedNoise, seed: u64) -> Self {
        Self { noise, random: ChaCha8Rng::seed_from_u64(seed), shared: BTreeMap::new() }
    }

    fn drawn(&mut self, count: usize) -> Vec<f64> {
        white_noise(&mut self.random, count, 1).as_slice().to_vec()
    }

    fn of_visit(&mut self, pose: u32, cycle: u32) -> Vec<f64> {
        let joints = self.noise.visit_rad.len();
        let mut sum: Vec<f64> =
            self.drawn(joints).iter().zip(&self.noise.visit_rad).map(|(draw, sigma)| draw * sigma).collect();
        for (key, sigma) in [((true, pose), self.noise.posture_rad), ((false, cycle), self.noise.cycle_rad)] {
            if !self.shared.contains_key(&key) {
                let drawn = self.drawn(joints);
                self.shared.insert(key, drawn);
            }
            sum.iter_mut().zip(&self.shared[&key]).for_each(|(sum, draw)| *sum += sigma * draw);
        }
        sum
    }

    fn of_point(&mut self) -> Vector3<f64> {
        Vector3::from_column_slice(&self.drawn(3))
    }
}
