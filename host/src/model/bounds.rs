//! What a correction may be at most: part of the model, so that whoever applies it cannot forget it.

use serde::{Deserialize, Serialize};

/// Bounds on the size and the rate of any correction, and on the temperatures that it may follow.
///
/// They guard a robot against what a wrong model, a dead sensor or a singular posture would make of a correction. The
/// defaults are an order above what arms of this kind need: corrections of a few milliradians, bodies of metal that warm by
/// hundredths of a kelvin a second.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CorrectionBounds {
    /// Largest correction of a revolute joint, rad.
    pub size_rad: f64,
    /// Largest correction of a prismatic joint, m.
    pub size_m: f64,
    /// Largest change of a revolute joint's correction, rad/s.
    pub rate_rad_per_s: f64,
    /// Largest change of a prismatic joint's correction, m/s.
    pub rate_m_per_s: f64,
    /// Fastest that the temperatures of a correction follow the sensors, K/s.
    pub rate_k_per_s: f64,
    /// How far outside the range that calibration saw a temperature is still believed, K.
    pub margin_k: f64,
    /// How long a sensor may be silent before its temperature is no longer believed, s.
    pub stale_s: f64,
}

impl Default for CorrectionBounds {
    fn default() -> Self {
        Self {
            size_rad: 0.05,
            size_m: 0.02,
            rate_rad_per_s: 0.05,
            rate_m_per_s: 0.02,
            rate_k_per_s: 0.1,
            margin_k: 5.0,
            stale_s: 60.0,
        }
    }
}

impl CorrectionBounds {
    /// What is wrong with the numbers, in words; none where they bound something.
    pub fn fault(&self) -> Option<String> {
        let positive = [
            ("size_rad", self.size_rad),
            ("size_m", self.size_m),
            ("rate_rad_per_s", self.rate_rad_per_s),
            ("rate_m_per_s", self.rate_m_per_s),
            ("rate_k_per_s", self.rate_k_per_s),
            ("stale_s", self.stale_s),
        ];
        let wrong = positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0));
        let margin = !(self.margin_k.is_finite() && self.margin_k >= 0.0);
        wrong
            .map(|(name, value)| format!("{name} is {value}, expected a number above 0"))
            .or_else(|| margin.then(|| format!("margin_k is {}, expected a number from 0", self.margin_k)))
    }
}
