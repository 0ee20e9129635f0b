//! Kinematics of a serial chain: the flange's frame, and the twists that parameters and joints give it.
//!
//! The product of elementary motions is built from the flange back to the world. Just before an elementary motion is
//! multiplied on, the accumulated frame is that of the flange seen from the motion's own axis; the row of that axis
//! therefore *is* the differential rotation of thesis section 6.2 (eqs. 6.36 to 6.42), already in the flange frame. One
//! pass gives the flange and all derivatives.

use nalgebra::{Matrix3, Vector3};

use super::convention::Symbol;
use super::description::{JointKind, Robot};
use super::frame::Frame;
use super::parameter::ParameterId;

/// A differential rigid motion of the flange, in the flange frame: a point at `p` moves by `angular × p + linear`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Twist {
    /// Rotation, radians per unit of the parameter.
    pub angular: [f64; 3],
    /// Motion of the flange's origin, metres per unit of the parameter.
    pub linear: [f64; 3],
}

impl Twist {
    /// The motion of the point at `p` of the flange frame, in that frame.
    #[inline]
    pub fn at(&self, p: &[f64; 3]) -> [f64; 3] {
        let [wx, wy, wz] = self.angular;
        let [vx, vy, vz] = self.linear;
        [vx + wy * p[2] - wz * p[1], vy + wz * p[0] - wx * p[2], vz + wx * p[1] - wy * p[0]]
    }
}

/// The position of one joint with its sine and cosine, which stay while parameters change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointState {
    /// Radians or metres.
    pub value: f64,
    /// Sine of the value (unused for prismatic joints).
    pub sin: f64,
    /// Cosine of the value (unused for prismatic joints).
    pub cos: f64,
}

/// The positions of all joints, in the order of the chain.
#[derive(Debug, Clone, PartialEq)]
pub struct Posture(Vec<JointState>);

impl Posture {
    /// A posture from joint positions, radians or metres.
    pub fn new(joints: &[f64]) -> Self {
        Self(joints.iter().map(|&value| JointState { value, sin: libm::sin(value), cos: libm::cos(value) }).collect())
    }

    /// Moves to other joint positions, as many as it has, without another allocation.
    pub fn set(&mut self, joints: &[f64]) {
        for (state, &value) in self.0.iter_mut().zip(joints) {
            let (sin, cos) = libm::sincos(value);
            *state = JointState { value, sin, cos };
        }
    }

    /// The joint states in the order of the chain.
    pub fn joints(&self) -> &[JointState] {
        &self.0
    }

    /// The joint positions, radians or metres.
    pub fn positions(&self) -> Vec<f64> {
        self.0.iter().map(|joint| joint.value).collect()
    }
}

/// Where a joint acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Motion {
    Fixed,
    /// The joint's place in the joint vector.
    Revolute(usize),
    Prismatic(usize),
}

/// The structure of a chain: which transforms, which joints, which parameters. Values are given to [`Chain::prepare`].
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    motions: Vec<Motion>,
    joint_count: usize,
    parameters: Vec<ParameterId>,
    /// For each transform and symbol the parameter's place in the parameter vector.
    places: Vec<[Option<usize>; 6]>,
}

/// The six elementary motions of one transform with given values.
#[derive(Debug, Clone, Copy)]
struct Elementary {
    motion: Motion,
    d: f64,
    a: f64,
    b: f64,
    theta: (f64, f64),
    alpha: (f64, f64),
    beta: (f64, f64),
    /// Whether the rotation by beta or translation by b can be other than zero: a `dh` transform has neither.
    has_second_axis: bool,
}

/// A chain with values for its parameters, ready to be evaluated at many postures.
#[derive(Debug, Clone)]
pub struct Prepared {
    elementary: Vec<Elementary>,
    /// For each twist that is asked for: transform and symbol.
    wanted: Vec<[Option<usize>; 6]>,
    joint_count: usize,
}

impl Chain {
    /// The chain of a robot's description.
    pub fn new(robot: &Robot) -> Self {
        let mut joint_count = 0;
        let mut parameters = Vec::new();
        let mut motions = Vec::new();
        let mut places = Vec::new();
        for (number, transform) in robot.transforms.iter().enumerate() {
            let motion = match transform.joint.as_ref().map(|joint| joint.kind) {
                None => Motion::Fixed,
                Some(JointKind::Revolute) => Motion::Revolute(joint_count),
                Some(JointKind::Prismatic) => Motion::Prismatic(joint_count),
            };
            joint_count += usize::from(transform.joint.is_some());
            motions.push(motion);
            let mut place = [None; 6];
            for &symbol in transform.convention.symbols() {
                place[symbol as usize] = Some(parameters.len());
                parameters.push(ParameterId::new(symbol, number));
            }
            places.push(place);
        }
        Self { motions, joint_count, parameters, places }
    }

    /// The chain's parameters in the order of parameter vectors.
    pub fn parameters(&self) -> &[ParameterId] {
        &self.parameters
    }

    /// The place of a parameter in parameter vectors.
    pub fn place(&self, id: ParameterId) -> Option<usize> {
        self.places.get(id.transform).and_then(|places| places[id.symbol as usize])
    }

    /// The number of joints.
    pub fn joint_count(&self) -> usize {
        self.joint_count
    }

    /// The number of transforms, world to base included.
    pub fn transform_count(&self) -> usize {
        self.motions.len()
    }

    /// The transform that joint `joint` (from 0) moves.
    pub fn transform_of_joint(&self, joint: usize) -> Option<usize> {
        self.motions.iter().position(|motion| match motion {
            Motion::Fixed => false,
            Motion::Revolute(place) | Motion::Prismatic(place) => *place == joint,
        })
    }

    /// Whether joint `joint` (from 0) turns rather than slides.
    pub fn is_revolute(&self, joint: usize) -> bool {
        self.motions.contains(&Motion::Revolute(joint))
    }

    /// The chain with `values` for its parameters (in the order of [`Chain::parameters`]).
    ///
    /// # Panics
    /// When `values` has another length than [`Chain::parameters`].
    pub fn prepare(&self, values: &[f64]) -> Prepared {
        assert_eq!(values.len(), self.parameters.len(), "one value a parameter");
        let elementary = self
            .motions
            .iter()
            .zip(&self.places)
            .map(|(&motion, places)| {
                let value = |symbol: Symbol| places[symbol as usize].map_or(0.0, |place| values[place]);
                Elementary {
                    motion,
                    d: value(Symbol::D),
                    a: value(Symbol::A),
                    b: value(Symbol::B),
                    theta: libm::sincos(value(Symbol::Theta)),
                    alpha: libm::sincos(value(Symbol::Alpha)),
                    beta: libm::sincos(value(Symbol::Beta)),
                    has_second_axis: places[Symbol::B as usize].is_some() || places[Symbol::Beta as usize].is_some(),
                }
            })
            .collect();
        Prepared { elementary, wanted: self.places.clone(), joint_count: self.joint_count }
    }
}

/// The flange seen from an axis of the chain, as rows of its rotation, grown from the flange back to the world.
#[derive(Clone, Copy)]
struct Accumulated {
    x: [f64; 3],
    y: [f64; 3],
    z: [f64; 3],
    origin: [f64; 3],
}

impl Accumulated {
    const IDENTITY: Self = Self { x: [1.0, 0.0, 0.0], y: [0.0, 1.0, 0.0], z: [0.0, 0.0, 1.0], origin: [0.0; 3] };

    /// A rotation that takes `u` to `cos u - sin w` and `w` to `sin u + cos w` (the two rows that it mixes).
    #[inline(always)]
    fn mix(u: &mut [f64; 3], w: &mut [f64; 3], pu: usize, pw: usize, origin: &mut [f64; 3], (sin, cos): (f64, f64)) {
        for k in 0..3 {
            let (first, second) = (u[k], w[k]);
            u[k] = cos * first - sin * second;
            w[k] = sin * first + cos * second;
        }
        let (first, second) = (origin[pu], origin[pw]);
        origin[pu] = cos * first - sin * second;
        origin[pw] = sin * first + cos * second;
    }

    #[inline(always)]
    fn rotate_x(&mut self, angle: (f64, f64)) {
        Self::mix(&mut self.y, &mut self.z, 1, 2, &mut self.origin, angle);
    }

    #[inline(always)]
    fn rotate_y(&mut self, angle: (f64, f64)) {
        Self::mix(&mut self.z, &mut self.x, 2, 0, &mut self.origin, angle);
    }

    #[inline(always)]
    fn rotate_z(&mut self, angle: (f64, f64)) {
        Self::mix(&mut self.x, &mut self.y, 0, 1, &mut self.origin, angle);
    }

    /// The twist of a rotation about the axis `N` (0 x, 1 y, 2 z) that the flange is now seen from: the axis is a row of
    /// the rotation, and the flange's origin moves by `axis × origin`.
    #[inline(always)]
    fn rotation<const N: usize>(&self) -> Twist {
        let rows = [&self.x, &self.y, &self.z];
        // axis × origin has two components, along the two other axes.
        let (first, second) = ((N + 1) % 3, (N + 2) % 3);
        let (along_first, along_second) = (-self.origin[second], self.origin[first]);
        let mut linear = [0.0; 3];
        for (k, value) in linear.iter_mut().enumerate() {
            *value = along_first * rows[first][k] + along_second * rows[second][k];
        }
        Twist { angular: *rows[N], linear }
    }

    #[inline(always)]
    fn translation<const N: usize>(&self) -> Twist {
        Twist { angular: [0.0; 3], linear: *[&self.x, &self.y, &self.z][N] }
    }

    fn frame(&self) -> Frame {
        Frame {
            rotation: Matrix3::from_rows(&[
                Vector3::from(self.x).transpose(),
                Vector3::from(self.y).transpose(),
                Vector3::from(self.z).transpose(),
            ]),
            origin: Vector3::from(self.origin),
        }
    }
}

impl Elementary {
    /// The angle about z as sine and cosine and the shift along z at a posture.
    #[inline(always)]
    fn about_z(&self, posture: &Posture) -> ((f64, f64), f64) {
        match self.motion {
            Motion::Fixed => (self.theta, self.d),
            Motion::Revolute(joint) => {
                let JointState { sin, cos, .. } = posture.0[joint];
                let (s, c) = self.theta;
                ((s * cos + c * sin, c * cos - s * sin), self.d)
            }
            Motion::Prismatic(joint) => (self.theta, self.d + posture.0[joint].value),
        }
    }
}

impl Prepared {
    /// The flange in the world frame.
    ///
    /// # Panics
    /// When the posture has fewer joints than the chain.
    pub fn flange(&self, posture: &Posture) -> Frame {
        let mut seen = Accumulated::IDENTITY;
        for part in self.elementary.iter().rev() {
            if part.has_second_axis {
                seen.rotate_y(part.beta);
                seen.origin[1] += part.b;
            }
            seen.rotate_x(part.alpha);
            seen.origin[0] += part.a;
            let (angle, shift) = part.about_z(posture);
            seen.rotate_z(angle);
            seen.origin[2] += shift;
        }
        seen.frame()
    }

    /// The flange in the world frame, the twist of each parameter (`parameters`, in the order of the parameter vector)
    /// and of each joint (`joints`), all in the flange frame and per unit of the parameter or joint.
    ///
    /// # Panics
    /// When a slice or the posture is shorter than the chain asks for.
    #[inline]
    pub fn twists(&self, posture: &Posture, parameters: &mut [Twist], joints: &mut [Twist]) -> Frame {
        let mut seen = Accumulated::IDENTITY;
        for (part, wanted) in self.elementary.iter().zip(&self.wanted).rev() {
            if part.has_second_axis {
                seen.rotate_y(part.beta);
                if let Some(place) = wanted[Symbol::Beta as usize] {
                    parameters[place] = seen.rotation::<1>();
                }
                seen.origin[1] += part.b;
                if let Some(place) = wanted[Symbol::B as usize] {
                    parameters[place] = seen.translation::<1>();
                }
            }
            seen.rotate_x(part.alpha);
            if let Some(place) = wanted[Symbol::Alpha as usize] {
                parameters[place] = seen.rotation::<0>();
            }
            seen.origin[0] += part.a;
            if let Some(place) = wanted[Symbol::A as usize] {
                parameters[place] = seen.translation::<0>();
            }
            let (angle, shift) = part.about_z(posture);
            seen.rotate_z(angle);
            let about = seen.rotation::<2>();
            if let Some(place) = wanted[Symbol::Theta as usize] {
                parameters[place] = about;
            }
            seen.origin[2] += shift;
            let along = seen.translation::<2>();
            if let Some(place) = wanted[Symbol::D as usize] {
                parameters[place] = along;
            }
            match part.motion {
                Motion::Fixed => {}
                Motion::Revolute(joint) => joints[joint] = about,
                Motion::Prismatic(joint) => joints[joint] = along,
            }
        }
        seen.frame()
    }

    /// The frames after each transform, seen from the world, the flange last.
    pub fn frames(&self, posture: &Posture) -> Vec<Frame> {
        let mut outer = Frame::identity();
        self.elementary
            .iter()
            .map(|part| {
                let mut seen = Accumulated::IDENTITY;
                seen.rotate_y(part.beta);
                seen.origin[1] += part.b;
                seen.rotate_x(part.alpha);
                seen.origin[0] += part.a;
                let (angle, shift) = part.about_z(posture);
                seen.rotate_z(angle);
                seen.origin[2] += shift;
                outer = outer.then(&seen.frame());
                outer
            })
            .collect()
    }

    /// The number of joints.
    pub fn joint_count(&self) -> usize {
        self.joint_count
    }
}
