//! The file of a model: JSON that a program reads in one line of Python or MATLAB, whole in itself.

use std::io::Write;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::bounds::CorrectionBounds;
use super::extended_file::ExtendedEntry;
use super::geometry::{Geometry, Growth, Model, ParameterEstimate, ReferenceTemperature};
use crate::input::InputError;
use crate::robot::{Chain, ParameterId, Robot};

/// How the numbers of a model are to be used: written into every model file and printed by `calibrate`.
pub const HOW_TO_APPLY: &str = "Put each parameter's value in place of its nominal one in the transform of its number; \
joint positions add to theta (or d). correction = value - nominal, so value = nominal + correction. A theta whose \
correction is +e means that the joint stands e further than its reading: to stand where the nominal arm would, command \
q - e. At other temperatures add, for each thermal coefficient, coefficient * (temperature - reference_c) to its parameter.";

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModelFile {
    format: u32,
    kind: String,
    how_to_apply: String,
    robot_toml: String,
    parameters: Vec<ParameterEntry>,
    targets: Vec<TargetEntry>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    anchors: Vec<AnchorEntry>,
    thermal_coefficients: Vec<GrowthEntry>,
    temperatures: Vec<TemperatureEntry>,
    estimates: Vec<EstimateEntry>,
    #[serde(default)]
    correction_bounds: CorrectionBounds,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    extended: Option<ExtendedEntry>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ParameterEntry {
    name: String,
    unit: String,
    /// As robot.toml has it.
    nominal: f64,
    /// Nominal, with the base aligned to the measurements.
    aligned: f64,
    /// From the reference cycle alone.
    geometric: f64,
    /// At the reference temperatures, from all cycles.
    value: f64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetEntry {
    name: String,
    aligned: [f64; 3],
    geometric: [f64; 3],
    position: [f64; 3],
    /// w, x, y, z in the flange frame.
    orientation: [f64; 4],
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AnchorEntry {
    name: String,
    aligned: [f64; 3],
    geometric: [f64; 3],
    position: [f64; 3],
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct GrowthEntry {
    parameter: String,
    sensor: String,
    unit: String,
    value: f64,
    sigma: f64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TemperatureEntry {
    sensor: String,
    reference_c: f64,
    lowest_c: f64,
    highest_c: f64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EstimateEntry {
    name: String,
    unit: String,
    nominal: f64,
    value: f64,
    sigma: Option<f64>,
    half_width_95: Option<f64>,
}

/// Why a model cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("{file}: the model cannot be written: {source}")]
pub struct ModelFileError {
    file: String,
    source: std::io::Error,
}

const KIND: &str = "thermokin model";

impl Model {
    /// The model as the text of its file.
    pub fn to_json(&self) -> String {
        let chain = self.robot.chain();
        let nominal = self.robot.nominal();
        let parameters = chain.parameters().iter().enumerate().map(|(place, id)| ParameterEntry {
            name: id.to_string(),
            unit: id.symbol.unit().to_owned(),
            nominal: nominal[place],
            aligned: self.nominal.parameters[place],
            geometric: self.geometric.parameters[place],
            value: self.reference.parameters[place],
        });
        let targets = self.robot.targets.iter().enumerate().map(|(target, described)| {
            let turn = self.reference.turns[target].quaternion();
            TargetEntry {
                name: described.name.clone(),
                aligned: self.nominal.targets[target].into(),
                geometric: self.geometric.targets[target].into(),
                position: self.reference.targets[target].into(),
                orientation: [turn.w, turn.i, turn.j, turn.k],
            }
        });
        let anchors = self.anchors.iter().enumerate().map(|(anchor, name)| AnchorEntry {
            name: name.clone(),
            aligned: self.nominal.anchors[anchor].into(),
            geometric: self.geometric.anchors[anchor].into(),
            position: self.reference.anchors[anchor].into(),
        });
        let growth = self.growth.iter().map(|growth| GrowthEntry {
            parameter: growth.parameter.to_string(),
            sensor: growth.sensor.clone(),
            unit: format!("{}/K", growth.parameter.symbol.unit()),
            value: growth.coefficient,
            sigma: growth.sigma,
        });
        let temperatures = self.temperatures.iter().map(|reference| TemperatureEntry {
            sensor: reference.sensor.clone(),
            reference_c: reference.celsius,
            lowest_c: reference.lowest,
            highest_c: reference.highest,
        });
        let estimates = self.estimates.iter().map(|estimate| EstimateEntry {
            name: estimate.name.clone(),
            unit: estimate.unit.to_owned(),
            nominal: estimate.nominal,
            value: estimate.value,
            sigma: estimate.sigma,
            half_width_95: estimate.half_width,
        });
        let content = ModelFile {
            format: 1,
            kind: KIND.to_owned(),
            how_to_apply: HOW_TO_APPLY.to_owned(),
            robot_toml: self.robot.to_toml(),
            parameters: parameters.collect(),
            targets: targets.collect(),
            anchors: anchors.collect(),
            thermal_coefficients: growth.collect(),
            temperatures: temperatures.collect(),
            estimates: estimates.collect(),
            correction_bounds: self.correction_bounds,
            extended: self.extended.as_ref().map(|extended| ExtendedEntry::of(extended, &self.robot)),
        };
        // Strings and finite numbers in plain structures: JSON has no reason to refuse them.
        let mut text = serde_json::to_string_pretty(&content).expect("a model is plain JSON");
        text.push('\n');
        text
    }

    /// Writes the model's file: whole, or not at all.
    ///
    /// # Errors
    /// When the folder or the disk does not take it.
    pub fn write(&self, file: &Path) -> Result<(), ModelFileError> {
        let fail = |source| ModelFileError { file: file.display().to_string(), source };
        let mut name = file.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        let part = file.with_file_name(name);
        let written = std::fs::File::create(&part).and_then(|mut open| {
            open.write_all(self.to_json().as_bytes())?;
            open.sync_all()
        });
        written.and_then(|()| std::fs::rename(&part, file)).map_err(|error| {
            // The part is of no use to anyone; that it cannot be removed is no further news.
            let _ = std::fs::remove_file(&part);
            fail(error)
        })
    }

    /// Reads a model's text; `file` is named in errors.
    ///
    /// # Errors
    /// What is wrong with it, with its line.
    pub fn parse(file: &Path, text: &str) -> Result<Model, InputError> {
        let content: ModelFile = serde_json::from_str(text).map_err(|error| {
            let message = format!("is no model file of thermokin: {error}");
            InputError { file: file.to_owned(), line: (error.line() > 0).then(|| error.line()), message }
        })?;
        if content.format != 1 || content.kind != KIND {
            let message = format!("kind '{}', format {}: expected '{KIND}', format 1", content.kind, content.format);
            return Err(InputError::of_file(file, message));
        }
        let robot = Robot::parse(file, &content.robot_toml)
            .map_err(|error| InputError::of_file(file, format!("robot_toml: {}", error.message)))?;
        from_file(file, content, robot)
    }

    /// Reads a model's file.
    ///
    /// # Errors
    /// See [`Model::parse`]; also a file that cannot be read.
    pub fn read(file: &Path) -> Result<Model, InputError> {
        let text = std::fs::read_to_string(file)
            .map_err(|error| InputError::of_file(file, format!("cannot be read: {error}")))?;
        Self::parse(file, &text)
    }
}

fn from_file(file: &Path, content: ModelFile, robot: Robot) -> Result<Model, InputError> {
    let chain = robot.chain();
    check_names(file, &content, &robot, &chain)?;
    let geometry = |parameter: fn(&ParameterEntry) -> f64,
                    target: fn(&TargetEntry) -> [f64; 3],
                    anchor: fn(&AnchorEntry) -> [f64; 3]| Geometry {
        parameters: content.parameters.iter().map(parameter).collect(),
        targets: content.targets.iter().map(|entry| Vector3::from(target(entry))).collect(),
        turns: content
            .targets
            .iter()
            .map(|entry| {
                let [w, x, y, z] = entry.orientation;
                UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
            })
            .collect(),
        anchors: content.anchors.iter().map(|entry| Vector3::from(anchor(entry))).collect(),
    };
    let growth = content
        .thermal_coefficients
        .iter()
        .map(|entry| {
            let unknown =
                || InputError::of_file(file, format!("thermal coefficient of {}: no such parameter", entry.parameter));
            let parameter: ParameterId = entry.parameter.parse().map_err(|_| unknown())?;
            chain.place(parameter).ok_or_else(unknown)?;
            Ok(Growth { parameter, sensor: entry.sensor.clone(), coefficient: entry.value, sigma: entry.sigma })
        })
        .collect::<Result<Vec<_>, InputError>>()?;
    let reference = geometry(|entry| entry.value, |entry| entry.position, |entry| entry.position);
    let temperatures: Vec<ReferenceTemperature> = content
        .temperatures
        .iter()
        .map(|entry| ReferenceTemperature {
            sensor: entry.sensor.clone(),
            celsius: entry.reference_c,
            lowest: entry.lowest_c,
            highest: entry.highest_c,
        })
        .collect();
    if let Some(fault) = content.correction_bounds.fault() {
        return Err(InputError::of_file(file, format!("correction_bounds: {fault}")));
    }
    let extended = content.extended.map(|entry| entry.read(file, &robot, &reference, &temperatures)).transpose()?;
    Ok(Model {
        correction_bounds: content.correction_bounds,
        extended,
        nominal: geometry(|entry| entry.aligned, |entry| entry.aligned, |entry| entry.aligned),
        geometric: geometry(|entry| entry.geometric, |entry| entry.geometric, |entry| entry.geometric),
        reference,
        growth,
        temperatures,
        anchors: content.anchors.iter().map(|entry| entry.name.clone()).collect(),
        estimates: content
            .estimates
            .iter()
            .map(|entry| ParameterEstimate {
                name: entry.name.clone(),
                unit: if entry.unit == "rad" { "rad" } else { "m" },
                nominal: entry.nominal,
                value: entry.value,
                sigma: entry.sigma,
                half_width: entry.half_width_95,
            })
            .collect(),
        robot,
    })
}

/// The lists of the file must be those of its robot, in its order.
fn check_names(file: &Path, content: &ModelFile, robot: &Robot, chain: &Chain) -> Result<(), InputError> {
    let expected: Vec<String> = chain.parameters().iter().map(ToString::to_string).collect();
    let found: Vec<&String> = content.parameters.iter().map(|entry| &entry.name).collect();
    if !expected.iter().eq(found.iter().copied()) {
        let message = format!("parameters are not those of its robot, expected {}", expected.join(", "));
        return Err(InputError::of_file(file, message));
    }
    let targets = robot.targets.iter().map(|target| &target.name);
    if !targets.clone().eq(content.targets.iter().map(|entry| &entry.name)) {
        let names: Vec<&str> = targets.map(String::as_str).collect();
        return Err(InputError::of_file(
            file,
            format!("targets are not those of its robot, expected {}", names.join(", ")),
        ));
    }
    Ok(())
}
