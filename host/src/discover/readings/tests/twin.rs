//! A twin of its own for these tests: a network of heat with random constants, a schedule like the examples', and sensors
//! that lie in one way.

use std::path::PathBuf;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};

use crate::robot::{Robot, Sensor, shipped};
use crate::run::{Instrument, MotionStep, Phase, Run, RunDescription, TemperatureLog};

/// Random numbers of a seed.
pub struct Dice(ChaCha8Rng);

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    pub fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    pub fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count - 1)
    }

    pub fn sign(&mut self) -> f64 {
        if self.uniform() < 0.5 { -1.0 } else { 1.0 }
    }

    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// How a sensor lies, by places of sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lie {
    Chill { sensor: usize, depth_k: f64, tau_s: f64 },
    Step { sensor: usize, time_s: f64, step_k: f64 },
    Drift { sensor: usize, drift_k_per_h: f64 },
    Detached { sensor: usize, share: f64 },
    Swap { one: usize, other: usize },
    Clock { offset_s: f64 },
}

/// How a campaign is made.
#[derive(Debug, Clone, Copy)]
pub struct Plan {
    pub cycles: usize,
    pub per_link: usize,
    /// Whether sensors feel the drives' own heat directly, as the blind examples' do.
    pub near_drives: bool,
    pub period_s: f64,
}

impl Default for Plan {
    fn default() -> Self {
        Self { cycles: 24, per_link: 4, near_drives: false, period_s: 10.0 }
    }
}

const LINKS: usize = 5;
const NOISE_K: f64 = 0.02;
const STEP_S: f64 = 2.5;

/// An arm with its sensors, and a run of it.
pub struct Twin {
    pub robot: Robot,
    pub run: Run,
    /// The log without the lie, and with the same noise.
    pub honest: TemperatureLog,
}

struct Heat {
    nodes: usize,
    conductance: Vec<Vec<f64>>,
    capacity: Vec<f64>,
    /// To still air, and more by speed, a node.
    air: Vec<(f64, f64)>,
    loss: Vec<[f64; 3]>,
    floor: f64,
    weather: [f64; 5],
}

impl Heat {
    fn draw(dice: &mut Dice) -> Self {
        let nodes = 2 + dice.below(6);
        let links_share = [1.0, 1.0, 0.75, 0.7, 0.3];
        let powers = [1.0, 1.3, 1.0, 0.35, 0.3];
        let drives = if dice.uniform() < 0.5 { LINKS - 1 } else { LINKS };
        let count = LINKS * nodes + drives;
        let mut conductance = vec![vec![0.0; count]; count];
        let mut join = |a: usize, b: usize, amount: f64| {
            conductance[a][b] += amount;
            conductance[b][a] += amount;
        };
        let mut around = |value: f64| value * dice.log_between(0.6, 1.6);
        let mut capacity = Vec::new();
        let mut air = Vec::new();
        let stirs = around(1.0) > 0.85;
        for (link, share) in links_share.iter().enumerate() {
            let whole = around(60_000.0 * share);
            let along = around(60.0 * share) * nodes as f64 / 2.0;
            let moving = if stirs && link > 0 { around(6.0 * share) } else { 0.0 };
            let still = around(9.0 * share);
            for node in 0..nodes {
                capacity.push(whole / nodes as f64);
                air.push((still / nodes as f64, moving / nodes as f64 * link as f64));
                if node + 1 < nodes {
                    join(link * nodes + node, link * nodes + node + 1, along);
                }
            }
        }
        let mut loss = Vec::new();
        for (drive, power) in powers.iter().take(drives).enumerate() {
            let place = LINKS * nodes + drive;
            capacity.push(around(8_000.0 * power));
            air.push((0.0, 0.0));
            join(place, drive * nodes + nodes - 1, around(12.0 * power));
            if drive + 1 < LINKS {
                join(place, (drive + 1) * nodes, around(16.0 * power));
            }
            loss.push([around(5.0 * power), around(80.0 * power), around(170.0 * power)]);
        }
        let floor = around(5.0);
        let weather = [
            dice.between(19.0, 23.0),
            dice.between(-0.4, 0.4),
            dice.between(0.1, 0.4),
            dice.between(3000.0, 9000.0),
            dice.between(0.0, std::f64::consts::TAU),
        ];
        Self { nodes, conductance, capacity, air, loss, floor, weather }
    }

    fn air_c(&self, time_s: f64) -> f64 {
        let [start, trend, swing, period, phase] = self.weather;
        start
            + trend * time_s / 3600.0
            + swing * ((std::f64::consts::TAU * time_s / period + phase).sin() - phase.sin())
    }

    fn rates(&self, time_s: f64, at: &[f64], speed: f64) -> Vec<f64> {
        let air = self.air_c(time_s);
        let mut rates = vec![0.0; at.len()];
        for n in 0..at.len() {
            let flow: f64 = self.conductance[n].iter().zip(at).map(|(g, other)| g * (other - at[n])).sum();
            rates[n] = flow + (self.air[n].0 + self.air[n].1 * speed) * (air - at[n]);
        }
        rates[0] += self.floor * (self.weather[0] - at[0]);
        for (drive, loss) in self.loss.iter().enumerate() {
            rates[LINKS * self.nodes + drive] +=
                if speed > 0.0 { loss[0] + loss[1] * speed + loss[2] * speed * speed } else { loss[0] };
        }
        rates.iter().zip(&self.capacity).map(|(rate, capacity)| rate / capacity).collect()
    }

    /// All nodes, each [`STEP_S`], by the midpoint rule.
    fn record(&self, steps: &[MotionStep], end_s: f64) -> Vec<Vec<f64>> {
        let mut at = vec![self.air_c(0.0); self.capacity.len()];
        let mut record = Vec::new();
        for n in 0..(end_s / STEP_S) as usize + 4 {
            record.push(at.clone());
            let time = n as f64 * STEP_S;
            let middle = time + 0.5 * STEP_S;
            let speed =
                steps.iter().find(|step| step.start_s <= middle && middle < step.end_s).map_or(0.0, |s| s.rms[0]);
            let first = self.rates(time, &at, speed);
            let half: Vec<f64> = at.iter().zip(&first).map(|(at, rate)| at + 0.5 * STEP_S * rate).collect();
            let rates = self.rates(middle, &half, speed);
            at.iter_mut().zip(rates).for_each(|(at, rate)| *at += STEP_S * rate);
        }
        record
    }
}

fn schedule(cycles: usize, dice: &mut Dice) -> Vec<MotionStep> {
    let mixed = dice.uniform() < 0.3;
    let mut steps = Vec::new();
    let mut now = 60.0;
    let mut push = |phase, length: f64, cycle: usize, share: f64| {
        steps.push(MotionStep {
            start_s: now,
            end_s: now + length,
            cycle: cycle as u32,
            phase,
            speed_override: share,
            rms: vec![share],
        });
        now += length;
    };
    for cycle in 0..cycles {
        if cycle > 0 {
            let share = match (mixed, 2 * cycle <= cycles) {
                (true, _) => [0.2, 0.4, 0.6, 0.8, 1.0][dice.below(5)],
                (false, true) => 0.75,
                (false, false) => 0.25,
            };
            push(Phase::Move, dice.between(480.0, 600.0), cycle, share);
            push(Phase::Pause, 60.0, cycle, 0.0);
        }
        push(Phase::Measure, dice.between(168.0, 176.0), cycle, 0.05);
    }
    steps
}

/// Motion through a lag, at a time, by many small steps: not the code under test.
fn stirred(steps: &[MotionStep], tau_s: f64, end_s: f64) -> Vec<f64> {
    let mut state = 0.0;
    (0..end_s as usize + 2)
        .map(|second| {
            let was = state;
            let middle = second as f64 + 0.5;
            let moves = steps.iter().any(|s| s.phase == Phase::Move && s.start_s <= middle && middle < s.end_s);
            state += (f64::from(u8::from(moves)) - state) * (1.0 - (-1.0 / tau_s).exp());
            was
        })
        .collect()
}

fn line(record: &[f64], place: f64) -> f64 {
    let place = place.clamp(0.0, (record.len() - 2) as f64);
    let rest = place - place.floor();
    record[place as usize] * (1.0 - rest) + record[place as usize + 1] * rest
}

impl Twin {
    pub fn new(seed: u64, plan: Plan, lie: impl FnOnce(&mut Dice, f64) -> Option<Lie>) -> (Self, Option<Lie>) {
        let mut dice = Dice::new(seed);
        let heat = Heat::draw(&mut dice);
        let steps = schedule(plan.cycles, &mut dice);
        let end_s = steps.last().map_or(600.0, |step| step.end_s);
        let lie = lie(&mut dice, end_s);
        let record = heat.record(&steps, end_s);
        let count = LINKS * plan.per_link;
        // What each spot feels: two neighbouring nodes, or the link's last node and a drive.
        let scattered = dice.uniform() < 0.2;
        let spots: Vec<[(usize, f64); 3]> = (0..count)
            .map(|sensor| {
                let (link, rank) = (sensor / plan.per_link, sensor % plan.per_link);
                let even = (rank as f64 + 0.5) / plan.per_link as f64;
                let along = if scattered { 0.5 * (even + dice.uniform()) } else { even };
                let place = (along * heat.nodes as f64 - 0.5).clamp(0.0, (heat.nodes - 1) as f64);
                let node = (place as usize).min(heat.nodes - 2);
                let rest = place - node as f64;
                let drive = LINKS * heat.nodes + link.min(heat.loss.len() - 1);
                let warm = if plan.near_drives { 0.3 * along } else { 0.0 };
                let first = link * heat.nodes + node;
                [(first, (1.0 - warm) * (1.0 - rest)), (first + 1, (1.0 - warm) * rest), (drive, warm)]
            })
            .collect();
        let moved = match lie {
            Some(Lie::Chill { tau_s, .. }) => stirred(&steps, tau_s, end_s + 10.0),
            _ => vec![0.0; 2],
        };
        let names: Vec<String> =
            (0..count).map(|s| format!("L{}S{}", s / plan.per_link, 1 + s % plan.per_link)).collect();
        let readings = |lie: Option<Lie>, dice: &mut Dice| {
            let rounds = (end_s / plan.period_s) as usize + 1;
            let late_s = if let Some(Lie::Clock { offset_s }) = lie { offset_s } else { 0.0 };
            let mut all = Vec::new();
            for (sensor, name) in names.iter().enumerate() {
                let source = match lie {
                    Some(Lie::Swap { one, other }) if sensor == one => other,
                    Some(Lie::Swap { one, other }) if sensor == other => one,
                    _ => sensor,
                };
                let zero = 0.02 * dice.normal();
                for round in 0..rounds {
                    let logged = round as f64 * plan.period_s + 0.01 * sensor as f64;
                    let time = logged - late_s;
                    let place = (time / STEP_S).clamp(0.0, (record.len() - 2) as f64);
                    let (n, rest) = (place as usize, place - place.floor());
                    let felt =
                        |n: usize| -> f64 { spots[source].iter().map(|(node, share)| share * record[n][*node]).sum() };
                    let mut celsius = felt(n) * (1.0 - rest) + felt(n + 1) * rest;
                    match lie {
                        Some(Lie::Chill { sensor: at, depth_k, .. }) if at == sensor => {
                            celsius -= depth_k * line(&moved, time);
                        }
                        Some(Lie::Step { sensor: at, time_s, step_k }) if at == sensor && time >= time_s => {
                            celsius += step_k;
                        }
                        Some(Lie::Drift { sensor: at, drift_k_per_h }) if at == sensor => {
                            celsius += drift_k_per_h * time / 3600.0;
                        }
                        Some(Lie::Detached { sensor: at, share }) if at == sensor => {
                            celsius += share * (heat.air_c(time) - celsius);
                        }
                        _ => {}
                    }
                    all.push((logged, name.clone(), quantised(celsius + zero + NOISE_K * dice.normal())));
                }
            }
            for round in 0..rounds {
                let logged = round as f64 * plan.period_s + 0.5;
                let air = heat.air_c((logged - late_s).max(0.0)) + NOISE_K * dice.normal();
                all.push((logged, "AMB".to_owned(), quantised(air)));
            }
            TemperatureLog::from_readings(all)
        };
        let noise = seed ^ 0x5eed;
        let honest = readings(None, &mut Dice::new(noise));
        let log = readings(lie, &mut Dice::new(noise));
        let mut robot = shipped("comau-nj-130-2.0").expect("a shipped arm");
        robot.sensors = names
            .iter()
            .enumerate()
            .map(|(s, name)| Sensor { name: name.clone(), link: s / plan.per_link, board: None, address: None })
            .collect();
        let run = Run {
            folder: PathBuf::new(),
            description: RunDescription {
                name: "twin".into(),
                robot: PathBuf::new(),
                reference_cycle: 0,
                ambient: Some("AMB".into()),
                instrument: Instrument {
                    name: "none".into(),
                    position: [0.0; 3],
                    sigma_m: 1e-6,
                    sigma_per_m: 0.0,
                    sigma_rad: None,
                },
                anchors: Vec::new(),
            },
            visits: Vec::new(),
            target_names: Vec::new(),
            temperatures: Some(log),
            motion: steps,
            notes: Vec::new(),
        };
        (Self { robot, run, honest }, lie)
    }
}

fn quantised(celsius: f64) -> f64 {
    (celsius * 256.0).round() / 256.0
}
