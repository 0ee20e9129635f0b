//! The kinematics of `host::robot` against implementations that share nothing with it: products of elementary matrices
//! over dual numbers (automatic differentiation), and the closed forms of the thesis (sections 4.2.2 and 6.2).
//!
//! # Tolerances
//! With the unit roundoff `u = eps / 2`, an elementary motion takes a coordinate to at most two products and a sum of
//! coordinates bounded by the scale `L` (all lengths of the chain and of the point, plus 1 for the axes), with a sine and
//! a cosine that err by less than an ulp: `(2 + 2 + 1) u √2 L < 4 eps L` of error. A dual number carries that error once
//! in its value and once in its derivative. So values of two implementations differ by less than `8 eps L` a motion and
//! derivatives by less than `12 eps L`. A transform counts seven motions: six, and the sum of `theta` and `q`.

use nalgebra::Vector3;
use num_dual::{Dual64, DualNum};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};
use thermokin::robot::{
    Body, Convention, Frame, Joint, JointKind, ParameterId, Payload, Posture, Robot, SHIPPED, Symbol, Target,
    Transform, Twist, gravity_torques, shipped,
};

const VALUE_EPS: f64 = 8.0;
const DERIVATIVE_EPS: f64 = 12.0;
const MOTIONS: f64 = 7.0;

/// Homogeneous matrices over any kind of number: the independent implementation.
type Homogeneous<D> = [[D; 4]; 4];

fn identity<D: DualNum<Primitive = f64> + Copy>() -> Homogeneous<D> {
    std::array::from_fn(|row| std::array::from_fn(|column| D::from(if row == column { 1.0 } else { 0.0 })))
}

fn product<D: DualNum<Primitive = f64> + Copy>(left: &Homogeneous<D>, right: &Homogeneous<D>) -> Homogeneous<D> {
    std::array::from_fn(|row| {
        std::array::from_fn(|column| (0..4).fold(D::from(0.0), |sum, k| sum + left[row][k] * right[k][column]))
    })
}

fn translation<D: DualNum<Primitive = f64> + Copy>(axis: usize, by: D) -> Homogeneous<D> {
    let mut matrix = identity();
    matrix[axis][3] = by;
    matrix
}

fn rotation<D: DualNum<Primitive = f64> + Copy>(axis: usize, by: D) -> Homogeneous<D> {
    let (first, second) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut matrix = identity();
    matrix[first][first] = by.cos();
    matrix[first][second] = -by.sin();
    matrix[second][first] = by.sin();
    matrix[second][second] = by.cos();
    matrix
}

/// The table of the contract's robot.md, `values` in its order.
fn contract_transform<D: DualNum<Primitive = f64> + Copy>(
    convention: Convention,
    values: &[D],
    joint: Option<(JointKind, D)>,
) -> Homogeneous<D> {
    let (turn, slide) = match joint {
        Some((JointKind::Revolute, q)) => (q, D::from(0.0)),
        Some((JointKind::Prismatic, q)) => (D::from(0.0), q),
        None => (D::from(0.0), D::from(0.0)),
    };
    let factors = match convention {
        Convention::Dh => vec![
            translation(2, values[0] + slide),
            rotation(2, values[1] + turn),
            translation(0, values[2]),
            rotation(0, values[3]),
        ],
        Convention::Hayati => vec![
            translation(2, slide),
            rotation(2, values[0] + turn),
            translation(0, values[1]),
            rotation(0, values[2]),
            rotation(1, values[3]),
        ],
        Convention::Full => vec![
            translation(2, values[0] + slide),
            rotation(2, values[1] + turn),
            translation(0, values[2]),
            rotation(0, values[3]),
            translation(1, values[4]),
            rotation(1, values[5]),
        ],
    };
    factors.iter().fold(identity(), |left, right| product(&left, right))
}

/// The frames after each transform for parameters and joints given as any kind of number.
fn contract_frames<D: DualNum<Primitive = f64> + Copy>(
    robot: &Robot,
    values: &[D],
    joints: &[D],
) -> Vec<Homogeneous<D>> {
    let (mut values, mut joints) = (values, joints.iter());
    let mut outer = identity();
    robot
        .transforms
        .iter()
        .map(|transform| {
            let (own, rest) = values.split_at(transform.convention.symbols().len());
            values = rest;
            let joint = transform.joint.as_ref().map(|joint| (joint.kind, *joints.next().expect("a joint value")));
            outer = product(&outer, &contract_transform(transform.convention, own, joint));
            outer
        })
        .collect()
}

fn contract_point<D: DualNum<Primitive = f64> + Copy>(frame: &Homogeneous<D>, local: &Vector3<f64>) -> [D; 3] {
    std::array::from_fn(|row| {
        frame[row][0] * local.x + frame[row][1] * local.y + frame[row][2] * local.z + frame[row][3]
    })
}

/// Random numbers for one test, their seed printed so that a failure can be repeated: `THERMOKIN_TEST_SEED`.
struct Dice(ChaCha8Rng);

impl Dice {
    fn new(test: &str) -> Self {
        let seed: u64 = std::env::var("THERMOKIN_TEST_SEED").ok().and_then(|text| text.parse().ok()).unwrap_or(20_140);
        println!("{test}: THERMOKIN_TEST_SEED={seed}");
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    fn whole(&mut self, low: u32, high: u32) -> u32 {
        low + self.0.next_u32() % (high - low + 1)
    }

    fn real(&mut self, reach: f64) -> f64 {
        reach * (f64::from(self.0.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0)
    }

    fn vector(&mut self, reach: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.real(reach))
    }

    /// A chain of 1 to 9 joints of both kinds, all conventions, with fixed transforms between them, targets and bodies.
    fn robot(&mut self) -> Robot {
        let joints = self.whole(1, 9);
        let mut kinds = vec![None];
        for _ in 0..joints {
            while self.whole(0, 4) == 0 {
                kinds.push(None);
            }
            kinds.push(Some(if self.whole(0, 2) == 0 { JointKind::Prismatic } else { JointKind::Revolute }));
        }
        let transforms: Vec<Transform> = kinds
            .into_iter()
            .map(|kind| {
                let convention = [Convention::Dh, Convention::Hayati, Convention::Full][self.whole(0, 2) as usize];
                let values = convention
                    .symbols()
                    .iter()
                    .map(|symbol| self.real(if symbol.is_angle() { std::f64::consts::PI } else { 2.0 }))
                    .collect();
                let joint = kind.map(|kind| Joint { kind, min: None, max: None, gear_ratio: None });
                Transform { convention, joint, values }
            })
            .collect();
        let last = transforms.len() as u32 - 1;
        let targets = (0..3).map(|k| Target { name: format!("T{k}"), position: Some(self.vector(0.3)) }).collect();
        let bodies = (0..4)
            .map(|_| Body {
                transform: self.whole(0, last) as usize,
                mass_kg: 100.0 + self.real(100.0),
                center: self.vector(0.5),
            })
            .collect();
        Robot {
            name: "random".to_owned(),
            gravity: self.vector(10.0),
            transforms,
            targets,
            monuments: Vec::new(),
            bodies,
            sensors: Vec::new(),
            thermal: Vec::new(),
        }
    }

    fn joints(&mut self, robot: &Robot) -> Vec<f64> {
        (0..robot.joint_count()).map(|_| self.real(std::f64::consts::PI)).collect()
    }
}

/// `L` of the tolerances: every length that a coordinate may hold, joints included, plus 1 for the axes.
fn scale(robot: &Robot, joints: &[f64], point: &Vector3<f64>) -> f64 {
    let lengths: f64 = robot
        .transforms
        .iter()
        .flat_map(|transform| transform.convention.symbols().iter().zip(&transform.values))
        .filter(|(symbol, _)| !symbol.is_angle())
        .map(|(_, value)| value.abs())
        .sum();
    1.0 + lengths + joints.iter().map(|q| q.abs()).sum::<f64>() + point.iter().map(|x| x.abs()).sum::<f64>()
}

fn bound(eps_a_motion: f64, robot: &Robot, joints: &[f64], point: &Vector3<f64>) -> f64 {
    eps_a_motion * MOTIONS * robot.transforms.len() as f64 * f64::EPSILON * scale(robot, joints, point)
}

fn assert_frame(found: &Frame, expected: &Homogeneous<f64>, tolerance: f64, what: &str) {
    for (row, expected) in expected.iter().take(3).enumerate() {
        for (column, expected) in expected.iter().take(3).enumerate() {
            let difference = (found.rotation[(row, column)] - expected).abs();
            assert!(difference <= tolerance, "{what}: rotation ({row}, {column}) differs by {difference:e}");
        }
        let difference = (found.origin[row] - expected[3]).abs();
        assert!(difference <= tolerance, "{what}: origin {row} differs by {difference:e} > {tolerance:e}");
    }
}

/// The motion in the world of a target for a twist of the flange.
fn world_motion(flange: &Frame, twist: &Twist, target: &Vector3<f64>) -> Vector3<f64> {
    flange.rotation * Vector3::from(twist.at(&(*target).into()))
}

fn check_twists(robot: &Robot, joints: &[f64]) {
    let nominal = robot.nominal();
    let chain = robot.chain();
    let prepared = chain.prepare(&nominal);
    let posture = Posture::new(joints);
    let mut parameter_twists = vec![Twist::default(); nominal.len()];
    let mut joint_twists = vec![Twist::default(); joints.len()];
    let flange = prepared.twists(&posture, &mut parameter_twists, &mut joint_twists);

    let expected = contract_frames(robot, &nominal, joints);
    let tolerance = bound(VALUE_EPS, robot, joints, &Vector3::zeros());
    assert_frame(&flange, expected.last().expect("a transform"), tolerance, "flange of twists()");
    assert_frame(&prepared.flange(&posture), expected.last().expect("a transform"), tolerance, "flange()");
    let frames = prepared.frames(&posture);
    assert_eq!(frames.len(), expected.len());
    for (number, (found, expected)) in frames.iter().zip(&expected).enumerate() {
        assert_frame(found, expected, tolerance, &format!("frame {number}"));
    }

    let constant = |values: &[f64]| values.iter().map(|&value| Dual64::from_re(value)).collect::<Vec<_>>();
    let (mut dual_values, mut dual_joints) = (constant(&nominal), constant(joints));
    let compare = |dual_values: &[Dual64], dual_joints: &[Dual64], twist: &Twist, what: &str| {
        let frames = contract_frames(robot, dual_values, dual_joints);
        for target in robot.targets.iter().filter_map(|target| target.position) {
            let tolerance = bound(DERIVATIVE_EPS, robot, joints, &target);
            let expected = contract_point(frames.last().expect("a transform"), &target);
            let found = world_motion(&flange, twist, &target);
            for row in 0..3 {
                let difference = (found[row] - expected[row].eps).abs();
                assert!(difference <= tolerance, "{what}, row {row}: {difference:e} > {tolerance:e}");
            }
        }
    };
    for (place, id) in chain.parameters().iter().enumerate() {
        assert_eq!(chain.place(*id), Some(place));
        dual_values[place].eps = 1.0;
        compare(&dual_values, &dual_joints, &parameter_twists[place], &id.to_string());
        dual_values[place].eps = 0.0;
    }
    for joint in 0..joints.len() {
        dual_joints[joint].eps = 1.0;
        compare(&dual_values, &dual_joints, &joint_twists[joint], &format!("joint {}", joint + 1));
        dual_joints[joint].eps = 0.0;
    }
}

#[test]
fn twists_equal_automatic_differentiation_on_random_chains() {
    let mut dice = Dice::new("twists_equal_automatic_differentiation_on_random_chains");
    let mut seen = [0; 10];
    for _ in 0..400 {
        let robot = dice.robot();
        let joints = dice.joints(&robot);
        seen[robot.joint_count()] += 1;
        check_twists(&robot, &joints);
    }
    assert!(seen[1..].iter().all(|&count| count > 0), "every count of joints was drawn: {seen:?}");
}

#[test]
fn twists_equal_automatic_differentiation_on_shipped_robots() {
    let mut dice = Dice::new("twists_equal_automatic_differentiation_on_shipped_robots");
    for (name, _) in SHIPPED {
        let mut robot = shipped(name).expect("a shipped robot");
        for target in &mut robot.targets {
            target.position.get_or_insert(Vector3::new(0.05, -0.03, 0.12));
        }
        for _ in 0..20 {
            let joints = dice.joints(&robot);
            check_twists(&robot, &joints);
        }
    }
}

#[test]
fn gravity_torques_equal_the_derivative_of_potential_energy() {
    let mut dice = Dice::new("gravity_torques_equal_the_derivative_of_potential_energy");
    for round in 0..200 {
        let robot = dice.robot();
        let joints = dice.joints(&robot);
        let nominal = robot.nominal();
        let payload = (round % 2 == 0).then(|| Payload { mass_kg: 130.0, center: dice.vector(0.3) });
        let prepared = robot.chain().prepare(&nominal);
        let found = gravity_torques(&robot, &prepared, &Posture::new(&joints), payload);

        let values: Vec<Dual64> = nominal.iter().map(|&value| Dual64::from_re(value)).collect();
        let last = robot.transforms.len() - 1;
        let masses: Vec<(usize, f64, Vector3<f64>)> = robot
            .bodies
            .iter()
            .map(|body| (body.transform, body.mass_kg, body.center))
            .chain(payload.map(|load| (last, load.mass_kg, load.center)))
            .collect();
        // Three coordinates of each weight, and the lever of each found from two frames instead of one.
        let weight: f64 = masses.iter().map(|(_, mass, _)| mass * robot.gravity.abs().sum()).sum();
        let tolerance = 2.0 * weight * bound(DERIVATIVE_EPS, &robot, &joints, &Vector3::repeat(0.5));
        for joint in 0..joints.len() {
            let mut moved: Vec<Dual64> = joints.iter().map(|&q| Dual64::from_re(q)).collect();
            moved[joint].eps = 1.0;
            let frames = contract_frames(&robot, &values, &moved);
            let potential = masses.iter().fold(Dual64::from_re(0.0), |sum, (transform, mass, center)| {
                let place = contract_point(&frames[*transform], center);
                (0..3).fold(sum, |sum, row| sum - place[row] * (robot.gravity[row] * mass))
            });
            let difference = (found[joint] + potential.eps).abs();
            assert!(difference <= tolerance, "joint {}: {difference:e} > {tolerance:e}", joint + 1);
        }
    }
}

/// A chain whose only transform beside an identity base is the one in question, turned by one joint.
fn single(convention: Convention, values: &[f64]) -> Robot {
    let base = Transform { convention: Convention::Hayati, joint: None, values: vec![0.0; 4] };
    let joint = Some(Joint { kind: JointKind::Revolute, min: None, max: None, gear_ratio: None });
    Robot {
        name: "single".to_owned(),
        gravity: Vector3::zeros(),
        transforms: vec![base, Transform { convention, joint, values: values.to_vec() }],
        targets: Vec::new(),
        monuments: Vec::new(),
        bodies: Vec::new(),
        sensors: Vec::new(),
        thermal: Vec::new(),
    }
}

/// The six parameters of one transform, in the thesis's letters.
#[derive(Clone, Copy, Default)]
struct Letters {
    d: f64,
    theta: f64,
    a: f64,
    alpha: f64,
    b: f64,
    beta: f64,
}

impl Letters {
    fn draw(dice: &mut Dice) -> Self {
        let mut angle = || dice.real(std::f64::consts::PI);
        let (theta, alpha, beta) = (angle(), angle(), angle());
        Self { d: dice.real(2.0), theta, a: dice.real(2.0), alpha, b: dice.real(2.0), beta }
    }

    fn values(&self, convention: Convention) -> Vec<f64> {
        let Self { d, theta, a, alpha, b, beta } = *self;
        match convention {
            Convention::Dh => vec![d, theta, a, alpha],
            Convention::Hayati => vec![theta, a, alpha, beta],
            Convention::Full => vec![d, theta, a, alpha, b, beta],
        }
    }

    /// Eq. 6.37 (Veitschegger-Wu) with the end frame's translation along y of section 4.2.3. Denavit-Hartenberg and
    /// Hayati-Mirmirani of section 4.2.2 are its cases of zero beta, b and of zero d, b.
    fn closed_form(&self) -> Homogeneous<f64> {
        let Self { d, theta, a, alpha, b, beta } = *self;
        let ((st, ct), (sa, ca), (sb, cb)) = (theta.sin_cos(), alpha.sin_cos(), beta.sin_cos());
        [
            [ct * cb - st * sa * sb, -st * ca, ct * sb + st * sa * cb, a * ct - b * st * ca],
            [st * cb + ct * sa * sb, ct * ca, st * sb - ct * sa * cb, a * st + b * ct * ca],
            [-ca * sb, sa, ca * cb, d + b * sa],
            [0.0, 0.0, 0.0, 1.0],
        ]
    }
}

#[test]
fn flanges_equal_the_closed_forms_of_the_thesis() {
    let mut dice = Dice::new("flanges_equal_the_closed_forms_of_the_thesis");
    for _ in 0..200 {
        let all = Letters::draw(&mut dice);
        for (convention, letters) in [
            (Convention::Dh, Letters { b: 0.0, beta: 0.0, ..all }),
            (Convention::Hayati, Letters { d: 0.0, b: 0.0, ..all }),
            (Convention::Full, all),
        ] {
            let robot = single(convention, &letters.values(convention));
            let flange = robot.chain().prepare(&robot.nominal()).flange(&Posture::new(&[0.0]));
            let tolerance = bound(VALUE_EPS, &robot, &[0.0], &Vector3::zeros());
            assert_frame(&flange, &letters.closed_form(), tolerance, convention.name());
        }
    }
}

#[test]
fn twists_equal_the_differential_matrices_of_the_thesis() {
    let mut dice = Dice::new("twists_equal_the_differential_matrices_of_the_thesis");
    for _ in 0..200 {
        let letters = Letters { b: 0.0, ..Letters::draw(&mut dice) };
        let Letters { d, theta, a, alpha, .. } = letters;
        let ((st, ct), (sa, ca)) = (theta.sin_cos(), alpha.sin_cos());
        // The vectors δ and d of eqs. 6.38 to 6.42, in the frame before the transform.
        let expected = [
            (Symbol::D, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
            (Symbol::Theta, [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]),
            (Symbol::A, [0.0, 0.0, 0.0], [ct, st, 0.0]),
            (Symbol::Alpha, [ct, st, 0.0], [-d * st, d * ct, 0.0]),
            (Symbol::Beta, [-st * ca, ct * ca, sa], [a * st * sa - d * ct * ca, -a * ct * sa - d * st * ca, a * ca]),
        ];
        let robot = single(Convention::Full, &letters.values(Convention::Full));
        let chain = robot.chain();
        let mut parameters = vec![Twist::default(); chain.parameters().len()];
        let mut joints = [Twist::default()];
        let flange = chain.prepare(&robot.nominal()).twists(&Posture::new(&[0.0]), &mut parameters, &mut joints);
        let tolerance = bound(DERIVATIVE_EPS, &robot, &[0.0], &Vector3::zeros());
        for (symbol, rotation, translation) in expected {
            let place = chain.place(ParameterId::new(symbol, 1)).expect("a parameter of the transform");
            let twist = parameters[place];
            let angular = flange.rotation * Vector3::from(twist.angular);
            // A point at the outer frame's origin moves by d alone (eq. 6.36).
            let linear = flange.rotation * Vector3::from(twist.linear) - angular.cross(&flange.origin);
            assert!((angular - Vector3::from(rotation)).amax() <= tolerance, "{symbol}: rotation {angular:?}");
            assert!((linear - Vector3::from(translation)).amax() <= 2.0 * tolerance, "{symbol}: {linear:?}");
        }
        assert_eq!(joints[0], parameters[chain.place(ParameterId::new(Symbol::Theta, 1)).expect("theta1")]);
    }
}

#[test]
fn the_nominal_arm_of_table_4_1_stands_upright_at_zero_joints() {
    // By hand from table 4.1: a1 leads forwards; x2, and so a2, points up; x3, and so a3, points backwards; z4 and z6
    // point down, so the negative d4 and d6 lead up.
    let robot = shipped("comau-nj-130-2.0").expect("shipped");
    let frames = robot.chain().prepare(&robot.nominal()).frames(&Posture::new(&[0.0; 6]));
    let tolerance = bound(VALUE_EPS, &robot, &[0.0; 6], &Vector3::zeros());
    for (what, number, height) in
        [("wrist centre", 4, 0.550 + 0.860 + 0.76158), ("flange", 6, 0.550 + 0.860 + 0.76158 + 0.210)]
    {
        // The base's z points down: a laser tracker's frame turned by alpha0 = pi.
        let place = frames[0].local(&frames[number].origin);
        assert!((place.x - (0.400 - 0.210)).abs() <= tolerance, "{what}: {place:?}");
        assert!(place.y.abs() <= tolerance, "{what}: {place:?}");
        assert!((place.z + height).abs() <= tolerance, "{what}: {place:?}");
    }
}

#[test]
fn frames_compose_and_invert() {
    let mut dice = Dice::new("frames_compose_and_invert");
    for _ in 0..100 {
        let robot = dice.robot();
        let joints = dice.joints(&robot);
        let flange = robot.chain().prepare(&robot.nominal()).flange(&Posture::new(&joints));
        let tolerance = bound(VALUE_EPS, &robot, &joints, &Vector3::zeros());
        let back = flange.then(&flange.inverse());
        assert!((back.rotation - nalgebra::Matrix3::identity()).amax() <= tolerance);
        assert!(back.origin.amax() <= 2.0 * tolerance);
        let point = dice.vector(1.0);
        assert!((flange.local(&flange.point(&point)) - point).amax() <= 2.0 * tolerance);
    }
}
