//! How long a corrected forward and inverse solution take, beside the same computations in the crate `k`.
//! `cargo bench -p thermokin --bench compensate`.
//!
//! Both have the same arm, goals and seeds. `k` has no effects and no temperatures and stops at a tolerance of its own; it is
//! given one a hundred times as coarse as what thermokin reaches.

use std::hint::black_box;
use std::path::Path;

use criterion::Criterion;
use k::nalgebra as na;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};
use thermokin::compensate::{Arm, Conditions};
use thermokin::model::{CorrectionBounds, Extended, Geometry, Growth, Level, Model, ModelEffect, ReferenceTemperature};
use thermokin::robot::{JointKind, Robot, Symbol, shipped};

/// A number from -1 to 1.
fn unit(random: &mut ChaCha8Rng) -> f64 {
    (random.next_u64() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// The COMAU with errors of up to a millimetre and a milliradian, growth of five parameters and two gears out of round.
fn model(robot: Robot, random: &mut ChaCha8Rng) -> Model {
    let nominal = Geometry::nominal(&robot);
    let parameters = nominal.parameters.iter().map(|value| value + 1e-3 * unit(random)).collect();
    let reference = Geometry { parameters, ..nominal.clone() };
    let growth = ["d1", "a1", "a2", "beta2", "d4"].map(|parameter| Growth {
        parameter: parameter.parse().expect("a parameter"),
        sensor: "L1".to_owned(),
        coefficient: 5e-6,
        sigma: 1e-7,
    });
    let eccentric = |joint| ModelEffect {
        effect: "gear_eccentricity",
        place: serde_json::from_str(&format!("{{\"joint\":{joint}}}")).expect("a place"),
        shape: vec![2.0],
        coefficients: vec![1e-4, 1e-4],
        parameters: Vec::new(),
    };
    Model {
        nominal,
        geometric: reference.clone(),
        growth: growth.to_vec(),
        temperatures: vec![ReferenceTemperature {
            sensor: "L1".to_owned(),
            celsius: 20.0,
            lowest: 20.0,
            highest: 40.0,
        }],
        anchors: Vec::new(),
        estimates: Vec::new(),
        correction_bounds: CorrectionBounds::default(),
        extended: Some(Extended {
            geometry: reference.clone(),
            growth: Vec::new(),
            air_reference_c: None,
            effects: vec![eccentric(2), eccentric(3)],
            noise: None,
        }),
        reference,
        robot,
    }
}

/// The chain of `k` with the same parameters.
fn peer(robot: &Robot, parameters: &[f64]) -> k::SerialChain<f64> {
    let mut robot = robot.clone();
    robot.set_values(parameters);
    let (x, y, z) = (na::Vector3::x_axis(), na::Vector3::y_axis(), na::Vector3::z_axis());
    let turn = |axis: &na::Unit<na::Vector3<f64>>, angle: f64| {
        na::Isometry3::from_parts(na::Translation3::identity(), na::UnitQuaternion::from_axis_angle(axis, angle))
    };
    let mut before = na::Isometry3::identity();
    let mut parent: Option<k::Node<f64>> = None;
    let mut last = None;
    for (number, transform) in robot.transforms.iter().enumerate() {
        let of = |symbol| transform.value(symbol);
        let first = na::Isometry3::translation(0.0, 0.0, of(Symbol::D)) * turn(&z, of(Symbol::Theta));
        let second = na::Isometry3::translation(of(Symbol::A), 0.0, 0.0)
            * turn(&x, of(Symbol::Alpha))
            * na::Isometry3::translation(0.0, of(Symbol::B), 0.0)
            * turn(&y, of(Symbol::Beta));
        match transform.joint.as_ref() {
            None => before = before * first * second,
            Some(joint) => {
                assert_eq!(joint.kind, JointKind::Revolute);
                let node: k::Node<f64> = k::NodeBuilder::new()
                    .name(&format!("joint{number}"))
                    .joint_type(k::JointType::Rotational { axis: z })
                    .origin(before * first)
                    .finalize()
                    .into();
                if let Some(parent) = &parent {
                    node.set_parent(parent);
                }
                before = second;
                parent = Some(node.clone());
                last = Some(node);
            }
        }
    }
    let flange: k::Node<f64> =
        k::NodeBuilder::new().name("flange").joint_type(k::JointType::Fixed).origin(before).finalize().into();
    flange.set_parent(&last.expect("an arm has joints"));
    k::SerialChain::from_end(&flange)
}

fn main() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let model = model(shipped("comau-nj-130-2.0").expect("shipped"), &mut random);
    // Through its file, as a controller gets it.
    let model = Model::parse(Path::new("model.json"), &model.to_json()).expect("its own text");
    let conditions = Conditions { celsius: vec![Some(33.0)], ..Conditions::default() };
    let postures: Vec<Vec<f64>> = (0..64)
        .map(|_| [0.0, 0.3, -0.4, 0.0, 0.9, 0.0].map(|middle| middle + 0.5 * unit(&mut random)).to_vec())
        .collect();
    let seeds: Vec<Vec<f64>> =
        postures.iter().map(|joints| joints.iter().map(|joint| joint + 3e-3 * unit(&mut random)).collect()).collect();
    let mut criterion = Criterion::default().configure_from_args();
    let mut turn = 0;
    let mut next = move || {
        turn = (turn + 1) % 64;
        turn
    };
    for (name, level) in
        [("geometry and temperatures", Level::Thermal), ("with two effects of joints", Level::Extended)]
    {
        let mut arm = Arm::new(&model, level).under(&conditions);
        let goals: Vec<_> = postures.iter().map(|joints| arm.forward(joints)).collect();
        for (goal, seed) in goals.iter().zip(&seeds) {
            arm.inverse_near(goal, seed).expect("reachable");
        }
        criterion.bench_function(&format!("forward: {name}"), |bench| {
            bench.iter(|| black_box(arm.forward(black_box(&postures[next()]))));
        });
        criterion.bench_function(&format!("inverse from the joints of the nominal arm: {name}"), |bench| {
            bench.iter(|| {
                let place = next();
                black_box(arm.inverse_near(black_box(&goals[place]), black_box(&seeds[place])).expect("reachable"))
            });
        });
    }
    let chain = peer(&model.robot, &Arm::new(&model, Level::Thermal).parameters(&conditions));
    let mut arm = Arm::new(&model, Level::Thermal).under(&conditions);
    let goals: Vec<na::Isometry3<f64>> = postures
        .iter()
        .map(|joints| {
            chain.set_joint_positions(joints).expect("six joints");
            chain.update_transforms();
            let place = chain.end_transform();
            let own = arm.forward(joints).origin;
            let apart = (place.translation.vector - na::Vector3::new(own.x, own.y, own.z)).norm();
            assert!(apart < 1e-12, "the peer has another arm: {apart} m");
            place
        })
        .collect();
    criterion.bench_function("forward: the crate k", |bench| {
        bench.iter(|| {
            chain.set_joint_positions(black_box(&postures[next()])).expect("six joints");
            chain.update_transforms();
            black_box(chain.end_transform())
        });
    });
    use k::InverseKinematicsSolver as _;
    let solver = k::JacobianIkSolver::new(1e-9, 1e-9, 1.0, 100);
    criterion.bench_function("inverse from the joints of the nominal arm: the crate k", |bench| {
        bench.iter(|| {
            let place = next();
            chain.set_joint_positions(&seeds[place]).expect("six joints");
            chain.update_transforms();
            solver.solve(&chain, black_box(&goals[place])).expect("reachable");
            black_box(chain.joint_positions())
        });
    });
    criterion.final_summary();
}
