//! When the arm moved, from motion.csv, and what follows motion through a lag.

use crate::run::{MotionStep, Phase};

/// Two movements closer than this, s, are one.
const SAME_S: f64 = 1.0;

/// The spans of movement, in order.
pub(super) struct Motion {
    /// Start and end, s.
    pub spans: Vec<(f64, f64)>,
}

impl Motion {
    /// The movements of a schedule.
    pub fn new(steps: &[MotionStep]) -> Self {
        let mut spans: Vec<(f64, f64)> = Vec::new();
        for step in steps.iter().filter(|step| step.phase == Phase::Move && step.end_s > step.start_s) {
            match spans.last_mut() {
                Some(last) if step.start_s <= last.1 + SAME_S => last.1 = last.1.max(step.end_s),
                _ => spans.push((step.start_s, step.end_s)),
            }
        }
        Self { spans }
    }

    /// How many movements begin and end between two times, s.
    pub fn within(&self, from_s: f64, to_s: f64) -> usize {
        self.spans.iter().filter(|(start, end)| *start > from_s && *end < to_s).count()
    }

    /// Motion (1) and rest (0) through a first-order lag, at rest before the first movement, at ascending times.
    pub fn followed(&self, tau_s: f64, times_s: &[f64]) -> Vec<f64> {
        let edges: Vec<(f64, f64)> = self.spans.iter().flat_map(|&(start, end)| [(start, 1.0), (end, 0.0)]).collect();
        let (mut at_s, mut state, mut target, mut next) = (f64::NEG_INFINITY, 0.0, 0.0, 0);
        let relax = |state: f64, target: f64, for_s: f64| target + (state - target) * (-for_s / tau_s).exp();
        times_s
            .iter()
            .map(|&time| {
                while next < edges.len() && edges[next].0 <= time {
                    state = relax(state, target, edges[next].0 - at_s);
                    (at_s, target) = edges[next];
                    next += 1;
                }
                state = relax(state, target, time - at_s);
                at_s = time;
                state
            })
            .collect()
    }
}
