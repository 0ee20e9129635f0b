//! Heat: a network of five shell nodes a link and one node a drive, losses of the drives, air that moves and changes.
//! Finer than what any fit assumes; integrated by the classical Runge-Kutta method.

use super::arm::Arm;
use super::random::Stream;
use super::schedule::{Phase, Schedule};

/// Shell nodes along a link.
pub const NODES: usize = 5;
/// Step of the integration and of the record, s.
const STEP_S: f64 = 10.0;
/// Inner steps a recorded one.
const INNER: usize = 4;

/// The thermal constants of an arm; links are base first.
#[derive(Debug, Clone)]
pub struct Physics {
    /// Capacity of a link's shell, J/K.
    pub shell: Vec<f64>,
    /// Capacity of a drive, J/K; drive j sits between links j and j+1.
    pub drive: Vec<f64>,
    /// Conductance between neighbouring nodes of a shell, W/K.
    pub along: Vec<f64>,
    /// Conductance from a drive to the shell nodes beside it, before and behind, W/K.
    pub mount: Vec<(f64, f64)>,
    /// Conductance of a whole link to still air, W/K, and more of it per rad/s.
    pub air: Vec<(f64, f64)>,
    /// Loss of a drive: resting, W; per rad/s; per (rad/s)².
    pub loss: Vec<(f64, f64, f64)>,
    /// Conductance of the base's first node to the floor, W/K.
    pub floor: f64,
    /// The floor and the air at the beginning, °C; trend, K/h; swing, K, and its period, s, and phase.
    pub weather: [f64; 6],
}

impl Physics {
    /// Constants of an arm of a size (1 is the thesis's) with each number drawn around a plausible one.
    pub fn draw(links: usize, size: f64, stream: &mut Stream) -> Self {
        let joints = links - 1;
        let mut around = |value: f64| value * stream.log_between(0.75, 1.33);
        let share: Vec<f64> = (0..links).map(|n| [1.0, 1.0, 0.75, 0.7, 0.3, 0.15, 0.06][n.min(6)]).collect();
        let power: Vec<f64> = (0..joints).map(|n| [1.0, 1.3, 1.0, 0.35, 0.3, 0.2][n.min(5)]).collect();
        let shell = share.iter().map(|s| around(60_000.0 * s * size)).collect();
        let drive = power.iter().map(|p| around(8_000.0 * p * size)).collect();
        let along = share.iter().map(|s| around(60.0 * s * size)).collect();
        let mount = power.iter().map(|p| (around(12.0 * p * size), around(16.0 * p * size))).collect();
        let air = share.iter().map(|s| (around(9.0 * s * size), around(6.0 * s * size))).collect();
        let loss = power
            .iter()
            .map(|p| (around(8.0 * p * size), around(160.0 * p * size), around(400.0 * p * size)))
            .collect();
        let floor = around(5.0 * size);
        let start = 21.0 + 2.0 * stream.between(-1.0, 1.0);
        let weather = [
            start,
            start + stream.between(-0.3, 0.3),
            stream.between(-0.4, 0.4),
            stream.between(0.1, 0.4),
            stream.between(3000.0, 9000.0),
            stream.between(0.0, std::f64::consts::TAU),
        ];
        Self { shell, drive, along, mount, air, loss, floor, weather }
    }

    /// The air's temperature, °C.
    pub fn air_c(&self, time_s: f64) -> f64 {
        let [_, air, trend, swing, period, phase] = self.weather;
        let wave = libm::sin(std::f64::consts::TAU * time_s / period + phase) - libm::sin(phase);
        air + trend * time_s / 3600.0 + swing * wave
    }

    fn nodes(&self) -> usize {
        self.shell.len() * NODES + self.drive.len()
    }

    /// Rates of all nodes, K/s, at joint speeds (rms, rad/s).
    fn rates(&self, time_s: f64, at: &[f64], rms: &[f64], rates: &mut [f64]) {
        let links = self.shell.len();
        let air = self.air_c(time_s);
        rates.fill(0.0);
        for link in 0..links {
            // The shell moves with all joints up to its own; the base stands.
            let speed: f64 = rms[..link.min(rms.len())].iter().sum();
            let (still, moving) = self.air[link];
            for node in 0..NODES {
                let n = link * NODES + node;
                rates[n] += (still + moving * speed) / NODES as f64 * (air - at[n]);
                if node + 1 < NODES {
                    let flow = self.along[link] * NODES as f64 / 2.0 * (at[n + 1] - at[n]);
                    rates[n] += flow;
                    rates[n + 1] -= flow;
                }
            }
        }
        rates[0] += self.floor * (self.weather[0] - at[0]);
        for (joint, (&(before, behind), &(rest, linear, square))) in self.mount.iter().zip(&self.loss).enumerate() {
            let d = links * NODES + joint;
            let (end, begin) = (joint * NODES + NODES - 1, (joint + 1) * NODES);
            let (to_end, to_begin) = (before * (at[d] - at[end]), behind * (at[d] - at[begin]));
            rates[d] += rest + (linear + square * rms[joint]) * rms[joint] - to_end - to_begin;
            rates[end] += to_end;
            rates[begin] += to_begin;
        }
        for link in 0..links {
            for node in 0..NODES {
                rates[link * NODES + node] /= self.shell[link] / NODES as f64;
            }
        }
        for (joint, capacity) in self.drive.iter().enumerate() {
            rates[links * NODES + joint] /= capacity;
        }
    }

    /// One Runge-Kutta step.
    fn advance(&self, time_s: f64, step_s: f64, at: &mut [f64], rms: &[f64]) {
        let count = at.len();
        let mut k = vec![vec![0.0; count]; 4];
        for stage in 0..4 {
            let share = [0.0, 0.5, 0.5, 1.0][stage];
            let there: Vec<f64> = if stage == 0 {
                at.to_vec()
            } else {
                at.iter().zip(&k[stage - 1]).map(|(x, k)| x + share * step_s * k).collect()
            };
            self.rates(time_s + share * step_s, &there, rms, &mut k[stage]);
        }
        for n in 0..count {
            at[n] += step_s / 6.0 * (k[0][n] + 2.0 * k[1][n] + 2.0 * k[2][n] + k[3][n]);
        }
    }

    /// All nodes over a campaign, switched on at its begin.
    pub fn run(&self, schedule: &Schedule) -> Heat {
        let joints = self.drive.len();
        let mut at = vec![self.air_c(0.0); self.nodes()];
        // Long switched off: the floor and the air have had their way.
        let off = Self { loss: vec![(0.0, 0.0, 0.0); joints], ..self.clone() };
        for _ in 0..4000 {
            off.advance(0.0, 20.0, &mut at, &vec![0.0; joints]);
        }
        let steps = (schedule.end_s / STEP_S) as usize + 3;
        let mut record = Vec::with_capacity(steps);
        let still = vec![0.0; joints];
        for n in 0..steps {
            record.push(at.clone());
            for inner in 0..INNER {
                let dt = STEP_S / INNER as f64;
                let time = n as f64 * STEP_S + inner as f64 * dt;
                let rms = schedule.step_at(time + 0.5 * dt).map_or(&still, |step| &step.rms);
                self.advance(time, dt, &mut at, rms);
            }
        }
        Heat { record, physics: self.clone() }
    }
}

/// All temperatures of a campaign.
#[derive(Debug, Clone)]
pub struct Heat {
    record: Vec<Vec<f64>>,
    physics: Physics,
}

impl Heat {
    /// A weighted sum of the nodes at a time, °C, by linear interpolation of the record.
    pub fn at(&self, weights: &[(usize, f64)], time_s: f64) -> f64 {
        let place = (time_s / STEP_S).clamp(0.0, (self.record.len() - 2) as f64);
        let (n, rest) = (place as usize, place - (place as usize) as f64);
        let sum = |n: usize| -> f64 { weights.iter().map(|&(node, weight)| weight * self.record[n][node]).sum() };
        sum(n) * (1.0 - rest) + sum(n + 1) * rest
    }

    /// The air, °C.
    pub fn air_c(&self, time_s: f64) -> f64 {
        self.physics.air_c(time_s)
    }
}

/// What a spot of a link's shell feels: the two nodes around it.
pub fn spot(link: usize, along: f64) -> Vec<(usize, f64)> {
    let place = (along * NODES as f64 - 0.5).clamp(0.0, (NODES - 1) as f64);
    let node = (place as usize).min(NODES - 2);
    let rest = place - node as f64;
    vec![(link * NODES + node, 1.0 - rest), (link * NODES + node + 1, rest)]
}

/// What the mean of a link feels.
pub fn whole(link: usize) -> Vec<(usize, f64)> {
    (0..NODES).map(|node| (link * NODES + node, 1.0 / NODES as f64)).collect()
}

/// A signal that follows motion (1) and rest (0) through a lag.
pub fn stirred(schedule: &Schedule, tau_s: f64, times: &[f64]) -> Vec<f64> {
    let moves = |t| schedule.step_at(t).is_some_and(|step| step.phase == Phase::Move);
    follow(tau_s, times, |t| if moves(t) { 1.0 } else { 0.0 })
}

/// A signal through a first-order lag, at rest at its first value, sampled at times in order.
pub fn follow(tau_s: f64, times: &[f64], signal: impl Fn(f64) -> f64) -> Vec<f64> {
    const INNER_S: f64 = 2.0;
    let decay = libm::exp(-INNER_S / tau_s);
    let mut state = signal(0.0);
    let mut n = 0_u64;
    times
        .iter()
        .map(|&time| {
            while (n + 1) as f64 * INNER_S <= time {
                // Exact for a signal that is constant through the step.
                state += (1.0 - decay) * (signal((n as f64 + 0.5) * INNER_S) - state);
                n += 1;
            }
            let rest = time - n as f64 * INNER_S;
            state + (1.0 - libm::exp(-rest / tau_s)) * (signal(time) - state)
        })
        .collect()
}

/// The size of an arm for its heat: 1 is the thesis's.
pub fn size(arm: &Arm) -> f64 {
    arm.bodies.iter().map(|body| body.mass_kg).sum::<f64>() / 787.0
}
