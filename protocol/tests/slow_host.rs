//! A host that takes its time: a board learns how long acknowledgements take and does not send again what is only waiting
//! to be synced; when the host is quick again, what is lost is sent again soon.

use proptest::prelude::*;
use thermokin_protocol::{
    BoardLink, Firmware, HostLink, Identity, Inbox, Key, MAX_DATAGRAM, Reading, ReplayGuard, ResetReason, Sensor,
    SensorKind, Settings,
};

const STEP_US: u64 = 10_000;
const SENSORS: [Sensor; 1] = [Sensor { address: 0x48, kind: SensorKind::Max30205 }];

/// A board that takes ten records a second and sends them by tens, and a host that syncs one group after another, each
/// for a while, and answers what a group covered when it is synced.
struct World {
    now_us: u64,
    board: BoardLink<2048>,
    host: HostLink<32>,
    synced_us: u64,
    heard: bool,
    /// Datagrams from the board that are lost from now on.
    lose: u32,
}

impl World {
    fn new() -> Self {
        let identity =
            Identity { firmware: Firmware { major: 0, minor: 1, patch: 0 }, reset: ResetReason::PowerOn, capacity: 0 };
        let key = Key::from_bytes([7; 32]);
        let settings = Settings { sampling_period_ms: 100, batch_length: 10, ..Settings::default() };
        Self {
            now_us: 0,
            board: BoardLink::new(3, key.clone(), 10, identity, &SENSORS, settings, 0),
            host: HostLink::new(3, key, 1, ReplayGuard::default(), Inbox::default()),
            synced_us: 0,
            heard: false,
            lose: 0,
        }
    }

    /// Runs for a time during which each sync takes as long as `sync_us` says.
    fn run(&mut self, seconds: u64, mut sync_us: impl FnMut() -> u64) {
        let (end_us, settings) = (self.now_us + seconds * 1_000_000, *self.board.settings());
        let mut buffer = [0; MAX_DATAGRAM];
        while self.now_us < end_us {
            self.now_us += STEP_US;
            if self.now_us.is_multiple_of(100_000) {
                self.board.record(self.now_us, &[Reading::Ok(5000)]);
            }
            while let Some(length) = self.board.poll(self.now_us, &mut buffer) {
                if self.lose > 0 {
                    self.lose -= 1;
                    continue;
                }
                let received = self.host.open(&mut buffer[..length]).expect("it is authentic and fresh");
                self.host.inbox_mut().accept(received.boot, &received.report.batch, |_| {}).expect("it is well formed");
                self.heard = true;
            }
            if self.now_us >= self.synced_us {
                self.host.inbox_mut().finish_commit();
                if let Some(length) = self.host.answer(1_000_000_000 + self.now_us, &settings, &mut buffer) {
                    self.board.receive(self.now_us, &mut buffer[..length]).expect("it is authentic and fresh");
                }
                // The next group is closed as soon as there is something in it.
                if std::mem::take(&mut self.heard) {
                    self.host.inbox_mut().begin_commit();
                    self.synced_us = self.now_us + sync_us();
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Syncs of up to 8 s, one unlike the other: the board learns within a few of them, and then sends hardly anything
    /// twice. A board that waits for a second sends everything again, several times.
    #[test]
    fn what_only_waits_is_not_sent_again(seed: u64, shortest_ms in 20u64..6000, spread_ms in 0u64..2000) {
        let mut random = seed;
        let mut sync_us = || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            1000 * (shortest_ms + (random >> 33) % (spread_ms + 1))
        };
        let mut world = World::new();
        world.run(120, &mut sync_us);
        let (learning, taken) = (world.board.outbox().resends(), world.board.outbox().next_sequence());
        world.run(600, &mut sync_us);
        let resends = world.board.outbox().resends() - learning;
        let records = world.board.outbox().next_sequence() - taken;
        prop_assert!(learning <= 400, "{learning} of {taken} records were sent again while it learnt");
        prop_assert!(u64::from(resends) * 50 <= records, "{resends} of {records} records were sent again");
        prop_assert_eq!(world.board.outbox().dropped(), 0);

        // Quick again: what is lost now is sent again within two seconds of its loss.
        world.run(60, || 50_000);
        let before = world.board.outbox().resends();
        world.lose = 1;
        world.run(1, || 50_000);
        prop_assert_eq!(world.lose, 0);
        world.run(2, || 50_000);
        prop_assert_eq!(world.board.outbox().resends(), before + 10);
        // What is left was taken since the last batch.
        prop_assert!(world.board.outbox().len() <= 10);
    }
}
