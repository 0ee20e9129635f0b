//! The sampler and its grid: one reading a sensor, whatever the others do, at the grid's times.

mod common;

use common::{Behaviour, Bus, Device, run, simulated_time};
use embassy_time::{Duration, Instant, Timer};
use thermokin_firmware::grid::Grid;
use thermokin_firmware::sampler::{BadAddress, Sampler};
use thermokin_protocol::{Reading, Sensor, SensorKind};

const ADDRESSES: [u8; 4] = [0x48, 0x49, 0x4A, 0x4B];

fn sensors() -> [Sensor; 4] {
    ADDRESSES.map(|address| Sensor { address, kind: SensorKind::Max30205 })
}

fn bus() -> Bus {
    Bus::of(ADDRESSES.map(|address| (address, Device::max30205(i16::from(address) * 100))))
}

fn healthy() -> [Reading; 4] {
    ADDRESSES.map(|address| Reading::Ok(i16::from(address) * 100))
}

/// What the sensors read when one of them has a fault.
fn without(index: usize, reading: Reading) -> [Reading; 4] {
    let mut readings = healthy();
    readings[index] = reading;
    readings
}

fn sampler(bus: &Bus) -> Sampler<Bus> {
    Sampler::new(bus.clone(), &sensors()).unwrap()
}

fn sample(sampler: &mut Sampler<Bus>) -> [Reading; 4] {
    run(sampler.sample()).0.readings.into_array().unwrap()
}

#[test]
fn all_sensors_convert_at_once() {
    let _time = simulated_time();
    let started = Instant::now();
    let (sample, cost) = run(sampler(&bus()).sample());
    assert_eq!(sample.readings, healthy());
    assert_eq!(sample.time_us, started.as_micros());
    // 50 ms of conversion, and for each sensor 3 transfers configuring, 1 starting and 2 reading, 0.3 ms each.
    assert!(started.elapsed() < Duration::from_millis(60), "one after another: {:?}", started.elapsed());
    assert_eq!(cost.converting, Duration::from_millis(200));
    assert!((5000..9000).contains(&cost.awake.as_micros()), "{:?}", cost.awake);
}

#[test]
fn a_sensor_that_vanishes_costs_its_own_reading_and_is_taken_up_again() {
    let _time = simulated_time();
    let bus = bus();
    let mut sampler = sampler(&bus);
    assert_eq!(sample(&mut sampler), healthy());
    bus.device(0x49).behaviour = Behaviour::Gone;
    assert_eq!(sample(&mut sampler), without(1, Reading::Absent));
    assert_eq!(sample(&mut sampler), without(1, Reading::Absent));
    bus.device(0x49).behaviour = Behaviour::Healthy;
    bus.device(0x49).brown_out();
    assert_eq!(sample(&mut sampler), healthy());
    assert_eq!((sampler.reads_failed(), sampler.bus_recoveries()), (2, 0));
}

#[test]
fn a_sensor_that_lost_its_supply_between_samples_converts_all_the_same() {
    let _time = simulated_time();
    let bus = bus();
    let mut sampler = sampler(&bus);
    sample(&mut sampler);
    bus.device(0x4A).brown_out();
    assert_eq!(sample(&mut sampler), healthy());
}

#[test]
fn a_held_bus_is_freed_at_once_and_counted() {
    let _time = simulated_time();
    let bus = bus();
    let mut sampler = sampler(&bus);
    sample(&mut sampler);
    bus.device(0x4B).behaviour = Behaviour::Holding;
    let started = Instant::now();
    assert_eq!(sample(&mut sampler), without(0, Reading::BusError), "the first transfer finds the bus held");
    assert!(started.elapsed() < Duration::from_millis(100), "{:?}", started.elapsed());
    assert_eq!((sampler.reads_failed(), sampler.bus_recoveries(), bus.recoveries()), (1, 1, 1));
    assert_eq!(sample(&mut sampler), healthy());
}

#[test]
fn errors_of_the_bus_itself_are_met_by_setting_it_up_anew_at_the_third() {
    let _time = simulated_time();
    let bus = bus();
    let mut sampler = sampler(&bus);
    sample(&mut sampler);
    for address in ADDRESSES {
        bus.device(address).behaviour = Behaviour::Failing;
    }
    assert_eq!(sample(&mut sampler), [Reading::BusError; 4]);
    assert_eq!(bus.recoveries(), 1);
}

#[test]
fn counts_beyond_the_operating_range_are_kept_and_flagged() {
    let _time = simulated_time();
    let bus = bus();
    let mut sampler = sampler(&bus);
    for (counts, reading) in [
        (50 * 256, Reading::Ok(50 * 256)),
        (50 * 256 + 1, Reading::OutOfRange(50 * 256 + 1)),
        (0, Reading::Ok(0)),
        (-1, Reading::OutOfRange(-1)),
    ] {
        bus.device(0x48).temperature = counts;
        assert_eq!(sample(&mut sampler), without(0, reading));
    }
}

#[test]
fn sensors_that_cannot_be_are_refused() {
    let sensor = |address, kind| Sensor { address, kind };
    let refused = |sensors: &[Sensor]| Sampler::new(Bus::default(), sensors).map(|_| ());
    assert_eq!(refused(&[sensor(0x60, SensorKind::Max30205)]), Err(BadAddress(0x60)));
    assert_eq!(refused(&[sensor(0x5F, SensorKind::Lm75)]), Err(BadAddress(0x5F)));
    assert_eq!(refused(&[sensor(0x48, SensorKind::Lm75); 2]), Err(BadAddress(0x48)));
    let five: Vec<_> = (0x48..0x4D).map(|address| sensor(address, SensorKind::Lm75)).collect();
    assert_eq!(refused(&five), Err(BadAddress(0x4C)));
}

#[test]
fn the_grid_is_kept_whatever_a_sample_takes() {
    let _time = simulated_time();
    let times = run(async {
        Timer::after(Duration::from_millis(350)).await;
        let mut grid = Grid::new(Duration::from_millis(1000), Instant::now());
        let mut times = Vec::new();
        for busy_ms in [10, 999, 300, 0, 700] {
            grid.tick().await;
            times.push(Instant::now().as_millis());
            Timer::after(Duration::from_millis(busy_ms)).await;
        }
        assert_eq!(grid.missed(), 0);
        assert_eq!(grid.worst_lateness(), Duration::from_ticks(0));
        times
    });
    assert_eq!(times, [1000, 2000, 3000, 4000, 5000]);
}

#[test]
fn grid_points_that_passed_are_counted_and_not_caught_up() {
    let _time = simulated_time();
    run(async {
        let mut grid = Grid::new(Duration::from_millis(1000), Instant::now());
        grid.tick().await;
        Timer::after(Duration::from_millis(3400)).await;
        grid.tick().await;
        assert_eq!(Instant::now().as_millis(), 5000);
        assert_eq!(grid.missed(), 3, "2000, 3000 and 4000 passed");
    });
}

#[test]
fn a_new_period_begins_a_new_grid() {
    let _time = simulated_time();
    run(async {
        let mut grid = Grid::new(Duration::from_millis(1000), Instant::now());
        grid.tick().await;
        grid.set_period(Duration::from_millis(400), Instant::now());
        for expected in [1200, 1600, 2000] {
            grid.tick().await;
            assert_eq!(Instant::now().as_millis(), expected);
        }
    });
}
