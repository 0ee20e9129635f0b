//! The logger without its socket, its disk and its clock: datagrams and times in, groups and answers out.
//!
//! What a datagram brought gathers in a group; a group is closed, made durable by a sink, and only then answered. One
//! group at most is on its way to the disk while the next gathers.

use std::collections::{BTreeMap, HashMap};
use std::net::SocketAddr;
use std::sync::Arc;

use thermokin_protocol::update::UpdateOrder;
use thermokin_protocol::{
    Arrival, Header, HostLink, Identity, Inbox, Kind, MAX_DATAGRAM, Received, Refused, ReplayGuard, SCHEMA_VERSION,
    Sensor, Settings,
};

use super::clock::{BoardClock, Bound, ClockFit};
use super::gauge::{Gauge, Remark};
use super::group::{BoardState, Entry, Group, MarkKind, ReportEntry, ReportWords, SensorLabel};
use super::registry::{Board, Registry};
use super::update::Updates;
use super::watch::{Trouble, Watch};

/// How scattered a board's records may be above the contiguous part: 64 sequences a segment.
pub const SEGMENTS: usize = 32;
/// The most bytes of datagrams that gather while the disk is busy; more are left to the boards to send again.
const MAX_GATHERED: usize = 16 << 20;
/// The disk counts as nearly full below this many bytes…
const NEARLY_FULL: u64 = 512 << 20;
/// …and as good again above this many.
const ROOM_AGAIN: u64 = 640 << 20;
/// A board that says nothing for this long is told of.
const SILENT_US: u64 = 10_000_000;
/// A clock that is not known this well after [`SETTLING_US`] is told of.
const SETTLED_US: f64 = 50_000.0;
/// How long a clock may take to settle.
const SETTLING_US: u64 = 60_000_000;
/// How many earlier boots' clocks are remembered, for records of a store that survived them.
const EARLIER_CLOCKS: usize = 4;

/// What the engine counted since it started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// Datagrams accepted.
    pub accepted: u64,
    /// Datagrams refused, for whatever reason.
    pub refused: u64,
    /// Records stored durably.
    pub records: u64,
    /// Readings stored durably.
    pub readings: u64,
    /// Records that came again.
    pub repeated: u64,
    /// Sequences told as lost.
    pub lost: u64,
    /// Groups stored durably.
    pub groups: u64,
    /// Answers given.
    pub answers: u64,
    /// Datagrams left to be sent again because the disk did not keep up.
    pub overrun: u64,
}

/// One board, as the logger knows it.
#[derive(Debug)]
pub struct BoardEntry {
    link: HostLink<SEGMENTS>,
    address: Option<SocketAddr>,
    clock: BoardClock,
    clock_boot: u32,
    clock_since_us: u64,
    earlier_clocks: Vec<(u32, ClockFit)>,
    sensors: Vec<Sensor>,
    labels: Arc<[SensorLabel]>,
    gathering: bool,
    /// When it was last heard, on the host's clock in microseconds; none before.
    pub heard_us: Option<u64>,
    /// Its last report's health.
    pub report: Option<ReportWords>,
    /// Who it is, as it said last.
    pub identity: Option<Identity>,
    /// The newest value of each sensor, in the order of the board's list.
    pub gauges: Vec<Gauge>,
    /// Sequences lost since the logger started.
    pub lost: u64,
}

impl BoardEntry {
    /// The mapping of its clock as known now.
    pub fn fit(&self) -> Option<&ClockFit> {
        self.clock.fit()
    }

    /// The boot that it was last heard in.
    pub fn boot(&self) -> u32 {
        self.link.guard().epoch()
    }

    /// Where it was last heard from.
    pub fn address(&self) -> Option<SocketAddr> {
        self.address
    }

    /// The names of its sensors, in the order of its list.
    pub fn labels(&self) -> &[SensorLabel] {
        &self.labels
    }
}

/// The logger's state.
#[derive(Debug)]
pub struct Engine {
    epoch: u32,
    settings: Settings,
    names: HashMap<(u32, u8), String>,
    boards: BTreeMap<u32, BoardEntry>,
    remembered: BTreeMap<u32, BoardState>,
    gathering: Vec<u32>,
    committing: Vec<u32>,
    group: Group,
    gathered: usize,
    /// Records, readings and lost sequences that gather, and that are on their way to the disk.
    counts: [Counts; 2],
    to_answer: Vec<u32>,
    watch: Watch,
    tally: Tally,
    updates: Updates,
}

#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    records: u64,
    readings: u64,
    lost: u64,
}

impl Engine {
    /// An engine that starts with an epoch and what the store remembers; `names` says which sensor sits at which address
    /// of which board.
    pub fn new(
        epoch: u32,
        registry: &Registry,
        names: HashMap<(u32, u8), String>,
        remembered: BTreeMap<u32, BoardState>,
    ) -> Self {
        let mut engine = Self {
            epoch,
            settings: registry.settings,
            names,
            boards: BTreeMap::new(),
            remembered,
            gathering: Vec::new(),
            committing: Vec::new(),
            group: Group::default(),
            gathered: 0,
            counts: [Counts::default(); 2],
            to_answer: Vec::new(),
            watch: Watch::default(),
            tally: Tally::default(),
            updates: Updates::default(),
        };
        engine.take_registry(registry);
        engine
    }

    /// Takes a registry that changed: new boards and settings; a board that is known already stays as it is.
    pub fn take_registry(&mut self, registry: &Registry) {
        self.settings = registry.settings;
        for board in &registry.boards {
            let number = board.board;
            self.boards.entry(number).or_insert_with(|| {
                let link = restored(board, self.epoch, self.remembered.get(&number));
                BoardEntry {
                    link,
                    address: None,
                    clock: BoardClock::default(),
                    clock_boot: 0,
                    clock_since_us: 0,
                    earlier_clocks: Vec::new(),
                    sensors: Vec::new(),
                    labels: Arc::default(),
                    gathering: false,
                    heard_us: None,
                    report: None,
                    identity: None,
                    gauges: Vec::new(),
                    lost: 0,
                }
            });
        }
    }

    /// The boards of the registry.
    pub fn boards(&self) -> &BTreeMap<u32, BoardEntry> {
        &self.boards
    }

    /// The settings that boards are told to have.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What was counted.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// The warnings.
    pub fn watch(&self) -> &Watch {
        &self.watch
    }

    /// The warnings, to raise those that only the caller can see.
    pub fn watch_mut(&mut self) -> &mut Watch {
        &mut self.watch
    }

    /// The new programs that are on their way to boards.
    pub fn updates(&self) -> &Updates {
        &self.updates
    }

    /// The same, to begin one.
    pub fn updates_mut(&mut self) -> &mut Updates {
        &mut self.updates
    }

    /// Takes a datagram that came at `now_us` on the host's clock. What it returns is to be sent back at once.
    pub fn on_datagram(&mut self, from: SocketAddr, datagram: &mut [u8], now_us: u64) -> Option<Vec<u8>> {
        let outcome = self.accept(from, datagram, now_us);
        match outcome {
            Ok(order) => order,
            Err((board, refused)) => {
                self.tally.refused += 1;
                let number = board?;
                let name = from.ip();
                match refused {
                    Refused::Forged => self.watch.raise(Trouble::Forged(number), now_us, || {
                        format!("board {number}: a datagram from {name} is not sealed with its key; dropped")
                    }),
                    Refused::Version { theirs } => {
                        self.watch.raise(Trouble::Version(number), now_us, || {
                            format!(
                                "board {number} speaks schema version {theirs}, this host speaks {SCHEMA_VERSION}: \
                                 update the older one; its records stay on the board until then"
                            )
                        });
                        let mut buffer = [0; MAX_DATAGRAM];
                        let length = self.boards.get_mut(&number)?.link.version_notice(&mut buffer);
                        return Some(buffer[..length].to_vec());
                    }
                    _ => {}
                }
                None
            }
        }
    }

    /// Gives what is to be said of a new program.
    fn accept(
        &mut self,
        from: SocketAddr,
        datagram: &mut [u8],
        now_us: u64,
    ) -> Result<Option<Vec<u8>>, (Option<u32>, Refused)> {
        let header = Header::parse(datagram).map_err(|refused| (None, refused))?;
        let number = header.board;
        let refuse = |refused| (Some(number), refused);
        if self.gathered > MAX_GATHERED {
            self.tally.overrun += 1;
            self.watch.raise(Trouble::Overrun, now_us, || {
                "more comes than the disk takes; the boards keep their records and send them again".to_owned()
            });
            return Err(refuse(Refused::Foreign));
        }
        let Some(board) = self.boards.get_mut(&number) else {
            self.watch.raise(Trouble::UnknownBoard(number), now_us, || {
                format!(
                    "board {number} at {} is not in the registry: `thermokin board add` gives it a key; \
                     it keeps its records until then",
                    from.ip()
                )
            });
            return Err(refuse(Refused::Misdirected));
        };
        if header.kind == Kind::Update {
            let report = board.link.open_update(datagram).map_err(refuse)?;
            board.address = Some(from);
            self.tally.accepted += 1;
            let (order, words) = self.updates.take(number, header.epoch, report, now_us);
            if let Some(words) = words {
                self.watch.note(now_us, words);
            }
            return Ok(order.and_then(|order| seal_update(&mut board.link, &order)));
        }
        let exact: Box<[u8]> = (&*datagram).into();
        let received = board.link.open(datagram).map_err(refuse)?;
        board.address = Some(from);
        if received.booted {
            if let Some(&fit) = board.clock.fit() {
                board.earlier_clocks.push((board.clock_boot, fit));
                if board.earlier_clocks.len() > EARLIER_CLOCKS {
                    board.earlier_clocks.remove(0);
                }
            }
            board.clock = BoardClock::default();
        }
        if board.clock.fit().is_none() {
            board.clock_since_us = now_us;
        }
        board.clock_boot = received.boot;
        self.gathered += exact.len();
        self.group.entries.push(Entry::Datagram { board: number, arrived_us: now_us, bytes: exact });
        self.tally.accepted += 1;
        let boot = received.boot;
        self.take(number, received, now_us).map_err(refuse)?;
        let offer = self.updates.offer(number, boot, now_us);
        Ok(offer.and_then(|offer| seal_update(&mut self.boards.get_mut(&number)?.link, &offer)))
    }

    fn take(&mut self, number: u32, received: Received, now_us: u64) -> Result<(), Refused> {
        let Some(board) = self.boards.get_mut(&number) else {
            return Err(Refused::Misdirected);
        };
        let report = &received.report;
        let echo = report.echo.map(|echo| Bound { board_us: echo.received_us, host_us: echo.host_us });
        // An echo from before this host's start may be on another clock.
        let echo = echo.filter(|echo| echo.host_us / 1_000_000 >= u64::from(self.epoch).min(now_us / 1_000_000));
        board.clock.hear(Bound { board_us: report.sent_us, host_us: now_us }, echo);
        let words = ReportWords::from(report);
        board.heard_us = Some(now_us);
        board.report = Some(words);
        board.identity = report.identity.or(board.identity);
        if !board.gathering {
            board.gathering = true;
            self.gathering.push(number);
        }
        let fit = board.clock.fit().copied();
        self.group.entries.push(Entry::Report(Box::new(ReportEntry {
            board: number,
            boot: received.boot,
            counter: received.counter,
            arrived_us: now_us,
            report: words,
            fit,
        })));
        self.watch.clear(&Trouble::Version(number), now_us, |_| format!("board {number} speaks our schema version"));
        self.watch.clear(&Trouble::Silent(number), now_us, |lasted| {
            format!("board {number} is heard again, {} s later", 10 + lasted / 1_000_000)
        });
        let batch = &report.batch;
        if board.sensors[..] != batch.sensors[..] {
            board.sensors = batch.sensors.to_vec();
            let mut labels = Vec::new();
            for sensor in &batch.sensors {
                let name = self.names.get(&(number, sensor.address)).cloned().unwrap_or_else(|| {
                    let name = format!("board{number}/0x{:02X}", sensor.address);
                    let trouble = Trouble::Unnamed(number, sensor.address);
                    // That there are no names at all is said once, by the caller.
                    if self.names.is_empty() {
                        return name;
                    }
                    self.watch.raise(trouble, now_us, || {
                        format!(
                            "board {number} has a sensor at 0x{:02X} that robot.toml does not name; stored as {name}",
                            sensor.address
                        )
                    });
                    name
                });
                labels.push(SensorLabel::new(name, sensor.kind));
            }
            board.gauges = vec![Gauge::default(); labels.len()];
            board.labels = labels.into();
        }
        let mut records = Vec::new();
        let (entries, counts, lost) = (&mut self.group.entries, &mut self.counts[0], &mut board.lost);
        board.link.inbox_mut().accept(received.boot, batch, |arrival| match arrival {
            Arrival::Record(record) => records.push(record.clone()),
            Arrival::Gap(gap) => {
                let missing = gap.until.map_or(0, |until| until - gap.from);
                counts.lost += missing;
                *lost += missing;
                entries.push(Entry::Gap { board: number, arrived_us: now_us, gap });
            }
        })?;
        self.tally.repeated += (batch.records.len() - records.len()) as u64;
        if records.is_empty() {
            return Ok(());
        }
        counts.records += records.len() as u64;
        counts.readings += (records.len() * batch.sensors.len()) as u64;
        let live = batch.boot == received.boot;
        let earlier = || board.earlier_clocks.iter().find(|(boot, _)| *boot == batch.boot).map(|(_, fit)| *fit);
        let fit = if live { fit } else { earlier() };
        if let Some(fit) = fit.filter(|_| live) {
            for record in &records {
                for (index, reading) in record.readings.iter().enumerate() {
                    let (label, sensor) = (&board.labels[index], board.sensors[index]);
                    let at_us = fit.host_us(record.time_us).max(0.0) as u64;
                    let remark = board.gauges[index].take(*reading, sensor.kind, at_us);
                    tell(&mut self.watch, remark, number, sensor.address, &label.name, now_us);
                }
            }
        }
        self.group.entries.push(Entry::Records {
            board: number,
            store: batch.store,
            boot: batch.boot,
            fit,
            arrived_us: now_us,
            sensors: Arc::clone(&board.labels),
            records,
        });
        Ok(())
    }

    /// Notes a run's start or stop, or a mark.
    pub fn mark(&mut self, now_us: u64, kind: MarkKind, name: String) {
        self.group.entries.push(Entry::Mark { time_us: now_us, kind, name });
    }

    /// Notes a warning as it was told.
    pub fn note_warning(&mut self, now_us: u64, text: String) {
        self.group.entries.push(Entry::Warning { time_us: now_us, text });
    }

    /// Closes the group that gathered, to be made durable; none if nothing did. Until [`Engine::committed`] or
    /// [`Engine::failed`] is called no other may be closed.
    pub fn close_group(&mut self, now_us: u64) -> Option<Group> {
        if self.group.entries.is_empty() {
            return None;
        }
        let mut group = std::mem::take(&mut self.group);
        group.closed_us = now_us;
        self.gathered = 0;
        self.counts[1] = std::mem::take(&mut self.counts[0]);
        self.committing = std::mem::take(&mut self.gathering);
        for number in &self.committing {
            if let Some(board) = self.boards.get_mut(number) {
                board.gathering = false;
                board.link.inbox_mut().begin_commit();
                group.states.push(state_of(*number, &board.link));
            }
        }
        Some(group)
    }

    /// The group that was closed is durable: its boards are to be answered.
    pub fn committed(&mut self, now_us: u64) {
        let counts = std::mem::take(&mut self.counts[1]);
        self.tally.records += counts.records;
        self.tally.readings += counts.readings;
        self.tally.lost += counts.lost;
        self.tally.groups += 1;
        for number in std::mem::take(&mut self.committing) {
            if let Some(board) = self.boards.get_mut(&number) {
                board.link.inbox_mut().finish_commit();
                self.to_answer.push(number);
            }
        }
        self.watch.clear(&Trouble::NotStored, now_us, |lasted| {
            format!("storing again, after {} s; what the boards kept is coming in", lasted / 1_000_000)
        });
        self.watch.clear(&Trouble::Overrun, now_us, |_| "the disk keeps up again".to_owned());
    }

    /// The group that was closed could not be made durable: neither it nor what gathered since counts, but for marks and
    /// warnings, which are tried again. The boards are answered with what was durable before.
    pub fn failed(&mut self, group: Group, now_us: u64, reason: &str) {
        self.counts = [Counts::default(); 2];
        self.gathered = 0;
        let gathered = std::mem::take(&mut self.group.entries);
        let kept = group.entries.into_iter().chain(gathered);
        self.group.entries = kept.filter(|entry| matches!(entry, Entry::Mark { .. } | Entry::Warning { .. })).collect();
        for number in std::mem::take(&mut self.committing).into_iter().chain(std::mem::take(&mut self.gathering)) {
            if let Some(board) = self.boards.get_mut(&number) {
                board.gathering = false;
                board.link.inbox_mut().roll_back();
                self.to_answer.push(number);
            }
        }
        self.watch.raise(Trouble::NotStored, now_us, || {
            format!("nothing can be stored: {reason}; the boards keep their records until it can")
        });
    }

    /// Gives the answers that are due. `clock` tells the host's time as close to each sending as can be.
    pub fn answers(&mut self, clock: impl Fn() -> u64, mut send: impl FnMut(SocketAddr, &[u8])) {
        let mut buffer = [0; MAX_DATAGRAM];
        for number in self.to_answer.drain(..) {
            let Some(board) = self.boards.get_mut(&number) else {
                continue;
            };
            let Some(address) = board.address else {
                continue;
            };
            if let Some(length) = board.link.answer(clock(), &self.settings, &mut buffer) {
                send(address, &buffer[..length]);
                self.tally.answers += 1;
            }
        }
    }

    /// Takes how many bytes the store's disk has free.
    pub fn on_disk(&mut self, free: u64, now_us: u64) {
        if free < NEARLY_FULL {
            self.watch.raise(Trouble::DiskNearlyFull, now_us, || {
                format!("the disk is nearly full: {} MB are free", free / 1_000_000)
            });
        } else if free > ROOM_AGAIN {
            self.watch.clear(&Trouble::DiskNearlyFull, now_us, |_| "the disk has room again".to_owned());
        }
    }

    /// Looks for what only time shows: boards that are silent, clocks that do not settle.
    pub fn on_tick(&mut self, now_us: u64) {
        for (&number, board) in &self.boards {
            let Some(heard_us) = board.heard_us else {
                continue;
            };
            if now_us.saturating_sub(heard_us) >= SILENT_US {
                self.watch
                    .raise(Trouble::Silent(number), now_us, || format!("board {number} has been silent for 10 s"));
                continue;
            }
            let uncertainty = board.clock.fit().and_then(|fit| fit.offset_uncertainty_us);
            let settled = uncertainty.is_some_and(|us| us <= SETTLED_US);
            if settled {
                self.watch.clear(&Trouble::Clock(number), now_us, |_| format!("board {number}: the clock has settled"));
            } else if now_us.saturating_sub(board.clock_since_us) >= SETTLING_US {
                let known = uncertainty
                    .map_or("one direction is not heard".to_owned(), |us| format!("known to {:.0} ms only", us / 1e3));
                self.watch.raise(Trouble::Clock(number), now_us, || {
                    format!("board {number}: the clock will not settle, {known} after a minute")
                });
            }
        }
    }
}

fn seal_update(link: &mut HostLink<SEGMENTS>, order: &UpdateOrder<'_>) -> Option<Vec<u8>> {
    let mut buffer = [0; MAX_DATAGRAM];
    let length = link.update(order, &mut buffer)?;
    Some(buffer[..length].to_vec())
}

fn tell(watch: &mut Watch, remark: Option<Remark>, board: u32, address: u8, name: &str, now_us: u64) {
    let no_reading = Trouble::NoReading(board, address);
    match remark {
        None => {}
        Some(Remark::Gone(status)) => watch.raise(no_reading, now_us, || {
            format!("sensor {name} gives no reading ({status}), board {board} address 0x{address:02X}")
        }),
        Some(Remark::Back) => watch.clear(&no_reading, now_us, |lasted| {
            format!("sensor {name} gives readings again, {} s later", lasted / 1_000_000)
        }),
        Some(Remark::Stuck { celsius, seconds }) => watch.raise(Trouble::Stuck(board, address), now_us, || {
            format!("sensor {name} is stuck: exactly {celsius:.4} °C for {} min", seconds / 60)
        }),
        Some(Remark::Moving) => {
            watch.clear(&Trouble::Stuck(board, address), now_us, |_| format!("sensor {name} moves again"));
        }
        Some(Remark::Jump { from, to }) => watch.raise(Trouble::Jump(board, address), now_us, || {
            format!("sensor {name} jumps: from {from:.2} to {to:.2} °C between two readings")
        }),
        Some(Remark::Steady) => {
            watch.clear(&Trouble::Jump(board, address), now_us, |_| format!("sensor {name} is steady again"));
        }
    }
}

fn restored(board: &Board, epoch: u32, state: Option<&BoardState>) -> HostLink<SEGMENTS> {
    let (number, key, first_boot) = (board.board, board.key.clone(), board.first_boot);
    let Some(state) = state else {
        return HostLink::new(number, key, epoch, ReplayGuard::default(), Inbox::from_boot(first_boot));
    };
    let (boot, next, heard) = state.guard;
    let guard = ReplayGuard::from_state(boot, next, heard);
    // A log written with more segments than this host keeps: what is missing comes again and is stored again, which is
    // the lesser evil; this host writes no such log.
    let restore =
        |(store, below, segments): &(u32, u64, Vec<_>)| Inbox::restore(state.boot, *store, *below, segments).ok();
    let inbox = state.inbox.as_ref().and_then(restore);
    HostLink::new(number, key, epoch, guard, inbox.unwrap_or_else(|| Inbox::from_boot(first_boot)))
}

fn state_of(board: u32, link: &HostLink<SEGMENTS>) -> BoardState {
    let inbox = link.inbox().received().map(|(store, below, segments)| (store, below, segments.to_vec()));
    BoardState { board, guard: link.guard().state(), boot: link.inbox().boot().unwrap_or(0), inbox }
}
