//! import.toml: which files of a laboratory hold what, in which columns, units and frames.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::{Rotation3, Vector3};
use regex::Regex;
use serde::Deserialize;
use toml::Spanned;

use super::time::TimeToml;
use crate::input::{InputError, line_of_offset};
use crate::robot::{Frame, SHIPPED};
use crate::run::{Checker, Instrument, InstrumentToml};

/// A mapping, checked as far as it can be without the files that it names.
#[derive(Debug, Clone)]
pub struct Mapping {
    /// The mapping's own file, which errors name.
    pub(super) file: PathBuf,
    pub(super) name: String,
    pub(super) robot: RobotSource,
    pub(super) reference_cycle: u32,
    pub(super) ambient: Option<String>,
    pub(super) start_ns: Option<i128>,
    pub(super) same_posture: f64,
    pub(super) instrument: Instrument,
    pub(super) tracker: Vec<PointsSource>,
    pub(super) joints: Vec<JointsSource>,
    pub(super) temperatures: Vec<TemperatureSource>,
    pub(super) holders: Option<HoldersSource>,
}

/// Where the arm's description is.
#[derive(Debug, Clone)]
pub(super) enum RobotSource {
    Shipped(&'static str),
    File(PathBuf),
}

/// The files of one table, and how they are laid out.
#[derive(Debug, Clone)]
pub(super) struct Files {
    /// Paths joined to the mapping's folder; the last part of one may hold `*`.
    pub(super) patterns: Vec<PathBuf>,
    /// The line of the mapping that names them.
    pub(super) line: usize,
    pub(super) layout: LayoutToml,
}

/// Positions: of a tracker, or of a coordinate measuring machine.
#[derive(Debug, Clone)]
pub(super) struct PointsSource {
    pub(super) files: Files,
    pub(super) metres: f64,
    pub(super) columns: PointColumns,
    pub(super) time: Option<TimeToml>,
    pub(super) names: Names,
    /// The frame of the coordinates seen from the world (for holders: from the flange, or from one frame for both).
    pub(super) frame: Frame,
    /// What `columns.status` says of a sample that counts.
    pub(super) good: Vec<String>,
    pub(super) samples: Option<SamplesToml>,
}

/// What names and numbers of a table mean.
#[derive(Debug, Clone)]
pub(super) struct Names {
    pub(super) pattern: Option<Regex>,
    pub(super) rename: BTreeMap<String, String>,
    pub(super) ignore: Vec<String>,
    pub(super) first_cycle: u32,
    pub(super) first_pose: u32,
}

/// Joints as a controller wrote them.
#[derive(Debug, Clone)]
pub(super) struct JointsSource {
    pub(super) files: Files,
    pub(super) rows: JointRows,
    pub(super) columns: JointColumns,
    pub(super) time: Option<TimeToml>,
    pub(super) names: Names,
    /// What makes SI of each joint's column: `value * factor + offset`.
    pub(super) scales: Vec<(f64, f64)>,
    pub(super) points: PointsAre,
    pub(super) max_gap_s: f64,
    pub(super) still: StillToml,
}

/// Readings of sensors.
#[derive(Debug, Clone)]
pub(super) struct TemperatureSource {
    pub(super) files: Files,
    pub(super) columns: TemperatureColumns,
    pub(super) time: Option<TimeToml>,
    pub(super) unit: TemperatureUnit,
    pub(super) names: Names,
}

/// What finds the targets' places in the flange frame.
#[derive(Debug, Clone)]
pub(super) struct HoldersSource {
    pub(super) line: usize,
    pub(super) machine: PointsSource,
    pub(super) tracker: PointsSource,
    pub(super) targets: PointsSource,
    pub(super) max_residual_m: f64,
}

/// A column by its name in the header, or by its number from 1.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged, expecting = "expected a column's name, or its number from 1")]
pub(super) enum Column {
    Name(String),
    Number(usize),
}

/// One thing or several.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged, expecting = "expected one, or a list of them")]
pub(super) enum OneOrMany<T> {
    One(T),
    Many(Vec<T>),
}

impl<T> OneOrMany<T> {
    pub(super) fn as_slice(&self) -> &[T] {
        match self {
            Self::One(one) => std::slice::from_ref(one),
            Self::Many(many) => many,
        }
    }
}

/// What a table looks like before its columns can be named.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LayoutToml {
    pub(super) separator: Option<Separator>,
    pub(super) header: Option<bool>,
    pub(super) comments: Option<Vec<String>>,
    #[serde(default)]
    pub(super) skip_lines: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub(super) enum Separator {
    #[serde(rename = ",", alias = "comma")]
    Comma,
    #[serde(rename = ";", alias = "semicolon")]
    Semicolon,
    #[serde(rename = "tab")]
    Tab,
    #[serde(rename = "space")]
    Space,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PointColumns {
    pub(super) x: Column,
    pub(super) y: Column,
    pub(super) z: Column,
    pub(super) target: OneOrMany<Column>,
    pub(super) cycle: Option<Column>,
    pub(super) pose: Option<Column>,
    pub(super) status: Option<Column>,
    pub(super) sigma: Option<Column>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JointColumns {
    pub(super) joints: Vec<Column>,
    pub(super) commanded: Option<Vec<Column>>,
    pub(super) payload_kg: Option<Column>,
    pub(super) visit: Option<OneOrMany<Column>>,
    pub(super) cycle: Option<Column>,
    pub(super) pose: Option<Column>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TemperatureColumns {
    pub(super) sensor: Option<Column>,
    pub(super) value: Option<Column>,
    #[serde(default)]
    pub(super) sensors: BTreeMap<String, String>,
    pub(super) cycle: Option<Column>,
    pub(super) pose: Option<Column>,
}

/// What is done with several samples of one target at one visit.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SamplesToml {
    /// Fewer good samples than this are a broken beam.
    #[serde(default = "one")]
    pub(super) least: usize,
    /// A sample further from the median than so many robust deviations is dropped.
    #[serde(default = "five")]
    pub(super) sigmas: f64,
    /// No deviation is taken to be smaller than this, m.
    #[serde(default = "a_micrometre")]
    pub(super) floor_m: f64,
}

fn one() -> usize {
    1
}

fn five() -> f64 {
    5.0
}

fn a_micrometre() -> f64 {
    1e-6
}

/// When an arm of a continuous log stands.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StillToml {
    /// Every joint stays this near to where it was when the standstill began, rad or m.
    #[serde(default = "a_tenth_of_a_milliradian")]
    pub(super) within: f64,
    /// For at least so long, s.
    #[serde(default = "half_a_second")]
    pub(super) seconds: f64,
}

fn a_tenth_of_a_milliradian() -> f64 {
    1e-4
}

fn half_a_second() -> f64 {
    0.5
}

impl Default for StillToml {
    fn default() -> Self {
        Self { within: a_tenth_of_a_milliradian(), seconds: half_a_second() }
    }
}

/// What a row of a table of joints is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum JointRows {
    /// A visit of a posture.
    #[default]
    Visits,
    /// A moment of a continuous log.
    Log,
}

/// When the points of a visit are measured, seen from the time of its row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum PointsAre {
    #[default]
    Near,
    After,
    Before,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
pub(super) enum TemperatureUnit {
    #[default]
    C,
    K,
    F,
}

impl TemperatureUnit {
    pub(super) fn celsius(self, value: f64) -> f64 {
        match self {
            Self::C => value,
            Self::K => value - 273.15,
            Self::F => (value - 32.0) / 1.8,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Unit {
    M,
    Mm,
    In,
    Rad,
    Deg,
}

impl Unit {
    /// What makes metres or radians of it.
    fn si(self) -> f64 {
        match self {
            Self::M | Self::Rad => 1.0,
            Self::Mm => 1e-3,
            Self::In => 25.4e-3,
            Self::Deg => 1_f64.to_radians(),
        }
    }

    fn is_length(self) -> bool {
        matches!(self, Self::M | Self::Mm | Self::In)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MappingToml {
    format: Spanned<i64>,
    name: Spanned<String>,
    robot: Spanned<String>,
    #[serde(default)]
    reference_cycle: u32,
    ambient: Option<Spanned<String>>,
    start: Option<Spanned<String>>,
    same_posture: Option<Spanned<f64>>,
    instrument: InstrumentToml,
    tracker: Vec<Spanned<PointsToml>>,
    joints: Vec<Spanned<JointsToml>>,
    #[serde(default)]
    temperatures: Vec<Spanned<TemperaturesToml>>,
    holders: Option<Spanned<HoldersToml>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PointsToml {
    files: Vec<Spanned<String>>,
    #[serde(default)]
    layout: LayoutToml,
    unit: Spanned<Unit>,
    columns: PointColumns,
    time: Option<TimeToml>,
    target_pattern: Option<Spanned<String>>,
    #[serde(default)]
    rename: BTreeMap<String, String>,
    #[serde(default)]
    ignore: Vec<String>,
    #[serde(default)]
    good: Vec<String>,
    #[serde(default)]
    first_cycle: u32,
    #[serde(default)]
    first_pose: u32,
    frame: Option<FrameToml>,
    samples: Option<Spanned<SamplesToml>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameToml {
    position: [f64; 3],
    #[serde(default)]
    turn_deg: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointsToml {
    files: Vec<Spanned<String>>,
    #[serde(default)]
    layout: LayoutToml,
    #[serde(default)]
    rows: JointRows,
    unit: Spanned<OneOrMany<Unit>>,
    signs: Option<Spanned<Vec<f64>>>,
    offsets: Option<Spanned<Vec<f64>>>,
    columns: Spanned<JointColumns>,
    time: Option<TimeToml>,
    visit_pattern: Option<Spanned<String>>,
    #[serde(default)]
    first_cycle: u32,
    #[serde(default)]
    first_pose: u32,
    #[serde(default)]
    points: PointsAre,
    max_gap_s: Option<Spanned<f64>>,
    still: Option<Spanned<StillToml>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TemperaturesToml {
    files: Vec<Spanned<String>>,
    #[serde(default)]
    layout: LayoutToml,
    columns: Spanned<TemperatureColumns>,
    time: Option<TimeToml>,
    #[serde(default)]
    unit: TemperatureUnit,
    #[serde(default)]
    rename: BTreeMap<String, String>,
    #[serde(default)]
    ignore: Vec<String>,
    #[serde(default)]
    first_cycle: u32,
    #[serde(default)]
    first_pose: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HoldersToml {
    machine: Spanned<PointsToml>,
    tracker: Spanned<PointsToml>,
    targets: Spanned<PointsToml>,
    max_residual_m: Option<Spanned<f64>>,
}

impl Mapping {
    /// A commented mapping to start from.
    pub const TEMPLATE: &'static str = include_str!("template.toml");

    /// Reads the text of a mapping; `file` is named in errors, and what it names is relative to its folder.
    ///
    /// # Errors
    /// The first thing that is wrong with it, with its line.
    pub fn parse(file: &Path, text: &str) -> Result<Self, InputError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let raw: MappingToml = toml::from_str(text).map_err(|error| InputError::of_toml(file, text, &error))?;
        Reading { check: Checker { file, text }, folder: file.parent().unwrap_or(Path::new("")) }.mapping(raw)
    }
}

/// A mapping being checked.
struct Reading<'a> {
    check: Checker<'a>,
    folder: &'a Path,
}

/// The default of `max_gap_s`, s: a visit to a posture for one row, the clocks' disagreement for a log of standstills.
const VISIT_GAP_S: f64 = 60.0;
const LOG_GAP_S: f64 = 1.0;

/// The default of `same_posture`, rad or m: above what controllers repeat, below what two postures of a plan differ by.
const SAME_POSTURE: f64 = 1e-3;

/// The default of the holders' `max_residual_m`: a holder further off is another holder.
const MAX_RESIDUAL_M: f64 = 1e-3;

impl Reading<'_> {
    fn mapping(&self, raw: MappingToml) -> Result<Mapping, InputError> {
        let check = &self.check;
        check.require(&raw.format, |&format| format == 1, "format", "1, the only one there is")?;
        check.name(&raw.name, "name")?;
        if let Some(ambient) = &raw.ambient {
            check.name(ambient, "ambient")?;
        }
        let start_ns = match &raw.start {
            None => None,
            Some(start) => Some(
                super::time::date_of(start.get_ref())
                    .ok_or_else(|| check.unexpected(start, "start", "a date and time such as 2024-05-06 07:08:09.5"))?,
            ),
        };
        let same_posture = self.above_zero(raw.same_posture.as_ref(), "same_posture", SAME_POSTURE)?;
        for (list, what) in [(raw.tracker.is_empty(), "[[tracker]]"), (raw.joints.is_empty(), "[[joints]]")] {
            if list {
                return Err(InputError::of_file(check.file, format!("has no {what}; expected one at least")));
            }
        }
        Ok(Mapping {
            file: check.file.to_owned(),
            name: raw.name.into_inner(),
            robot: self.robot(&raw.robot)?,
            reference_cycle: raw.reference_cycle,
            ambient: raw.ambient.map(Spanned::into_inner),
            start_ns,
            same_posture,
            instrument: check.instrument(raw.instrument)?,
            tracker: raw.tracker.into_iter().map(|points| self.points(points)).collect::<Result<_, _>>()?,
            joints: raw.joints.into_iter().map(|joints| self.joints(joints)).collect::<Result<_, _>>()?,
            temperatures: raw.temperatures.into_iter().map(|log| self.temperatures(log)).collect::<Result<_, _>>()?,
            holders: raw.holders.map(|holders| self.holders(holders)).transpose()?,
        })
    }

    fn robot(&self, named: &Spanned<String>) -> Result<RobotSource, InputError> {
        let name = named.get_ref();
        if let Some((shipped, _)) = SHIPPED.iter().find(|(shipped, _)| shipped == name) {
            return Ok(RobotSource::Shipped(shipped));
        }
        if name.ends_with(".toml") {
            return Ok(RobotSource::File(self.folder.join(name)));
        }
        let names: Vec<&str> = SHIPPED.iter().map(|(name, _)| *name).collect();
        Err(self.check.unexpected(named, "robot", &format!("the path of a .toml or one of {}", names.join(", "))))
    }

    fn files(&self, place: usize, names: Vec<Spanned<String>>, layout: LayoutToml) -> Result<Files, InputError> {
        let line = line_of_offset(self.check.text, place);
        if names.is_empty() {
            return Err(InputError::at_line(self.check.file, line, "files is empty; expected one at least"));
        }
        for name in &names {
            self.check.name(name, "a file's name")?;
        }
        if layout.comments.iter().flatten().any(|mark| mark.trim().is_empty()) {
            return Err(InputError::at_line(
                self.check.file,
                line,
                "comments holds an empty mark; expected such as \"//\"",
            ));
        }
        Ok(Files { patterns: names.iter().map(|name| self.folder.join(name.get_ref())).collect(), line, layout })
    }

    fn points(&self, raw: Spanned<PointsToml>) -> Result<PointsSource, InputError> {
        let place = raw.span().start;
        let raw = raw.into_inner();
        self.check.require(&raw.unit, |unit| unit.is_length(), "unit", "m, mm or in")?;
        let pattern = self.pattern(raw.target_pattern.as_ref(), &["target", "cycle", "pose"])?;
        if let Some(written) = &raw.target_pattern
            && pattern.as_ref().is_some_and(|pattern| !captures(pattern, "target"))
        {
            return Err(self
                .check
                .error(written, "target_pattern has no (?<target>…); expected one, the target's name"));
        }
        if let (Some(written), Some(pattern)) = (&raw.target_pattern, &pattern)
            && captures(pattern, "cycle") != captures(pattern, "pose")
        {
            return Err(self
                .check
                .error(written, "target_pattern has one of cycle and pose; expected both, or neither"));
        }
        if let Some(samples) = &raw.samples {
            let right = |samples: &SamplesToml| {
                samples.least > 0 && above_zero(&samples.sigmas) && above_zero(&samples.floor_m)
            };
            self.check.require(samples, right, "samples", "least, sigmas and floor_m above 0")?;
        }
        let frame = match raw.frame {
            None => Frame::identity(),
            Some(frame) => {
                let [x, y, z] = frame.turn_deg.map(f64::to_radians);
                let frame = Frame {
                    rotation: Rotation3::from_euler_angles(x, y, z).into_inner(),
                    origin: Vector3::from(frame.position),
                };
                if !frame.rotation.iter().chain(frame.origin.iter()).all(|value| value.is_finite()) {
                    let line = line_of_offset(self.check.text, place);
                    return Err(InputError::at_line(self.check.file, line, "frame holds a number that is not finite"));
                }
                frame
            }
        };
        if raw.columns.status.is_some() == raw.good.is_empty() {
            let line = line_of_offset(self.check.text, place);
            let message =
                "expected columns.status and good (what it says of a sample that counts) together, or neither";
            return Err(InputError::at_line(self.check.file, line, message));
        }
        let keyed = (raw.columns.cycle.is_some(), raw.columns.pose.is_some());
        if keyed.0 != keyed.1 {
            return Err(self.half_key(place));
        }
        Ok(PointsSource {
            files: self.files(place, raw.files, raw.layout)?,
            metres: raw.unit.get_ref().si(),
            columns: raw.columns,
            time: raw.time,
            names: Names {
                pattern,
                rename: raw.rename,
                ignore: raw.ignore,
                first_cycle: raw.first_cycle,
                first_pose: raw.first_pose,
            },
            frame,
            good: raw.good,
            samples: raw.samples.map(Spanned::into_inner),
        })
    }

    fn half_key(&self, place: usize) -> InputError {
        let line = line_of_offset(self.check.text, place);
        InputError::at_line(self.check.file, line, "columns has one of cycle and pose; expected both, or neither")
    }

    fn joints(&self, raw: Spanned<JointsToml>) -> Result<JointsSource, InputError> {
        let place = raw.span().start;
        let raw = raw.into_inner();
        let count = raw.columns.get_ref().joints.len();
        let many =
            |found: usize, what: &str| format!("{what} has {found} entries for {count} joints; expected {count}");
        if count == 0 {
            return Err(self.check.error(&raw.columns, "columns names no joints; expected one column a joint"));
        }
        if let Some(commanded) = raw.columns.get_ref().commanded.as_ref().filter(|commanded| commanded.len() != count) {
            return Err(self.check.error(&raw.columns, many(commanded.len(), "commanded")));
        }
        let units = raw.unit.get_ref().as_slice();
        if units.len() != 1 && units.len() != count {
            return Err(self.check.error(&raw.unit, many(units.len(), "unit")));
        }
        for (list, what) in [(&raw.signs, "signs"), (&raw.offsets, "offsets")] {
            let Some(list) = list else { continue };
            if list.get_ref().len() != count {
                return Err(self.check.error(list, many(list.get_ref().len(), what)));
            }
            let right = |value: &f64| value.is_finite() && (what == "offsets" || value.abs() == 1.0);
            if !list.get_ref().iter().all(right) {
                return Err(self.check.unexpected(
                    list,
                    what,
                    if what == "signs" { "1 or -1 for each" } else { "finite numbers" },
                ));
            }
        }
        let entry = |list: &Option<Spanned<Vec<f64>>>, joint: usize, otherwise: f64| {
            list.as_ref().map_or(otherwise, |list| list.get_ref()[joint])
        };
        let scales = (0..count)
            .map(|joint| {
                let si = units[joint.min(units.len() - 1)].si();
                (si * entry(&raw.signs, joint, 1.0), si * entry(&raw.offsets, joint, 0.0))
            })
            .collect();
        if raw.rows == JointRows::Log && raw.time.is_none() {
            let line = line_of_offset(self.check.text, place);
            return Err(InputError::at_line(self.check.file, line, "rows = \"log\" has no time; expected its column"));
        }
        if let Some(still) = &raw.still {
            let right = |still: &StillToml| above_zero(&still.within) && above_zero(&still.seconds);
            self.check.require(still, right, "still", "within and seconds above 0")?;
        }
        let columns = raw.columns.get_ref();
        if columns.cycle.is_some() != columns.pose.is_some() {
            return Err(self.half_key(place));
        }
        let pattern = self.pattern(raw.visit_pattern.as_ref(), &["cycle", "pose"])?;
        if let Some(pattern) = &pattern
            && !(captures(pattern, "cycle") && captures(pattern, "pose") && columns.visit.is_some())
        {
            let line = line_of_offset(self.check.text, place);
            let message =
                "visit_pattern; expected (?<cycle>…) and (?<pose>…) in it, and the column visit that it is for";
            return Err(InputError::at_line(self.check.file, line, message));
        }
        let gap = if raw.rows == JointRows::Log { LOG_GAP_S } else { VISIT_GAP_S };
        Ok(JointsSource {
            files: self.files(place, raw.files, raw.layout)?,
            rows: raw.rows,
            columns: raw.columns.into_inner(),
            time: raw.time,
            names: Names {
                pattern,
                rename: BTreeMap::new(),
                ignore: Vec::new(),
                first_cycle: raw.first_cycle,
                first_pose: raw.first_pose,
            },
            scales,
            points: raw.points,
            max_gap_s: self.above_zero(raw.max_gap_s.as_ref(), "max_gap_s", gap)?,
            still: raw.still.map_or_else(StillToml::default, Spanned::into_inner),
        })
    }

    fn temperatures(&self, raw: Spanned<TemperaturesToml>) -> Result<TemperatureSource, InputError> {
        let place = raw.span().start;
        let raw = raw.into_inner();
        let columns = raw.columns.get_ref();
        let long = (columns.sensor.is_some(), columns.value.is_some(), columns.sensors.is_empty());
        if !matches!(long, (true, true, true) | (false, false, false)) {
            let message = "columns; expected sensor and value (a row a reading), or sensors (a column a sensor)";
            return Err(self.check.error(&raw.columns, message));
        }
        if raw.time.is_none() && columns.cycle.is_none() {
            return Err(self
                .check
                .error(&raw.columns, "neither time nor cycle; expected one, to know when a row is from"));
        }
        if columns.pose.is_some() && columns.cycle.is_none() {
            return Err(self.half_key(place));
        }
        Ok(TemperatureSource {
            files: self.files(place, raw.files, raw.layout)?,
            columns: raw.columns.into_inner(),
            time: raw.time,
            unit: raw.unit,
            names: Names {
                pattern: None,
                rename: raw.rename,
                ignore: raw.ignore,
                first_cycle: raw.first_cycle,
                first_pose: raw.first_pose,
            },
        })
    }

    fn holders(&self, raw: Spanned<HoldersToml>) -> Result<HoldersSource, InputError> {
        let line = line_of_offset(self.check.text, raw.span().start);
        let raw = raw.into_inner();
        let points = |points: Spanned<PointsToml>| {
            let columns = &points.get_ref().columns;
            if points.get_ref().time.is_some() || columns.cycle.is_some() || columns.pose.is_some() {
                return Err(self.check.error(&points, "holders are measured once; expected no time, cycle or pose"));
            }
            self.points(points)
        };
        Ok(HoldersSource {
            line,
            machine: points(raw.machine)?,
            tracker: points(raw.tracker)?,
            targets: points(raw.targets)?,
            max_residual_m: self.above_zero(raw.max_residual_m.as_ref(), "max_residual_m", MAX_RESIDUAL_M)?,
        })
    }

    /// A pattern, which must match a name as a whole.
    fn pattern(&self, written: Option<&Spanned<String>>, known: &[&str]) -> Result<Option<Regex>, InputError> {
        let Some(written) = written else { return Ok(None) };
        let pattern = Regex::new(&format!("^(?:{})$", written.get_ref())).map_err(|error| {
            // The last line says what is wrong; those before it draw the pattern.
            let reason = error.to_string();
            let reason = reason.lines().last().unwrap_or_default().trim();
            self.check.error(written, format!("the pattern cannot be read: {}", reason.escape_debug()))
        })?;
        match pattern.capture_names().flatten().find(|name| !known.contains(name)) {
            None => Ok(Some(pattern)),
            Some(name) => {
                let message = format!("the pattern has a group {name:?}; expected none but {}", known.join(", "));
                Err(self.check.error(written, message))
            }
        }
    }

    fn above_zero(&self, value: Option<&Spanned<f64>>, what: &str, otherwise: f64) -> Result<f64, InputError> {
        let Some(value) = value else { return Ok(otherwise) };
        self.check.require(value, above_zero, what, "a number above 0")?;
        Ok(*value.get_ref())
    }
}

fn above_zero(value: &f64) -> bool {
    value.is_finite() && *value > 0.0
}

fn captures(pattern: &Regex, group: &str) -> bool {
    pattern.capture_names().flatten().any(|name| name == group)
}
