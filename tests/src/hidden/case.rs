//! One hidden run: a world of a seed, effects sized to a signal-to-noise ratio, and what an instrument saw of it.

use nalgebra::Vector3;

use super::arms::Model;
use super::draw::{self, Request};
use super::effect::Effect;
use super::kind::Kind;
use super::oracle::{Basis, Oracle, length};
use super::random::{Purpose, Stream};
use super::readings::{self, Log};
use super::schedule::Plan;
use super::world::{Influence, Noise, World};

/// All that makes a run.
#[derive(Debug, Clone)]
pub struct Options {
    /// Its seed.
    pub seed: u64,
    /// Its arm.
    pub model: Model,
    /// Its campaign.
    pub plan: Plan,
    /// What to hide.
    pub effects: Vec<Request>,
    /// The signal-to-noise ratio that the oracle shall find; none: natural sizes.
    pub rho: Option<f64>,
    /// 1-sigma of a point's coordinate, m; drawn where absent.
    pub point_sigma_m: Option<f64>,
    /// 1-sigma of the first joint from visit to visit, rad; drawn where absent. Later joints repeat worse.
    pub joint_sigma_rad: Option<f64>,
    /// Error that a posture keeps, as a share of the joint's repeatability.
    pub posture_share: f64,
    /// Share of points that are not seen.
    pub missing: f64,
}

/// What the oracle knows of one hidden effect.
#[derive(Debug, Clone)]
pub struct Weighed {
    /// The effect.
    pub effect: Effect,
    /// Square root of the noncentrality; none for gross errors.
    pub rho: Option<f64>,
    /// The same before anything is projected out.
    pub raw: f64,
}

/// One hidden run.
pub struct Case {
    /// What made it.
    pub options: Options,
    /// The true world.
    pub world: World,
    /// What is hidden.
    pub hidden: Vec<Weighed>,
    /// What is seen: a position a point, none where the beam was broken.
    pub measured: Vec<Option<Vector3<f64>>>,
    /// Positions without any noise or gross error.
    pub clean: Vec<Vector3<f64>>,
    /// The target that each point's record names.
    pub labels: Vec<usize>,
    /// The points that are outliers.
    pub outliers: Vec<usize>,
    /// The temperature log.
    pub log: Log,
    /// How far the growth is from what the readings can explain, in units of noise.
    pub mismatch: f64,
}

impl Case {
    /// Makes the run of the options.
    ///
    /// # Errors
    ///
    /// Where an effect cannot be.
    pub fn make(options: Options) -> Result<Self, String> {
        let seed = options.seed;
        let mut stream = Stream::new(seed, Purpose::Noise);
        let noise = noise(&options, &mut stream);
        let mut arm = options.model.arm(&mut stream);
        arm.targets.truncate(options.plan.targets.unwrap_or(usize::MAX));
        let world = World::draw(seed, arm, &options.plan, noise);
        let seen = seen(&world, &mut Stream::new(seed, Purpose::Points));
        let mut stream = Stream::new(seed, Purpose::Effects);
        let mut effects = Vec::new();
        for request in &options.effects {
            effects.push(draw::effect(&world, request, &mut stream)?);
        }
        let honest = Oracle::new(&world, &readings::said_rises(&world, &[]), &seen);
        let mismatch = length(&honest.visible(&honest.column(&Oracle::growth(&world))));
        if let Some(rho) = options.rho {
            for n in 0..effects.len() {
                resize(&world, &honest, &mut effects, n, rho);
            }
        }
        let hidden = weigh(&world, &honest, &effects);
        let clean = world.positions(&together(&world, &effects), &[]);
        let (measured, labels, outliers) = observe(&world, &effects, &seen, seed);
        let log = readings::log(&world, &effects, &mut Stream::new(seed, Purpose::Readings));
        Ok(Self { options, world, hidden, measured, clean, labels, outliers, log, mismatch })
    }

    /// The effects alone.
    pub fn effects(&self) -> Vec<Effect> {
        self.hidden.iter().map(|weighed| weighed.effect.clone()).collect()
    }
}

fn noise(options: &Options, stream: &mut Stream) -> Noise {
    let drawn = stream.between(4e-6, 9e-6);
    let first = options.joint_sigma_rad.unwrap_or(drawn);
    // Gears of the wrist are smaller and repeat worse.
    let joint: Vec<f64> =
        [1.0, 1.0, 1.2, 2.1, 2.4, 3.4].iter().map(|worse| first * worse * stream.between(0.9, 1.1)).collect();
    let posture = joint.iter().map(|sigma| options.posture_share * sigma).collect();
    let point = match (options.point_sigma_m, options.model) {
        (Some(sigma), _) => (sigma, 0.0),
        (None, Model::Nj130) => (4e-6, 0.0),
        (None, _) => (stream.between(3e-6, 8e-6), stream.between(0.0, 2e-6)),
    };
    Noise { point, joint, posture, reading_k: (0.02, 0.02), missing: options.missing }
}

fn seen(world: &World, stream: &mut Stream) -> Vec<bool> {
    world.points.iter().map(|_| stream.uniform() >= world.noise.missing).collect()
}

/// The sum of all effects' influences.
pub fn together(world: &World, effects: &[Effect]) -> Influence {
    let mut sum = Influence::default();
    for effect in effects {
        sum.add(1.0, &effect.influence(world));
    }
    sum
}

/// What is projected out when one of the effects is weighed: calibration with the log as it is, and all other effects with
/// their nonlinear parameters.
fn absorbed(world: &World, oracle: &Oracle, effects: &[Effect], but: usize) -> Basis {
    let mut basis = oracle.nuisance_with(world, &readings::said_rises(world, effects));
    for (n, effect) in effects.iter().enumerate() {
        if n != but {
            for tangent in tangents(world, effect) {
                basis.add(&oracle.column(&tangent));
            }
        }
    }
    basis
}

/// The directions in which an effect's parameters move the positions.
pub fn tangents(world: &World, effect: &Effect) -> Vec<Influence> {
    let mut tangents = super::effect::basis(world, effect.kind, &effect.place, &effect.shape);
    let smooth = match effect.kind {
        Kind::GearEccentricity | Kind::LostMotion | Kind::ThermalLag | Kind::UnsensedHeat => 1,
        _ => 0,
    };
    for n in 0..smooth {
        let moved = |by: f64| {
            let mut shape = effect.shape.clone();
            shape[n] *= 1.0 + by;
            Effect { shape, ..effect.clone() }.influence(world)
        };
        let mut tangent = moved(1e-4);
        tangent.add(-1.0, &moved(-1e-4));
        tangents.push(tangent);
    }
    tangents
}

/// The signal of one effect after all that is projected out; none for gross errors.
fn signal(world: &World, oracle: &Oracle, effects: &[Effect], n: usize, basis: &Basis) -> Option<f64> {
    let kind = effects[n].kind;
    if kind.is_gross() {
        return None;
    }
    if !kind.is_of_readings() {
        return Some(length(&basis.beyond(&oracle.column(&effects[n].influence(world)))));
    }
    // What a wrong log leaves of the true growth, beyond what the right one leaves.
    let left = basis.beyond(&oracle.column(&Oracle::growth(world))).norm_squared();
    let others: Vec<Effect> = effects.iter().enumerate().filter(|(m, _)| *m != n).map(|(_, e)| e.clone()).collect();
    let right = absorbed(world, oracle, &others, others.len());
    let mismatch = right.beyond(&oracle.column(&Oracle::growth(world))).norm_squared();
    Some(libm::sqrt((left - mismatch).max(0.0)))
}

fn resize(world: &World, oracle: &Oracle, effects: &mut [Effect], n: usize, rho: f64) {
    match effects[n].kind {
        kind if kind.is_linear() => {
            let basis = absorbed(world, oracle, effects, n);
            if let Some(found) = signal(world, oracle, effects, n, &basis).filter(|found| *found > 0.0) {
                effects[n].size.iter_mut().for_each(|size| *size *= rho / found);
            }
        }
        // Times: the first at which the signal is as large as asked for, between the shortest and the longest sensible.
        Kind::ThermalLag => search(world, oracle, effects, n, rho, (10.0, 20_000.0)),
        Kind::ClockOffset => search(world, oracle, effects, n, rho, (2.0, 3000.0)),
        _ => {}
    }
}

fn search(world: &World, oracle: &Oracle, effects: &mut [Effect], n: usize, rho: f64, bounds: (f64, f64)) {
    const STEPS: usize = 14;
    let sign = effects[n].shape[0].signum();
    let (mut low, mut high) = bounds;
    for _ in 0..STEPS {
        let middle = libm::sqrt(low * high);
        effects[n].shape[0] = sign * middle;
        let basis = absorbed(world, oracle, effects, n);
        match signal(world, oracle, effects, n, &basis) {
            Some(found) if found < rho => low = middle,
            _ => high = middle,
        }
    }
    // A signal that is never as large as asked for leaves the longest time; a plausible one is better than that.
    let plausible = if effects[n].kind == Kind::ThermalLag { 4000.0 } else { 1200.0 };
    effects[n].shape[0] = sign * libm::sqrt(low * high).min(plausible);
}

fn weigh(world: &World, oracle: &Oracle, effects: &[Effect]) -> Vec<Weighed> {
    (0..effects.len())
        .map(|n| {
            let basis = absorbed(world, oracle, effects, n);
            let rho = signal(world, oracle, effects, n, &basis);
            let raw = length(&oracle.column(&effects[n].influence(world)));
            Weighed { effect: effects[n].clone(), rho, raw }
        })
        .collect()
}

/// What the instrument records: positions with all noise, the names of the targets, and the points that are outliers.
fn observe(
    world: &World,
    effects: &[Effect],
    seen: &[bool],
    seed: u64,
) -> (Vec<Option<Vector3<f64>>>, Vec<usize>, Vec<usize>) {
    let mut stream = Stream::new(seed, Purpose::Repeatability);
    let poses = world.schedule.visits.iter().map(|visit| visit.pose).max().map_or(0, |last| last + 1);
    let kept: Vec<Vec<f64>> =
        (0..poses).map(|_| world.noise.posture.iter().map(|sigma| sigma * stream.normal()).collect()).collect();
    let joint_noise: Vec<Vec<f64>> = world
        .schedule
        .visits
        .iter()
        .map(|visit| {
            let of_visit = world.noise.joint.iter().map(|sigma| sigma * stream.normal());
            of_visit.zip(&kept[visit.pose]).map(|(visit, kept)| visit + kept).collect()
        })
        .collect();
    let positions = world.positions(&together(world, effects), &joint_noise);
    let mut stream = Stream::new(seed.wrapping_add(1 << 40), Purpose::Points);
    let mut labels: Vec<usize> = world.points.iter().map(|point| point.target).collect();
    let mut outliers = Vec::new();
    let mut measured: Vec<Option<Vector3<f64>>> = positions
        .iter()
        .zip(seen)
        .map(|(at, seen)| {
            let sigma = world.noise.at(at);
            let noise = Vector3::new(stream.normal(), stream.normal(), stream.normal()) * sigma;
            seen.then_some(at + noise)
        })
        .collect();
    for effect in effects {
        match effect.kind {
            Kind::TargetSwap => {
                let (a, b) = (effect.place.targets[0], effect.place.targets[1]);
                for (label, point) in labels.iter_mut().zip(&world.points) {
                    let cycle = world.schedule.visits[point.visit].cycle as f64;
                    if effect.shape.contains(&cycle) && (*label == a || *label == b) {
                        *label = a + b - *label;
                    }
                }
            }
            Kind::Outliers => {
                for (p, at) in measured.iter_mut().enumerate() {
                    if stream.uniform() < effect.shape[0]
                        && let Some(at) = at
                    {
                        let error = Vector3::new(stream.normal(), stream.normal(), stream.normal());
                        *at += error * effect.shape[1];
                        outliers.push(p);
                    }
                }
            }
            _ => {}
        }
    }
    (measured, labels, outliers)
}
