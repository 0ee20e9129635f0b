//! The temperature log: what sensors say of the bodies under them, and how effects on readings distort it.

use super::effect::Effect;
use super::heat::{spot, stirred};
use super::kind::Kind;
use super::random::Stream;
use super::world::{World, less_reference};

/// Seconds between the readings of a sensor.
pub const PERIOD_S: f64 = 10.0;
/// Steps of a reading, K.
const COUNT_K: f64 = 1.0 / 256.0;

/// The log: times and readings of each sensor in the arm's order, the air's last.
pub struct Log {
    /// Seconds and °C.
    pub sensors: Vec<Vec<(f64, f64)>>,
}

/// What sensor `s` says at logged times (in order), without its noise.
pub fn said(world: &World, effects: &[Effect], s: usize, times: &[f64]) -> Vec<f64> {
    let mut source = s;
    let mut late_s = 0.0;
    for effect in effects {
        match effect.kind {
            Kind::SensorSwap if effect.place.sensors[0] == s => source = effect.place.sensors[1],
            Kind::SensorSwap if effect.place.sensors[1] == s => source = effect.place.sensors[0],
            Kind::ClockOffset => late_s += effect.shape[0],
            _ => {}
        }
    }
    let true_times: Vec<f64> = times.iter().map(|time| time - late_s).collect();
    let weights = spot(world.arm.sensors[source].link, world.arm.sensors[source].along);
    let mut said: Vec<f64> = true_times.iter().map(|&time| world.heat.at(&weights, time)).collect();
    for effect in effects.iter().filter(|effect| effect.place.sensors == [source]) {
        match effect.kind {
            Kind::SensorChill => {
                let moved = stirred(&world.schedule, effect.shape[1], &true_times);
                said.iter_mut().zip(moved).for_each(|(c, moved)| *c -= effect.shape[0] * moved);
            }
            Kind::SensorBias => said.iter_mut().zip(&true_times).for_each(|(c, &time)| {
                let step = if time >= effect.shape[0] { effect.shape[1] } else { 0.0 };
                *c += step + effect.shape[2] * time / 3600.0;
            }),
            Kind::SensorDetached => said.iter_mut().zip(&true_times).for_each(|(c, &time)| {
                *c += effect.shape[0] * (world.heat.air_c(time) - *c);
            }),
            _ => {}
        }
    }
    said
}

/// The rise above the reference cycle that a reader of the log finds at each point, without noise.
pub fn said_rises(world: &World, effects: &[Effect]) -> Vec<Vec<f64>> {
    let times: Vec<f64> = world.points.iter().map(|point| point.time_s).collect();
    (0..world.arm.sensors.len())
        .map(|s| less_reference(&world.schedule, &world.points, said(world, effects, s, &times)))
        .collect()
}

/// The log of a run with its noise.
pub fn log(world: &World, effects: &[Effect], stream: &mut Stream) -> Log {
    let rounds = (world.schedule.end_s / PERIOD_S) as usize + 2;
    let (noise, bias) = world.noise.reading_k;
    let quantized = |c: f64| libm::round(c / COUNT_K) * COUNT_K;
    let count = world.arm.sensors.len();
    let mut sensors: Vec<Vec<(f64, f64)>> = (0..count)
        .map(|s| {
            let times: Vec<f64> = (0..rounds).map(|round| round as f64 * PERIOD_S + 0.01 * s as f64).collect();
            let bias = bias * stream.normal();
            let values = said(world, effects, s, &times);
            times
                .into_iter()
                .zip(values)
                .map(|(time, c)| (time, quantized(c + bias + noise * stream.normal())))
                .collect()
        })
        .collect();
    let late_s: f64 =
        effects.iter().filter(|effect| effect.kind == Kind::ClockOffset).map(|effect| effect.shape[0]).sum();
    let air = (0..rounds).map(|round| {
        let time = round as f64 * PERIOD_S + 0.01 * count as f64;
        (time, quantized(world.heat.air_c((time - late_s).max(0.0)) + noise * stream.normal()))
    });
    sensors.push(air.collect());
    Log { sensors }
}
