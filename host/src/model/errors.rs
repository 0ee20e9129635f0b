//! Errors of position: distances between measured and predicted target positions, summed up.

use serde::{Deserialize, Serialize};

/// Mean, root mean square and maximum of distances, in millimetres (contract `results.md`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Mean distance.
    pub mean_mm: f64,
    /// Root mean square of the distances.
    pub rms_mm: f64,
    /// Largest distance.
    pub max_mm: f64,
}

/// Distances taken one by one.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ErrorTally {
    count: usize,
    sum: f64,
    squares: f64,
    max: f64,
}

impl ErrorTally {
    /// Takes in a distance, metres.
    pub fn add(&mut self, distance: f64) {
        self.count += 1;
        self.sum += distance;
        self.squares += distance * distance;
        self.max = self.max.max(distance);
    }

    /// Takes in all distances of another tally.
    pub fn merge(&mut self, other: &ErrorTally) {
        self.count += other.count;
        self.sum += other.sum;
        self.squares += other.squares;
        self.max = self.max.max(other.max);
    }

    /// The number of distances.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Mean, RMS and maximum; zeros where there was no distance.
    pub fn errors(&self) -> Errors {
        let count = self.count.max(1) as f64;
        Errors { mean_mm: self.sum / count * 1e3, rms_mm: (self.squares / count).sqrt() * 1e3, max_mm: self.max * 1e3 }
    }
}

impl Extend<f64> for ErrorTally {
    fn extend<T: IntoIterator<Item = f64>>(&mut self, distances: T) {
        distances.into_iter().for_each(|distance| self.add(distance));
    }
}
