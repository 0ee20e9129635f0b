//! `robot.toml`: reading with the line of every error, checking, and writing.

use std::path::Path;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use toml::Spanned;

use super::convention::{Convention, Symbol};
use super::description::{Body, Joint, JointKind, Robot, Sensor, Target, ThermalChoice, Transform};
use super::parameter::ParameterId;
use crate::input::{InputError, line_of_offset};

const STANDARD_GRAVITY: [f64; 3] = [0.0, 0.0, -9.80665];

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    format: Spanned<i64>,
    name: String,
    #[serde(default = "standard_gravity")]
    gravity: [f64; 3],
    transform: Vec<Spanned<TransformTable>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    target: Vec<Spanned<TargetTable>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    monument: Vec<Spanned<MonumentTable>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    body: Vec<Spanned<BodyTable>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    sensor: Vec<Spanned<SensorTable>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    thermal: Vec<Spanned<ThermalTable>>,
}

fn standard_gravity() -> [f64; 3] {
    STANDARD_GRAVITY
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TransformTable {
    convention: Convention,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    joint: Option<JointName>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    min: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    max: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    d: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    theta: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    a: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    alpha: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    b: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    beta: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gear_ratio: Option<f64>,
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum JointName {
    Revolute,
    Prismatic,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetTable {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    position: Option<[f64; 3]>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MonumentTable {
    name: String,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BodyTable {
    transform: usize,
    mass_kg: f64,
    center: [f64; 3],
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorTable {
    name: String,
    link: usize,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    board: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    address: Option<u8>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ThermalTable {
    parameter: String,
    sensors: Vec<String>,
}

impl TransformTable {
    fn value(&self, symbol: Symbol) -> Option<f64> {
        match symbol {
            Symbol::D => self.d,
            Symbol::Theta => self.theta,
            Symbol::A => self.a,
            Symbol::Alpha => self.alpha,
            Symbol::B => self.b,
            Symbol::Beta => self.beta,
        }
    }
}

/// The text of one robot.toml with the words to complain about it.
struct Reader<'a> {
    file: &'a Path,
    text: &'a str,
}

impl Reader<'_> {
    fn error<T>(&self, place: &Spanned<T>, message: impl Into<String>) -> InputError {
        InputError::at_line(self.file, line_of_offset(self.text, place.span().start), message)
    }

    fn transform(&self, number: usize, place: &Spanned<TransformTable>) -> Result<Transform, InputError> {
        let table = place.as_ref();
        let complain = |message: String| Err(self.error(place, format!("transform {number}: {message}")));
        let convention = table.convention;
        let mut values = Vec::new();
        for symbol in Symbol::ALL {
            match (convention.symbols().contains(&symbol), table.value(symbol)) {
                (true, Some(value)) if value.is_finite() => values.push(value),
                (true, Some(value)) => return complain(format!("{symbol} is {value}, expected a finite number")),
                (true, None) => {
                    return complain(format!("convention '{}' needs {symbol}, which is missing", convention.name()));
                }
                (false, Some(_)) => {
                    return complain(format!(
                        "convention '{}' has no {symbol}; it has {}",
                        convention.name(),
                        convention.symbols().iter().map(|symbol| symbol.name()).collect::<Vec<_>>().join(", ")
                    ));
                }
                (false, None) => {}
            }
        }
        for (name, value) in [("min", table.min), ("max", table.max), ("gear_ratio", table.gear_ratio)] {
            match value {
                Some(value) if !value.is_finite() => {
                    return complain(format!("{name} is {value}, expected a finite number"));
                }
                Some(_) if table.joint.is_none() => {
                    return complain(format!("{name} is given, but the transform has no joint"));
                }
                _ => {}
            }
        }
        if let (Some(min), Some(max)) = (table.min, table.max)
            && min >= max
        {
            return complain(format!("joint limits min = {min} and max = {max}, expected min < max"));
        }
        if table.gear_ratio == Some(0.0) {
            return complain("gear_ratio is 0, expected motor turns per joint turn".to_owned());
        }
        let joint = table.joint.map(|kind| Joint {
            kind: match kind {
                JointName::Revolute => JointKind::Revolute,
                JointName::Prismatic => JointKind::Prismatic,
            },
            min: table.min,
            max: table.max,
            gear_ratio: table.gear_ratio,
        });
        if number == 0 && joint.is_some() {
            return complain("world to base never moves, expected no joint".to_owned());
        }
        Ok(Transform { convention, joint, values })
    }

    fn finite<T>(&self, place: &Spanned<T>, what: &str, values: [f64; 3]) -> Result<Vector3<f64>, InputError> {
        if values.iter().all(|value| value.is_finite()) {
            Ok(Vector3::from(values))
        } else {
            Err(self.error(place, format!("{what} is {values:?}, expected three finite numbers")))
        }
    }

    /// Refuses a name that is empty or was used before.
    fn name<T>(&self, place: &Spanned<T>, what: &str, name: &str, known: &mut Vec<String>) -> Result<(), InputError> {
        if name.trim().is_empty() {
            return Err(self.error(place, format!("the {what} has an empty name")));
        }
        if known.iter().any(|other| other == name) {
            return Err(
                self.error(place, format!("the name '{name}' is used before, expected another for this {what}"))
            );
        }
        known.push(name.to_owned());
        Ok(())
    }

    fn robot(&self, content: RobotFile) -> Result<Robot, InputError> {
        if *content.format.as_ref() != 1 {
            return Err(
                self.error(&content.format, format!("format {} is unknown, expected 1", content.format.as_ref()))
            );
        }
        let whole = Spanned::new(0..0, ());
        let gravity = self.finite(&whole, "gravity", content.gravity)?;
        let transforms = content
            .transform
            .iter()
            .enumerate()
            .map(|(number, place)| self.transform(number, place))
            .collect::<Result<Vec<_>, _>>()?;
        let joints = transforms.iter().filter(|transform| transform.joint.is_some()).count();
        if joints == 0 {
            return Err(InputError::of_file(self.file, "no transform has a joint, expected at least one"));
        }
        let last = transforms.len() - 1;

        let mut points = Vec::new();
        let mut targets = Vec::new();
        for place in &content.target {
            let table = place.as_ref();
            self.name(place, "target", &table.name, &mut points)?;
            let position =
                table.position.map(|p| self.finite(place, &format!("position of {}", table.name), p)).transpose()?;
            targets.push(Target { name: table.name.clone(), position });
        }
        let mut monuments = Vec::new();
        for place in &content.monument {
            self.name(place, "monument", &place.as_ref().name, &mut points)?;
            monuments.push(place.as_ref().name.clone());
        }
        let mut bodies = Vec::new();
        for place in &content.body {
            let table = place.as_ref();
            if table.transform > last {
                let message = format!("the body moves with transform {}, but the last is {last}", table.transform);
                return Err(self.error(place, message));
            }
            if !(table.mass_kg.is_finite() && table.mass_kg >= 0.0) {
                return Err(self.error(place, format!("mass_kg is {}, expected 0 or more", table.mass_kg)));
            }
            let center = self.finite(place, "center", table.center)?;
            bodies.push(Body { transform: table.transform, mass_kg: table.mass_kg, center });
        }
        let mut names = Vec::new();
        let mut sensors: Vec<Sensor> = Vec::new();
        for place in &content.sensor {
            let table = place.as_ref();
            self.name(place, "sensor", &table.name, &mut names)?;
            if table.link > last {
                let message = format!("sensor {} sits on link {}, but the last is {last}", table.name, table.link);
                return Err(self.error(place, message));
            }
            if let Some(address) = table.address.filter(|&address| address > 0x7f) {
                let message = format!("I2C address {address:#04x} of sensor {}, expected 7 bits", table.name);
                return Err(self.error(place, message));
            }
            let twin = sensors.iter().find(|other| {
                table.board.is_some()
                    && other.board == table.board
                    && table.address.is_some()
                    && other.address == table.address
            });
            if let Some(twin) = twin {
                let message = format!("sensor {} has the board and address of {}", table.name, twin.name);
                return Err(self.error(place, message));
            }
            sensors.push(Sensor {
                name: table.name.clone(),
                link: table.link,
                board: table.board,
                address: table.address,
            });
        }
        let mut thermal: Vec<ThermalChoice> = Vec::new();
        for place in &content.thermal {
            let table = place.as_ref();
            let parameter: ParameterId =
                table.parameter.parse().map_err(|error| self.error(place, format!("{error}")))?;
            let exists = transforms
                .get(parameter.transform)
                .is_some_and(|transform| transform.convention.symbols().contains(&parameter.symbol));
            if !exists {
                return Err(self.error(place, format!("the chain has no parameter {parameter}")));
            }
            if thermal.iter().any(|other| other.parameter == parameter) {
                return Err(
                    self.error(place, format!("a second [[thermal]] for {parameter}, expected one a parameter"))
                );
            }
            if table.sensors.is_empty() {
                return Err(self.error(place, format!("[[thermal]] for {parameter} lists no sensor")));
            }
            for (rank, name) in table.sensors.iter().enumerate() {
                if !names.contains(name) {
                    return Err(
                        self.error(place, format!("[[thermal]] for {parameter}: no [[sensor]] is named '{name}'"))
                    );
                }
                if table.sensors[..rank].contains(name) {
                    return Err(self.error(place, format!("[[thermal]] for {parameter} lists sensor {name} twice")));
                }
            }
            thermal.push(ThermalChoice { parameter, sensors: table.sensors.clone() });
        }
        let robot = Robot { name: content.name, gravity, transforms, targets, monuments, bodies, sensors, thermal };
        let extent: f64 = robot.transforms[1..]
            .iter()
            .map(|transform| transform.value(Symbol::D).abs() + transform.value(Symbol::A).abs())
            .sum();
        let slides = robot
            .transforms
            .iter()
            .any(|transform| transform.joint.as_ref().is_some_and(|joint| joint.kind == JointKind::Prismatic));
        if extent == 0.0 && !slides {
            return Err(InputError::of_file(self.file, "every d and a after the base is 0: an arm without any length"));
        }
        if extent > 100.0 {
            let message =
                format!("the lengths of the arm add up to {extent:.0} m: expected metres, are these millimetres?");
            return Err(InputError::of_file(self.file, message));
        }
        Ok(robot)
    }
}

impl Robot {
    /// Reads the text of a `robot.toml`; `file` is named in errors.
    ///
    /// # Errors
    /// What is wrong with it, with its line: unknown keys, a parameter that the convention does not have or lacks, names
    /// that are used twice, sensors or parameters that do not exist, a chain that cannot be.
    pub fn parse(file: &Path, text: &str) -> Result<Robot, InputError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let content = toml::from_str::<RobotFile>(text).map_err(|error| InputError::of_toml(file, text, &error))?;
        Reader { file, text }.robot(content)
    }

    /// Reads a `robot.toml`.
    ///
    /// # Errors
    /// See [`Robot::parse`]; also a file that cannot be read.
    pub fn read(file: &Path) -> Result<Robot, InputError> {
        let text = std::fs::read_to_string(file)
            .map_err(|error| InputError::of_file(file, format!("cannot be read: {error}")))?;
        Self::parse(file, &text)
    }

    /// The description as the text of a `robot.toml`.
    pub fn to_toml(&self) -> String {
        fn placed<T>(value: T) -> Spanned<T> {
            Spanned::new(0..0, value)
        }
        let content = RobotFile {
            format: placed(1),
            name: self.name.clone(),
            gravity: self.gravity.into(),
            transform: self.transforms.iter().map(|transform| placed(transform_table(transform))).collect(),
            target: self
                .targets
                .iter()
                .map(|target| {
                    placed(TargetTable { name: target.name.clone(), position: target.position.map(Into::into) })
                })
                .collect(),
            monument: self.monuments.iter().map(|name| placed(MonumentTable { name: name.clone() })).collect(),
            body: self
                .bodies
                .iter()
                .map(|body| {
                    placed(BodyTable { transform: body.transform, mass_kg: body.mass_kg, center: body.center.into() })
                })
                .collect(),
            sensor: self
                .sensors
                .iter()
                .map(|sensor| {
                    placed(SensorTable {
                        name: sensor.name.clone(),
                        link: sensor.link,
                        board: sensor.board,
                        address: sensor.address,
                    })
                })
                .collect(),
            thermal: self
                .thermal
                .iter()
                .map(|choice| {
                    placed(ThermalTable { parameter: choice.parameter.to_string(), sensors: choice.sensors.clone() })
                })
                .collect(),
        };
        // Plain numbers, strings and tables: nothing in a `RobotFile` is beyond TOML.
        toml::to_string(&content).expect("a robot's description is plain TOML")
    }
}

fn transform_table(transform: &Transform) -> TransformTable {
    let has = |symbol| transform.convention.symbols().contains(&symbol).then(|| transform.value(symbol));
    let joint = transform.joint.as_ref();
    TransformTable {
        convention: transform.convention,
        joint: joint.map(|joint| match joint.kind {
            JointKind::Revolute => JointName::Revolute,
            JointKind::Prismatic => JointName::Prismatic,
        }),
        min: joint.and_then(|joint| joint.min),
        max: joint.and_then(|joint| joint.max),
        d: has(Symbol::D),
        theta: has(Symbol::Theta),
        a: has(Symbol::A),
        alpha: has(Symbol::Alpha),
        b: has(Symbol::B),
        beta: has(Symbol::Beta),
        gear_ratio: joint.and_then(|joint| joint.gear_ratio),
    }
}
