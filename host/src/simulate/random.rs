//! Random numbers that are the same on every machine: ChaCha8 streams, one a purpose, and normal deviates by functions
//! of `libm` alone. A purpose with a stream of its own keeps its draws when another purpose needs more or fewer.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};

/// What a stream of random numbers is for; its number must never change.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    Parameters = 1,
    Targets = 2,
    Transmission = 3,
    SensorSpots = 4,
    Postures = 5,
    Schedule = 6,
    Repeatability = 7,
    Instrument = 8,
    Beams = 9,
    Readings = 10,
    PlannedPoses = 11,
    JudgedPoses = 12,
    Refinement = 13,
    Starts = 14,
}

/// A stream of random numbers.
pub(crate) struct Stream {
    source: ChaCha8Rng,
    /// The second deviate of a pair that was drawn.
    kept: Option<f64>,
}

impl Stream {
    pub(crate) fn new(seed: u64, purpose: Purpose) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        let mut source = ChaCha8Rng::from_seed(key);
        source.set_stream(purpose as u64);
        Self { source, kept: None }
    }

    /// Uniform in [0, 1), in steps of 2⁻⁵³.
    pub(crate) fn uniform(&mut self) -> f64 {
        const STEP: f64 = 1.0 / (1_u64 << 53) as f64;
        (self.source.next_u64() >> 11) as f64 * STEP
    }

    /// Uniform between two bounds.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Normal of mean 0 and deviation 1, by Marsaglia's polar method.
    pub(crate) fn normal(&mut self) -> f64 {
        if let Some(kept) = self.kept.take() {
            return kept;
        }
        loop {
            let (u, v) = (self.between(-1.0, 1.0), self.between(-1.0, 1.0));
            let square = u * u + v * v;
            if square > 0.0 && square < 1.0 {
                let factor = libm::sqrt(-2.0 * libm::log(square) / square);
                self.kept = Some(v * factor);
                return u * factor;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_deviates_have_the_moments_of_the_normal_distribution() {
        const COUNT: usize = 200_000;
        let mut stream = Stream::new(5, Purpose::Readings);
        let (mut mean, mut square, mut fourth) = (0.0, 0.0, 0.0);
        for _ in 0..COUNT {
            let z = stream.normal();
            mean += z;
            square += z * z;
            fourth += z * z * z * z;
        }
        let count = COUNT as f64;
        // Deviations of the sample moments: of z 1, of z² √2, of z⁴ √(105 - 9); five of them.
        assert!((mean / count).abs() < 5.0 / count.sqrt());
        assert!((square / count - 1.0).abs() < 5.0 * (2.0 / count).sqrt());
        assert!((fourth / count - 3.0).abs() < 5.0 * (96.0 / count).sqrt());
    }

    #[test]
    fn purposes_and_seeds_have_their_own_streams() {
        let first = |seed, purpose| Stream::new(seed, purpose).uniform();
        assert_eq!(first(1, Purpose::Parameters), first(1, Purpose::Parameters));
        assert_ne!(first(1, Purpose::Parameters), first(1, Purpose::Targets));
        assert_ne!(first(1, Purpose::Parameters), first(2, Purpose::Parameters));
    }
}
