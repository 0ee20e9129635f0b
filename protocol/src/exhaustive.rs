//! Every state that a small window can get into, visited one by one.
//!
//! A board whose store has room for two records takes up to four; two datagrams at most are under way in each direction
//! and each may be delivered in any order, delivered twice, or lost; the host syncs, fails to sync or is killed at any
//! moment; the board loses its power or resets with its store retained. Time is left out: whatever is held may be sent
//! at any moment, which covers every timing. In every state the invariants are checked, and that a window left in peace
//! from then on completes.

extern crate std;

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::format;
use std::string::String;
use std::vec::Vec;

use crate::inbox::{Arrival, Gap, Inbox};
use crate::message::{Acknowledgement, Batch, Segment};
use crate::outbox::{Outbox, Pace};

type Board = Outbox<2>;
const PACE: Pace = Pace { now_us: 1, resend_after_us: 0 };

/// What the host wrote: a record, or a gap up to an end (none: open).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Written {
    Record { store: u32, sequence: u64, time_us: u64 },
    Gap { store: u32, stores_until: u32, from: u64, until: Option<u64> },
}

impl Written {
    /// Whether it is a gap that says that a record will never come.
    fn tells(&self, in_store: u32, sequence: u64) -> bool {
        matches!(*self, Written::Gap { store, stores_until, from, until }
            if (store..stores_until).contains(&in_store)
                && from <= sequence
                && until.is_none_or(|until| sequence < until))
    }
}

#[derive(Debug, Clone)]
struct World {
    board: Board,
    boot: u32,
    host: Inbox<2>,
    /// Synced, in order.
    disk: Vec<Written>,
    /// Being synced.
    syncing: Vec<Written>,
    /// Received since the sync began.
    pending: Vec<Written>,
    /// The window's state as it is on disk.
    remembered: Option<(u32, u32, u64, Vec<Segment>)>,
    /// The newest boot heard, as it will be remembered with what is being synced and with what was received since.
    heard: (u32, u32),
    /// Batches under way, with the boots that sent them.
    up: Vec<(u32, Batch)>,
    down: Vec<Acknowledgement>,
    /// Everything ever taken: (store, sequence) to its time.
    taken: BTreeMap<(u32, u64), u64>,
    /// What the board no longer holds without an acknowledgement.
    lost: BTreeSet<(u32, u64)>,
    pushes: u8,
    trouble: u8,
}

impl World {
    fn push(&mut self) {
        let before: BTreeSet<u64> = self.board.sequences().collect();
        let time_us = 100 + self.taken.len() as u64;
        let sequence = self.board.push(self.boot, time_us, heapless::Vec::new());
        self.taken.insert((self.board.store(), sequence), time_us);
        let after: BTreeSet<u64> = self.board.sequences().collect();
        self.lost.extend(before.difference(&after).map(|&gone| (self.board.store(), gone)));
        self.pushes -= 1;
    }

    fn deliver_up(&mut self, boot: u32, batch: &Batch) {
        // What an earlier boot sent is refused before the window sees it (`crate::ReplayGuard`).
        if boot < self.heard.1 {
            return;
        }
        self.heard.1 = boot;
        let (host, pending) = (&mut self.host, &mut self.pending);
        // A batch of a store that ended is refused; that is all there is to it.
        let _ = host.accept(boot, batch, |arrival| {
            pending.push(match arrival {
                Arrival::Record(record) => {
                    Written::Record { store: batch.store, sequence: record.sequence, time_us: record.time_us }
                }
                Arrival::Gap(Gap { store, stores_until, from, until, .. }) => {
                    Written::Gap { store, stores_until, from, until }
                }
            });
        });
    }

    fn begin_sync(&mut self) {
        self.heard.0 = self.host.boot().unwrap_or(0);
        self.host.begin_commit();
        self.syncing = core::mem::take(&mut self.pending);
    }

    fn finish_sync(&mut self) {
        self.host.finish_commit();
        self.disk.append(&mut self.syncing);
        if let Some((store, below, segments)) = self.host.durable() {
            self.remembered = Some((self.heard.0, store, below, segments.to_vec()));
        }
    }

    fn acknowledge(&mut self, acknowledgement: &Acknowledgement) {
        let before: Vec<u64> = self.board.sequences().collect();
        self.board.acknowledge(acknowledgement);
        let after: BTreeSet<u64> = self.board.sequences().collect();
        for sequence in before.into_iter().filter(|sequence| !after.contains(sequence)) {
            assert!(
                self.stored(self.board.store(), sequence),
                "acknowledged without being on disk: {sequence} in {self:?}"
            );
        }
    }

    /// The host is killed; what it remembers is what was synced.
    fn restart_host(&mut self) {
        self.pending.clear();
        self.syncing.clear();
        self.heard = self.remembered.as_ref().map_or((0, 0), |remembered| (remembered.0, remembered.0));
        self.host = match &self.remembered {
            Some((boot, store, below, segments)) => {
                Inbox::restore(*boot, *store, *below, segments).expect("it fitted before")
            }
            None => Inbox::from_boot(1),
        };
    }

    fn stored(&self, store: u32, sequence: u64) -> bool {
        self.disk.iter().any(
            |written| matches!(written, Written::Record { store: s, sequence: q, .. } if (*s, *q) == (store, sequence)),
        )
    }

    fn check(&self) {
        let mut records = BTreeSet::new();
        for written in &self.disk {
            if let Written::Record { store, sequence, time_us } = *written {
                assert!(records.insert((store, sequence)), "stored twice: {sequence} in {self:?}");
                assert_eq!(self.taken.get(&(store, sequence)), Some(&time_us), "invented or altered in {self:?}");
            }
        }
        for written in &self.disk {
            let hit = records.iter().find(|&&(store, sequence)| written.tells(store, sequence));
            assert_eq!(hit, None, "both stored and told as lost in {self:?}");
        }
    }

    /// Leaves the window in peace until all is said; then everything taken is stored, or told as lost for a reason.
    fn completes(mut self) {
        self.up.clear();
        self.down.clear();
        self.finish_sync();
        for _ in 0..4 {
            let index = 0;
            let batch = self.board.batch(index, &[], 1000, PACE);
            self.deliver_up(self.boot, &batch);
            self.deliver_up(self.boot, &self.board.empty_batch(&[]).clone());
            self.begin_sync();
            self.finish_sync();
            if let Some(acknowledgement) = self.host.acknowledgement() {
                self.acknowledge(&acknowledgement);
            }
        }
        self.check();
        assert!(self.board.is_empty(), "the board keeps records for ever: {self:?}");
        for &(store, sequence) in self.taken.keys() {
            let told = self.disk.iter().any(|written| written.tells(store, sequence));
            assert!(self.stored(store, sequence) || told, "{sequence} of {store} vanished: {self:?}");
            let kept = !self.lost.contains(&(store, sequence));
            assert!(!kept || self.stored(store, sequence), "{sequence} of {store} was kept and is gone: {self:?}");
        }
    }

    fn successors(&self) -> Vec<World> {
        let mut next = Vec::new();
        let mut step = |change: &dyn Fn(&mut World)| {
            let mut world = self.clone();
            change(&mut world);
            next.push(world);
        };
        if self.pushes > 0 {
            step(&|world| world.push());
        }
        if self.up.len() < 2 {
            for index in 0..self.board.len() {
                step(&|world| {
                    let batch = world.board.batch(index, &[], 1000, PACE);
                    world.up.push((world.boot, batch));
                });
            }
            step(&|world| world.up.push((world.boot, world.board.empty_batch(&[]))));
        }
        for index in 0..self.up.len() {
            step(&|world| {
                let (boot, batch) = world.up.remove(index);
                world.deliver_up(boot, &batch);
            });
            step(&|world| {
                let (boot, batch) = world.up[index].clone();
                world.deliver_up(boot, &batch);
            });
            step(&|world| drop(world.up.remove(index)));
        }
        for index in 0..self.down.len() {
            step(&|world| {
                let acknowledgement = world.down.remove(index);
                world.acknowledge(&acknowledgement);
            });
            step(&|world| drop(world.down.remove(index)));
        }
        if self.syncing.is_empty() && !self.pending.is_empty() {
            step(&|world| world.begin_sync());
        }
        if !self.syncing.is_empty() {
            step(&|world| world.finish_sync());
        }
        if self.down.len() < 2 {
            step(&|world| {
                if let Some(acknowledgement) = world.host.acknowledgement() {
                    world.down.push(acknowledgement);
                }
            });
        }
        if self.trouble > 0 {
            step(&|world| {
                world.trouble -= 1;
                world.restart_host();
            });
            step(&|world| {
                world.trouble -= 1;
                world.pending.clear();
                world.syncing.clear();
                world.host.roll_back();
            });
            step(&|world| {
                world.trouble -= 1;
                world.boot += 1;
                world.board.resume();
            });
            step(&|world| {
                world.trouble -= 1;
                world.boot += 1;
                world.lost.extend(world.board.sequences().map(|sequence| (world.board.store(), sequence)));
                world.board = Board::new(world.boot);
            });
        }
        next
    }

    /// The state without what only differs by history: the board's counters, the order of what is on disk.
    fn key(&self) -> String {
        let held: Vec<u64> = self.board.sequences().collect();
        let disk: BTreeSet<&Written> = self.disk.iter().collect();
        let (store, next) = (self.board.store(), self.board.next_sequence());
        format!(
            "{store} {next} {held:?} {:?} {disk:?} {:?} {:?} {:?} {:?} {:?} {:?} {} {} {}",
            self.host,
            self.heard,
            self.syncing,
            self.pending,
            self.up,
            self.down,
            self.lost,
            self.boot,
            self.pushes,
            self.trouble
        )
    }
}

fn explore(pushes: u8, trouble: u8) -> usize {
    let start = World {
        board: Board::new(1),
        boot: 1,
        host: Inbox::from_boot(1),
        disk: Vec::new(),
        syncing: Vec::new(),
        pending: Vec::new(),
        remembered: None,
        heard: (0, 0),
        up: Vec::new(),
        down: Vec::new(),
        taken: BTreeMap::new(),
        lost: BTreeSet::new(),
        pushes,
        trouble,
    };
    let mut seen = HashSet::from([hash(&start.key())]);
    let mut open = Vec::from([start]);
    while let Some(world) = open.pop() {
        world.check();
        world.clone().completes();
        open.extend(world.successors().into_iter().filter(|next| seen.insert(hash(&next.key()))));
    }
    seen.len()
}

/// 128 bits of a key: two different states are mistaken for one with a chance below 1e-24 at a million states.
fn hash(key: &str) -> (u64, u64) {
    use std::hash::{BuildHasher, BuildHasherDefault, DefaultHasher};
    let hasher = BuildHasherDefault::<DefaultHasher>::default();
    (hasher.hash_one((0, key)), hasher.hash_one((1, key)))
}

#[test]
fn every_state_of_a_small_window_without_trouble() {
    let states = explore(3, 0);
    std::println!("{states} states");
    assert!(states > 1000);
}

#[test]
fn every_state_of_a_small_window_with_a_crash_or_a_reboot() {
    let states = explore(2, 1);
    std::println!("{states} states");
    assert!(states > 1000);
}
