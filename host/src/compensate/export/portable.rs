//! The part of a model that can be said in a few lines of any language: the chain, growth with temperatures, and effects that
//! are waves, straight lines or steps of joints.

use crate::effect::Instance;
use crate::model::{Level, Model};
use crate::robot::JointKind;

use super::super::arm::Arm;

/// Why a model cannot be exported at a level.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0} cannot be exported: it needs more than joints, directions and temperatures; --level thermal leaves effects out"
)]
pub struct NotPortable(String);

/// One transform of the chain: `Tz(d) Rz(theta) Tx(a) Rx(alpha) Ty(b) Ry(beta)`, zeros where its convention has none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PortableTransform {
    /// d, theta, a, alpha, b, beta; metres and radians.
    pub values: [f64; 6],
    /// 0: fixed, 1: the joint adds to theta, 2: to d.
    pub moves: u8,
}

/// A parameter that follows a sensor: `linear · rise + square · rise²`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PortableGrowth {
    /// The transform.
    pub transform: usize,
    /// Place in [`PortableTransform::values`].
    pub symbol: usize,
    /// The sensor.
    pub sensor: usize,
    /// m/K or rad/K.
    pub linear: f64,
    /// m/K² or rad/K².
    pub square: f64,
}

/// What an effect adds to a joint: `cosine · cos(harmonic · q) + sine · sin(harmonic · q) + ratio · q + step · approach`, of
/// the joint `from`, with the direction of `joint`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PortableEffect {
    /// The joint that it is added to, from 0.
    pub joint: usize,
    /// The joint that it follows, from 0.
    pub from: usize,
    /// Waves a turn.
    pub harmonic: f64,
    /// rad.
    pub cosine: f64,
    /// rad.
    pub sine: f64,
    /// Share of the joint's position.
    pub ratio: f64,
    /// rad, on the side that the joint came from.
    pub step: f64,
}

/// A model in plain numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Portable {
    /// The arm's name.
    pub name: String,
    /// The chain at the reference temperatures, world to base first.
    pub transforms: Vec<PortableTransform>,
    /// The sensors with their reference temperatures, °C.
    pub sensors: Vec<(String, f64)>,
    /// What follows temperatures.
    pub growth: Vec<PortableGrowth>,
    /// What is added to joints.
    pub effects: Vec<PortableEffect>,
    /// What is left out, and why.
    pub notes: Vec<String>,
}

impl Portable {
    /// A model at a level.
    ///
    /// # Errors
    /// An effect that depends on gravity, or on what the model's covariates alone describe.
    pub fn new(model: &Model, level: Level) -> Result<Self, NotPortable> {
        let arm = Arm::new(model, level);
        let chain = model.robot.chain();
        let values = &model.geometry(level).parameters;
        let mut place = 0;
        let transforms = model.robot.transforms.iter().map(|transform| {
            let mut six = [0.0; 6];
            for &symbol in transform.convention.symbols() {
                six[symbol as usize] = values[place];
                place += 1;
            }
            let moves = match transform.joint.as_ref().map(|joint| joint.kind) {
                None => 0,
                Some(JointKind::Revolute) => 1,
                Some(JointKind::Prismatic) => 2,
            };
            PortableTransform { values: six, moves }
        });
        let transforms = transforms.collect();
        let sensor = |name: &str| model.temperatures.iter().position(|reference| reference.sensor == name);
        let growth = model.growth_at(level).into_iter().filter_map(|(parameter, name, linear)| {
            let (transform, symbol) = (parameter.transform, parameter.symbol as usize);
            Some(PortableGrowth { transform, symbol, sensor: sensor(name)?, linear, square: 0.0 })
        });
        let mut portable = Self {
            name: model.robot.name.clone(),
            transforms,
            sensors: model.temperatures.iter().map(|one| (one.sensor.clone(), one.celsius)).collect(),
            growth: growth.collect(),
            effects: Vec::new(),
            notes: arm.notes().to_vec(),
        };
        for instance in arm.effects_on_joints() {
            portable.take_joint(instance)?;
        }
        for instance in arm.effects_on_temperatures() {
            let at = instance.site.parameter.map(|place| chain.parameters()[place]);
            portable.take_growth(instance, at.map(|id| (id.transform, id.symbol as usize)))?;
        }
        Ok(portable)
    }

    fn take_joint(&mut self, instance: &Instance) -> Result<(), NotPortable> {
        let refused = || NotPortable(instance.effect.name().to_owned());
        let joint = instance.site.joint.ok_or_else(refused)?;
        let own = PortableEffect { joint, from: joint, ..PortableEffect::default() };
        let c = &instance.coefficients;
        let effect = match (instance.effect.name(), c.as_slice(), instance.shape.as_slice()) {
            ("gear_eccentricity", &[cosine, sine], &[harmonic]) => PortableEffect { harmonic, cosine, sine, ..own },
            ("encoder_gain", &[ratio], _) => PortableEffect { ratio, ..own },
            ("joint_coupling", &[ratio], _) => {
                PortableEffect { ratio, from: instance.site.from.ok_or_else(refused)?, ..own }
            }
            ("backlash", &[width], _) => PortableEffect { step: 0.5 * width, ..own },
            ("joint_log_early", ..) => {
                self.notes.push("joint_log_early: belongs to how joints were logged: not exported".to_owned());
                return Ok(());
            }
            _ => return Err(refused()),
        };
        self.effects.push(effect);
        Ok(())
    }

    fn take_growth(&mut self, instance: &Instance, at: Option<(usize, usize)>) -> Result<(), NotPortable> {
        let refused = || NotPortable(instance.effect.name().to_owned());
        let (transform, symbol) = at.ok_or_else(refused)?;
        match (instance.effect.name(), instance.site.sensors.as_slice(), instance.coefficients.as_slice()) {
            ("thermal_nonlinearity", &[sensor], &[square]) => {
                self.growth.push(PortableGrowth { transform, symbol, sensor, linear: 0.0, square });
                Ok(())
            }
            ("thermal_lag", ..) => {
                self.notes.push("thermal_lag: exported as if temperatures had been so for long".to_owned());
                Ok(())
            }
            _ => Err(refused()),
        }
    }

    /// The number of joints.
    pub fn joint_count(&self) -> usize {
        self.transforms.iter().filter(|transform| transform.moves > 0).count()
    }
}

/// A number as every language reads it, with all its digits.
pub(super) fn number(value: f64) -> String {
    format!("{value:?}")
}

/// Numbers with commas between them.
pub(super) fn numbers(values: &[f64]) -> String {
    values.iter().map(|&value| number(value)).collect::<Vec<_>>().join(", ")
}

/// A name in which nothing ends a comment or a string of any of the languages.
pub(super) fn plain(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || " .-_+()".contains(c) { c } else { '_' }).collect()
}
