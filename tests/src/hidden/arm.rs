//! An arm of the hidden runs: its chain as plain homogeneous matrices, its masses, targets and sensors, and robot.toml.

use std::fmt::Write as _;

use nalgebra::{Matrix4, Vector3, Vector4};

/// Gravity in the world frame, m/s².
pub const GRAVITY: [f64; 3] = [0.0, 0.0, -9.80665];

/// Which elementary motions a transform is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Convention {
    /// Tz(d) Rz(theta) Tx(a) Rx(alpha).
    Dh,
    /// Rz(theta) Tx(a) Rx(alpha) Ry(beta).
    Hayati,
    /// Tz(d) Rz(theta) Tx(a) Rx(alpha) Ty(b) Ry(beta).
    Full,
}

impl Convention {
    /// The transform's parameters in the order of its product.
    pub fn symbols(self) -> &'static [&'static str] {
        match self {
            Self::Dh => &["d", "theta", "a", "alpha"],
            Self::Hayati => &["theta", "a", "alpha", "beta"],
            Self::Full => &["d", "theta", "a", "alpha", "b", "beta"],
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Dh => "dh",
            Self::Hayati => "hayati",
            Self::Full => "full",
        }
    }
}

/// One transform of the chain; all but the first are moved by a revolute joint.
#[derive(Debug, Clone)]
pub struct Transform {
    /// Its form.
    pub convention: Convention,
    /// Nominal values in the order of [`Convention::symbols`].
    pub nominal: Vec<f64>,
}

/// A mass that moves with a transform.
#[derive(Debug, Clone)]
pub struct Body {
    /// The transform's number.
    pub transform: usize,
    /// Kilograms.
    pub mass_kg: f64,
    /// Its centre in the transform's frame, m.
    pub center: [f64; 3],
}

/// A temperature sensor.
#[derive(Debug, Clone)]
pub struct Sensor {
    /// Its name.
    pub name: String,
    /// The link it is glued to.
    pub link: usize,
    /// Its place among the link's sensors.
    pub address: usize,
    /// How far along the link it sits, 0 to 1.
    pub along: f64,
}

/// A parameter that follows temperatures in robot.toml.
#[derive(Debug, Clone)]
pub struct Thermal {
    /// The parameter's place among all parameters.
    pub parameter: usize,
    /// Places of its sensors.
    pub sensors: Vec<usize>,
}

/// A six-axis arm as robot.toml describes it.
#[derive(Debug, Clone)]
pub struct Arm {
    /// Its name.
    pub name: String,
    /// Base first.
    pub transforms: Vec<Transform>,
    /// Names and places in the flange frame.
    pub targets: Vec<(String, Vector3<f64>)>,
    /// Masses.
    pub bodies: Vec<Body>,
    /// Sensors.
    pub sensors: Vec<Sensor>,
    /// Growth of the baseline.
    pub thermal: Vec<Thermal>,
    /// Bounds within which postures are drawn, a pair a joint.
    pub ranges: Vec<(f64, f64)>,
    /// Root-mean-square joint speeds at full override, rad/s.
    pub speeds: Vec<f64>,
}

/// Where a chain stands: the frames before and after each transform.
pub struct Standing {
    /// `frames[n]` is the product of the transforms before transform n; the last is the flange.
    pub frames: Vec<Matrix4<f64>>,
}

fn shift(axis: usize, by: f64) -> Matrix4<f64> {
    let mut matrix = Matrix4::identity();
    matrix[(axis, 3)] = by;
    matrix
}

fn turn(axis: usize, by: f64) -> Matrix4<f64> {
    let (s, c) = (libm::sin(by), libm::cos(by));
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut matrix = Matrix4::identity();
    matrix[(i, i)] = c;
    matrix[(j, j)] = c;
    matrix[(i, j)] = -s;
    matrix[(j, i)] = s;
    matrix
}

fn elementary(symbol: &str, value: f64) -> Matrix4<f64> {
    match symbol {
        "d" => shift(2, value),
        "theta" => turn(2, value),
        "a" => shift(0, value),
        "alpha" => turn(0, value),
        "b" => shift(1, value),
        _ => turn(1, value),
    }
}

impl Arm {
    /// Joints.
    pub fn joints(&self) -> usize {
        self.transforms.len() - 1
    }

    /// All parameters: transform, symbol.
    pub fn parameters(&self) -> Vec<(usize, &'static str)> {
        let symbols = |(n, transform): (usize, &Transform)| {
            transform.convention.symbols().iter().map(move |&symbol| (n, symbol)).collect::<Vec<_>>()
        };
        self.transforms.iter().enumerate().flat_map(symbols).collect()
    }

    /// A parameter's name.
    pub fn parameter_name(&self, place: usize) -> String {
        let (transform, symbol) = self.parameters()[place];
        format!("{symbol}{transform}")
    }

    /// A parameter's place by its name.
    ///
    /// # Panics
    ///
    /// If there is none: names are the program's own.
    pub fn place(&self, name: &str) -> usize {
        (0..self.parameters().len()).find(|&place| self.parameter_name(place) == name).expect("a parameter's name")
    }

    /// Nominal values of all parameters.
    pub fn nominal(&self) -> Vec<f64> {
        self.transforms.iter().flat_map(|transform| transform.nominal.iter().copied()).collect()
    }

    /// All frames of the chain at parameter values and joint positions.
    pub fn stand(&self, values: &[f64], joints: &[f64]) -> Standing {
        let mut frames = vec![Matrix4::identity()];
        let mut values = values.iter();
        for (n, transform) in self.transforms.iter().enumerate() {
            let mut frame = frames[n];
            for &symbol in transform.convention.symbols() {
                let mut value = *values.next().expect("a value a parameter");
                if symbol == "theta" && n > 0 {
                    value += joints[n - 1];
                }
                frame *= elementary(symbol, value);
            }
            frames.push(frame);
        }
        Standing { frames }
    }

    /// The flange at parameter values and joint positions.
    pub fn flange(&self, values: &[f64], joints: &[f64]) -> Matrix4<f64> {
        *self.stand(values, joints).frames.last().expect("a chain has a flange")
    }

    /// What gravity does at a posture: the moment about each joint's axis and, for errors that are none of a joint's, about
    /// the x axis behind it; N·m, positive where it pushes the angle up.
    pub fn moments(&self, values: &[f64], joints: &[f64], payload_kg: f64) -> Vec<(f64, f64)> {
        let standing = self.stand(values, joints);
        let frames = &standing.frames;
        let point = |frame: &Matrix4<f64>, at: [f64; 3]| (frame * Vector4::new(at[0], at[1], at[2], 1.0)).xyz();
        let mut masses: Vec<(usize, f64, Vector3<f64>)> = self
            .bodies
            .iter()
            .map(|body| (body.transform, body.mass_kg, point(&frames[body.transform + 1], body.center)))
            .collect();
        masses.push((self.joints(), payload_kg, point(&frames[self.joints() + 1], [0.0; 3])));
        (1..=self.joints())
            .map(|n| {
                let about = |axis: Vector3<f64>, origin: Vector3<f64>| -> f64 {
                    let moved = masses.iter().filter(|(transform, ..)| *transform >= n);
                    moved.map(|(_, m, at)| axis.dot(&(at - origin).cross(&(Vector3::from(GRAVITY) * *m)))).sum()
                };
                let column = |frame: &Matrix4<f64>, c: usize| frame.fixed_view::<3, 1>(0, c).into_owned();
                let (before, behind) = (&frames[n], &frames[n + 1]);
                (about(column(before, 2), column(before, 3)), about(column(behind, 0), column(behind, 3)))
            })
            .collect()
    }

    /// robot.toml.
    pub fn to_toml(&self) -> String {
        let mut text = format!("format = 1\nname = \"{}\"\ngravity = {GRAVITY:?}\n", self.name);
        for (n, transform) in self.transforms.iter().enumerate() {
            let _ = write!(text, "\n[[transform]]\nconvention = \"{}\"\n", transform.convention.name());
            if n > 0 {
                text.push_str("joint = \"revolute\"\n");
            }
            for (symbol, value) in transform.convention.symbols().iter().zip(&transform.nominal) {
                let _ = writeln!(text, "{symbol} = {value:?}");
            }
        }
        for (name, at) in &self.targets {
            let _ = write!(text, "\n[[target]]\nname = \"{name}\"\nposition = {:?}\n", [at.x, at.y, at.z]);
        }
        for body in &self.bodies {
            let (n, mass, center) = (body.transform, body.mass_kg, body.center);
            let _ = write!(text, "\n[[body]]\ntransform = {n}\nmass_kg = {mass:?}\ncenter = {center:?}\n");
        }
        for sensor in &self.sensors {
            let (name, link, address) = (&sensor.name, sensor.link, 72 + sensor.address);
            let _ =
                write!(text, "\n[[sensor]]\nname = \"{name}\"\nlink = {link}\nboard = {link}\naddress = {address}\n");
        }
        for thermal in &self.thermal {
            let names: Vec<&str> = thermal.sensors.iter().map(|&sensor| self.sensors[sensor].name.as_str()).collect();
            let parameter = self.parameter_name(thermal.parameter);
            let _ = write!(text, "\n[[thermal]]\nparameter = \"{parameter}\"\nsensors = {names:?}\n");
        }
        text
    }
}
