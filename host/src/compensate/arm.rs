//! A model made ready to be asked where the arm stands, and that arm under present conditions.
//!
//! An effect states its physics over the visits of a scene; here the scene has one visit, the present one. Effects that act
//! on parameters follow from temperatures alone and are computed once for the conditions, those that act on joints at every
//! posture.

use std::sync::Arc;

use super::inverse::Limit;
use crate::effect::{Acts, Growing, Instance, Scene};
use crate::model::{Level, Model};
use crate::robot::{Chain, Frame, Joint, JointKind, Posture, Prepared, Robot, Twist};
use crate::run::TemperatureSeries;

/// What the arm's geometry depends on besides its joints.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Conditions {
    /// Degrees Celsius in the order of [`Model::sensors`]; none, or beyond the end: as at the reference.
    pub celsius: Vec<Option<f64>>,
    /// What the sensors read before, in the same order, for parameters that follow late; empty: it has always been so.
    pub history: Vec<TemperatureSeries>,
    /// The present time on the clock of `history`, s.
    pub time_s: f64,
    /// What the flange carries, kg.
    pub payload_kg: f64,
    /// The sign of each joint's last motion, -1, 0 or 1; empty: unknown, which counts as 0.
    pub approach: Vec<f64>,
}

/// A model at a level with those of its effects that act now.
#[derive(Debug, Clone)]
pub struct Arm {
    model: Arc<Model>,
    level: Level,
    chain: Chain,
    scene: Scene,
    on_joints: Vec<Instance>,
    on_temperatures: Vec<Instance>,
    loaded: bool,
    notes: Vec<String>,
}

/// No joint stands farther from zero than this, rad or m: where robot.toml gives no limits.
const FARTHEST: f64 = 1e3;

/// Where an instance acts, once it is known that it does.
enum Place {
    Joints,
    Temperatures,
    Elsewhere,
}

fn place_of(instance: &Instance, scene: &Scene) -> Place {
    let terms = instance.terms(scene);
    let all = |fits: fn(&Acts) -> bool| terms.iter().flatten().all(fits);
    if all(|act| matches!(act, Acts::Joint(..))) {
        Place::Joints
    } else if all(|act| matches!(act, Acts::Parameter(..) | Acts::Reading(..))) {
        Place::Temperatures
    } else {
        Place::Elsewhere
    }
}

/// Whether an effect looks at gravity: what is no number there is none in its amounts either. Weighing is dear, and most
/// effects do without it.
fn looks_at_torques(instance: &Instance, scene: &Scene) -> bool {
    let mut weightless = scene.clone();
    weightless.visits[0].torques.fill(f64::NAN);
    weightless.moments.iter_mut().flatten().for_each(|amounts| amounts.fill(f64::NAN));
    instance.terms(&weightless).iter().flatten().any(|act| act.amounts()[0].is_nan())
}

impl Arm {
    /// The model's arm at a level. Effects that belong to one run, to the instrument or to the tool are left out, and
    /// [`Arm::notes`] says which.
    pub fn new(model: &Model, level: Level) -> Self {
        let robot = &model.robot;
        let chain = robot.chain();
        let sensor = |name: &str| model.temperatures.iter().position(|reference| reference.sensor == name);
        let growth = model.growth_at(level).into_iter().filter_map(|(parameter, name, coefficient)| {
            Some(Growing { parameter: chain.place(parameter)?, sensor: sensor(name)?, coefficient })
        });
        let targets = model.geometry(level).targets.clone();
        let scene = Scene::present(robot, &model.temperatures, growth.collect(), targets);
        let mut arm = Self {
            model: Arc::new(model.clone()),
            level,
            chain,
            scene,
            on_joints: Vec::new(),
            on_temperatures: Vec::new(),
            loaded: false,
            notes: Vec::new(),
        };
        if level == Level::Extended {
            arm.take_effects();
        }
        arm
    }

    fn take_effects(&mut self) {
        let model = Arc::clone(&self.model);
        let names: Vec<String> = model.robot.targets.iter().map(|target| target.name.clone()).collect();
        // Moments of unknown masses are weighed before an effect is asked whether it has all it needs.
        let prepared = self.chain.prepare(&model.geometry(self.level).parameters);
        let zero = vec![0.0; self.chain.joint_count()];
        self.scene.stand(&model.robot, &prepared, &zero, 0.0, !model.effects().is_empty());
        let applied = model.effects_in(&self.scene, &names);
        self.notes = applied.notes;
        for instance in applied.instances {
            match place_of(&instance, &self.scene) {
                Place::Joints => self.on_joints.push(instance),
                Place::Temperatures => self.on_temperatures.push(instance),
                Place::Elsewhere => self.notes.push(format!(
                    "{}: belongs to the instrument or the tool and does not move the arm: not applied",
                    instance.effect.name()
                )),
            }
        }
        self.loaded = self.on_joints.iter().any(|instance| looks_at_torques(instance, &self.scene));
    }

    /// What is not applied, and why.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The effects that act on joints and so at every posture.
    pub fn effects_on_joints(&self) -> &[Instance] {
        &self.on_joints
    }

    /// The effects that follow from temperatures alone.
    pub fn effects_on_temperatures(&self) -> &[Instance] {
        &self.on_temperatures
    }

    /// Whether each sensor of [`Model::sensors`] can move the arm.
    pub fn needed_sensors(&self) -> Vec<bool> {
        let mut needed = vec![false; self.scene.sensors.len()];
        self.scene.growth.iter().filter(|growing| growing.coefficient != 0.0).for_each(|growing| {
            needed[growing.sensor] = true;
        });
        // An effect may look at any sensor of its link.
        let reads = |instance: &Instance| instance.effect.name() == crate::effect::UNEXPLAINED;
        if !self.on_temperatures.is_empty() || self.on_joints.iter().any(reads) {
            needed.fill(true);
        }
        needed
    }

    /// The chain's parameters under these conditions, in the order of [`Chain::parameters`].
    pub fn parameters(&self, conditions: &Conditions) -> Vec<f64> {
        self.parameters_in(&self.scene_under(conditions), conditions)
    }

    fn scene_under(&self, conditions: &Conditions) -> Scene {
        let mut scene = self.scene.clone();
        let visit = &mut scene.visits[0];
        visit.time_s = conditions.time_s;
        for (own, given) in visit.approach.iter_mut().zip(&conditions.approach) {
            *own = *given;
        }
        for (sensor, (sensed, rise)) in scene.sensors.iter_mut().zip(&mut visit.rises).enumerate() {
            let celsius = conditions.celsius.get(sensor).copied().flatten().unwrap_or(sensed.reference_c);
            *rise = celsius - sensed.reference_c;
            sensed.series = match conditions.history.get(sensor).filter(|series| !series.times_s().is_empty()) {
                Some(series) => series.clone(),
                None => TemperatureSeries::constant(conditions.time_s, celsius),
            };
        }
        scene
    }

    fn parameters_in(&self, scene: &Scene, conditions: &Conditions) -> Vec<f64> {
        if self.on_temperatures.is_empty() {
            return self.model.parameters_at(self.level, &self.chain, &conditions.celsius);
        }
        let targets = &self.model.geometry(self.level).targets;
        let adjustment = crate::effect::adjustments(scene, &self.on_temperatures, targets).swap_remove(0);
        let rises = scene.visits[0].rises.iter().zip(&adjustment.rises);
        let celsius: Vec<Option<f64>> =
            rises.zip(&scene.sensors).map(|((rise, more), sensed)| Some(sensed.reference_c + rise + more)).collect();
        let mut values = self.model.parameters_at(self.level, &self.chain, &celsius);
        values.iter_mut().zip(&adjustment.parameters).for_each(|(value, more)| *value += more);
        values
    }

    /// The arm under these conditions.
    pub fn under(&self, conditions: &Conditions) -> Present {
        let scene = self.scene_under(conditions);
        let parameters = self.parameters_in(&scene, conditions);
        let joints = self.chain.joint_count();
        Present {
            model: Arc::clone(&self.model),
            prepared: self.chain.prepare(&parameters),
            effects: self.on_joints.clone(),
            loaded: self.loaded,
            payload_kg: conditions.payload_kg,
            scene,
            posture: Posture::new(&vec![0.0; joints]),
            moved: vec![0.0; joints],
            parameter_twists: vec![Twist::default(); self.chain.parameters().len()],
            joint_twists: vec![Twist::default(); joints],
            limits: joints_of(&self.model.robot).map(Limit::of).collect(),
        }
    }
}

/// The joints of a robot in the order of the chain.
pub(super) fn joints_of(robot: &Robot) -> impl Iterator<Item = &Joint> {
    robot.transforms.iter().filter_map(|transform| transform.joint.as_ref())
}

/// An arm under conditions: answers where it stands, and how to reach a place.
///
/// Its buffers are its own, so that an answer allocates nothing where no effect acts on joints: one for each thread.
#[derive(Debug, Clone)]
pub struct Present {
    model: Arc<Model>,
    pub(super) prepared: Prepared,
    effects: Vec<Instance>,
    loaded: bool,
    payload_kg: f64,
    scene: Scene,
    pub(super) posture: Posture,
    moved: Vec<f64>,
    pub(super) parameter_twists: Vec<Twist>,
    pub(super) joint_twists: Vec<Twist>,
    pub(super) limits: Vec<Limit>,
}

impl Present {
    /// The number of joints.
    pub fn joint_count(&self) -> usize {
        self.joint_twists.len()
    }

    /// Whether each joint turns rather than slides.
    pub fn turns(&self) -> impl Iterator<Item = bool> + '_ {
        joints_of(&self.model.robot).map(|joint| joint.kind == JointKind::Revolute)
    }

    /// The first joint that is outside its limits, or so far that it is no position at all, with those limits.
    pub fn outside(&self, joints: &[f64]) -> Option<(usize, f64, f64)> {
        let limits = self.limits.iter().map(|limit| (limit.min.max(-FARTHEST), limit.max.min(FARTHEST)));
        let mut named = joints.iter().zip(limits).enumerate();
        named
            .find(|(_, (joint, (low, high)))| !(*low..=*high).contains(joint))
            .map(|(place, (_, (low, high)))| (place, low, high))
    }

    /// Another payload, kg, and other directions of approach (-1, 0 or 1; as many as there are joints).
    pub fn load(&mut self, payload_kg: f64, approach: &[f64]) {
        self.payload_kg = payload_kg;
        let own = &mut self.scene.visits[0].approach;
        own.fill(0.0);
        own.iter_mut().zip(approach).for_each(|(own, given)| *own = *given);
    }

    /// The joints as the geometry has them when the controller reads `joints`: effects added.
    fn stand(&mut self, joints: &[f64]) {
        if self.effects.is_empty() {
            self.posture.set(joints);
            return;
        }
        self.scene.stand(&self.model.robot, &self.prepared, joints, self.payload_kg, self.loaded);
        self.moved.copy_from_slice(joints);
        for instance in &self.effects {
            for (term, coefficient) in instance.terms(&self.scene).iter().zip(&instance.coefficients) {
                for act in term {
                    if let Acts::Joint(joint, amounts) = act {
                        self.moved[*joint] += coefficient * amounts[0];
                    }
                }
            }
        }
        self.posture.set(&self.moved);
    }

    /// The flange in the world frame at joint positions as the controller reads them, radians and metres.
    ///
    /// # Panics
    /// When there are fewer joints than the arm has.
    pub fn forward(&mut self, joints: &[f64]) -> Frame {
        self.stand(joints);
        self.prepared.flange(&self.posture)
    }

    /// The flange, and the twist of each joint in `joint_twists`.
    pub(super) fn forward_with_twists(&mut self, joints: &[f64]) -> Frame {
        self.stand(joints);
        self.prepared.twists(&self.posture, &mut self.parameter_twists, &mut self.joint_twists)
    }
}
