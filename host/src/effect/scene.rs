//! What effects may look at: the visits with their joints, directions, loads and times, the temperature log with its
//! history, the schedule. No measured position is among it: an effect that saw one could explain anything.

use nalgebra::Vector3;

use crate::model::ReferenceTemperature;
use crate::robot::{Chain, JointKind, Payload, Posture, Prepared, Robot, gravity_torques};
use crate::run::{MotionStep, Phase, Run, TemperatureSeries};

/// One visit as an effect sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Situation {
    /// When the arm stood there, s since the run began.
    pub time_s: f64,
    /// The cycle.
    pub cycle: u32,
    /// The posture's number.
    pub pose: u32,
    /// The joints that are believed.
    pub joints: Vec<f64>,
    /// The joints of the visit before; none at the first.
    pub before: Option<Vec<f64>>,
    /// The other account of the joints, where poses.csv has both: commanded where the logged ones are believed.
    pub other_account: Option<Vec<f64>>,
    /// -1, 0 or 1: from where each joint came.
    pub approach: Vec<f64>,
    /// Gravity torque about each joint, N·m, payload included.
    pub torques: Vec<f64>,
    /// Rise of each sensor above its reference, kelvin, as read.
    pub rises: Vec<f64>,
}

/// A sensor with its history.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensed {
    /// Its name.
    pub name: String,
    /// The link it is glued to.
    pub link: usize,
    /// Its temperature at the reference, °C.
    pub reference_c: f64,
    /// All that it read.
    pub series: TemperatureSeries,
}

/// A parameter that follows a sensor, by the model as it stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Growing {
    /// Place of the parameter in [`Chain::parameters`].
    pub parameter: usize,
    /// The sensor.
    pub sensor: usize,
    /// m/K or rad/K.
    pub coefficient: f64,
}

/// A run as effects see it.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The arm's chain.
    pub chain: Chain,
    /// Which joints turn.
    pub revolute: Vec<bool>,
    /// Motor turns per joint turn, where robot.toml says.
    pub gear_ratios: Vec<Option<f64>>,
    /// Whether robot.toml gives masses, so that torques are known.
    pub masses_known: bool,
    /// For each joint, torques by unit first moments (1 kg·m) of the masses that it carries, where masses are unknown: three
    /// moments a transform from 1 on, each with one amount a visit.
    pub moments: Vec<Vec<Vec<f64>>>,
    /// For each joint, sets of moments that the run's visits tell apart, by place, and the mean of each over the run: those of
    /// its own link alone, as if all that it carries were one body, and those of all links that it carries.
    pub told_apart: Vec<Vec<Vec<(usize, f64)>>>,
    /// From when drifts count, s since the run began: fixed, whatever visits are looked at.
    pub origin_s: f64,
    /// The visits in order of time.
    pub visits: Vec<Situation>,
    /// The sensors.
    pub sensors: Vec<Sensed>,
    /// What reads the air of the cell.
    pub air: Option<TemperatureSeries>,
    /// From where the air's temperature counts, °C; none: its mean over the visits of the first cycle.
    pub air_reference_c: Option<f64>,
    /// The thermal model as it stands.
    pub growth: Vec<Growing>,
    /// The schedule.
    pub motion: Vec<MotionStep>,
    /// Places of the targets in the flange frame as the model has them, metres.
    pub targets: Vec<Vector3<f64>>,
    /// Whether each target's place is an unknown of the calibration.
    pub unknown_targets: Vec<bool>,
    /// Where the instrument stands, world frame, metres.
    pub station: Vector3<f64>,
}

/// What a scene needs of a run's visits, as calibration observed them.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Place of the visit in [`Run::visits`].
    pub place: usize,
    /// The joints that are believed.
    pub joints: Vec<f64>,
    /// Rises of the sensors, kelvin.
    pub rises: Vec<f64>,
}

impl Scene {
    /// The scene of a run's visits. `values` are the chain's parameters for the torques, `references` the sensors in the
    /// order of the rises.
    pub fn new(
        robot: &Robot,
        run: &Run,
        seen: impl IntoIterator<Item = Seen>,
        values: &[f64],
        references: &[ReferenceTemperature],
        targets: Vec<Vector3<f64>>,
        unknown_targets: &[usize],
    ) -> Scene {
        let chain = robot.chain();
        let prepared = chain.prepare(values);
        let approach = run.approach_directions();
        let joints: Vec<_> = robot.transforms.iter().filter_map(|transform| transform.joint.as_ref()).collect();
        let mut visits: Vec<Situation> = Vec::new();
        for Seen { place, joints, rises } in seen {
            let visit = &run.visits[place];
            let payload = visit.payload_kg.filter(|mass| *mass != 0.0);
            let load = payload.map(|mass_kg| Payload { mass_kg, center: Vector3::zeros() });
            let before = place.checked_sub(1).map(|before| match visit.commanded.as_ref() == Some(&joints) {
                true => run.visits[before].commanded.clone().unwrap_or_else(|| run.visits[before].joints.clone()),
                false => run.visits[before].joints.clone(),
            });
            let other_account = visit.commanded.as_ref().map(|commanded| match *commanded == joints {
                true => visit.joints.clone(),
                false => commanded.clone(),
            });
            visits.push(Situation {
                time_s: visit.time_s,
                cycle: visit.cycle,
                pose: visit.pose,
                before,
                other_account,
                approach: approach[place].iter().map(|&sign| f64::from(sign)).collect(),
                torques: gravity_torques(robot, &prepared, &Posture::new(&joints), load),
                joints,
                rises,
            });
        }
        let log = run.temperatures.as_ref();
        let series = |name: &str| log.and_then(|log| Some(log.series[log.index_of(name)?].clone()));
        let sensors = references
            .iter()
            .map(|reference| Sensed {
                name: reference.sensor.clone(),
                link: robot.sensor(&reference.sensor).map_or(0, |place| robot.sensors[place].link),
                reference_c: reference.celsius,
                series: series(&reference.sensor).unwrap_or_default(),
            })
            .collect();
        let masses_known = !robot.bodies.is_empty();
        let moments = if masses_known { vec![Vec::new(); joints.len()] } else { moments(robot, &visits, &prepared) };
        let mut unknown = vec![false; targets.len()];
        unknown_targets.iter().for_each(|&target| unknown[target] = true);
        Scene {
            revolute: joints.iter().map(|joint| joint.kind == JointKind::Revolute).collect(),
            gear_ratios: joints.iter().map(|joint| joint.gear_ratio).collect(),
            chain,
            masses_known,
            told_apart: moments.iter().enumerate().map(|(joint, columns)| told_apart(joint, columns)).collect(),
            moments,
            origin_s: visits.first().map_or(0.0, |visit| visit.time_s),
            visits,
            sensors,
            air: run.description.ambient.as_deref().and_then(series),
            air_reference_c: None,
            growth: Vec::new(),
            motion: run.motion.clone(),
            targets,
            unknown_targets: unknown,
            station: Vector3::from(run.description.instrument.position),
        }
    }

    /// The same scene with a choice of its visits, by place.
    pub fn select(&self, places: &[usize]) -> Scene {
        let pick = |amounts: &Vec<f64>| places.iter().map(|&place| amounts[place]).collect();
        Scene {
            visits: places.iter().map(|&place| self.visits[place].clone()).collect(),
            moments: self.moments.iter().map(|joint| joint.iter().map(pick).collect()).collect(),
            ..self.clone()
        }
    }

    /// One amount a visit.
    pub fn by_visit(&self, amount: impl Fn(&Situation) -> f64) -> Vec<f64> {
        self.visits.iter().map(amount).collect()
    }

    /// Half the range of a joint over the visits.
    pub fn half_range(&self, joint: usize) -> f64 {
        let (low, high) = self.visits.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), visit| {
            (low.min(visit.joints[joint]), high.max(visit.joints[joint]))
        });
        if high > low { 0.5 * (high - low) } else { 0.0 }
    }

    /// The cycles, ascending.
    pub fn cycles(&self) -> Vec<u32> {
        let mut cycles: Vec<u32> = self.visits.iter().map(|visit| visit.cycle).collect();
        cycles.sort_unstable();
        cycles.dedup();
        cycles
    }

    /// First and last time of the visits.
    pub fn span_s(&self) -> (f64, f64) {
        self.visits.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), visit| {
            (first.min(visit.time_s), last.max(visit.time_s))
        })
    }

    /// Parameters that follow sensors, each once.
    pub fn growing_parameters(&self) -> Vec<usize> {
        let mut places: Vec<usize> = self.growth.iter().map(|growing| growing.parameter).collect();
        places.sort_unstable();
        places.dedup();
        places
    }

    /// Sensors that drive a parameter, each once.
    pub fn driving_sensors(&self) -> Vec<usize> {
        let mut sensors: Vec<usize> = self.growth.iter().map(|growing| growing.sensor).collect();
        sensors.sort_unstable();
        sensors.dedup();
        sensors
    }

    /// The links that have sensors, ascending.
    pub fn sensed_links(&self) -> Vec<usize> {
        let mut links: Vec<usize> = self.sensors.iter().map(|sensor| sensor.link).collect();
        links.sort_unstable();
        links.dedup();
        links
    }

    /// The sensors of a link.
    pub fn sensors_of(&self, link: usize) -> Vec<usize> {
        (0..self.sensors.len()).filter(|&sensor| self.sensors[sensor].link == link).collect()
    }

    /// The rise of a sensor at every visit as a body would follow it through a first-order lag.
    pub fn lagged(&self, sensor: usize, tau_s: f64) -> Vec<f64> {
        let Sensed { series, reference_c, .. } = &self.sensors[sensor];
        let (times, celsius) = (series.times_s(), series.celsius());
        let Some(&first) = celsius.first() else { return vec![0.0; self.visits.len()] };
        // The body starts as warm as the first minute of readings is on the average.
        let settled: Vec<f64> =
            times.iter().zip(celsius).take_while(|(time, _)| **time <= times[0] + 60.0).map(|(_, &c)| c).collect();
        let start = if settled.is_empty() { first } else { settled.iter().sum::<f64>() / settled.len() as f64 };
        let mut filter = Lag { time_s: times[0], value: start, tau_s };
        let mut at = 0;
        self.visits
            .iter()
            .map(|visit| {
                while at < times.len() && times[at] <= visit.time_s {
                    filter.follow(times[at], celsius[at]);
                    at += 1;
                }
                filter.ahead(visit.time_s, celsius[at.saturating_sub(1)]) - reference_c
            })
            .collect()
    }

    /// What a sensor read at every visit's time moved by an offset, less what it read at the visit, kelvin. Readings are
    /// averaged over half a minute on each side: the difference of two readings would be mostly noise.
    pub fn shifted(&self, sensor: usize, offset_s: f64) -> Vec<f64> {
        let series = &self.sensors[sensor].series;
        self.by_visit(|visit| match (smooth(series, visit.time_s + offset_s), smooth(series, visit.time_s)) {
            (Some(then), Some(now)) => then - now,
            _ => 0.0,
        })
    }

    /// What the air read at every visit.
    fn air_c(&self) -> Option<Vec<Option<f64>>> {
        let air = self.air.as_ref()?;
        Some(self.visits.iter().map(|visit| smooth(air, visit.time_s)).collect())
    }

    /// The mean of what the air read at the visits of the first cycle, °C; none without an air sensor.
    pub fn air_at_first(&self) -> Option<f64> {
        let values = self.air_c()?;
        let first = self.cycles().first().copied();
        let cold: Vec<f64> = self
            .visits
            .iter()
            .zip(&values)
            .filter(|(visit, _)| Some(visit.cycle) == first)
            .filter_map(|(_, value)| *value)
            .collect();
        Some(cold.iter().sum::<f64>() / cold.len().max(1) as f64)
    }

    /// What the air read at every visit, less its reference; none without an air sensor.
    pub fn air_rises(&self) -> Option<Vec<f64>> {
        let values = self.air_c()?;
        let zero = self.air_reference_c.or_else(|| self.air_at_first())?;
        Some(values.into_iter().map(|value| value.map_or(0.0, |value| value - zero)).collect())
    }

    /// The mean squared speed of a joint through a first-order lag, at every visit.
    pub fn driven(&self, joint: usize, tau_s: f64) -> Vec<f64> {
        self.through_schedule(tau_s, |step| step.rms.get(joint).map_or(0.0, |rms| rms * rms))
    }

    /// Whether the arm moves, through a first-order lag, at every visit: 0 for a long rest, 1 for a long motion.
    pub fn stirred(&self, tau_s: f64) -> Vec<f64> {
        self.through_schedule(tau_s, |step| if step.phase == Phase::Move { 1.0 } else { 0.0 })
    }

    /// Whether the arm moves, through a first-order lag, at any ascending times.
    pub fn stirred_at(&self, tau_s: f64, times: &[f64]) -> Vec<f64> {
        self.schedule_at(tau_s, times.iter().copied(), |step| if step.phase == Phase::Move { 1.0 } else { 0.0 })
    }

    fn through_schedule(&self, tau_s: f64, level: impl Fn(&MotionStep) -> f64) -> Vec<f64> {
        self.schedule_at(tau_s, self.visits.iter().map(|visit| visit.time_s), level)
    }

    fn schedule_at(
        &self,
        tau_s: f64,
        times: impl Iterator<Item = f64>,
        level: impl Fn(&MotionStep) -> f64,
    ) -> Vec<f64> {
        let start = self.motion.first().map_or(0.0, |step| step.start_s);
        let mut filter = Lag { time_s: start, value: 0.0, tau_s };
        let mut at = 0;
        times
            .map(|time| {
                while at < self.motion.len() && self.motion[at].end_s <= time {
                    filter.follow_constant(self.motion[at].start_s, 0.0);
                    filter.follow_constant(self.motion[at].end_s, level(&self.motion[at]));
                    at += 1;
                }
                match self.motion.get(at).filter(|step| step.start_s <= time) {
                    Some(step) => {
                        let mut now = filter;
                        now.follow_constant(step.start_s, 0.0);
                        now.follow_constant(time, level(step));
                        now.value
                    }
                    None => {
                        let mut now = filter;
                        now.follow_constant(time.max(filter.time_s), 0.0);
                        now.value
                    }
                }
            })
            .collect()
    }
}

/// The mean of a series' readings within half a minute of a time; none where there is none.
fn smooth(series: &TemperatureSeries, time_s: f64) -> Option<f64> {
    let times = series.times_s();
    let (from, to) = (times.partition_point(|&t| t < time_s - 30.0), times.partition_point(|&t| t <= time_s + 30.0));
    match to > from {
        true => Some(series.celsius()[from..to].iter().sum::<f64>() / (to - from) as f64),
        false => series.at(time_s, series.max_gap_s(&Default::default())).celsius(),
    }
}

/// A first-order lag that follows an input.
#[derive(Debug, Clone, Copy)]
struct Lag {
    time_s: f64,
    value: f64,
    tau_s: f64,
}

impl Lag {
    /// Follows an input that was constant since the last time.
    fn follow_constant(&mut self, time_s: f64, input: f64) {
        let step = (time_s - self.time_s).max(0.0);
        if self.tau_s > 0.0 {
            self.value += (input - self.value) * -libm::expm1(-step / self.tau_s);
        } else {
            self.value = input;
        }
        self.time_s = self.time_s.max(time_s);
    }

    fn follow(&mut self, time_s: f64, input: f64) {
        self.follow_constant(time_s, input);
    }

    fn ahead(&self, time_s: f64, input: f64) -> f64 {
        let mut later = *self;
        later.follow_constant(time_s, input);
        later.value
    }
}

/// Torques about each joint by unit first moments of the links that it carries.
pub(super) fn moments(robot: &Robot, visits: &[Situation], prepared: &Prepared) -> Vec<Vec<Vec<f64>>> {
    let chain = robot.chain();
    let joints = chain.joint_count();
    let mut raw: Vec<Vec<Vec<f64>>> = vec![Vec::new(); joints];
    for transform in 1..chain.transform_count() {
        for axis in 0..3 {
            let mut by_joint: Vec<Vec<f64>> = vec![Vec::with_capacity(visits.len()); joints];
            for visit in visits {
                let posture = Posture::new(&visit.joints);
                let torque = |center: Vector3<f64>| {
                    let mut probe = robot.clone();
                    probe.bodies = vec![crate::robot::Body { transform, mass_kg: 1.0, center }];
                    gravity_torques(&probe, prepared, &posture, None)
                };
                let mut center = Vector3::zeros();
                center[axis] = 1.0;
                // The moment alone: the mass at the frame's own origin belongs to the links before it.
                let (out, origin) = (torque(center), torque(Vector3::zeros()));
                for joint in 0..joints {
                    by_joint[joint].push(out[joint] - origin[joint]);
                }
            }
            for (joint, amounts) in by_joint.into_iter().enumerate() {
                raw[joint].push(amounts);
            }
        }
    }
    raw
}

/// The sets of moments that a joint's torque may follow, the smallest first.
fn told_apart(joint: usize, columns: &[Vec<f64>]) -> Vec<Vec<(usize, f64)>> {
    let all = independent(columns);
    if all.is_empty() {
        return Vec::new();
    }
    // The link that a joint turns has the frame of the transform after it, and transforms count from 1.
    let first = 3 * joint;
    let own = columns.get(first..first + 3).map(independent).unwrap_or_default();
    let own: Vec<(usize, f64)> = own.into_iter().map(|(place, mean)| (first + place, mean)).collect();
    let mut sets = vec![own, all];
    sets.retain(|set| !set.is_empty());
    sets.dedup_by(|a, b| a.len() == b.len());
    sets
}

/// A subset of columns that spans them all to a part in a thousand, less the constant, with the mean of each: pivoted
/// Gram-Schmidt over the visits.
fn independent(columns: &[Vec<f64>]) -> Vec<(usize, f64)> {
    let means: Vec<f64> =
        columns.iter().map(|column| column.iter().sum::<f64>() / column.len().max(1) as f64).collect();
    let norm = |column: &Vec<f64>| column.iter().map(|value| value * value).sum::<f64>().sqrt();
    let mut rest: Vec<Vec<f64>> =
        columns.iter().zip(&means).map(|(column, mean)| column.iter().map(|value| value - mean).collect()).collect();
    let scale = rest.iter().map(norm).fold(0.0, f64::max);
    let mut kept = Vec::new();
    while let Some(best) = (0..rest.len()).max_by(|&a, &b| norm(&rest[a]).total_cmp(&norm(&rest[b]))) {
        let length = norm(&rest[best]);
        if length <= 1e-3 * scale || scale == 0.0 {
            break;
        }
        kept.push((best, means[best]));
        let unit: Vec<f64> = rest[best].iter().map(|value| value / length).collect();
        for column in &mut rest {
            let along: f64 = column.iter().zip(&unit).map(|(a, b)| a * b).sum();
            column.iter_mut().zip(&unit).for_each(|(a, b)| *a -= along * b);
        }
    }
    kept
}
