//! Byte strings that both ends must make and take, for ever: a change here is a change of the wire.

use heapless::Vec;
use thermokin_protocol::update::{
    CHUNK, Chunk, Manifest, Offer, Target, UpdateOrder, UpdateRefusal, UpdateReport, UpdateState,
};
use thermokin_protocol::{
    Acknowledgement, Answer, Batch, Battery, BoardLink, BoardMessage, Counters, Direction, Firmware, HEADER_LENGTH,
    Header, Health, HostLink, HostMessage, Identity, Inbox, Key, Kind, MAX_BATCH, MAX_DATAGRAM, MAX_SENSORS,
    MAX_SEQUENCE, PowerMode, Reading, Record, Refused, ReplayGuard, Report, ResetReason, Segment, Sensor, SensorKind,
    Settings, Signal, TimeEcho, seal,
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

fn offer() -> UpdateOrder<'static> {
    UpdateOrder::Offer(Offer {
        boot: 10,
        order: 300,
        patience_s: 128,
        manifest: manifest(),
        signature: [[0x5A; 32], [0xA5; 32]],
    })
}

fn manifest() -> Manifest {
    let digest = std::array::from_fn(|index| index as u8);
    Manifest { target: Target::Esp32c3, version: Firmware { major: 1, minor: 2, patch: 3 }, length: 70_000, digest }
}

#[test]
fn what_is_said_of_a_new_program() {
    assert_eq!(encoded(&offer()), format!("000aac02800101010203f0a204{DIGITS}{}{}", "5a".repeat(32), "a5".repeat(32)));
    assert_eq!(
        hex(&manifest().signed_bytes()),
        format!("{}0100010002000300{}{DIGITS}", hex(b"thermokin program 1\0"), "70110100")
    );
    assert_eq!(Manifest::from_bytes(&manifest().to_bytes()), Some(manifest()));
    let chunk = UpdateOrder::Chunk(Chunk { boot: 10, order: 300, offset: 1024, bytes: b"hello" });
    assert_eq!(encoded(&chunk), "010aac0280080568656c6c6f");
    let states = [
        UpdateState::Wants(1024),
        UpdateState::Checking,
        UpdateState::Restarting,
        UpdateState::OnTrial,
        UpdateState::Installed,
        UpdateState::RolledBack,
        UpdateState::Refused(UpdateRefusal::NoSlots),
    ];
    assert_eq!(
        states.map(|state| encoded(&UpdateReport { order: 3, state })).join(" "),
        "03008008 0301 0302 0303 0304 0305 030600"
    );
    let refusals = [
        UpdateRefusal::NoSlots,
        UpdateRefusal::NoKey,
        UpdateRefusal::BadSignature,
        UpdateRefusal::OtherTarget,
        UpdateRefusal::BadLength,
        UpdateRefusal::Damaged,
        UpdateRefusal::Flash,
        UpdateRefusal::OnTrial,
    ];
    assert_eq!(encoded(&refusals), "0001020304050607");
    assert_eq!(encoded(&[Target::Emulated, Target::Esp32c3, Target::Esp32c6]), "000102");
}

#[test]
fn the_largest_chunk_fits_a_datagram() {
    let bytes = [0xFF; CHUNK];
    let largest = UpdateOrder::Chunk(Chunk { boot: u32::MAX, order: u32::MAX, offset: u32::MAX, bytes: &bytes });
    assert!(encoded(&largest).len() / 2 <= seal::MAX_MESSAGE);
}

#[test]
fn a_program_is_told_of_between_the_ends_and_to_one_boot_only() {
    let key = Key::from_bytes([7; 32]);
    let identity =
        Identity { firmware: Firmware { major: 0, minor: 1, patch: 0 }, reset: ResetReason::PowerOn, capacity: 0 };
    let mut board: BoardLink<8> = BoardLink::new(3, key.clone(), 10, identity, &[], Settings::default(), 0);
    let mut host: HostLink<4> = HostLink::new(3, key, 1, ReplayGuard::default(), Inbox::default());
    let mut buffer = [0; MAX_DATAGRAM];
    assert_eq!(host.update(&offer(), &mut buffer), None, "a board that was never heard");
    let report = UpdateReport { order: 300, state: UpdateState::OnTrial };
    let length = board.seal_update(&report, &mut buffer).unwrap();
    let mut again = buffer;
    assert_eq!(host.open_update(&mut buffer[..length]), Ok(report));
    assert_eq!(host.open_update(&mut again[..length]), Err(Refused::Replayed));
    for (boot, heard) in [(10, Ok(())), (9, Err(Refused::OtherBoot))] {
        let order = UpdateOrder::Chunk(Chunk { boot, order: 300, offset: 1024, bytes: b"hello" });
        let length = host.update(&order, &mut buffer).unwrap();
        let taken = board.receive(5, &mut buffer[..length]);
        assert_eq!(taken.map(|heard| assert_eq!(heard.update, Some(order))), heard);
    }
    // A report of records is none of programs, and the other way round.
    let length = board.poll(2_000_000, &mut buffer).unwrap();
    assert_eq!(host.open_update(&mut buffer[..length]), Err(Refused::Malformed));
    let length = board.seal_update(&report, &mut buffer).unwrap();
    assert_eq!(host.open(&mut buffer[..length]), Err(Refused::Malformed));
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

const DIGITS: &str = "000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f";
const REPORT: &str = "00c0843d018080f9c0c1c48203a0f7360101020303840701931f01c3010203040507090a64ac0204480049004a004b0001\
    8001f0fd3904008055010203ff03";
const ANSWER: &str = "000ac0c480c1c1c482030109640180010107e8070a01";
const SEALED: &str = "544b018003000000c086fd6a2a00000000000000a14ddc82e7a452f785b1c8bcf50aeef861f84aad01";
