//! The postures that are measured: given, or drawn so that they are spread within a window and see the instrument.

use nalgebra::Vector3;

use super::SimulationError;
use super::random::{Purpose, Stream};
use super::scenario::{DrawnPostures, Scenario};
use crate::robot::{Posture, Robot};

/// How many acceptable candidates are drawn for each posture that is wanted.
const CANDIDATES: usize = 40;
/// How many draws an acceptable candidate may take.
const DRAWS: usize = 2_000;

/// The joint positions of every posture, kept to the nanoradian, as they are written.
pub(super) fn postures(scenario: &Scenario) -> Result<Vec<Vec<f64>>, SimulationError> {
    let mut postures = match (&scenario.postures.joints, &scenario.postures.drawn) {
        (Some(given), _) => given.clone(),
        (None, Some(drawn)) => draw(&scenario.robot, &Vector3::from(scenario.instrument.position), drawn)?,
        (None, None) => return Err(SimulationError::NoPostures),
    };
    for value in postures.iter_mut().flatten() {
        *value = libm::round(*value * 1e9) / 1e9;
    }
    Ok(postures)
}

/// Each posture is, among the candidates, the one farthest from those already taken.
fn draw(robot: &Robot, instrument: &Vector3<f64>, wanted: &DrawnPostures) -> Result<Vec<Vec<f64>>, SimulationError> {
    let window = Window::new(robot, wanted);
    let prepared = robot.chain().prepare(&robot.nominal());
    let gravity = robot.gravity.norm();
    let up = if gravity > 0.0 { -robot.gravity / gravity } else { Vector3::z() };
    let acceptable = |joints: &[f64]| {
        let frames = prepared.frames(&Posture::new(joints));
        let (base, flange) = (&frames[0], &frames[frames.len() - 1]);
        let seen = wanted.facing_rad.is_none_or(|limit| {
            let towards = instrument - flange.origin;
            flange.rotation.column(2).dot(&towards) >= libm::cos(limit) * towards.norm()
        });
        let high = wanted.lowest_m.is_none_or(|limit| up.dot(&(flange.origin - base.origin)) >= limit);
        seen && high
    };
    let mut stream = Stream::new(wanted.seed, Purpose::Postures);
    let mut candidates: Vec<Vec<f64>> = Vec::new();
    for _ in 0..DRAWS * CANDIDATES * wanted.count {
        if candidates.len() == CANDIDATES * wanted.count {
            break;
        }
        let joints = window.draw(&mut stream);
        if acceptable(&joints) {
            candidates.push(joints);
        }
    }
    if candidates.len() < wanted.count {
        return Err(SimulationError::NoSuchPostures { wanted: wanted.count, found: candidates.len() });
    }
    let mut distances = vec![f64::INFINITY; candidates.len()];
    let mut taken: Vec<Vec<f64>> = Vec::new();
    while taken.len() < wanted.count {
        let (farthest, _) = distances.iter().enumerate().fold((0, f64::NEG_INFINITY), |best, (place, &distance)| {
            if distance > best.1 { (place, distance) } else { best }
        });
        let posture = candidates[farthest].clone();
        for (distance, candidate) in distances.iter_mut().zip(&candidates) {
            *distance = distance.min(window.distance(&posture, candidate));
        }
        // Never again, even where all candidates are alike.
        distances[farthest] = f64::NEG_INFINITY;
        taken.push(posture);
    }
    Ok(taken)
}

/// The positions that joints may take.
struct Window(Vec<(f64, f64)>);

impl Window {
    /// The window that is asked for, within the joints' own limits.
    fn new(robot: &Robot, wanted: &DrawnPostures) -> Self {
        let joints = robot.transforms.iter().filter_map(|transform| transform.joint.as_ref());
        let bounds = joints
            .zip(wanted.min.iter().zip(&wanted.max))
            .map(|(joint, (&min, &max))| {
                let low = joint.min.map_or(min, |limit| limit.max(min));
                let high = joint.max.map_or(max, |limit| limit.min(max));
                (low, high.max(low))
            })
            .collect();
        Self(bounds)
    }

    fn draw(&self, stream: &mut Stream) -> Vec<f64> {
        self.0.iter().map(|&(low, high)| stream.between(low, high)).collect()
    }

    /// Euclidean distance with every joint's window as its unit.
    fn distance(&self, one: &[f64], other: &[f64]) -> f64 {
        let square = |((a, b), &(low, high)): ((&f64, &f64), &(f64, f64))| {
            let share = if high > low { (a - b) / (high - low) } else { 0.0 };
            share * share
        };
        libm::sqrt(one.iter().zip(other).zip(&self.0).map(square).sum())
    }
}

/// The sign of each joint's motion from one posture to the next.
pub(super) fn approach(from: &[f64], to: &[f64]) -> Vec<i8> {
    from.iter()
        .zip(to)
        .map(|(from, to)| match to.partial_cmp(from) {
            Some(std::cmp::Ordering::Greater) => 1,
            Some(std::cmp::Ordering::Less) => -1,
            _ => 0,
        })
        .collect()
}

/// Where the exercise leaves the arm before the first posture: the middle of the postures.
pub(super) fn home(postures: &[Vec<f64>]) -> Vec<f64> {
    let count = postures.len() as f64;
    (0..postures[0].len()).map(|joint| postures.iter().map(|posture| posture[joint]).sum::<f64>() / count).collect()
}
