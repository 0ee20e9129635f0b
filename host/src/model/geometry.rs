//! The values of a calibrated arm and the levels at which it can be asked.

use nalgebra::{UnitQuaternion, Vector3};

use super::bounds::CorrectionBounds;
use super::extended::Extended;
use crate::robot::{Chain, Frame, ParameterId, Posture, Robot};

/// Values for everything that does not change with temperature: the chain's parameters and the places of what is measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry {
    /// In the order of [`Chain::parameters`], metres and radians.
    pub parameters: Vec<f64>,
    /// The place of each target in the flange frame, metres.
    pub targets: Vec<Vector3<f64>>,
    /// The orientation of each target in the flange frame; used by six-degree-of-freedom targets alone.
    pub turns: Vec<UnitQuaternion<f64>>,
    /// The place of each anchor of measured distances in the world frame, metres.
    pub anchors: Vec<Vector3<f64>>,
}

impl Geometry {
    /// The nominal geometry of a robot; targets without a position start at the flange's origin.
    pub fn nominal(robot: &Robot) -> Self {
        Self {
            parameters: robot.nominal(),
            targets: robot.targets.iter().map(|target| target.position.unwrap_or_default()).collect(),
            turns: vec![UnitQuaternion::identity(); robot.targets.len()],
            anchors: Vec::new(),
        }
    }
}

/// One thermal coefficient: a parameter grows by `coefficient` for each kelvin that a sensor is above its reference
/// (thesis eq. 4.2).
#[derive(Debug, Clone, PartialEq)]
pub struct Growth {
    /// The parameter.
    pub parameter: ParameterId,
    /// The sensor's name.
    pub sensor: String,
    /// m/K or rad/K.
    pub coefficient: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// A sensor's temperature at the reference, from which growth counts.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceTemperature {
    /// The sensor's name.
    pub sensor: String,
    /// Degrees Celsius at the reference cycle.
    pub celsius: f64,
    /// The lowest temperature of the calibration run.
    pub lowest: f64,
    /// The highest temperature of the calibration run.
    pub highest: f64,
}

/// What is known of one estimated or held parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterEstimate {
    /// `d1`, or `T1.x` for a target's coordinate.
    pub name: String,
    /// `m` or `rad`.
    pub unit: &'static str,
    /// The value it started from.
    pub nominal: f64,
    /// The identified value.
    pub value: f64,
    /// Its standard deviation; none where it was held fixed.
    pub sigma: Option<f64>,
    /// Half the width of its 95 % interval; none where it was held fixed.
    pub half_width: Option<f64>,
}

/// How much of a model is used for a prediction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Nominal parameters (base and unknown targets aligned).
    Nominal,
    /// The geometry found at the reference cycle.
    Geometric,
    /// With the thermal correction.
    Thermal,
    /// With the effects that discovery found; the same as thermal where there are none.
    Extended,
}

/// A calibrated arm.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// The arm as it was described.
    pub robot: Robot,
    /// The nominal geometry, its base and unknown targets aligned to the measurements.
    pub nominal: Geometry,
    /// The geometry found at the reference cycle alone.
    pub geometric: Geometry,
    /// The geometry at the reference temperatures, found from all cycles together.
    pub reference: Geometry,
    /// Thermal coefficients on top of `reference`.
    pub growth: Vec<Growth>,
    /// The temperatures from which growth counts.
    pub temperatures: Vec<ReferenceTemperature>,
    /// Names of the anchors of measured distances.
    pub anchors: Vec<String>,
    /// What was found, with its uncertainty.
    pub estimates: Vec<ParameterEstimate>,
    /// What a correction by this model may be at most.
    pub correction_bounds: CorrectionBounds,
    /// What discovery added; none where nothing was found, or nothing was looked for.
    pub extended: Option<Extended>,
}

impl Model {
    /// The geometry that a level starts from.
    pub fn geometry(&self, level: Level) -> &Geometry {
        match level {
            Level::Nominal => &self.nominal,
            Level::Geometric => &self.geometric,
            Level::Thermal => &self.reference,
            Level::Extended => self.extended.as_ref().map_or(&self.reference, |extended| &extended.geometry),
        }
    }

    /// The sensors that growth asks for, each once, in the order of `temperatures`.
    pub fn sensors(&self) -> Vec<&str> {
        self.temperatures.iter().map(|reference| reference.sensor.as_str()).collect()
    }

    /// The chain's parameters at a level and at temperatures in the order of [`Model::sensors`], degrees Celsius; a
    /// temperature that is missing counts as the reference. At the extended level these are the values that the effects
    /// come on top of: effects follow from a run's history, see [`Model::effects_in`].
    pub fn parameters_at(&self, level: Level, chain: &Chain, celsius: &[Option<f64>]) -> Vec<f64> {
        let mut values = self.geometry(level).parameters.clone();
        if level < Level::Thermal {
            return values;
        }
        for (parameter, sensor, coefficient) in self.growth_at(level) {
            let rise = self.temperatures.iter().zip(celsius).find(|(reference, _)| reference.sensor == sensor);
            if let (Some((reference, Some(celsius))), Some(place)) = (rise, chain.place(parameter)) {
                values[place] += coefficient * (celsius - reference.celsius);
            }
        }
        values
    }

    /// The thermal coefficients of a level: parameter, sensor, m/K or rad/K.
    pub fn growth_at(&self, level: Level) -> Vec<(ParameterId, &str, f64)> {
        match (level, &self.extended) {
            (Level::Nominal | Level::Geometric, _) => Vec::new(),
            (Level::Extended, Some(extended)) => extended
                .growth
                .iter()
                .map(|growth| (growth.parameter, growth.sensor.as_str(), growth.coefficient))
                .collect(),
            (Level::Thermal | Level::Extended, _) => self
                .growth
                .iter()
                .map(|growth| (growth.parameter, growth.sensor.as_str(), growth.coefficient))
                .collect(),
        }
    }

    /// The flange in the world frame at joint positions (radians, metres) and temperatures in the order of
    /// [`Model::sensors`], without effects.
    pub fn flange(&self, level: Level, joints: &[f64], celsius: &[Option<f64>]) -> Frame {
        let chain = self.robot.chain();
        chain.prepare(&self.parameters_at(level, &chain, celsius)).flange(&Posture::new(joints))
    }
}
