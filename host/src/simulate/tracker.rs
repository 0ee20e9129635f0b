//! The laser tracker: noise along and across the beam, readings averaged, beams that break.

use nalgebra::Vector3;

use super::random::{Purpose, Stream};
use super::scenario::Tracker;

/// Positions are kept to 0.1 µm, as they are written; the instrument resolves 0.5 µm in one reading.
const RESOLUTION_PER_M: f64 = 1e7;

/// The instrument at work.
pub(super) struct Measuring<'a> {
    tracker: &'a Tracker,
    noise: Stream,
    beams: Stream,
}

impl<'a> Measuring<'a> {
    pub(super) fn new(tracker: &'a Tracker, seed: u64) -> Self {
        Self { tracker, noise: Stream::new(seed, Purpose::Instrument), beams: Stream::new(seed, Purpose::Beams) }
    }

    /// The mean of the readings of a target, m; none where the beam breaks.
    ///
    /// The mean of independent normal readings is itself normal, so it is drawn at once.
    pub(super) fn measure(&mut self, place: &Vector3<f64>) -> Option<Vector3<f64>> {
        let draws = Vector3::from([self.noise.normal(), self.noise.normal(), self.noise.normal()]);
        if self.beams.uniform() < self.tracker.broken_beam {
            return None;
        }
        let beam = place - Vector3::from(self.tracker.position);
        let distance = beam.norm();
        let along = if distance > 0.0 { beam / distance } else { Vector3::x() };
        let shrink = 1.0 / libm::sqrt(f64::from(self.tracker.readings));
        // Of the draws, what points along the beam and what points across it are independent and normal themselves.
        let radial = along * along.dot(&draws);
        let error = radial * (self.tracker.radial.at(distance) * shrink)
            + (draws - radial) * (self.tracker.transverse.at(distance) * shrink);
        Some((place + error).map(|value| libm::round(value * RESOLUTION_PER_M) / RESOLUTION_PER_M))
    }
}

impl Tracker {
    /// What run.toml states of one coordinate of a point: the constant deviation (m) and that per metre, each the root
    /// mean square over one direction along the beam and two across it, after averaging.
    pub fn stated_sigma(&self) -> (f64, f64) {
        let shrink = 1.0 / libm::sqrt(f64::from(self.readings));
        let mean = |along: f64, across: f64| libm::sqrt((along * along + 2.0 * across * across) / 3.0) * shrink;
        (mean(self.radial.sigma_m, self.transverse.sigma_m), mean(self.radial.sigma_per_m, self.transverse.sigma_per_m))
    }
}
