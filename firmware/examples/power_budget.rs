//! Prints what a board costs: mean current, hours on a cell of 1000 mAh and bytes on the air, at one sample a second.
//!
//! The sampler runs on a simulated bus for ten simulated minutes and counts its own duty; the datagrams are those that
//! the protocol makes of its records. What a simulation cannot know is assumed, and printed with the table.

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Bus, Device, run, simulated_time};
use embassy_time::{Duration, Instant, Timer};
use thermokin_firmware::grid::Grid;
use thermokin_firmware::power::{CELL_MAH, Duty, ESP32C3_MAX30205};
use thermokin_firmware::sampler::Sampler;
use thermokin_firmware::{SENSORS, Store, VERSION};
use thermokin_protocol::{
    BoardLink, HostLink, Identity, Inbox, Key, MAX_DATAGRAM, PowerMode, ReplayGuard, ResetReason, Sensor, SensorKind,
    Settings,
};

const MINUTES: u64 = 10;
/// From radio on to an address by DHCP: scan of one known channel, authentication, association, four-way handshake, DHCP.
const JOINING: Duration = Duration::from_millis(1200);
/// From a batch's sending to its acknowledgement: the host gathers 100 ms before it syncs.
const ANSWER: Duration = Duration::from_millis(150);

struct Row {
    mode: PowerMode,
    batch: u16,
    mean_ua: u32,
    hours: u32,
    bytes_per_reading: f64,
}

fn main() {
    let _time = simulated_time();
    println!(
        "ESP32-C3, {SENSORS} MAX30205, 1 sample/s, cell of {CELL_MAH} mAh; each row counts {MINUTES} simulated minutes"
    );
    println!("| mode | batch | mean current | hours | bytes a reading |");
    println!("| --- | --- | --- | --- | --- |");
    let rows = [
        (PowerMode::Live, 1),
        (PowerMode::Live, 10),
        (PowerMode::Live, 60),
        (PowerMode::Burst, 1),
        (PowerMode::Burst, 10),
        (PowerMode::Burst, 60),
    ];
    for (mode, batch) in rows {
        let row = budget(mode, batch);
        println!(
            "| {:?} | {} s | {:.2} mA | {} | {:.1} |",
            row.mode,
            row.batch,
            f64::from(row.mean_ua) / 1000.0,
            row.hours,
            row.bytes_per_reading
        );
    }
    println!(
        "text, as `12.000000,L0S1,25.1289` a line and one datagram each, unsealed: {} bytes a reading",
        "12.000000,L0S1,25.1289\n".len()
    );
    println!(
        "assumed: {JOINING:?} to join the network, {ANSWER:?} to an acknowledgement, no loss, and these currents:"
    );
    println!("{ESP32C3_MAX30205:#?}");
}

fn budget(mode: PowerMode, batch: u16) -> Row {
    let sensors: [Sensor; SENSORS] =
        std::array::from_fn(|index| Sensor { address: 0x48 + index as u8, kind: SensorKind::Max30205 });
    let bus = Bus::of(sensors.map(|sensor| (sensor.address, Device::max30205(25 * 256 + i16::from(sensor.address)))));
    let mut sampler = Sampler::new(bus, &sensors).expect("the addresses are the part's");
    let identity = Identity { firmware: VERSION, reset: ResetReason::PowerOn, capacity: 0 };
    let settings = Settings { batch_length: batch, power: mode, ..Settings::default() };
    let mut store: Store<0> = Store::new(1);
    let mut link = BoardLink::resume(1, Key::from_bytes([1; 32]), 1, identity, &sensors, settings, 0, &mut store);
    let mut duty = Duty::new(Instant::now());
    let mut datagram = [0; MAX_DATAGRAM];
    let mut host = HostLink::<64>::new(1, Key::from_bytes([1; 32]), 1, ReplayGuard::default(), Inbox::default());
    run(async {
        let end = Instant::now() + Duration::from_secs(MINUTES * 60);
        let mut grid = Grid::new(Duration::from_secs(1), Instant::now());
        let mut taken = 0;
        if mode == PowerMode::Live {
            duty.radio_switched_on(Instant::now());
        }
        while Instant::now() < end {
            grid.tick().await;
            let (sample, cost) = sampler.sample().await;
            duty.sampled(cost, grid.worst_lateness());
            link.record(sample.time_us, &sample.readings);
            taken += 1;
            if mode == PowerMode::Burst && taken < batch {
                continue;
            }
            taken = 0;
            let on = Instant::now();
            loop {
                let now = Instant::now().as_micros();
                while let Some(length) = link.poll(now, &mut datagram) {
                    duty.sent(length);
                    let mut answer = [0; MAX_DATAGRAM];
                    let length = answer_to(&mut host, &mut datagram[..length], &settings, &mut answer);
                    link.receive(now, &mut answer[..length]).expect("the host's answer is authentic");
                }
                if mode == PowerMode::Live || link.outbox().is_empty() {
                    break;
                }
                Timer::after(Duration::from_millis(20)).await;
            }
            if mode == PowerMode::Burst {
                duty.radio_switched_on(on);
                duty.radio_switched_off(Instant::now() + JOINING + ANSWER);
            }
        }
    });
    let budget = ESP32C3_MAX30205.budget(&duty, mode, SENSORS, Instant::now());
    let readings = f64::from(duty.samples) * SENSORS as f64;
    Row {
        mode,
        batch,
        mean_ua: budget.mean_ua,
        hours: budget.hours,
        bytes_per_reading: f64::from(duty.bytes_sent) / readings,
    }
}

/// What a host answers that has everything on disk at once.
fn answer_to(
    host: &mut HostLink<64>,
    datagram: &mut [u8],
    settings: &Settings,
    answer: &mut [u8; MAX_DATAGRAM],
) -> usize {
    let received = host.open(datagram).expect("the board's datagram is authentic");
    let inbox = host.inbox_mut();
    inbox.accept(received.boot, &received.report.batch, |_| ()).expect("the inbox has room");
    inbox.begin_commit();
    inbox.finish_commit();
    host.answer(Instant::now().as_micros(), settings, answer).expect("the board was heard")
}
