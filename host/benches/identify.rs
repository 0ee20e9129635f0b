//! How long kinematics and identification take. `cargo bench -p thermokin --bench identify`.
//!
//! The same problems, from the same numbers, are timed with scipy by `benches/scipy_pair.py`, which this file's
//! `--export DIR` writes them for.

use std::hint::black_box;

use criterion::{BatchSize, Criterion};
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use thermokin::calibrate::{
    Campaign, GrowthTerm, Manner, ObservedPosition, ObservedVisit, State, Unknown, geometric_unknowns, identify,
};
use thermokin::model::Geometry;
use thermokin::robot::{Posture, Robot, Twist, shipped};

/// A number from -1 to 1.
fn unit(random: &mut ChaCha8Rng) -> f64 {
    (random.next_u64() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// A sum of uniform numbers of variance one: near enough to Gaussian for a benchmark.
fn noise(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| unit(random) * 0.5).sum()
}

/// The COMAU with errors of up to a millimetre and a milliradian, measured at `postures` postures in `cycles` cycles.
fn campaign(robot: &Robot, postures: usize, cycles: usize, sensors: usize) -> (Campaign, State) {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let chain = robot.chain();
    let nominal = Geometry::nominal(robot);
    let truth: Vec<f64> = nominal.parameters.iter().map(|value| value + 1e-3 * unit(&mut random)).collect();
    let joints: Vec<Vec<f64>> = (0..postures).map(|_| (0..6).map(|_| 1.2 * unit(&mut random)).collect()).collect();
    let parameters: Vec<usize> = ["d1", "a1", "a2", "beta2", "d4"]
        .iter()
        .filter_map(|name| name.parse().ok().and_then(|id| chain.place(id)))
        .collect();
    let growth: Vec<GrowthTerm> = (0..sensors)
        .map(|sensor| GrowthTerm { parameter: parameters[sensor * parameters.len() / sensors], sensor })
        .collect();
    let mut visits = Vec::with_capacity(postures * cycles);
    for cycle in 0..cycles {
        let rises: Vec<f64> = (0..sensors).map(|_| 10.0 * cycle as f64 / cycles as f64 + unit(&mut random)).collect();
        let mut values = truth.clone();
        for term in &growth {
            values[term.parameter] += 3e-6 * rises[term.sensor];
        }
        let prepared = chain.prepare(&values);
        for (pose, joints) in joints.iter().enumerate() {
            let posture = Posture::new(joints);
            let flange = prepared.flange(&posture);
            let positions = (0..4)
                .map(|target| ObservedPosition {
                    target,
                    at: flange.point(&nominal.targets[target]) + Vector3::from_fn(|_, _| 4e-6 * noise(&mut random)),
                })
                .collect();
            visits.push(ObservedVisit {
                place: cycle * postures + pose,
                cycle: cycle as u32,
                pose: pose as u32,
                posture,
                rises: rises.clone(),
                positions,
                sigma: 4e-6,
                turns: Vec::new(),
                turn_sigma: 1.0,
                distances: Vec::new(),
            });
        }
    }
    let campaign = Campaign {
        chain,
        targets: robot.targets.iter().map(|target| target.name.clone()).collect(),
        anchors: Vec::new(),
        sensors: (0..sensors).map(|sensor| format!("S{sensor}")).collect(),
        growth: growth.clone(),
        visits,
    };
    (campaign, State { geometry: nominal, growth: vec![0.0; growth.len()] })
}

fn identification(
    criterion: &mut Criterion,
    name: &str,
    robot: &Robot,
    postures: usize,
    cycles: usize,
    sensors: usize,
) {
    let (campaign, start) = campaign(robot, postures, cycles, sensors);
    let mut unknowns = geometric_unknowns(&campaign, &[], &[], &[]);
    unknowns.extend((0..sensors).map(Unknown::Growth));
    criterion.bench_function(name, |bencher| {
        bencher.iter_batched(
            || (unknowns.clone(), start.clone()),
            |(unknowns, start)| {
                let found = identify(black_box(&campaign), unknowns, start, &Manner::default());
                assert!(found.solution.stop.converged());
                found
            },
            BatchSize::SmallInput,
        );
    });
}

fn kinematics(criterion: &mut Criterion, robot: &Robot) {
    let chain = robot.chain();
    let prepared = chain.prepare(&robot.nominal());
    let joints = [0.3, -0.4, 0.5, 0.6, -0.7, 0.8];
    let mut parameters = vec![Twist::default(); chain.parameters().len()];
    let mut by_joint = vec![Twist::default(); chain.joint_count()];
    criterion.bench_function("flange from joint positions", |bencher| {
        bencher.iter(|| prepared.flange(&Posture::new(black_box(&joints))));
    });
    criterion.bench_function("flange with 30 parameter and 6 joint derivatives", |bencher| {
        bencher.iter(|| prepared.twists(&Posture::new(black_box(&joints)), &mut parameters, &mut by_joint));
    });
}

/// Writes the thesis-size problem for another solver: joints and measured positions, one row a point.
fn export(robot: &Robot, folder: &std::path::Path) -> std::io::Result<()> {
    let (campaign, _) = campaign(robot, 15, 1, 0);
    let mut text = String::from("q1,q2,q3,q4,q5,q6,target_x,target_y,target_z,x,y,z\n");
    for visit in &campaign.visits {
        for position in &visit.positions {
            let target = robot.targets[position.target].position.unwrap_or_default();
            let numbers: Vec<String> = visit
                .posture
                .joints()
                .iter()
                .map(|joint| joint.value)
                .chain(target.iter().copied())
                .chain(position.at.iter().copied())
                .map(|value| value.to_string())
                .collect();
            text.push_str(&numbers.join(","));
            text.push('\n');
        }
    }
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("thesis_size.csv"), text)
}

fn main() {
    let Some(robot) = shipped("comau-nj-130-2.0") else { return };
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(at) = arguments.iter().position(|argument| argument == "--export") {
        let folder = arguments.get(at + 1).map_or(".", String::as_str);
        if let Err(error) = export(&robot, std::path::Path::new(folder)) {
            eprintln!("{folder}: {error}");
            std::process::exit(1);
        }
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    kinematics(&mut criterion, &robot);
    identification(&mut criterion, "15 poses, 4 targets, 30 parameters", &robot, 15, 1, 0);
    identification(&mut criterion, "1,440 points, 30 parameters, 20 thermal coefficients", &robot, 15, 24, 20);
    let mut long = criterion.sample_size(10);
    identification(&mut long, "a million points, 30 parameters", &robot, 250_000, 1, 0);
    long.final_summary();
}
