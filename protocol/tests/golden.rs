//! Byte strings that both ends must make and take, for ever: a change here is a change of the wire.

use heapless::Vec;
use thermokin_protocol::{
    Acknowledgement, Answer, Batch, Battery, BoardMessage, Counters, Direction, Firmware, HEADER_LENGTH, Header,
    Health, HostMessage, Identity, Key, Kind, MAX_BATCH, MAX_DATAGRAM, MAX_SENSORS, MAX_SEQUENCE, PowerMode, Reading,
    Record, Report, ResetReason, Segment, Sensor, SensorKind, Settings, Signal, TimeEcho, seal,
};

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn encoded(message: &impl serde::Serialize) -> String {
    let mut buffer = [0; 2048];
    hex(postcard::to_slice(message, &mut buffer).expect("it fits"))
}

fn report() -> BoardMessage {
    let readings = [Reading::Ok(5440), Reading::Absent, Reading::BusError, Reading::OutOfRange(-256)];
    BoardMessage::Report(Report {
        sent_us: 1_000_000,
        echo: Some(TimeEcho { host_us: 1_700_000_000_000_000, received_us: 900_000 }),
        identity: Some(Identity {
            firmware: Firmware { major: 1, minor: 2, patch: 3 },
            reset: ResetReason::Watchdog,
            capacity: 900,
        }),
        health: Health {
            battery: Battery::Millivolts(3987),
            signal: Signal::Dbm(-61),
            counters: Counters {
                reads_failed: 1,
                bus_recoveries: 2,
                records_dropped: 3,
                resends: 4,
                datagrams_refused: 5,
            },
        },
        settings_revision: 7,
        batch: Batch {
            store: 9,
            boot: 10,
            from: 100,
            until: 300,
            sensors: (0..4).map(|index| Sensor { address: 0x48 + index, kind: SensorKind::Max30205 }).collect(),
            records: Vec::from_iter([Record {
                sequence: 128,
                time_us: 950_000,
                readings: readings.into_iter().collect(),
            }]),
        },
    })
}

fn answer() -> HostMessage {
    HostMessage::Answer(Answer {
        boot: 10,
        host_us: 1_700_000_000_123_456,
        identity_known: true,
        acknowledgement: Acknowledgement {
            store: 9,
            below: 100,
            segments: Vec::from_iter([Segment { from: 128, bits: 1 }]),
        },
        settings: Settings { revision: 7, sampling_period_ms: 1000, batch_length: 10, power: PowerMode::Burst },
    })
}

#[test]
fn messages() {
    assert_eq!(encoded(&report()), REPORT);
    assert_eq!(encoded(&answer()), ANSWER);
}

#[test]
fn every_variant_has_its_number() {
    let numbers = [
        encoded(&[ResetReason::Unknown, ResetReason::PowerOn, ResetReason::Brownout, ResetReason::Watchdog]),
        encoded(&[ResetReason::Software, ResetReason::Panic, ResetReason::External, ResetReason::Wake]),
        encoded(&[Battery::NotMeasured, Battery::Millivolts(1)]),
        encoded(&[Signal::NotMeasured, Signal::Dbm(1)]),
        encoded(&[SensorKind::Max30205, SensorKind::Lm75]),
        encoded(&[Reading::Ok(1), Reading::Absent, Reading::BusError, Reading::OutOfRange(1)]),
        encoded(&[PowerMode::Live, PowerMode::Burst]),
    ];
    assert_eq!(numbers, ["00010203", "04050607", "000101", "000101", "0001", "000201020302", "0001"]);
}

#[test]
fn a_sealed_datagram() {
    let key = Key::from_bytes(std::array::from_fn(|index| index as u8));
    let header = Header {
        version: 1,
        direction: Direction::ToBoard,
        kind: Kind::Message,
        board: 3,
        epoch: 1_795_000_000,
        counter: 42,
    };
    let mut buffer = [0; MAX_DATAGRAM];
    buffer[HEADER_LENGTH..HEADER_LENGTH + 5].copy_from_slice(b"hello");
    let length = seal::seal(&key, &header, &mut buffer, 5);
    assert_eq!(hex(&buffer[..length]), SEALED);
    assert_eq!(Header::parse(&buffer), Ok(header));
}

#[test]
fn the_largest_report_fits_a_datagram() {
    let counters = Counters {
        reads_failed: u32::MAX,
        bus_recoveries: u32::MAX,
        records_dropped: u32::MAX,
        resends: u32::MAX,
        datagrams_refused: u32::MAX,
    };
    let largest = BoardMessage::Report(Report {
        sent_us: u64::MAX,
        echo: Some(TimeEcho { host_us: u64::MAX, received_us: u64::MAX }),
        identity: Some(Identity {
            firmware: Firmware { major: u16::MAX, minor: u16::MAX, patch: u16::MAX },
            reset: ResetReason::Wake,
            capacity: u32::MAX,
        }),
        health: Health { battery: Battery::Millivolts(u16::MAX), signal: Signal::Dbm(i8::MIN), counters },
        settings_revision: u32::MAX,
        batch: Batch {
            store: u32::MAX,
            boot: u32::MAX,
            from: MAX_SEQUENCE,
            until: MAX_SEQUENCE,
            sensors: (0..MAX_SENSORS).map(|_| Sensor { address: 0x7F, kind: SensorKind::Lm75 }).collect(),
            records: Vec::<Record, MAX_BATCH>::new(),
        },
    });
    // What board_link.rs leaves for everything but the records.
    assert!(encoded(&largest).len() / 2 <= 140, "{}", encoded(&largest).len() / 2);
}

const REPORT: &str = "00c0843d018080f9c0c1c48203a0f7360101020303840701931f01c3010203040507090a64ac0204480049004a004b0001\
    8001f0fd3904008055010203ff03";
const ANSWER: &str = "000ac0c480c1c1c482030109640180010107e8070a01";
const SEALED: &str = "544b018003000000c086fd6a2a00000000000000a14ddc82e7a452f785b1c8bcf50aeef861f84aad01";
