//! Names: the catalogue of effects.md, kinds of effects that are in no catalogue, and the places where they sit.

use serde_json::{Map, Value, json};

use super::arm::Arm;

/// What is hidden.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[allow(missing_docs)] // Their meaning is effects.md's; of those outside it, said where `basis` computes them.
pub enum Kind {
    GearEccentricity,
    EncoderGain,
    Backlash,
    LostMotion,
    JointLogEarly,
    JointCompliance,
    JointCoupling,
    ThermalGrowth,
    ThermalLag,
    ThermalNonlinearity,
    UnsensedHeat,
    FrameDrift,
    FrameJump,
    ScaleError,
    TargetShift,
    ToolSlip,
    TargetSwap,
    Outliers,
    SensorChill,
    SensorBias,
    SensorSwap,
    SensorDetached,
    ClockOffset,
    OffJointProduct,
    OffLinkBending,
    OffCubicDrift,
    OffScaleWalk,
    OffOverride,
    OffCrossWave,
    OffIncidence,
}

impl Kind {
    /// The catalogue, in the order of effects.md.
    pub const CATALOGUE: [Self; 23] = [
        Self::GearEccentricity,
        Self::EncoderGain,
        Self::Backlash,
        Self::LostMotion,
        Self::JointLogEarly,
        Self::JointCompliance,
        Self::JointCoupling,
        Self::ThermalGrowth,
        Self::ThermalLag,
        Self::ThermalNonlinearity,
        Self::UnsensedHeat,
        Self::FrameDrift,
        Self::FrameJump,
        Self::ScaleError,
        Self::TargetShift,
        Self::ToolSlip,
        Self::TargetSwap,
        Self::Outliers,
        Self::SensorChill,
        Self::SensorBias,
        Self::SensorSwap,
        Self::SensorDetached,
        Self::ClockOffset,
    ];

    /// Kinds outside the catalogue.
    pub const OFF: [Self; 7] = [
        Self::OffJointProduct,
        Self::OffLinkBending,
        Self::OffCubicDrift,
        Self::OffScaleWalk,
        Self::OffOverride,
        Self::OffCrossWave,
        Self::OffIncidence,
    ];

    /// The name; one of effects.md, or one of this program's own for what is outside it.
    pub fn name(self) -> &'static str {
        match self {
            Self::GearEccentricity => "gear_eccentricity",
            Self::EncoderGain => "encoder_gain",
            Self::Backlash => "backlash",
            Self::LostMotion => "lost_motion",
            Self::JointLogEarly => "joint_log_early",
            Self::JointCompliance => "joint_compliance",
            Self::JointCoupling => "joint_coupling",
            Self::ThermalGrowth => "thermal_growth",
            Self::ThermalLag => "thermal_lag",
            Self::ThermalNonlinearity => "thermal_nonlinearity",
            Self::UnsensedHeat => "unsensed_heat",
            Self::FrameDrift => "frame_drift",
            Self::FrameJump => "frame_jump",
            Self::ScaleError => "scale_error",
            Self::TargetShift => "target_shift",
            Self::ToolSlip => "tool_slip",
            Self::TargetSwap => "target_swap",
            Self::Outliers => "outliers",
            Self::SensorChill => "sensor_chill",
            Self::SensorBias => "sensor_bias",
            Self::SensorSwap => "sensor_swap",
            Self::SensorDetached => "sensor_detached",
            Self::ClockOffset => "clock_offset",
            Self::OffJointProduct => "off_joint_product",
            Self::OffLinkBending => "off_link_bending",
            Self::OffCubicDrift => "off_cubic_drift",
            Self::OffScaleWalk => "off_scale_walk",
            Self::OffOverride => "off_override",
            Self::OffCrossWave => "off_cross_wave",
            Self::OffIncidence => "off_incidence",
        }
    }

    /// The kind of a name.
    pub fn of(name: &str) -> Option<Self> {
        Self::CATALOGUE.into_iter().chain(Self::OFF).find(|kind| kind.name() == name)
    }

    /// Whether it is outside the catalogue, so that `unexplained` is the right answer.
    pub fn is_off(self) -> bool {
        Self::OFF.contains(&self)
    }

    /// The name by which an answer should call it.
    pub fn answer(self) -> &'static str {
        if self.is_off() { "unexplained" } else { self.name() }
    }

    /// Whether it changes the temperature log and not the positions.
    pub fn is_of_readings(self) -> bool {
        matches!(
            self,
            Self::SensorChill | Self::SensorBias | Self::SensorSwap | Self::SensorDetached | Self::ClockOffset
        )
    }

    /// Whether it is a gross error of the points' records, whose size no signal-to-noise ratio measures.
    pub fn is_gross(self) -> bool {
        matches!(self, Self::TargetSwap | Self::Outliers)
    }

    /// Whether its size is a coefficient that can be scaled; otherwise it is a time that is searched.
    pub fn is_linear(self) -> bool {
        !self.is_gross() && !self.is_of_readings() && self != Self::ThermalLag
    }
}

/// Where an effect sits; joints from 0, parameters, sensors and targets by their places in the arm.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub struct Place {
    /// The joint.
    pub joint: Option<usize>,
    /// The joint that couples into it.
    pub from: Option<usize>,
    /// The parameter.
    pub parameter: Option<usize>,
    /// The sensors.
    pub sensors: Vec<usize>,
    /// The targets.
    pub targets: Vec<usize>,
}

impl Place {
    /// At a joint.
    pub fn joint(joint: usize) -> Self {
        Self { joint: Some(joint), ..Self::default() }
    }

    /// At a parameter.
    pub fn parameter(parameter: usize) -> Self {
        Self { parameter: Some(parameter), ..Self::default() }
    }

    /// `where` of results.md.
    pub fn to_json(&self, arm: &Arm) -> Value {
        let mut map = Map::new();
        if let Some(from) = self.from {
            map.insert("from".into(), json!(from + 1));
        }
        if let Some(joint) = self.joint {
            map.insert("joint".into(), json!(joint + 1));
        }
        if let Some(parameter) = self.parameter {
            map.insert("parameter".into(), json!(arm.parameter_name(parameter)));
        }
        let names = |of: &[usize]| of.iter().map(|&sensor| arm.sensors[sensor].name.clone()).collect::<Vec<_>>();
        match self.sensors.as_slice() {
            [] => {}
            [_] => {
                map.insert("sensor".into(), json!(names(&self.sensors)[0]));
            }
            many => {
                map.insert("sensors".into(), json!(names(many)));
            }
        }
        match self.targets.as_slice() {
            [] => {}
            [one] => {
                map.insert("target".into(), json!(arm.targets[*one].0));
            }
            many => {
                let names: Vec<&str> = many.iter().map(|&target| arm.targets[target].0.as_str()).collect();
                map.insert("targets".into(), json!(names));
            }
        }
        Value::Object(map)
    }
}
