//! What is when: cycles of movement, pause and measurement, the postures, their order, loads and directions of approach.

use super::arm::Arm;
use super::random::Stream;

/// How long and how varied a campaign is.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Cycles, the cold reference included.
    pub cycles: usize,
    /// Postures.
    pub poses: usize,
    /// How many of the arm's targets are on the flange; absent: all.
    pub targets: Option<usize>,
    /// Whether each cycle visits the postures in an order of its own.
    pub shuffled: bool,
    /// Whether the speed override takes many values instead of a warm-up and a cool-down.
    pub mixed_overrides: bool,
    /// Whether the load changes from cycle to cycle.
    pub payload_changes: bool,
}

/// What the arm does in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// It moves.
    Move,
    /// It stands.
    Pause,
    /// It is measured.
    Measure,
}

impl Phase {
    /// The name in motion.csv.
    pub fn name(self) -> &'static str {
        match self {
            Self::Move => "move",
            Self::Pause => "pause",
            Self::Measure => "measure",
        }
    }
}

/// One row of motion.csv.
#[derive(Debug, Clone)]
pub struct Step {
    /// Start, s.
    pub start_s: f64,
    /// End, s.
    pub end_s: f64,
    /// Cycle.
    pub cycle: usize,
    /// What is done.
    pub phase: Phase,
    /// Speed override.
    pub speed: f64,
    /// Root-mean-square speed of each joint, rad/s.
    pub rms: Vec<f64>,
}

/// One visit of one posture.
#[derive(Debug, Clone)]
pub struct Visit {
    /// When it began, s.
    pub time_s: f64,
    /// Cycle.
    pub cycle: usize,
    /// Posture.
    pub pose: usize,
    /// Joints as logged.
    pub joints: Vec<f64>,
    /// Joints of the visit before; at the very first, its own: the arm had long arrived.
    pub before: Vec<f64>,
    /// Sign of each joint's last motion.
    pub approach: Vec<f64>,
    /// Load, kg.
    pub payload_kg: f64,
}

/// The whole campaign.
#[derive(Debug, Clone)]
pub struct Schedule {
    /// Steps in order of time.
    pub steps: Vec<Step>,
    /// Visits in order of time.
    pub visits: Vec<Visit>,
    /// Start of the first posture's first target.
    pub start_s: f64,
    /// End of the last step.
    pub end_s: f64,
    /// Seconds a target takes.
    pub target_s: f64,
}

/// Rest before the first visit, s.
const REST_S: f64 = 60.0;
/// Seconds from a visit's begin, when the arm arrives, to its first target; and from target to target.
const TARGET_S: f64 = 2.0;

impl Schedule {
    /// Draws a campaign for an arm with so many targets.
    pub fn draw(arm: &Arm, plan: &Plan, stream: &mut Stream) -> Self {
        let joints = arm.joints();
        let home: Vec<f64> = arm.ranges.iter().map(|(low, high)| 0.5 * (low + high)).collect();
        let poses = postures(arm, plan.poses, stream);
        let warm = plan.cycles / 2;
        let targets = arm.targets.len();
        let (mut steps, mut visits) = (Vec::new(), Vec::<Visit>::new());
        let mut now = REST_S;
        let mut order: Vec<usize> = (0..plan.poses).collect();
        for cycle in 0..plan.cycles {
            if cycle > 0 {
                let speed = match (plan.mixed_overrides, cycle <= warm) {
                    (true, _) => *stream.pick(&[0.2, 0.4, 0.6, 0.8, 1.0]),
                    (false, true) => 0.75,
                    (false, false) => 0.25,
                };
                let length = stream.between(480.0, 600.0);
                let rms = arm.speeds.iter().map(|full| speed * full * (1.0 + 0.03 * stream.normal())).collect();
                steps.push(Step { start_s: now, end_s: now + length, cycle, phase: Phase::Move, speed, rms });
                now += length;
                let rms = vec![0.0; joints];
                steps.push(Step { start_s: now, end_s: now + 60.0, cycle, phase: Phase::Pause, speed: 0.0, rms });
                now += 60.0;
            }
            if plan.shuffled {
                for last in (1..order.len()).rev() {
                    order.swap(last, stream.below(last + 1));
                }
            }
            let payload_kg = if plan.payload_changes { [0.0, 60.0, 120.0][cycle % 3] } else { 0.0 };
            let start_s = now;
            for &pose in &order {
                let at = poses[pose].clone();
                let first = visits.is_empty();
                let before = visits.last().map_or_else(|| at.clone(), |visit| visit.joints.clone());
                let from = if first { &home } else { &before };
                let approach = at.iter().zip(from).map(|(to, from)| if to >= from { 1.0 } else { -1.0 }).collect();
                visits.push(Visit { time_s: now, cycle, pose, joints: at, before, approach, payload_kg });
                now += TARGET_S * targets as f64 + stream.between(3.0, 4.0);
            }
            let rms = vec![0.05; joints];
            steps.push(Step { start_s, end_s: now, cycle, phase: Phase::Measure, speed: 0.1, rms });
        }
        Self { steps, visits, start_s: REST_S, end_s: now, target_s: TARGET_S }
    }

    /// The step that holds at a time, if any.
    pub fn step_at(&self, time_s: f64) -> Option<&Step> {
        self.steps.iter().find(|step| step.start_s <= time_s && time_s < step.end_s)
    }

    /// The override of the movement before a cycle's measurement; 0 before the first.
    pub fn override_before(&self, cycle: usize) -> f64 {
        let moves = |step: &&Step| step.phase == Phase::Move && step.cycle == cycle;
        self.steps.iter().find(moves).map_or(0.0, |step| step.speed)
    }

    /// When the targets of a visit are measured, s.
    pub fn target_time(&self, visit: usize, target: usize) -> f64 {
        self.visits[visit].time_s + self.target_s * (target + 1) as f64
    }
}

/// Postures at which the flange is in front of the instrument and off the ground, each far from those before: the
/// farthest of a few candidates.
fn postures(arm: &Arm, count: usize, stream: &mut Stream) -> Vec<Vec<f64>> {
    const CANDIDATES: usize = 6;
    let nominal = arm.nominal();
    let mut chosen: Vec<Vec<f64>> = Vec::new();
    while chosen.len() < count {
        let mut best: Option<(f64, Vec<f64>)> = None;
        for _ in 0..CANDIDATES {
            let joints: Vec<f64> = arm.ranges.iter().map(|&(low, high)| stream.between(low, high)).collect();
            let at = arm.flange(&nominal, &joints).fixed_view::<3, 1>(0, 3).into_owned();
            let distance = libm::sqrt(at.norm_squared());
            if !(0.5..6.0).contains(&distance) {
                continue;
            }
            let apart = |other: &Vec<f64>| -> f64 { other.iter().zip(&joints).map(|(a, b)| (a - b) * (a - b)).sum() };
            let nearest = chosen.iter().map(apart).fold(f64::INFINITY, f64::min);
            if best.as_ref().is_none_or(|(apart, _)| nearest > *apart) {
                best = Some((nearest, joints));
            }
        }
        if let Some((_, joints)) = best {
            // What a controller logs has nine digits.
            chosen.push(joints.iter().map(|q| libm::round(q * 1e9) / 1e9).collect());
        }
    }
    chosen
}
