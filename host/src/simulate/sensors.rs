//! What the temperature sensors say: a spot between core and housing, a first-order response, counts of 1/256 °C.

use std::collections::BTreeMap;

use super::arm::node_place;
use super::heat::Trajectory;
use super::random::{Purpose, Stream};
use super::scenario::{Node, Scenario};
use super::timetable::to_millisecond;
use super::warmth::Warmth;
use crate::run::TemperatureLog;

/// Counts of the sensor per °C.
const COUNTS_PER_K: f64 = 256.0;
/// Time from one sensor of a board to the next, s.
const NEXT_SENSOR_S: f64 = 0.01;

/// Where one sensor sits and how it errs.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spot {
    pub name: String,
    /// The link; none for the sensor of the air.
    link: Option<usize>,
    /// The share of the core in what the spot feels.
    pub core_share: f64,
    /// K.
    pub bias_k: f64,
    /// When its board begins a round, and its turn in the round, s.
    offset_s: f64,
    /// The board, for the jitter that its sensors share.
    board: usize,
}

/// The spots of all sensors: part of what the arm is, so drawn by the arm's seed.
pub(super) fn spots(scenario: &Scenario) -> Vec<Spot> {
    let sensors = &scenario.sensors;
    let mut stream = Stream::new(scenario.arm.seed, Purpose::SensorSpots);
    let mut boards: BTreeMap<Option<u32>, (usize, usize)> = BTreeMap::new();
    let board_count = {
        let mut all: Vec<Option<u32>> = scenario.robot.sensors.iter().map(|sensor| sensor.board).collect();
        all.sort_unstable();
        all.dedup();
        all.len() + usize::from(sensors.ambient.is_some())
    };
    let begin = |board: usize| sensors.period_s * board as f64 / board_count as f64;
    let mut spots: Vec<Spot> = Vec::new();
    for sensor in &scenario.robot.sensors {
        let next = boards.len();
        let (board, turn) = boards.entry(sensor.board).or_insert((next, 0));
        spots.push(Spot {
            name: sensor.name.clone(),
            link: Some(sensor.link),
            core_share: stream.between(sensors.core_share[0], sensors.core_share[1]),
            bias_k: sensors.bias_k * stream.normal(),
            offset_s: begin(*board) + *turn as f64 * NEXT_SENSOR_S,
            board: *board,
        });
        *turn += 1;
    }
    if let Some(name) = &sensors.ambient {
        let board = boards.len();
        let bias_k = sensors.bias_k * stream.normal();
        spots.push(Spot { name: name.clone(), link: None, core_share: 0.0, bias_k, offset_s: begin(board), board });
    }
    spots
}

/// The readings of all sensors until the last step of the timetable ends.
pub(super) fn readings(scenario: &Scenario, spots: &[Spot], warmth: &Warmth) -> TemperatureLog {
    let sensors = &scenario.sensors;
    let felt = felt(scenario, spots, warmth);
    let end_s = warmth.nodes.times_s.last().copied().unwrap_or(0.0);
    let boards = spots.iter().map(|spot| spot.board + 1).max().unwrap_or(0);
    let mut stream = Stream::new(scenario.seed, Purpose::Readings);
    let mut log = Vec::new();
    let rounds = libm::floor(end_s / sensors.period_s) as usize + 1;
    for round in 0..rounds {
        // A late round stays between its neighbours, or times would not ascend.
        let limit = sensors.period_s / 4.0;
        let late: Vec<f64> = (0..boards).map(|_| (sensors.jitter_s * stream.normal()).clamp(-limit, limit)).collect();
        for (place, spot) in spots.iter().enumerate() {
            let noise_k = sensors.noise_k * stream.normal();
            let time_s = to_millisecond(round as f64 * sensors.period_s + spot.offset_s + late[spot.board]);
            if (0.0..=end_s).contains(&time_s) {
                let celsius = felt.one_at(place, time_s) + spot.bias_k + noise_k;
                log.push((time_s, spot.name.as_str(), libm::round(celsius * COUNTS_PER_K) / COUNTS_PER_K));
            }
        }
    }
    TemperatureLog::from_readings(log)
}

/// The temperature of every sensor itself over time, which follows that of its spot with first-order lag.
fn felt(scenario: &Scenario, spots: &[Spot], warmth: &Warmth) -> Trajectory {
    let sensors = &scenario.sensors;
    let ambient = &scenario.heat.ambient;
    let spot_c = |spot: &Spot, nodes_c: &[f64], time_s: f64| match spot.link {
        None => ambient.celsius(time_s),
        Some(link) => {
            let core = nodes_c[node_place(link, Node::Core)];
            let housing = nodes_c[node_place(link, Node::Housing)];
            housing + spot.core_share * (core - housing)
        }
    };
    let nodes = &warmth.nodes;
    let mut now_c: Vec<f64> = spots.iter().map(|spot| spot_c(spot, &nodes.temperatures[0], 0.0)).collect();
    let mut felt = Trajectory::default();
    felt.push(0.0, now_c.clone());
    for (interval, ends) in warmth.intervals.iter().zip(nodes.temperatures.windows(2)) {
        let kept = libm::exp(-(interval.end_s - interval.start_s) / sensors.response_s);
        for (now_c, spot) in now_c.iter_mut().zip(spots) {
            let chill = spot.link.map_or(0.0, |link| sensors.chill_k * interval.link_speeds[link]);
            let middle =
                (spot_c(spot, &ends[0], interval.start_s) + spot_c(spot, &ends[1], interval.end_s)) / 2.0 - chill;
            *now_c = middle + kept * (*now_c - middle);
        }
        felt.push(interval.end_s, now_c.clone());
    }
    felt
}
