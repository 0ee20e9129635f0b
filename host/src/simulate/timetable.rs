//! The schedule as times: every step of motion, every visit and every point.

use super::random::{Purpose, Stream};
use super::scenario::{Scenario, Schedule};
use crate::run::{MotionStep, Phase};

/// Times are kept to the millisecond, as they are written.
pub(super) fn to_millisecond(time_s: f64) -> f64 {
    libm::round(time_s * 1e3) / 1e3
}

/// When one posture is visited and its targets are measured.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlannedVisit {
    pub cycle: u32,
    pub pose: usize,
    /// When the arm has come to rest, s.
    pub time_s: f64,
    /// When each target is measured, s.
    pub points_s: Vec<f64>,
}

/// The whole experiment in time.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Timetable {
    /// Steps without gaps, from 0 on.
    pub steps: Vec<MotionStep>,
    /// In order of time.
    pub visits: Vec<PlannedVisit>,
}

impl Schedule {
    /// The longest time that the measurement of a cycle may take, s.
    pub(crate) fn longest_measurement_s(&self, postures: usize, targets: usize) -> f64 {
        postures as f64 * (self.transit_s[1] + self.settle_s + targets as f64 * self.target_s)
    }
}

/// Lays the schedule out in time.
pub(super) fn timetable(scenario: &Scenario, postures: usize) -> Timetable {
    let schedule = &scenario.schedule;
    let mut stream = Stream::new(scenario.seed, Purpose::Schedule);
    let mut table = Timetable::default();
    let still = vec![0.0; schedule.rms_speed.len()];
    let mut now = 0.0;
    if schedule.rest_s > 0.0 {
        now = to_millisecond(schedule.rest_s);
        table.steps.push(MotionStep {
            start_s: 0.0,
            end_s: now,
            cycle: 0,
            phase: Phase::Pause,
            speed_override: 0.0,
            rms: still.clone(),
        });
    }
    now = measure(scenario, 0, now, postures, &mut stream, &mut table);
    let drives = schedule.phases.iter().flat_map(|phase| (0..phase.cycles).map(move |_| phase));
    for (cycle, phase) in (1..).zip(drives) {
        let speed_override = phase.speed_override;
        let moves = |joint: usize| phase.joints.as_ref().is_none_or(|moving| moving.contains(&(joint + 1)));
        // The measurement is drawn ahead of the movement, for the cycle as a whole has a given time.
        let mut measured = Timetable::default();
        let length = stream.between(schedule.cycle_s[0], schedule.cycle_s[1]);
        let measurement = measure(scenario, cycle, 0.0, postures, &mut stream, &mut measured);
        let moved = to_millisecond(now + length - measurement - schedule.pause_s);
        let rms = schedule
            .rms_speed
            .iter()
            .enumerate()
            .map(|(joint, speed)| {
                // Drawn for every joint, so that which joints move changes nothing else of a run.
                let spread = (1.0 + schedule.speed_spread * stream.normal()).max(0.0);
                if moves(joint) { speed * speed_override * spread } else { 0.0 }
            })
            .map(|speed| libm::round(speed * 1e5) / 1e5)
            .collect();
        table.steps.push(MotionStep { start_s: now, end_s: moved, cycle, phase: Phase::Move, speed_override, rms });
        let paused = to_millisecond(moved + schedule.pause_s);
        if paused > moved {
            table.steps.push(MotionStep {
                start_s: moved,
                end_s: paused,
                cycle,
                phase: Phase::Pause,
                speed_override: 0.0,
                rms: still.clone(),
            });
        }
        for mut step in measured.steps {
            step.start_s = to_millisecond(step.start_s + paused);
            step.end_s = to_millisecond(step.end_s + paused);
            now = step.end_s;
            table.steps.push(step);
        }
        for mut visit in measured.visits {
            visit.time_s = to_millisecond(visit.time_s + paused);
            visit.points_s.iter_mut().for_each(|time| *time = to_millisecond(*time + paused));
            table.visits.push(visit);
        }
    }
    if schedule.rest_s > 0.0 {
        let (end_s, cycle) =
            (to_millisecond(now + schedule.rest_s), schedule.phases.iter().map(|phase| phase.cycles).sum());
        table.steps.push(MotionStep {
            start_s: now,
            end_s,
            cycle,
            phase: Phase::Pause,
            speed_override: 0.0,
            rms: still,
        });
    }
    table
}

/// Adds the measurement of one cycle from `start_s` on; returns when it ends.
fn measure(
    scenario: &Scenario,
    cycle: u32,
    start_s: f64,
    postures: usize,
    stream: &mut Stream,
    table: &mut Timetable,
) -> f64 {
    let schedule = &scenario.schedule;
    let mut now = start_s;
    let mut moving = 0.0;
    for pose in 0..postures {
        let transit = stream.between(schedule.transit_s[0], schedule.transit_s[1]);
        moving += transit;
        let time_s = to_millisecond(now + transit);
        let points_s: Vec<f64> = (0..scenario.robot.targets.len())
            .map(|target| to_millisecond(time_s + schedule.settle_s + (target + 1) as f64 * schedule.target_s))
            .collect();
        now = points_s.last().copied().unwrap_or(time_s);
        table.visits.push(PlannedVisit { cycle, pose, time_s, points_s });
    }
    // The arm moves for a part of the step only.
    let duty = if now > start_s { libm::sqrt(moving / (now - start_s)) } else { 0.0 };
    let rms = schedule
        .rms_speed
        .iter()
        .map(|speed| libm::round(speed * schedule.measure_override * duty * 1e5) / 1e5)
        .collect();
    table.steps.push(MotionStep {
        start_s,
        end_s: now,
        cycle,
        phase: Phase::Measure,
        speed_override: schedule.measure_override,
        rms,
    });
    now
}
