//! The true world of one run: what the arm is, how warm it is, and where its targets are when effects act on it.

use nalgebra::{Matrix3, Vector3, Vector4};

use super::arm::Arm;
use super::heat::{self, Heat, Physics};
use super::random::{Purpose, Stream};
use super::schedule::{Plan, Schedule};

/// One measured position: which visit, which target, when.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    /// The visit.
    pub visit: usize,
    /// The target.
    pub target: usize,
    /// Time, s.
    pub time_s: f64,
}

/// Sizes of the noise.
#[derive(Debug, Clone)]
pub struct Noise {
    /// 1-sigma of one coordinate, m, and more of it per metre of distance.
    pub point: (f64, f64),
    /// 1-sigma of each joint from visit to visit, rad.
    pub joint: Vec<f64>,
    /// 1-sigma of each joint's error that a posture keeps, rad; 0 mostly.
    pub posture: Vec<f64>,
    /// 1-sigma of one reading of a sensor and of its constant error, K.
    pub reading_k: (f64, f64),
    /// Share of points that are not seen.
    pub missing: f64,
}

/// How a parameter follows the nodes, m/K or rad/K.
#[derive(Debug, Clone)]
pub struct Growth {
    /// The parameter.
    pub parameter: usize,
    /// Nodes and coefficients.
    pub terms: Vec<(usize, f64)>,
}

/// What effects do to the positions: added joint angles a visit, parameters, flange-frame shifts and world motions a point.
#[derive(Debug, Clone, Default)]
pub struct Influence {
    /// Joint and one angle a visit.
    pub joints: Vec<(usize, Vec<f64>)>,
    /// Parameter and one change a point.
    pub parameters: Vec<(usize, Vec<f64>)>,
    /// One shift in the flange frame a point; or none.
    pub flange: Vec<Vector3<f64>>,
    /// One affine motion a point in the world, beyond identity; or none.
    pub world: Vec<(Matrix3<f64>, Vector3<f64>)>,
}

impl Influence {
    /// Adds a multiple of another.
    pub fn add(&mut self, factor: f64, other: &Self) {
        let scaled = |(place, values): &(usize, Vec<f64>)| (*place, values.iter().map(|v| factor * v).collect());
        self.joints.extend(other.joints.iter().map(scaled));
        self.parameters.extend(other.parameters.iter().map(scaled));
        if !other.flange.is_empty() {
            self.flange.resize(other.flange.len(), Vector3::zeros());
            self.flange.iter_mut().zip(&other.flange).for_each(|(mine, theirs)| *mine += theirs * factor);
        }
        if !other.world.is_empty() {
            self.world.resize(other.world.len(), (Matrix3::zeros(), Vector3::zeros()));
            self.world.iter_mut().zip(&other.world).for_each(|(mine, theirs)| {
                mine.0 += theirs.0 * factor;
                mine.1 += theirs.1 * factor;
            });
        }
    }
}

/// The true world of one run.
pub struct World {
    /// The arm as it is described.
    pub arm: Arm,
    /// The campaign.
    pub schedule: Schedule,
    /// True parameters at the reference temperatures.
    pub values: Vec<f64>,
    /// Noise.
    pub noise: Noise,
    /// Temperatures.
    pub heat: Heat,
    /// Growth that the baseline knows the form of.
    pub growth: Vec<Growth>,
    /// All points in order of time.
    pub points: Vec<Point>,
    /// One change a point, for each of `growth`.
    pub grown: Vec<Vec<f64>>,
    /// For each sensor, the rise of the body beneath it above the reference cycle's mean, a point.
    pub rises: Vec<Vec<f64>>,
    /// Moments of gravity a visit: about each joint, and about the x axis behind it, N·m.
    pub moments: Vec<Vec<(f64, f64)>>,
}

impl World {
    /// Draws the world of a seed.
    pub fn draw(seed: u64, mut arm: Arm, plan: &Plan, noise: Noise) -> Self {
        let mut stream = Stream::new(seed, Purpose::Geometry);
        // Plausible masses as robot.toml gives them; the truth below uses the same, as gravity is no error here.
        for body in &mut arm.bodies {
            body.mass_kg *= stream.between(0.95, 1.05);
        }
        let values: Vec<f64> = arm
            .parameters()
            .iter()
            .zip(arm.nominal())
            .map(|(&(transform, _), nominal)| nominal + if transform == 0 { 2.0e-3 } else { 0.9e-3 } * stream.normal())
            .collect();
        let schedule = Schedule::draw(&arm, plan, &mut Stream::new(seed, Purpose::Schedule));
        let mut stream = Stream::new(seed, Purpose::Heat);
        let heat = Physics::draw(arm.transforms.len(), heat::size(&arm), &mut stream).run(&schedule);
        let mut stream = Stream::new(seed, Purpose::Growth);
        let growth =
            arm.thermal.iter().map(|pair| draw_growth(&arm, pair.parameter, &pair.sensors, &mut stream)).collect();
        Self::assemble(arm, schedule, values, noise, heat, growth)
    }

    /// A world of given parts.
    pub fn assemble(
        arm: Arm,
        schedule: Schedule,
        values: Vec<f64>,
        noise: Noise,
        heat: Heat,
        growth: Vec<Growth>,
    ) -> Self {
        let points: Vec<Point> = (0..schedule.visits.len())
            .flat_map(|visit| (0..arm.targets.len()).map(move |target| (visit, target)))
            .map(|(visit, target)| Point { visit, target, time_s: schedule.target_time(visit, target) })
            .collect();
        let rise = |weights: &[(usize, f64)]| above_reference(&schedule, &points, |t| heat.at(weights, t));
        let grown = growth.iter().map(|growth| rise(&growth.terms)).collect();
        let rises = arm.sensors.iter().map(|sensor| rise(&heat::spot(sensor.link, sensor.along))).collect();
        let moments =
            schedule.visits.iter().map(|visit| arm.moments(&values, &visit.joints, visit.payload_kg)).collect();
        Self { arm, schedule, values, noise, heat, growth, points, grown, rises, moments }
    }

    /// Where the targets are, in the world frame, under an influence and joint noise (one vector a visit; or none).
    pub fn positions(&self, influence: &Influence, joint_noise: &[Vec<f64>]) -> Vec<Vector3<f64>> {
        self.positions_from(&self.values, influence, joint_noise)
    }

    /// The same from other parameters than the true ones.
    pub fn positions_from(&self, values: &[f64], influence: &Influence, joint_noise: &[Vec<f64>]) -> Vec<Vector3<f64>> {
        self.points
            .iter()
            .enumerate()
            .map(|(p, point)| {
                let mut joints = self.schedule.visits[point.visit].joints.clone();
                for (joint, angles) in &influence.joints {
                    joints[*joint] += angles[point.visit];
                }
                if let Some(noise) = joint_noise.get(point.visit) {
                    joints.iter_mut().zip(noise).for_each(|(q, noise)| *q += noise);
                }
                let mut values = values.to_vec();
                for (growth, grown) in self.growth.iter().zip(&self.grown) {
                    values[growth.parameter] += grown[p];
                }
                for (parameter, changes) in &influence.parameters {
                    values[*parameter] += changes[p];
                }
                let mut target = self.arm.targets[point.target].1;
                if let Some(shift) = influence.flange.get(p) {
                    target += shift;
                }
                let at = (self.arm.flange(&values, &joints) * Vector4::new(target.x, target.y, target.z, 1.0)).xyz();
                influence.world.get(p).map_or(at, |(turn, shift)| at + turn * at + shift)
            })
            .collect()
    }

    /// The sensors' place names for a link.
    pub fn sensors_of(&self, link: usize) -> Vec<usize> {
        (0..self.arm.sensors.len()).filter(|&sensor| self.arm.sensors[sensor].link == link).collect()
    }
}

/// A signal at all points, less its mean over the points of the reference cycle.
pub fn above_reference(schedule: &Schedule, points: &[Point], signal: impl Fn(f64) -> f64) -> Vec<f64> {
    let values: Vec<f64> = points.iter().map(|point| signal(point.time_s)).collect();
    less_reference(schedule, points, values)
}

/// Values at all points, less their mean over the points of the reference cycle.
pub fn less_reference(schedule: &Schedule, points: &[Point], values: Vec<f64>) -> Vec<f64> {
    let cold = |point: &Point| schedule.visits[point.visit].cycle == 0;
    let (sum, count) = points
        .iter()
        .zip(&values)
        .filter(|(point, _)| cold(point))
        .fold((0.0, 0.0), |(sum, count), (_, value)| (sum + value, count + 1.0));
    values.into_iter().map(|value| value - sum / count).collect()
}

/// Iron and aluminium for lengths, with the whole link; for angles, one end of the link against the other.
fn draw_growth(arm: &Arm, parameter: usize, sensors: &[usize], stream: &mut Stream) -> Growth {
    let (_, symbol) = arm.parameters()[parameter];
    let link = arm.sensors[sensors[0]].link;
    let terms = if matches!(symbol, "d" | "a" | "b") {
        let length = arm.nominal()[parameter];
        let per_k = stream.between(9e-6, 14e-6) * length;
        heat::whole(link).into_iter().map(|(node, weight)| (node, weight * per_k)).collect()
    } else {
        let (bend, common) = (stream.between(1e-5, 3e-5) * stream.sign(), 1e-6 * stream.normal());
        let ends = heat::spot(link, 0.2).into_iter().map(|(node, w)| (node, w * (common + bend)));
        ends.chain(heat::spot(link, 0.8).into_iter().map(|(node, w)| (node, w * (common - bend)))).collect()
    };
    Growth { parameter, terms }
}

impl Noise {
    /// 1-sigma of one coordinate of a point seen from the world's origin, m.
    pub fn at(&self, position: &Vector3<f64>) -> f64 {
        self.point.0 + self.point.1 * libm::sqrt(position.norm_squared())
    }
}
