//! Random numbers of the hidden runs: one ChaCha8 stream a purpose, so that a purpose that draws more or fewer leaves the
//! others as they were.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};

/// What a stream is for.
#[derive(Debug, Clone, Copy)]
pub enum Purpose {
    /// Geometric errors and masses.
    Geometry = 101,
    /// Postures, order and times of the visits.
    Schedule = 102,
    /// Capacities, losses and the weather of the cell.
    Heat = 103,
    /// Growth of parameters by heat.
    Growth = 104,
    /// Sizes of the noise.
    Noise = 105,
    /// Joint repeatability.
    Repeatability = 106,
    /// Tracker noise and broken beams.
    Points = 107,
    /// Sensor noise.
    Readings = 108,
    /// Which effects are hidden, where and in what shape.
    Effects = 109,
    /// Everything that a batch draws before its runs.
    Batch = 110,
}

/// A stream of random numbers.
pub struct Stream {
    source: ChaCha8Rng,
}

impl Stream {
    /// The stream of a purpose under a seed.
    pub fn new(seed: u64, purpose: Purpose) -> Self {
        let mut key = [0x5a; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        let mut source = ChaCha8Rng::from_seed(key);
        source.set_stream(purpose as u64);
        Self { source }
    }

    /// Uniform in (0, 1).
    pub fn uniform(&mut self) -> f64 {
        ((self.source.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// Uniform between two bounds.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Log-uniform between two positive bounds.
    pub fn log_between(&mut self, low: f64, high: f64) -> f64 {
        libm::exp(self.between(libm::log(low), libm::log(high)))
    }

    /// A whole number below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// One of the items.
    pub fn pick<'a, T>(&mut self, items: &'a [T]) -> &'a T {
        &items[self.below(items.len())]
    }

    /// -1 or 1.
    pub fn sign(&mut self) -> f64 {
        if self.uniform() < 0.5 { -1.0 } else { 1.0 }
    }

    /// Standard normal, by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(self.uniform()));
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }
}
