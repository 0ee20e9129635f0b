//! What the fuzz targets and the test of their corpus do with arbitrary bytes.

use thermokin_protocol::{
    BoardLink, Direction, Firmware, HEADER_LENGTH, Header, HostLink, Identity, Inbox, Key, Kind, MAX_DATAGRAM,
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
    let header = Header { version: SCHEMA_VERSION, direction, kind: Kind::Message, board: 3, epoch, counter: 0 };
    let mut buffer = [0; MAX_DATAGRAM];
    let length = bytes.len().min(seal::MAX_MESSAGE);
    buffer[HEADER_LENGTH..HEADER_LENGTH + length].copy_from_slice(&bytes[..length]);
    let length = seal::seal(&key(), &header, &mut buffer, length);
    buffer[..length].to_vec()
}

/// What the fuzz target `message` does with its input: the bytes come sealed, as from a board or host gone wrong.
pub fn message(bytes: &[u8]) {
    let mut host: HostLink<4> = HostLink::new(3, key(), 1, ReplayGuard::default(), Inbox::default());
    if let Ok(received) = host.open(&mut sealed(Direction::ToHost, 5, bytes)) {
        let _ = host.inbox_mut().accept(&received.report.batch, |_| {});
        let _ = host.inbox_mut().acknowledgement();
    }
    let identity =
        Identity { firmware: Firmware { major: 0, minor: 1, patch: 0 }, reset: ResetReason::PowerOn, capacity: 0 };
    let sensors = [Sensor { address: 0x48, kind: SensorKind::Max30205 }];
    let mut board: BoardLink<8> = BoardLink::new(3, key(), 5, identity, &sensors, Settings::default(), 0);
    if board.receive(0, &mut sealed(Direction::ToBoard, 1, bytes)).is_ok() {
        let mut buffer = [0; MAX_DATAGRAM];
        let _ = board.poll(1, &mut buffer);
        let _ = board.next_poll_us(2);
    }
}
