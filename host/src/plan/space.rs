//! Where poses may be: within the joints' limits, with every target inside the working volume, and seen by the tracker.
//!
//! A target counts as seen where
//! 1. the direction to the tracker lies within a cone about an axis of the target that is fixed to the flange (a reflector
//!    takes a beam from in front of it only), and
//! 2. the beam does not come within a clearance of the centre line of a link, nearer than the target itself is to it.
//!
//! Centre lines run along each transform's axis and across to the next. Nothing else is known of the arm's shape, nor of its
//! surroundings: collisions and what else could stand in the beam's way are for the person who runs the plan to exclude.

use nalgebra::Vector3;

use super::telling::Setup;
use crate::robot::{Frame, Posture, Prepared, centre_lines};
use crate::simulate::random::{Purpose, Stream};

/// When a target counts as seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Visibility {
    /// Where the tracker stands, m, in the world frame.
    pub tracker: Vector3<f64>,
    /// The axis of each target's cone, of length one, in the flange frame.
    pub axes: Vec<Vector3<f64>>,
    /// Half the opening of each target's cone, rad.
    pub half_angles: Vec<f64>,
    /// How near a beam may come to a link's centre line, m.
    pub clearance_m: f64,
}

/// Why a posture is not admitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refused {
    /// A joint is beyond its limits.
    Limits,
    /// A target is outside the working volume.
    Volume,
    /// Something of the arm is lower than it may be.
    Low,
    /// A target does not face the tracker.
    Averted,
    /// A beam comes too near a link.
    Blocked,
}

/// Too few postures are admitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{found} of {wanted} postures found in {drawn} draws: {outside} had a target outside the volume, {low} were too low, \
     {averted} did not face the tracker, {blocked} had a beam blocked; expected a wider volume, window or cone"
)]
pub struct SpaceError {
    /// How many are asked for.
    pub wanted: usize,
    /// How many there are.
    pub found: usize,
    /// How many were drawn.
    pub drawn: usize,
    /// Refused by [`Refused::Volume`].
    pub outside: usize,
    /// By [`Refused::Low`].
    pub low: usize,
    /// By [`Refused::Averted`].
    pub averted: usize,
    /// By [`Refused::Blocked`].
    pub blocked: usize,
}

/// Where poses may be.
#[derive(Debug, Clone, PartialEq)]
pub struct Space {
    /// Lowest and highest position of each joint, rad or m.
    pub joints: Vec<[f64; 2]>,
    /// Lowest and highest x, y and z of every target, m, in the world frame; none: anywhere.
    pub volume: Option<[[f64; 2]; 3]>,
    /// The least height above the base of everything beyond the first joint, m, and the direction up; none: any.
    pub lowest: Option<(f64, Vector3<f64>)>,
    /// What the tracker sees.
    pub visibility: Visibility,
}

/// How many postures are drawn for one that is wanted, at most.
const DRAWS: usize = 3_000;

/// How far about a known posture draws go at most, 1-sigma as a share of the joints' windows.
const WIDEST: f64 = 0.2;

/// The distance between two segments (Ericson, Real-Time Collision Detection, 5.1.9).
fn between_segments(p: &Vector3<f64>, q: &Vector3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let (d1, d2, r) = (q - p, b - a, p - a);
    let (one, other, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    let (s, t) = if other <= f64::EPSILON {
        ((-d1.dot(&r) / one.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0), 0.0)
    } else {
        let (c, both) = (d1.dot(&r), d1.dot(&d2));
        let apart = one * other - both * both;
        let s = if apart > f64::EPSILON * one * other { ((both * f - c * other) / apart).clamp(0.0, 1.0) } else { 0.0 };
        match (both * s + f) / other {
            t if t < 0.0 => ((-c / one.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0), 0.0),
            t if t > 1.0 => (((both - c) / one.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0), 1.0),
            t => (s, t),
        }
    };
    (p + d1 * s - (a + d2 * t)).norm()
}

fn to_segment(p: &Vector3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let along = b - a;
    let share = ((p - a).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    (p - a - along * share).norm()
}

impl Visibility {
    /// The angle between a target's axis and the direction to the tracker, rad.
    pub fn angle(&self, flange: &Frame, target: usize, place: &Vector3<f64>) -> f64 {
        let towards = flange.rotation.tr_mul(&(self.tracker - flange.point(place)));
        libm::atan2(self.axes[target].cross(&towards).norm(), self.axes[target].dot(&towards))
    }

    /// How near the beam to a target comes to the centre line of a link that it approaches, m; infinite where it
    /// approaches none.
    pub fn nearest_link(&self, frames: &[Frame], target: &Vector3<f64>) -> f64 {
        let lines = centre_lines(frames);
        lines
            .windows(2)
            .filter(|ends| (ends[1] - ends[0]).norm_squared() > f64::EPSILON)
            .filter_map(|ends| {
                let own = to_segment(target, &ends[0], &ends[1]);
                let beam = between_segments(target, &self.tracker, &ends[0], &ends[1]);
                // A millionth: the beam begins at the target, whose own distance is that of its first point.
                (beam < own * (1.0 - 1e-6)).then_some(beam)
            })
            .fold(f64::INFINITY, f64::min)
    }
}

impl Space {
    /// Whether a posture of an arm with targets at `targets` (flange frame, m) is admitted.
    ///
    /// # Errors
    /// The first reason why not.
    pub fn admits(&self, arm: &Prepared, targets: &[Vector3<f64>], joints: &[f64]) -> Result<(), Refused> {
        if joints.iter().zip(&self.joints).any(|(joint, [low, high])| !(*low..=*high).contains(joint)) {
            return Err(Refused::Limits);
        }
        let frames = arm.frames(&Posture::new(joints));
        let Some(flange) = frames.last() else { return Err(Refused::Limits) };
        let places: Vec<Vector3<f64>> = targets.iter().map(|target| flange.point(target)).collect();
        if let Some(volume) = &self.volume {
            let inside = |place: &Vector3<f64>| {
                place.iter().zip(volume).all(|(value, [low, high])| (*low..=*high).contains(value))
            };
            if !places.iter().all(inside) {
                return Err(Refused::Volume);
            }
        }
        if let Some((lowest, up)) = &self.lowest {
            let beyond = &frames[2.min(frames.len() - 1)..];
            let low = |place: &Vector3<f64>| up.dot(&(place - frames[0].origin)) < *lowest;
            if beyond.iter().map(|frame| &frame.origin).chain(&places).any(low) {
                return Err(Refused::Low);
            }
        }
        let seen = &self.visibility;
        if (0..targets.len()).any(|target| seen.angle(flange, target, &targets[target]) > seen.half_angles[target]) {
            return Err(Refused::Averted);
        }
        if seen.clearance_m > 0.0 && places.iter().any(|place| seen.nearest_link(&frames, place) < seen.clearance_m) {
            return Err(Refused::Blocked);
        }
        Ok(())
    }

    /// Draws `count` postures to choose from; fewer where room is scarce, but `least` of them. Every second draw is even in
    /// the joints, every other one about a posture of `known` (all, where there are none): what a run could measure may be
    /// too small a part of all postures to be met by chance.
    ///
    /// # Errors
    /// Fewer than `least` are found.
    pub fn draw(
        &self,
        setup: &Setup,
        known: &[Vec<f64>],
        count: usize,
        least: usize,
        seed: u64,
    ) -> Result<Vec<Vec<f64>>, SpaceError> {
        self.drawn(setup, known, count, least, Stream::new(seed, Purpose::PlannedPoses))
    }

    /// Draws `count` other postures, at which predictions are judged.
    ///
    /// # Errors
    /// None is found.
    pub fn draw_judges(&self, setup: &Setup, count: usize, seed: u64) -> Result<Vec<Vec<f64>>, SpaceError> {
        self.drawn(setup, &[], count, 1, Stream::new(seed, Purpose::JudgedPoses))
    }

    fn drawn(
        &self,
        setup: &Setup,
        known: &[Vec<f64>],
        count: usize,
        least: usize,
        mut stream: Stream,
    ) -> Result<Vec<Vec<f64>>, SpaceError> {
        let (arm, targets) = (setup.prepared(), &setup.state.geometry.targets);
        let mut found = Vec::new();
        let mut error = SpaceError { wanted: least, found: 0, drawn: 0, outside: 0, low: 0, averted: 0, blocked: 0 };
        while found.len() < count && error.drawn < DRAWS * count {
            error.drawn += 1;
            let mut joints: Vec<f64> = self.joints.iter().map(|&[low, high]| stream.between(low, high)).collect();
            if !known.is_empty() && error.drawn.is_multiple_of(2) {
                let about = &known[(stream.uniform() * known.len() as f64) as usize];
                let width = stream.between(0.0, WIDEST);
                let near = joints.iter_mut().zip(about).zip(&self.joints);
                near.for_each(|((joint, about), [low, high])| {
                    *joint = (about + width * (high - low) * stream.normal()).clamp(*low, *high);
                });
            }
            match self.admits(&arm, targets, &joints) {
                Ok(()) => found.push(joints),
                Err(Refused::Volume) => error.outside += 1,
                Err(Refused::Low) => error.low += 1,
                Err(Refused::Averted) => error.averted += 1,
                Err(Refused::Blocked) => error.blocked += 1,
                Err(Refused::Limits) => {}
            }
        }
        error.found = found.len();
        if found.len() < least { Err(error) } else { Ok(found) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_of_segments_is_that_of_their_nearest_points() {
        let v = Vector3::new;
        let cases = [
            // Crossing, parallel, end to end, end to middle, a point.
            (v(-1.0, 0.0, 0.0), v(1.0, 0.0, 0.0), v(0.0, -1.0, 0.5), v(0.0, 1.0, 0.5), 0.5),
            (v(0.0, 0.0, 0.0), v(2.0, 0.0, 0.0), v(1.0, 3.0, 0.0), v(5.0, 3.0, 0.0), 3.0),
            (v(0.0, 0.0, 0.0), v(1.0, 0.0, 0.0), v(4.0, 4.0, 0.0), v(4.0, 9.0, 0.0), 5.0),
            (v(0.0, 0.0, 0.0), v(4.0, 0.0, 0.0), v(2.0, 1.0, 0.0), v(2.0, 7.0, 0.0), 1.0),
            (v(0.0, 0.0, 0.0), v(4.0, 0.0, 0.0), v(2.0, 2.0, 0.0), v(2.0, 2.0, 0.0), 2.0),
        ];
        for (p, q, a, b, expected) in cases {
            assert!((between_segments(&p, &q, &a, &b) - expected).abs() < 1e-12);
            assert!((between_segments(&a, &b, &p, &q) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn a_beam_is_blocked_by_a_link_between_target_and_tracker_alone() {
        let at = |x: f64, y: f64, z: f64| Frame { origin: Vector3::new(x, y, z), ..Frame::identity() };
        // A column from (0, 0, 0) to (0, 0, 2), and an arm from there to the flange at (1, 0, 2).
        let frames = [at(0.0, 0.0, 0.0), at(0.0, 0.0, 2.0), at(1.0, 0.0, 2.0)];
        let mut seen = Visibility {
            tracker: Vector3::new(4.0, 0.0, 1.0),
            axes: Vec::new(),
            half_angles: Vec::new(),
            clearance_m: 0.1,
        };
        let target = Vector3::new(1.1, 0.0, 1.0);
        assert_eq!(seen.nearest_link(&frames, &target), f64::INFINITY);
        seen.tracker = Vector3::new(-4.0, 0.05, 1.0);
        // The column stands in the way: the beam passes it at about 5 cm · 1.1 / 5.1.
        assert!(seen.nearest_link(&frames, &target) < 0.05);
    }
}
