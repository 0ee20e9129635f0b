//! What the fuzz targets and the test of their corpus do with arbitrary bytes.

use thermokin_protocol::{
    BoardLink, Direction, Firmware, HEADER_LENGTH, Header, HostLink, Identity, Inbox, Key, Kind, MAX_DATAGRAM, Reading,
    ReplayGuard, ResetReason, SCHEMA_VERSION, Sensor, SensorKind, Settings, seal,
};

fn key() -> Key {
    Key::from_bytes([7; 32])
}

/// What the fuzz target `datagram` does with its input.
pub fn datagram(bytes: &[u8]) {
    let _ = Header::parse(bytes);
    let mut host: HostLink<4> = HostLink::new(3, key(), 1, ReplayGuard::default(), Inbox::default());
    let _ = host.open(&mut bytes.to_vec());
    let identity =
        Identity { firmware: Firmware { major: 0, minor: 1, patch: 0 }, reset: ResetReason::PowerOn, capacity: 0 };
    let sensors = [Sensor { address: 0x48, kind: SensorKind::Max30205 }];
    let mut board: BoardLink<8> = BoardLink::new(3, key(), 1, identity, &sensors, Settings::default(), 0);
    let _ = board.receive(0, &mut bytes.to_vec());
}

/// The bytes sealed under the right key, as many as a datagram takes.
fn sealed(direction: Direction, epoch: u32, bytes: &[u8]) -> Vec<u8> {
    sealed_as(Kind::Message, direction, epoch, bytes)
}

fn sealed_as(kind: Kind, direction: Direction, epoch: u32, bytes: &[u8]) -> Vec<u8> {
    let header = Header { version: SCHEMA_VERSION, direction, kind, board: 3, epoch, counter: 0 };
    let mut buffer = [0; MAX_DATAGRAM];
    let length = bytes.len().min(seal::MAX_MESSAGE);
    buffer[HEADER_LENGTH..HEADER_LENGTH + length].copy_from_slice(&bytes[..length]);
    let length = seal::seal(&key(), &header, &mut buffer, length);
    buffer[..length].to_vec()
}

/// What the fuzz target `message` does with its input: the bytes come sealed, as from a board or host gone wrong, to ends
/// that have something in their windows.
pub fn message(bytes: &[u8]) {
    let mut host: HostLink<4> = HostLink::new(3, key(), 1, ReplayGuard::default(), Inbox::default());
    // The second time it is a message of a later boot, which meets what the first left behind.
    for boot in [5, 6] {
        if let Ok(received) = host.open(&mut sealed(Direction::ToHost, boot, bytes)) {
            let _ = host.inbox_mut().accept(received.boot, &received.report.batch, |_| {});
            host.inbox_mut().begin_commit();
            host.inbox_mut().finish_commit();
            let _ = host.inbox_mut().acknowledgement();
        }
    }
    let identity =
        Identity { firmware: Firmware { major: 0, minor: 1, patch: 0 }, reset: ResetReason::PowerOn, capacity: 0 };
    let sensors = [Sensor { address: 0x48, kind: SensorKind::Max30205 }];
    let mut board: BoardLink<8> = BoardLink::new(3, key(), 5, identity, &sensors, Settings::default(), 0);
    let mut buffer = [0; MAX_DATAGRAM];
    // The same bytes as something that is said of a new program.
    let _ = host.open_update(&mut sealed_as(Kind::Update, Direction::ToHost, 7, bytes));
    let _ = board.receive(0, &mut sealed_as(Kind::Update, Direction::ToBoard, 0, bytes));
    // Some records are thinned out, some are under way and some are not when the message comes.
    for second in 0..12 {
        board.record(second * 1_000_000, &[Reading::Ok(5000)]);
        if second < 10 {
            while board.poll(second * 1_000_000, &mut buffer).is_some() {}
        }
    }
    let held = board.outbox().len();
    if let Ok(heard) = board.receive(11_000_000, &mut sealed(Direction::ToBoard, 1, bytes)) {
        assert_eq!(board.outbox().len() + heard.released, held);
        while board.poll(11_000_001, &mut buffer).is_some() {}
        let _ = board.next_poll_us(11_000_002);
    }
}
