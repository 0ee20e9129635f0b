//! The power budget: what duty cycles cost, and what the vigil lets pass.

mod common;

use common::simulated_time;
use embassy_time::{Duration, Instant};
use thermokin_firmware::power::{Currents, Duty, ESP32C3_MAX30205, SampleCost};
use thermokin_firmware::vigil::{Starving, Vigil};
use thermokin_protocol::PowerMode;

const ROUND: Currents = Currents {
    asleep: 100,
    awake: 10_000,
    live: 20_000,
    receiving: 80_000,
    sending: 300_000,
    datagram_overhead: Duration::from_millis(1),
    byte_ns: 10_000,
    sensor_converting: 500,
    sensor_asleep: 10,
};

fn after(seconds: u64) -> Instant {
    Instant::from_secs(seconds)
}

#[test]
fn a_board_that_does_nothing_draws_what_sleep_draws() {
    let duty = Duty::new(after(0));
    assert_eq!(ROUND.budget(&duty, PowerMode::Burst, 0, after(1000)).mean_ua, 100);
    assert_eq!(ROUND.budget(&duty, PowerMode::Burst, 4, after(1000)).mean_ua, 140);
}

#[test]
fn each_part_of_the_time_is_charged_with_its_current() {
    let mut duty = Duty::new(after(0));
    // 1000 s: 10 s at the bus, 50 s of conversions, 100 s of radio of which 2 s sending.
    let cost = SampleCost { awake: Duration::from_secs(10), converting: Duration::from_secs(50) };
    duty.sampled(cost, Duration::from_millis(3));
    duty.radio_switched_on(after(0));
    for _ in 0..1000 {
        duty.sent(100);
    }
    duty.radio_switched_off(after(100));
    let budget = ROUND.budget(&duty, PowerMode::Burst, 4, after(1000));
    let expected = 2 * 300_000 + 98 * 80_000 + 10 * 10_000 + 890 * 100 + 50 * 500 + 1000 * 4 * 10;
    assert_eq!(budget.mean_ua, expected / 1000);
    assert_eq!(budget.hours, 1_000_000 / (expected / 1000));
    assert_eq!(duty.worst_lateness, Duration::from_millis(3));
}

#[test]
fn a_radio_that_is_still_up_counts_and_switching_on_twice_counts_once() {
    let mut duty = Duty::new(after(0));
    duty.radio_switched_on(after(10));
    duty.radio_switched_on(after(20));
    assert_eq!(duty.radio_up(after(30)), Duration::from_secs(20));
    duty.radio_switched_off(after(40));
    assert_eq!(duty.radio_up(after(90)), Duration::from_secs(30));
}

#[test]
fn bursts_outlive_the_live_mode_on_the_real_board() {
    let mut live = Duty::new(after(0));
    live.radio_switched_on(after(0));
    let mut burst = Duty::new(after(0));
    for minute in 0..60 {
        burst.radio_switched_on(after(minute * 60));
        burst.radio_switched_off(after(minute * 60 + 2));
    }
    let live = ESP32C3_MAX30205.budget(&live, PowerMode::Live, 4, after(3600));
    let burst = ESP32C3_MAX30205.budget(&burst, PowerMode::Burst, 4, after(3600));
    assert!(burst.hours > 5 * live.hours, "{burst:?} against {live:?}");
}

#[test]
fn the_vigil_waits_for_both_and_for_slow_sampling_longer() {
    let _time = simulated_time();
    let vigil = Vigil::new(after(0));
    let second = Duration::from_secs(1);
    assert_eq!(vigil.starving(after(10), second), None);
    assert_eq!(vigil.starving(after(11), second), Some(Starving::Sampling));
    vigil.sampled(after(11));
    assert_eq!(vigil.starving(after(11), second), Some(Starving::Uplink));
    vigil.uplink_came_round(after(11));
    assert_eq!(vigil.starving(after(21), second), None);
    vigil.uplink_came_round(after(40));
    assert_eq!(vigil.starving(after(41), second * 10), None, "three periods of ten seconds");
    vigil.uplink_came_round(after(42));
    assert_eq!(vigil.starving(after(42), second * 10), Some(Starving::Sampling));
}
