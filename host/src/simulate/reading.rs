//! Scenario files: reading, and checking with the line of every error.

use std::path::Path;

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::hidden::HiddenEffect;
use super::scenario::{Arm, DrawnPostures, Growth, Heat, Noise, Postures, Scenario, Schedule, Sensors, Tracker};
use crate::input::{InputError, line_of_offset};
use crate::robot::{ParameterId, Robot, shipped};
use crate::run::read_postures;

/// The scenarios that ship with thermokin: name and text.
pub const SHIPPED_SCENARIOS: [(&str, &str); 3] = [
    ("thesis-75-25", include_str!("../../scenarios/thesis-75-25.toml")),
    ("thesis-90-30", include_str!("../../scenarios/thesis-90-30.toml")),
    ("small", include_str!("../../scenarios/small.toml")),
];

/// A scenario as its file says it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ScenarioFile {
    format: i64,
    name: String,
    seed: u64,
    arm: Arm,
    schedule: Schedule,
    postures: Postures,
    heat: Heat,
    #[serde(default)]
    growth: Vec<Growth>,
    sensors: Sensors,
    instrument: Tracker,
    #[serde(default)]
    effect: Vec<HiddenEffect>,
}

/// One step on the way to a value of the file.
#[derive(Debug, Clone, Copy)]
enum Step<'a> {
    Key(&'a str),
    Index(usize),
}

impl<'a> From<&'a str> for Step<'a> {
    fn from(key: &'a str) -> Self {
        Step::Key(key)
    }
}

impl From<usize> for Step<'_> {
    fn from(index: usize) -> Self {
        Step::Index(index)
    }
}

/// The way to a value, from the top of the file.
macro_rules! way {
    ($($step:expr),+) => { &[$(Step::from($step)),+] };
}

struct Checker<'a> {
    file: &'a Path,
    text: &'a str,
    content: Spanned<DeTable<'a>>,
}

impl Checker<'_> {
    /// The line of a value, or of the innermost table around it that is in the file.
    fn line(&self, way: &[Step<'_>]) -> usize {
        let mut offset = self.content.span().start;
        let mut value: Option<&Spanned<DeValue<'_>>> = None;
        for (depth, step) in way.iter().enumerate() {
            let next = match (step, value.map(|value| value.as_ref())) {
                (Step::Key(key), None) if depth == 0 => self.content.as_ref().get(*key),
                (Step::Key(key), Some(DeValue::Table(table))) => table.get(*key),
                (Step::Index(index), Some(DeValue::Array(array))) => array.get(*index),
                _ => None,
            };
            match next {
                Some(next) => offset = next.span().start,
                None => break,
            }
            value = next;
        }
        line_of_offset(self.text, offset)
    }

    fn error(&self, way: &[Step<'_>], message: impl Into<String>) -> InputError {
        InputError::at_line(self.file, self.line(way), message)
    }

    fn require(&self, way: &[Step<'_>], value: f64, right: bool, expected: &str) -> Result<(), InputError> {
        if right && value.is_finite() {
            return Ok(());
        }
        let name = way.iter().rev().find_map(|step| match step {
            Step::Key(key) => Some(*key),
            Step::Index(_) => None,
        });
        Err(self.error(way, format!("{} is {value}, expected {expected}", name.unwrap_or("value"))))
    }

    fn finite(&self, way: &[Step<'_>], value: f64) -> Result<(), InputError> {
        self.require(way, value, true, "a finite number")
    }

    fn positive(&self, way: &[Step<'_>], value: f64) -> Result<(), InputError> {
        self.require(way, value, value > 0.0, "more than 0")
    }

    fn not_negative(&self, way: &[Step<'_>], value: f64) -> Result<(), InputError> {
        self.require(way, value, value >= 0.0, "0 or more")
    }

    fn share(&self, way: &[Step<'_>], value: f64) -> Result<(), InputError> {
        self.require(way, value, (0.0..=1.0).contains(&value), "a share from 0 to 1")
    }

    fn range(&self, way: &[Step<'_>], [low, high]: [f64; 2]) -> Result<(), InputError> {
        if low.is_finite() && high.is_finite() && 0.0 <= low && low <= high {
            return Ok(());
        }
        Err(self.error(way, format!("the range is {low} to {high}, expected two numbers from 0 on, the lower first")))
    }

    /// One number a joint.
    fn per_joint(&self, way: &[Step<'_>], values: &[f64], joints: usize) -> Result<(), InputError> {
        if values.len() == joints && values.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        Err(self.error(way, format!("{} numbers, expected a finite one for each of {joints} joints", values.len())))
    }

    fn name(&self, way: &[Step<'_>], name: &str) -> Result<(), InputError> {
        if !name.is_empty() && name.trim() == name && !name.chars().any(char::is_control) {
            return Ok(());
        }
        Err(self.error(way, format!("the name is {name:?}, expected one line without spaces around it")))
    }

    fn arm(&self, arm: &Arm, robot: &Robot) -> Result<(), InputError> {
        for (name, value) in [
            ("length_error_m", arm.length_error_m),
            ("angle_error_rad", arm.angle_error_rad),
            ("base_length_error_m", arm.base_length_error_m),
            ("base_angle_error_rad", arm.base_angle_error_rad),
            ("target_error_m", arm.target_error_m),
            ("repeatability_m", arm.repeatability_m),
            ("transmission_error_rad", arm.transmission_error_rad),
            ("payload_kg", arm.payload_kg.unwrap_or(0.0)),
        ] {
            self.not_negative(way!["arm", name], value)?;
        }
        self.finite(way!["arm", "reference_c"], arm.reference_c)?;
        let chain = robot.chain();
        for (name, &value) in &arm.offsets {
            let way = way!["arm", "offsets", name.as_str()];
            let id: ParameterId = name.parse().map_err(|error| self.error(way, format!("{error}")))?;
            if chain.place(id).is_none() {
                return Err(self.error(way, format!("{} has no parameter {id}", robot.name)));
            }
            self.finite(way, value)?;
        }
        for (name, place) in &arm.targets {
            let way = way!["arm", "targets", name.as_str()];
            if robot.target(name).is_none() {
                return Err(self.error(way, format!("{} has no target {name}", robot.name)));
            }
            place.iter().try_for_each(|&value| self.finite(way, value))?;
        }
        if robot.targets.is_empty() {
            return Err(self.error(way!["arm", "robot"], format!("{} has no target to measure", robot.name)));
        }
        for target in &robot.targets {
            if target.position.is_none() && !arm.targets.contains_key(&target.name) {
                let message = format!(
                    "target {0} has no position, expected its true one in [arm.targets]: {0} = [x, y, z]",
                    target.name
                );
                return Err(self.error(way!["arm", "targets"], message));
            }
        }
        Ok(())
    }

    fn schedule(&self, schedule: &Schedule, robot: &Robot, postures: usize) -> Result<(), InputError> {
        for (name, value) in [
            ("rest_s", schedule.rest_s),
            ("pause_s", schedule.pause_s),
            ("speed_spread", schedule.speed_spread),
            ("settle_s", schedule.settle_s),
        ] {
            self.not_negative(way!["schedule", name], value)?;
        }
        self.positive(way!["schedule", "target_s"], schedule.target_s)?;
        self.share(way!["schedule", "measure_override"], schedule.measure_override)?;
        self.range(way!["schedule", "cycle_s"], schedule.cycle_s)?;
        self.range(way!["schedule", "transit_s"], schedule.transit_s)?;
        self.positive(way!["schedule", "transit_s"], schedule.transit_s[0])?;
        self.per_joint(way!["schedule", "rms_speed"], &schedule.rms_speed, robot.joint_count())?;
        for (number, &speed) in schedule.rms_speed.iter().enumerate() {
            self.not_negative(way!["schedule", "rms_speed", number], speed)?;
        }
        for (number, phase) in schedule.phases.iter().enumerate() {
            self.share(way!["schedule", "phases", number, "override"], phase.speed_override)?;
            for (place, &joint) in phase.joints.iter().flatten().enumerate() {
                let expected = format!("a joint from 1 to {}", robot.joint_count());
                let known = (1..=robot.joint_count()).contains(&joint);
                self.require(way!["schedule", "phases", number, "joints", place], joint as f64, known, &expected)?;
            }
        }
        let longest = schedule.longest_measurement_s(postures, robot.targets.len());
        if schedule.cycle_s[0] <= longest + schedule.pause_s {
            let message = format!(
                "the shortest cycle is {} s, but pause and measurement take up to {:.0} s of it; expected more",
                schedule.cycle_s[0],
                longest + schedule.pause_s
            );
            return Err(self.error(way!["schedule", "cycle_s"], message));
        }
        Ok(())
    }

    fn postures(&self, postures: &Postures, robot: &Robot) -> Result<usize, InputError> {
        let joints = robot.joint_count();
        match (&postures.joints, &postures.drawn) {
            _ if postures.file.is_some() => {
                Err(self
                    .error(way!["postures"], "expected one of joints = [[…], …], file = \"…\" and [postures.drawn]"))
            }
            (Some(given), None) => {
                if given.is_empty() {
                    return Err(self.error(way!["postures", "joints"], "no posture, expected at least one"));
                }
                for (number, posture) in given.iter().enumerate() {
                    self.per_joint(way!["postures", "joints", number], posture, joints)?;
                }
                Ok(given.len())
            }
            (None, Some(drawn)) => {
                self.drawn(drawn, joints)?;
                Ok(drawn.count)
            }
            _ => {
                Err(self
                    .error(way!["postures"], "expected one of joints = [[…], …], file = \"…\" and [postures.drawn]"))
            }
        }
    }

    fn drawn(&self, drawn: &DrawnPostures, joints: usize) -> Result<(), InputError> {
        let expected = "1 to 1000";
        self.require(
            way!["postures", "drawn", "count"],
            drawn.count as f64,
            (1..=1000).contains(&drawn.count),
            expected,
        )?;
        for (name, values) in [("min", &drawn.min), ("max", &drawn.max)] {
            self.per_joint(way!["postures", "drawn", name], values, joints)?;
        }
        for (number, (&min, &max)) in drawn.min.iter().zip(&drawn.max).enumerate() {
            let expected = format!("at least the {min} of min");
            self.require(way!["postures", "drawn", "max", number], max, min <= max, &expected)?;
        }
        self.positive(way!["postures", "drawn", "facing_rad"], drawn.facing_rad.unwrap_or(1.0))?;
        self.finite(way!["postures", "drawn", "lowest_m"], drawn.lowest_m.unwrap_or(0.0))
    }

    fn heat(&self, heat: &Heat, robot: &Robot) -> Result<(), InputError> {
        self.positive(way!["heat", "step_s"], heat.step_s)?;
        self.finite(way!["heat", "floor_c"], heat.floor_c)?;
        self.not_negative(way!["heat", "floor_w_per_k"], heat.floor_w_per_k)?;
        let ambient = &heat.ambient;
        for (name, value) in [
            ("start_c", ambient.start_c),
            ("trend_k_per_h", ambient.trend_k_per_h),
            ("swing_k", ambient.swing_k),
            ("swing_phase_rad", ambient.swing_phase_rad),
        ] {
            self.finite(way!["heat", "ambient", name], value)?;
        }
        self.positive(way!["heat", "ambient", "swing_s"], ambient.swing_s)?;
        if heat.links.len() != robot.transforms.len() {
            let message = format!(
                "{} links, expected {}: one for each transform of {}, the base's first",
                heat.links.len(),
                robot.transforms.len(),
                robot.name
            );
            return Err(self.error(way!["heat", "links"], message));
        }
        for (number, link) in heat.links.iter().enumerate() {
            for (name, value) in [
                ("core_j_per_k", link.core_j_per_k),
                ("housing_j_per_k", link.housing_j_per_k),
                ("inside_w_per_k", link.inside_w_per_k),
                ("air_w_per_k", link.air_w_per_k),
            ] {
                self.positive(way!["heat", "links", number, name], value)?;
            }
            self.not_negative(way!["heat", "links", number, "next_w_per_k"], link.next_w_per_k)?;
            self.not_negative(way!["heat", "links", number, "moving_w_per_k"], link.moving_w_per_k)?;
        }
        let joints = robot.joint_count();
        if heat.joints.len() != joints {
            let message = format!("{} joints, expected {joints} as {} has", heat.joints.len(), robot.name);
            return Err(self.error(way!["heat", "joints"], message));
        }
        for (number, joint) in heat.joints.iter().enumerate() {
            for (name, value) in
                [("holding_w", joint.holding_w), ("coulomb", joint.coulomb), ("viscous", joint.viscous)]
            {
                self.not_negative(way!["heat", "joints", number, name], value)?;
            }
            self.share(way!["heat", "joints", number, "beyond"], joint.beyond)?;
        }
        Ok(())
    }

    fn growth(&self, growth: &[Growth], robot: &Robot) -> Result<(), InputError> {
        let chain = robot.chain();
        for (number, one) in growth.iter().enumerate() {
            let id = one.parameter.0;
            if chain.place(id).is_none() {
                let message = format!("{} has no parameter {id}", robot.name);
                return Err(self.error(way!["growth", number, "parameter"], message));
            }
            if growth[..number].iter().any(|other| other.parameter == one.parameter) {
                let message = format!("a second [[growth]] of {id}, expected one a parameter");
                return Err(self.error(way!["growth", number, "parameter"], message));
            }
            for (place, term) in one.terms.iter().enumerate() {
                self.finite(way!["growth", number, "terms", place, "per_k"], term.per_k)?;
                if term.link >= robot.transforms.len() {
                    let message = format!("link {}, but the last is {}", term.link, robot.transforms.len() - 1);
                    return Err(self.error(way!["growth", number, "terms", place, "link"], message));
                }
            }
        }
        Ok(())
    }

    fn sensors(&self, sensors: &Sensors, robot: &Robot) -> Result<(), InputError> {
        self.positive(way!["sensors", "period_s"], sensors.period_s)?;
        self.positive(way!["sensors", "response_s"], sensors.response_s)?;
        for (name, value) in [
            ("jitter_s", sensors.jitter_s),
            ("bias_k", sensors.bias_k),
            ("noise_k", sensors.noise_k),
            ("chill_k", sensors.chill_k),
        ] {
            self.not_negative(way!["sensors", name], value)?;
        }
        self.range(way!["sensors", "core_share"], sensors.core_share)?;
        self.share(way!["sensors", "core_share"], sensors.core_share[1])?;
        if let Some(ambient) = &sensors.ambient {
            self.name(way!["sensors", "ambient"], ambient)?;
            if robot.sensor(ambient).is_some() {
                let message = format!("{ambient} is a sensor of the arm, expected another name");
                return Err(self.error(way!["sensors", "ambient"], message));
            }
        }
        Ok(())
    }

    fn instrument(&self, tracker: &Tracker) -> Result<(), InputError> {
        self.name(way!["instrument", "name"], &tracker.name)?;
        tracker.position.iter().try_for_each(|&value| self.finite(way!["instrument", "position"], value))?;
        self.positive(way!["instrument", "readings"], f64::from(tracker.readings))?;
        for (name, Noise { sigma_m, sigma_per_m }) in [("radial", tracker.radial), ("transverse", tracker.transverse)] {
            self.not_negative(way!["instrument", name, "sigma_m"], sigma_m)?;
            self.not_negative(way!["instrument", name, "sigma_per_m"], sigma_per_m)?;
        }
        let broken = tracker.broken_beam;
        self.require(way!["instrument", "broken_beam"], broken, (0.0..1.0).contains(&broken), "from 0 to below 1")
    }
}

impl Scenario {
    /// Reads the text of a scenario; `file` is named in errors, and a robot's path is relative to its folder.
    ///
    /// # Errors
    /// The first thing that is wrong, with its line: unknown keys, values out of range, names that do not exist; also
    /// what is wrong with the robot's own file.
    pub fn parse(file: &Path, text: &str) -> Result<Self, InputError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let complain = |error: toml::de::Error| InputError::of_toml(file, text, &error);
        let content = DeTable::parse(text).map_err(complain)?;
        let read: ScenarioFile = toml::from_str(text).map_err(complain)?;
        let checker = Checker { file, text, content };
        checker.require(way!["format"], read.format as f64, read.format == 1, "1")?;
        checker.name(way!["name"], &read.name)?;
        let robot = match shipped(&read.arm.robot) {
            Some(robot) => robot,
            None if read.arm.robot.ends_with(".toml") => {
                Robot::read(&file.parent().unwrap_or(Path::new("")).join(&read.arm.robot))?
            }
            None => {
                let names: Vec<&str> = crate::robot::SHIPPED.iter().map(|(name, _)| *name).collect();
                let message = format!(
                    "no robot '{}' ships, expected the path of a .toml or one of {}",
                    read.arm.robot,
                    names.join(", ")
                );
                return Err(checker.error(way!["arm", "robot"], message));
            }
        };
        checker.arm(&read.arm, &robot)?;
        let mut read = read;
        if let Postures { joints: None, file: Some(named), drawn: None } = &read.postures {
            let table = file.parent().unwrap_or(Path::new("")).join(named);
            let rows = read_postures(&table)?;
            if let Some(row) = rows.iter().find(|row| row.len() != robot.joint_count()) {
                let message = format!("has {} joints, expected the arm's {}", row.len(), robot.joint_count());
                return Err(InputError::at_line(&table, 1, message));
            }
            read.postures = Postures { joints: Some(rows), file: None, drawn: None };
        }
        let postures = checker.postures(&read.postures, &robot)?;
        checker.schedule(&read.schedule, &robot, postures)?;
        checker.heat(&read.heat, &robot)?;
        checker.growth(&read.growth, &robot)?;
        checker.sensors(&read.sensors, &robot)?;
        checker.instrument(&read.instrument)?;
        let ScenarioFile {
            name,
            seed,
            arm,
            schedule,
            postures,
            heat,
            growth,
            sensors,
            instrument,
            effect: effects,
            ..
        } = read;
        let scenario = Self { name, seed, robot, arm, schedule, postures, heat, growth, sensors, instrument, effects };
        if !scenario.effects.is_empty() {
            // Whether an effect does anything can only be told by its doing it.
            if let Err(super::SimulationError::Effect { number, message }) = super::simulate(&scenario) {
                return Err(checker.error(way!["effect", number], message));
            }
        }
        Ok(scenario)
    }

    /// Reads a scenario file.
    ///
    /// # Errors
    /// See [`Scenario::parse`]; also a file that cannot be read.
    pub fn read(file: &Path) -> Result<Self, InputError> {
        let text = std::fs::read_to_string(file)
            .map_err(|error| InputError::of_file(file, format!("cannot be read: {error}")))?;
        Self::parse(file, &text)
    }

    /// A shipped scenario by its name.
    pub fn shipped(name: &str) -> Option<Self> {
        let (_, text) = SHIPPED_SCENARIOS.iter().find(|(own, _)| *own == name)?;
        // The texts are part of the program and a test reads every one of them.
        Some(Self::parse(Path::new(name), text).expect("a shipped scenario is valid"))
    }
}
