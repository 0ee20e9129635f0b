//! Run folders from what laboratories have: exports of trackers, logs of controllers, logs of temperatures.
//!
//! A mapping (import.toml) says which file holds what. Rows are read by `positions`, `postures` and `readings` through
//! `source`, which knows about foreign tables; `join` finds the visit of each sample, `average` makes points of samples, and
//! `holders` finds the targets in the flange frame. The disk is asked in [`Mapping::load`] and nowhere else.

mod average;
mod holders;
mod join;
mod mapping;
mod positions;
mod postures;
mod readings;
mod report;
mod source;
mod time;

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use nalgebra::Vector3;

pub use holders::{HolderFiles, HolderResidual, PlacedTarget, Registration};
pub use mapping::Mapping;
pub use report::{Report, Samples, SensorReport, Unmatched};
pub use source::Source;

use crate::input::InputError;
use crate::robot::{Robot, Target, shipped};
use crate::run::{BrokenBeam, JoinOptions, Point, Run, RunDescription, RunFiles, TemperatureLog, Visit, WriteError};
use average::{average, usual_spread};
use join::{Join, join};
use mapping::{JointRows, RobotSource};
use positions::Sample;
use postures::Stand;
use readings::{Readings, When};
use source::Key;
use time::Moment;

/// What a robot's description is called in the run's folder.
const ROBOT_FILE: &str = "robot.toml";

/// The files that a mapping names, as bytes; a list for each of its tables, in the order of the mapping.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Loaded {
    /// Of each `[[tracker]]`.
    pub tracker: Vec<Vec<Source>>,
    /// Of each `[[joints]]`.
    pub joints: Vec<Vec<Source>>,
    /// Of each `[[temperatures]]`.
    pub temperatures: Vec<Vec<Source>>,
    /// Of `[holders]`.
    pub holders: Option<HolderFiles>,
    /// The robot's description, where it does not ship.
    pub robot: Option<Source>,
}

/// A run that was put together, not yet written.
#[derive(Debug, Clone)]
pub struct Imported {
    /// The run; its folder and robot are those of [`Imported::files`].
    pub run: Run,
    /// The text of its robot.toml.
    pub robot: String,
    /// What was found, and what did not match.
    pub report: Report,
}

impl Imported {
    /// The files of the run's folder.
    ///
    /// # Errors
    /// A run that could not be read back.
    pub fn files(&self, folder: &Path) -> Result<RunFiles, WriteError> {
        let mut run = self.run.clone();
        run.folder = folder.to_owned();
        run.description.robot = folder.join(ROBOT_FILE);
        let mut files = RunFiles::of(&run, folder)?;
        files.robot = Some((ROBOT_FILE.into(), self.robot.clone().into_bytes()));
        Ok(files)
    }
}

impl Mapping {
    /// Takes the files that the mapping names into memory, unchecked.
    ///
    /// # Errors
    /// A file that is not there or cannot be read.
    pub fn load(&self) -> Result<Loaded, InputError> {
        let holders = match &self.holders {
            None => None,
            Some(holders) => {
                let load = |points: &mapping::PointsSource| points.files.load(self);
                Some([load(&holders.machine)?, load(&holders.tracker)?, load(&holders.targets)?])
            }
        };
        let robot = match &self.robot {
            RobotSource::Shipped(_) => None,
            RobotSource::File(path) => {
                let bytes = std::fs::read(path)
                    .map_err(|error| InputError::of_file(path, format!("cannot be read: {error}")))?;
                Some(Source { path: path.clone(), bytes })
            }
        };
        Ok(Loaded {
            tracker: self.tracker.iter().map(|points| points.files.load(self)).collect::<Result<_, _>>()?,
            joints: self.joints.iter().map(|joints| joints.files.load(self)).collect::<Result<_, _>>()?,
            temperatures: self.temperatures.iter().map(|log| log.files.load(self)).collect::<Result<_, _>>()?,
            holders,
            robot,
        })
    }

    /// Puts a run together. The disk is not asked.
    ///
    /// # Errors
    /// The first thing that is wrong with a file, with its line; files that have nothing in common.
    pub fn import(&self, loaded: &Loaded) -> Result<Imported, InputError> {
        let mut notes = Vec::new();
        let (mut robot, mut robot_text) = self.robot(loaded)?;
        let (mut samples, mut passed) = (Vec::new(), 0);
        for (index, (points, sources)) in self.tracker.iter().zip(&loaded.tracker).enumerate() {
            let (read, others) = positions::read(points, index, sources, &mut notes)?;
            samples.extend(read);
            passed += others;
        }
        let mut rows = Vec::new();
        for (index, (joints, sources)) in self.joints.iter().zip(&loaded.joints).enumerate() {
            rows.push(postures::read(joints, index, sources, &mut notes)?);
        }
        let mut readings = Readings::default();
        for (index, (log, sources)) in self.temperatures.iter().zip(&loaded.temperatures).enumerate() {
            readings.read(log, index, sources, &mut notes)?;
        }
        let registration = match (&self.holders, &loaded.holders) {
            (Some(holders), Some(files)) => Some(holders::register(&self.file, holders, files, &mut notes)?),
            _ => None,
        };
        if let Some(registration) = &registration {
            place_targets(&mut robot, registration);
            robot_text = robot.to_toml();
        }

        let moments = samples.iter().filter_map(|sample| sample.moment);
        let moments = moments.chain(rows.iter().flatten().filter_map(|row| row.moment));
        let logged = readings.readings.iter().filter_map(|reading| match reading.when {
            When::At(moment) => Some(moment),
            When::During(..) => None,
        });
        let start_ns = self.start(moments, logged)?;
        let stands: Vec<Stand> =
            self.joints.iter().zip(rows).flat_map(|(joints, rows)| postures::stands(joints, rows, start_ns)).collect();
        self.check_stands(&robot, &stands, loaded)?;
        let times_s: Vec<Option<f64>> =
            samples.iter().map(|sample| sample.moment.map(|moment| moment.since(start_ns))).collect();
        let joined = join(&samples, &times_s, &stands, &self.joints, self.same_posture);
        if !joined.stands.iter().any(Result::is_ok) {
            return Err(self.nothing_in_common(&samples, &joined, loaded));
        }

        let mut report = Report::default();
        let (visits, target_names) = self.visits(&samples, &times_s, stands, &joined, loaded, &mut report)?;
        self.report_misses(&samples, &times_s, &joined, loaded, &mut report);
        report.samples.passed_over = passed;
        let temperatures = self.log(&readings, &visits, start_ns, loaded, &mut report);
        if !visits.iter().any(|visit| visit.cycle == self.reference_cycle) {
            let message = format!(
                "reference_cycle is {}, but no visit is of that cycle; expected one that is",
                self.reference_cycle
            );
            return Err(InputError::of_file(&self.file, message));
        }
        let run = Run {
            folder: PathBuf::new(),
            description: RunDescription {
                name: self.name.clone(),
                robot: ROBOT_FILE.into(),
                reference_cycle: self.reference_cycle,
                ambient: self.ambient.clone(),
                instrument: self.instrument.clone(),
                anchors: Vec::new(),
            },
            visits,
            target_names,
            temperatures,
            motion: Vec::new(),
            notes: Vec::new(),
        };
        report.finish(&run, &robot, registration, joined.by_key, joined.by_time, notes);
        Ok(Imported { run, robot: robot_text, report })
    }

    fn robot(&self, loaded: &Loaded) -> Result<(Robot, String), InputError> {
        match (&self.robot, &loaded.robot) {
            (RobotSource::File(path), source) => {
                let bytes = source.as_ref().map_or(&[][..], |source| &source.bytes);
                let text = str::from_utf8(bytes)
                    .map_err(|_| InputError::of_file(path, "is not UTF-8 text; expected TOML in UTF-8"))?;
                Ok((Robot::parse(path, text)?, text.to_owned()))
            }
            (RobotSource::Shipped(name), _) => {
                let robot = shipped(name)
                    .ok_or_else(|| InputError::of_file(&self.file, format!("no robot {name} ships with thermokin")))?;
                let text = robot.to_toml();
                Ok((robot, text))
            }
        }
    }

    /// When the run began, in nanoseconds since 1970: what the mapping says, or the first date of a measurement.
    fn start(
        &self,
        measured: impl Iterator<Item = Moment> + Clone,
        logged: impl Iterator<Item = Moment> + Clone,
    ) -> Result<i128, InputError> {
        if let Some(start_ns) = self.start_ns {
            return Ok(start_ns);
        }
        let date = |moment| match moment {
            Moment::Date(ns, offset_s) => Some(ns + (offset_s * 1e9) as i128),
            Moment::Seconds(_) => None,
        };
        let mut all = measured.clone().chain(logged);
        let mixed = all.clone().any(|moment| date(moment).is_some()) && all.any(|moment| date(moment).is_none());
        if mixed {
            let message =
                "some times are dates and others seconds since the run began; expected start, the date when it did";
            return Err(InputError::of_file(&self.file, message));
        }
        Ok(measured.filter_map(date).min().unwrap_or(0))
    }

    fn check_stands(&self, robot: &Robot, stands: &[Stand], loaded: &Loaded) -> Result<(), InputError> {
        let expected = robot.joint_count();
        for joints in &self.joints {
            let found = joints.columns.joints.len();
            if found != expected {
                let message =
                    format!("[[joints]] names {found} joints, but {} has {expected}; expected as many", robot.name);
                return Err(InputError::at_line(&self.file, joints.files.line, message));
            }
        }
        let keyed = stands.iter().filter(|stand| stand.row.key.is_some()).count();
        if keyed > 0 && keyed < stands.len() {
            let message = "some [[joints]] say cycle and pose and others do not; expected all of them to, or none";
            return Err(InputError::of_file(&self.file, message));
        }
        let mut lines: HashMap<Key, &Stand> = HashMap::new();
        for stand in stands {
            let Some(key) = stand.row.key else { continue };
            if let Some(earlier) = lines.insert(key, stand) {
                let message = format!(
                    "cycle {}, pose {} stands in {} already; expected each visit once",
                    key.0,
                    key.1,
                    place_of(&loaded.joints, earlier.row.source, earlier.row.line)
                );
                let (table, file) = stand.row.source;
                return Err(InputError::at_line(&loaded.joints[table][file].path, stand.row.line, message));
            }
        }
        Ok(())
    }

    fn nothing_in_common(&self, samples: &[Sample], joined: &Join, loaded: &Loaded) -> InputError {
        let Some((sample, Err(miss))) = samples.iter().zip(&joined.stands).next() else {
            return InputError::of_file(&self.file, "the tracker's files hold no position; expected one at least");
        };
        let (table, file) = sample.source;
        let message = format!("no position belongs to any posture: of this one, {}", miss.words());
        InputError::at_line(&loaded.tracker[table][file].path, sample.line, message)
    }

    /// The visits with their points.
    fn visits(
        &self,
        samples: &[Sample],
        times_s: &[Option<f64>],
        stands: Vec<Stand>,
        joined: &Join,
        loaded: &Loaded,
        report: &mut Report,
    ) -> Result<(Vec<Visit>, Vec<String>), InputError> {
        let mut targets: Vec<&str> = Vec::new();
        let mut index: HashMap<&str, usize> = HashMap::new();
        let mut groups: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
        for (number, (sample, stand)) in samples.iter().zip(&joined.stands).enumerate() {
            let Ok(stand) = *stand else { continue };
            let target = *index.entry(&sample.target).or_insert_with(|| {
                targets.push(&sample.target);
                targets.len() - 1
            });
            groups.entry((stand, target)).or_default().push(number);
        }
        let mut points: BTreeMap<usize, Vec<OfTarget>> = BTreeMap::new();
        for (source, of_source) in by_source(&groups, samples) {
            let rule = self.tracker[source].samples;
            let seen: Vec<Vec<Vector3<f64>>> = of_source
                .iter()
                .map(|(_, numbers)| numbers.iter().filter_map(|&number| samples[number].seen).collect())
                .collect();
            let usual = usual_spread(seen.iter().map(Vec::as_slice));
            for (&(&(stand, target), numbers), seen) in of_source.iter().zip(&seen) {
                let not_seen = numbers.len() - seen.len();
                report.samples.read += numbers.len();
                report.samples.not_seen += not_seen;
                let measured = match (&rule, seen.as_slice()) {
                    (_, []) => None,
                    (None, [position]) => {
                        let sigma_m = numbers.iter().find_map(|&number| samples[number].sigma_m);
                        report.samples.used += 1;
                        Some(Measured { position: *position, sigma_m })
                    }
                    (None, _) => return Err(twice(samples, numbers, targets[target], loaded)),
                    (Some(rule), seen) => average(seen, &usual, rule).map(|average| {
                        report.samples.used += average.used;
                        report.samples.spreads_m.extend(average.spread_m);
                        let stated = || numbers.iter().find_map(|&number| samples[number].sigma_m);
                        Measured { position: average.position, sigma_m: average.sigma_m().or_else(stated) }
                    }),
                };
                let of_group: Vec<f64> = numbers.iter().filter_map(|&number| times_s[number]).collect();
                let time_s = mean(&of_group);
                points.entry(stand).or_default().push(OfTarget { time_s, target, measured });
            }
        }
        report.samples.dropped = report.samples.read - report.samples.not_seen - report.samples.used;
        let mut visits = Vec::new();
        let mut timeless = 0;
        for (number, stand) in stands.into_iter().enumerate() {
            let measured = points.remove(&number).unwrap_or_default();
            let joints = &self.joints[stand.row.source.0];
            if measured.is_empty() {
                let reason = "nothing was measured there";
                report.unmatched_visits.push(Unmatched::of_stand(&stand, joined.keys[number], reason, &loaded.joints));
            }
            let (Some((cycle, pose)), false) =
                (joined.keys[number], measured.is_empty() && joints.rows == JointRows::Log)
            else {
                continue;
            };
            let times: Vec<f64> = measured.iter().filter_map(|one| one.time_s).collect();
            let time_s = stand.time_s().or_else(|| mean(&times));
            timeless += usize::from(time_s.is_none());
            // Without any time the order of the rows is all that is known.
            let time_s = time_s.unwrap_or(number as f64);
            let mut visit = Visit {
                cycle,
                pose,
                time_s,
                joints: stand.row.joints,
                commanded: stand.row.commanded,
                payload_kg: stand.row.payload_kg,
                approach: None,
                points: Vec::new(),
                distances: Vec::new(),
                broken_beams: Vec::new(),
            };
            for OfTarget { time_s: own, target, measured } in measured {
                let time_s = own.unwrap_or(time_s);
                match measured {
                    Some(Measured { position, sigma_m }) => {
                        visit.points.push(Point { time_s, target, position, orientation: None, sigma_m });
                    }
                    None => visit.broken_beams.push(BrokenBeam { time_s, target, anchor: None }),
                }
            }
            visits.push(visit);
        }
        if timeless > 0 {
            report.notes.push(format!("{timeless} visits have no time: the order of the rows stands for it"));
        }
        visits.sort_by(|left, right| left.time_s.total_cmp(&right.time_s));
        Ok((visits, targets.into_iter().map(str::to_owned).collect()))
    }

    fn report_misses(
        &self,
        samples: &[Sample],
        times_s: &[Option<f64>],
        joined: &Join,
        loaded: &Loaded,
        report: &mut Report,
    ) {
        for ((sample, time_s), stand) in samples.iter().zip(times_s).zip(&joined.stands) {
            let Err(miss) = stand else { continue };
            report.samples.unmatched += 1;
            let unmatched = Unmatched::of_sample(sample, *time_s, *miss, &loaded.tracker);
            match report.unmatched_points.last_mut() {
                Some(last) if last.is_same_point(&unmatched) => last.rows += 1,
                _ => report.unmatched_points.push(unmatched),
            }
        }
    }

    /// The log of temperatures; none where the mapping names none.
    fn log(
        &self,
        readings: &Readings,
        visits: &[Visit],
        start_ns: i128,
        loaded: &Loaded,
        report: &mut Report,
    ) -> Option<TemperatureLog> {
        if self.temperatures.is_empty() {
            return None;
        }
        report.empty_readings = readings.empty;
        let mut of_cycle: BTreeMap<(u32, u32), f64> = BTreeMap::new();
        for visit in visits {
            of_cycle.insert((visit.cycle, visit.pose), visit.time_s);
        }
        let mut log: Vec<(f64, &str, f64)> = Vec::with_capacity(readings.readings.len());
        for reading in &readings.readings {
            let name = readings.sensors[reading.sensor].as_str();
            match reading.when {
                When::At(moment) => log.push((moment.since(start_ns), name, reading.celsius)),
                When::During(cycle, pose) => {
                    let poses = pose.map_or(0..=u32::MAX, |pose| pose..=pose);
                    let before = log.len();
                    let at = of_cycle.range((cycle, *poses.start())..=(cycle, *poses.end()));
                    log.extend(at.map(|(_, &time_s)| (time_s, name, reading.celsius)));
                    if log.len() == before {
                        report.unmatched_readings.push(Unmatched::of_reading(reading, name, &loaded.temperatures));
                    }
                }
            }
        }
        Some(TemperatureLog::from_readings(log))
    }
}

/// What a visit's rows of one target came to.
struct OfTarget {
    time_s: Option<f64>,
    target: usize,
    /// None: the beam was broken.
    measured: Option<Measured>,
}

/// A point that was measured.
struct Measured {
    position: Vector3<f64>,
    sigma_m: Option<f64>,
}

/// A stand and a target, and the samples of that target there.
type Group<'g> = (&'g (usize, usize), &'g Vec<usize>);

/// The groups of samples by the `[[tracker]]` of their first sample.
fn by_source<'g>(
    groups: &'g BTreeMap<(usize, usize), Vec<usize>>,
    samples: &[Sample],
) -> BTreeMap<usize, Vec<Group<'g>>> {
    let mut sources: BTreeMap<usize, Vec<_>> = BTreeMap::new();
    for group in groups {
        let source = group.1.first().map_or(0, |&number| samples[number].source.0);
        sources.entry(source).or_default().push(group);
    }
    sources
}

/// The error of a target that was measured more than once at a visit where samples are not averaged.
fn twice(samples: &[Sample], numbers: &[usize], target: &str, loaded: &Loaded) -> InputError {
    let mut seen = numbers.iter().map(|&number| &samples[number]).filter(|sample| sample.seen.is_some());
    let (Some(first), Some(second)) = (seen.next(), seen.next()) else {
        return InputError::of_file(Path::new(target), "is measured twice at a visit");
    };
    let message = format!(
        "{target} was measured at this visit in {} already; expected it once, or samples = {{}} in the mapping",
        place_of(&loaded.tracker, first.source, first.line)
    );
    let (table, file) = second.source;
    InputError::at_line(&loaded.tracker[table][file].path, second.line, message)
}

/// A line in words: the file's name, and the line.
fn place_of(sources: &[Vec<Source>], (table, file): (usize, usize), line: usize) -> String {
    let path = &sources[table][file].path;
    format!("{} line {line}", path.file_name().unwrap_or(path.as_os_str()).to_string_lossy())
}

/// The mean; none of nothing.
fn mean(values: &[f64]) -> Option<f64> {
    let first = *values.first()?;
    Some(first + values.iter().map(|value| value - first).sum::<f64>() / values.len() as f64)
}

/// Puts the registered places into the description; a target that it did not have is added.
fn place_targets(robot: &mut Robot, registration: &Registration) {
    for placed in &registration.targets {
        let position = Some(Vector3::from(placed.position_m));
        match robot.targets.iter_mut().find(|target| target.name == placed.name) {
            Some(target) => target.position = position,
            None => robot.targets.push(Target { name: placed.name.clone(), position }),
        }
    }
}

/// How sensors were joined to visits by the room that does it for every run.
fn sensors(run: &Run) -> Vec<SensorReport> {
    run.temperatures_at_visits(&JoinOptions::default()).report.into_iter().map(SensorReport::from).collect()
}
