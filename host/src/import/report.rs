//! What an import found, and what did not match.

use serde::Serialize;

use super::holders::Registration;
use super::join::Miss;
use super::positions::Sample;
use super::postures::Stand;
use super::readings::{Reading, When};
use super::source::{Key, Source};
use super::{average, sensors};
use crate::robot::Robot;
use crate::run::{Run, SensorJoin};

/// What an import found, and what did not match. Lengths in m, times in s since the run began.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Report {
    /// Visits of postures in the run.
    pub visits: usize,
    /// Different cycles.
    pub cycles: usize,
    /// Different postures.
    pub poses: usize,
    /// Joints of the arm.
    pub joints: usize,
    /// The measured names.
    pub targets: Vec<String>,
    /// Measured positions in the run.
    pub points: usize,
    /// Measurements that gave nothing.
    pub broken_beams: usize,
    /// Rows of the tracker that were joined by cycle and pose.
    pub joined_by_key: usize,
    /// Rows of the tracker that were joined by time.
    pub joined_by_time: usize,
    /// The tracker's rows.
    pub samples: Samples,
    /// Measurements without a posture; rows in a row of one target for one reason stand together.
    pub unmatched_points: Vec<Unmatched>,
    /// Postures without a measurement.
    pub unmatched_visits: Vec<Unmatched>,
    /// Temperatures of visits that do not exist.
    pub unmatched_readings: Vec<Unmatched>,
    /// Cells of temperature without a reading.
    pub empty_readings: usize,
    /// How each sensor's temperatures at the visits came about.
    pub sensors: Vec<SensorReport>,
    /// The registration of the holders.
    pub holders: Option<Registration>,
    /// What else was odd, in words.
    pub notes: Vec<String>,
}

/// What became of the tracker's rows.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Samples {
    /// Rows that belong to a visit.
    pub read: usize,
    /// Rows that made points.
    pub used: usize,
    /// Rows without a position: the beam was broken.
    pub not_seen: usize,
    /// Rows that were left out because the others of their point contradict them.
    pub dropped: usize,
    /// Rows that belong to no visit.
    pub unmatched: usize,
    /// Rows whose names the mapping passes over.
    pub passed_over: usize,
    /// 1-sigma of one coordinate of a sample, m: the median over the points.
    pub spread_median_m: Option<f64>,
    /// The greatest.
    pub spread_max_m: Option<f64>,
    /// Of each averaged point.
    #[serde(skip)]
    pub(super) spreads_m: Vec<f64>,
}

/// Something that found no partner.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unmatched {
    /// The file.
    pub file: String,
    /// The (first) line, counted from 1.
    pub line: usize,
    /// How many rows.
    pub rows: usize,
    /// The target or the sensor.
    pub name: Option<String>,
    /// Where it is known.
    pub cycle: Option<u32>,
    /// Where it is known.
    pub pose: Option<u32>,
    /// Where it is known.
    pub time_s: Option<f64>,
    /// Why.
    pub reason: &'static str,
}

/// How a sensor's temperatures at the visits came about: the three counts add up to the visits.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorReport {
    /// The sensor.
    pub sensor: String,
    /// The longest gap that was bridged, s.
    pub max_gap_s: f64,
    /// Visits with readings on both sides.
    pub interpolated: usize,
    /// Visits that take the nearest reading.
    pub held: usize,
    /// Visits without a temperature.
    pub missing: usize,
}

impl From<SensorJoin> for SensorReport {
    fn from(join: SensorJoin) -> Self {
        let SensorJoin { sensor, max_gap_s, interpolated, held, missing, spread_k: _ } = join;
        Self { sensor, max_gap_s, interpolated, held, missing }
    }
}

fn file_of(sources: &[Vec<Source>], (table, file): (usize, usize)) -> String {
    sources[table][file].path.display().to_string()
}

impl Unmatched {
    pub(super) fn of_sample(sample: &Sample, time_s: Option<f64>, miss: Miss, sources: &[Vec<Source>]) -> Self {
        Self {
            file: file_of(sources, sample.source),
            line: sample.line,
            rows: 1,
            name: Some(sample.target.clone()),
            cycle: sample.key.map(|key| key.0),
            pose: sample.key.map(|key| key.1),
            time_s,
            reason: miss.words(),
        }
    }

    pub(super) fn of_stand(stand: &Stand, key: Option<Key>, reason: &'static str, sources: &[Vec<Source>]) -> Self {
        Self {
            file: file_of(sources, stand.row.source),
            line: stand.row.line,
            rows: 1,
            name: None,
            cycle: key.map(|key| key.0),
            pose: key.map(|key| key.1),
            time_s: stand.time_s(),
            reason,
        }
    }

    pub(super) fn of_reading(reading: &Reading, sensor: &str, sources: &[Vec<Source>]) -> Self {
        let (cycle, pose) = match reading.when {
            When::During(cycle, pose) => (Some(cycle), pose),
            When::At(_) => (None, None),
        };
        Self {
            file: file_of(sources, reading.source),
            line: reading.line,
            rows: 1,
            name: Some(sensor.to_owned()),
            cycle,
            pose,
            time_s: None,
            reason: "no visit of that cycle and pose",
        }
    }

    /// Whether another row is one more sample of the same point, as far as can be told.
    pub(super) fn is_same_point(&self, other: &Self) -> bool {
        (&self.file, &self.name, self.cycle, self.pose, self.reason)
            == (&other.file, &other.name, other.cycle, other.pose, other.reason)
    }
}

impl Report {
    /// Whether everything found its partner.
    pub fn is_complete(&self) -> bool {
        self.unmatched_points.is_empty()
            && self.unmatched_visits.is_empty()
            && self.unmatched_readings.is_empty()
            && self.sensors.iter().all(|sensor| sensor.missing == 0)
    }

    /// Counts what the run has, and says what it lacks beside its robot.
    pub(super) fn finish(
        &mut self,
        run: &Run,
        robot: &Robot,
        holders: Option<Registration>,
        by_key: usize,
        by_time: usize,
        notes: Vec<String>,
    ) {
        let mut poses: Vec<u32> = run.visits.iter().map(|visit| visit.pose).collect();
        poses.sort_unstable();
        poses.dedup();
        self.visits = run.visits.len();
        self.cycles = run.cycles().len();
        self.poses = poses.len();
        self.joints = run.joint_count();
        self.targets = run.target_names.clone();
        self.points = run.point_count();
        self.broken_beams = run.visits.iter().map(|visit| visit.broken_beams.len()).sum();
        (self.joined_by_key, self.joined_by_time) = (by_key, by_time);
        let mut spreads = std::mem::take(&mut self.samples.spreads_m);
        if !spreads.is_empty() {
            self.samples.spread_median_m = Some(average::median(&mut spreads));
            self.samples.spread_max_m = spreads.last().copied();
        }
        self.sensors = sensors(run);
        self.holders = holders;
        self.notes.extend(notes);
        if !robot.targets.is_empty() {
            for name in &run.target_names {
                if robot.target(name).is_none() && !robot.monuments.contains(name) {
                    self.notes.push(format!(
                        "{name} is neither a [[target]] nor a [[monument]] of the robot: rename or ignore it, or add it there"
                    ));
                }
            }
        }
        let Some(log) = &run.temperatures else { return };
        let silent: Vec<&str> = robot.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
        let silent: Vec<&str> = silent.into_iter().filter(|name| log.index_of(name).is_none()).collect();
        if !silent.is_empty() {
            self.notes.push(format!("sensors of the robot without a reading: {}", silent.join(", ")));
        }
        for name in &log.sensors {
            if robot.sensor(name).is_none() && run.description.ambient.as_ref() != Some(name) {
                self.notes.push(format!("the sensor {name} is none of the robot's: calibration will not use it"));
            }
        }
    }
}
