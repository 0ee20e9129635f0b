//! The arms that runs are made with: the thesis's, smaller ones, one with parallel axes, and random ones.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;

use super::arm::{Arm, Body, Convention, Sensor, Thermal, Transform};
use super::random::Stream;

/// Which arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Model {
    /// The thesis's arm, table 4.1, with four sensors a link.
    Nj130,
    /// The same form at 0.45 of the size, light, with two sensors a link and three targets.
    ThesisSmall,
    /// An arm with three parallel axes like a UR10, three sensors a link.
    Ur,
    /// The thesis's form with random lengths, masses, targets and thermal pairs.
    Random,
}

const NJ_RANGES: [(f64, f64); 6] = [(-0.9, 0.9), (-0.25, 0.95), (-0.9, 0.3), (-1.7, 1.7), (0.0, 1.6), (-2.1, 2.1)];
const UR_RANGES: [(f64, f64); 6] = [(-1.2, 1.2), (-2.2, -0.6), (0.3, 2.0), (-2.2, -0.5), (-2.0, 2.0), (-2.4, 2.4)];

impl Model {
    /// The model's name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nj130 => "nj130",
            Self::ThesisSmall => "thesis-small",
            Self::Ur => "ur",
            Self::Random => "random",
        }
    }

    /// The arm.
    pub fn arm(self, stream: &mut Stream) -> Arm {
        match self {
            Self::Nj130 => thesis("COMAU NJ-130-2.0", &[1.0; 6], 1.0, 4, 4),
            Self::ThesisSmall => thesis("small arm", &[0.45; 6], 0.05, 2, 3),
            Self::Ur => ur(),
            Self::Random => {
                let scale = stream.between(0.5, 1.1);
                let lengths: Vec<f64> = (0..6).map(|_| scale * stream.between(0.75, 1.25)).collect();
                let lengths: [f64; 6] = lengths.try_into().expect("six lengths");
                let sensors = 2 + stream.below(3);
                let targets = 3 + stream.below(2);
                let mut arm = thesis("random arm", &lengths, scale * scale * scale, sensors, targets);
                arm.thermal.retain(|_| stream.uniform() < 0.85);
                for (_, place) in &mut arm.targets {
                    *place += Vector3::from_fn(|_, _| 0.03 * stream.normal());
                }
                arm
            }
        }
    }
}

fn transform(convention: Convention, nominal: &[f64]) -> Transform {
    Transform { convention, nominal: nominal.to_vec() }
}

/// Sensors named as the blind examples name them: `count` on each of the links 0 to 4.
fn sensors(count: usize) -> Vec<Sensor> {
    (0..5)
        .flat_map(|link| {
            (0..count).map(move |address| Sensor {
                name: format!("L{link}S{}", address + 1),
                link,
                address,
                along: (address as f64 + 0.5) / count as f64,
            })
        })
        .collect()
}

fn pairs(arm: &mut Arm, pairs: &[(&str, usize)]) {
    for &(name, link) in pairs {
        let of_link = |(_, sensor): &(usize, &Sensor)| sensor.link == link;
        let sensors = arm.sensors.iter().enumerate().filter(of_link).map(|(place, _)| place).collect();
        let parameter = arm.place(name);
        arm.thermal.push(Thermal { parameter, sensors });
    }
}

/// Table 4.1 with each length scaled by a factor of its own.
fn thesis(name: &str, l: &[f64; 6], masses: f64, per_link: usize, targets: usize) -> Arm {
    let (dh, hayati) = (Convention::Dh, Convention::Hayati);
    let tool = l[5].max(0.5);
    let places = [[0.1, 0.0, 0.06], [0.0, 0.1, 0.06], [-0.1, 0.0, 0.06], [0.0, -0.1, 0.06]];
    let body = |transform, mass_kg: f64, center: [f64; 3], scale: f64| Body {
        transform,
        mass_kg: mass_kg * masses,
        center: center.map(|c| c * scale),
    };
    let mut arm = Arm {
        name: name.into(),
        transforms: vec![
            transform(hayati, &[-FRAC_PI_2, -2.0, PI, 0.0]),
            transform(dh, &[-0.55 * l[0], 0.0, 0.4 * l[1], FRAC_PI_2]),
            transform(hayati, &[-FRAC_PI_2, 0.86 * l[2], PI, 0.0]),
            transform(dh, &[0.0, FRAC_PI_2, 0.21 * l[3], -FRAC_PI_2]),
            transform(dh, &[-0.76158 * l[4], 0.0, 0.0, -FRAC_PI_2]),
            transform(dh, &[0.0, 0.0, 0.0, FRAC_PI_2]),
            transform(Convention::Full, &[-0.21 * l[5], PI, 0.0, PI, 0.0, 0.0]),
        ],
        targets: (0..targets).map(|n| (format!("T{}", n + 1), Vector3::from(places[n]) * tool)).collect(),
        bodies: vec![
            body(1, 320.0, [-0.25, 0.05, 0.0], l[1]),
            body(2, 170.0, [-0.43, 0.0, 0.08], l[2]),
            body(3, 190.0, [-0.05, 0.0, 0.05], l[3]),
            body(4, 60.0, [0.0, 0.25, 0.0], l[4]),
            body(5, 35.0, [0.0, 0.0, 0.02], l[4]),
            body(6, 12.0, [0.0, 0.0, 0.05], l[5]),
        ],
        sensors: sensors(per_link),
        thermal: Vec::new(),
        ranges: NJ_RANGES.to_vec(),
        speeds: vec![0.89, 0.71, 0.80, 1.20, 1.11, 1.49],
    };
    pairs(&mut arm, &[("d1", 0), ("a1", 1), ("a2", 2), ("beta2", 2), ("d4", 4)]);
    arm
}

fn ur() -> Arm {
    let (dh, hayati) = (Convention::Dh, Convention::Hayati);
    let body = |transform, mass_kg, center| Body { transform, mass_kg, center };
    let mut arm = Arm {
        name: "an arm with three parallel axes".into(),
        transforms: vec![
            transform(hayati, &[-0.52, 2.6, 0.0, 0.0]),
            transform(dh, &[0.1273, 0.0, 0.0, FRAC_PI_2]),
            transform(hayati, &[0.0, -0.612, 0.0, 0.0]),
            transform(hayati, &[0.0, -0.5723, 0.0, 0.0]),
            transform(dh, &[0.163941, 0.0, 0.0, FRAC_PI_2]),
            transform(dh, &[0.1157, 0.0, 0.0, -FRAC_PI_2]),
            transform(Convention::Full, &[0.0922, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ],
        targets: [[0.06, 0.0, 0.05], [-0.03, 0.055, 0.05], [-0.03, -0.05, 0.09]]
            .iter()
            .enumerate()
            .map(|(n, &place)| (format!("T{}", n + 1), Vector3::from(place)))
            .collect(),
        bodies: vec![
            body(1, 7.8, [0.0, -0.02, 0.0]),
            body(2, 12.9, [0.25, 0.0, 0.17]),
            body(3, 3.9, [0.25, 0.0, 0.05]),
            body(4, 2.0, [0.0, 0.0, 0.01]),
            body(5, 2.0, [0.0, 0.0, 0.01]),
            body(6, 0.4, [0.0, 0.0, -0.02]),
        ],
        sensors: sensors(3),
        thermal: Vec::new(),
        ranges: UR_RANGES.to_vec(),
        speeds: vec![0.8, 0.7, 0.9, 1.3, 1.2, 1.4],
    };
    pairs(&mut arm, &[("d1", 0), ("a2", 2), ("a3", 3), ("alpha1", 1)]);
    arm
}
