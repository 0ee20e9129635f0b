//! The board's end: readings in, datagrams out, answers in.

use core::borrow::BorrowMut;

use heapless::Vec;

use crate::header::{Direction, HEADER_LENGTH, Header, Kind};
use crate::message::{
    Battery, BoardMessage, Counters, Health, HostMessage, Identity, Reading, Report, Sensor, Settings, Signal, TimeEcho,
};
use crate::outbox::{Outbox, Pace};
use crate::patience::Patience;
use crate::replay::ReplayGuard;
use crate::seal::{self, MAX_MESSAGE, Refused};
use crate::update::{UpdateOrder, UpdateReport};
use crate::{Key, MAX_BATCH, MAX_DATAGRAM, MAX_SENSORS, SCHEMA_VERSION};

/// The most bytes of a report, its records aside; a test holds this against the largest report.
const REPORT_OVERHEAD: usize = 140;
/// After this long without any answer a board is alone: it probes, one datagram a wait.
const ALONE_US: u64 = 10_000_000;
/// A report is sent this often even if there are no records.
const HEARTBEAT_US: u64 = 2_000_000;
/// The least time between two batches of the backlog.
const BACKLOG_SPACING_US: u64 = 20_000;
/// The most records in flight for which more of the backlog is sent.
const IN_FLIGHT: usize = 64;

/// What only the firmware counts, since the boot; the link adds what it knows itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BoardCounters {
    /// Reads of sensors that failed.
    pub reads_failed: u32,
    /// Times that the bus had to be set up anew or cleared.
    pub bus_recoveries: u32,
}

/// What a datagram of the host's brought.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Heard<'a> {
    /// How many records it freed: they are durable on the host.
    pub released: usize,
    /// Whether [`BoardLink::settings`] changed.
    pub settings_changed: bool,
    /// What it says of a new program, which is the caller's affair; the report goes out by [`BoardLink::seal_update`].
    pub update: Option<UpdateOrder<'a>>,
}

/// A board's link to its host, with a store of `RECORDS` unacknowledged records, and more in `BLOCKS` of an archive.
///
/// The firmware calls [`BoardLink::record`] when it has sampled, [`BoardLink::poll`] until it gives nothing whenever
/// [`BoardLink::next_poll_us`] has come (or the radio is up), and [`BoardLink::receive`] with each datagram that came.
/// All times are the board's own microsecond clock. The link owns its store, or borrows one that lies in a static.
#[derive(Debug)]
pub struct BoardLink<
    const RECORDS: usize,
    const SENSORS: usize = MAX_SENSORS,
    const BLOCKS: usize = 0,
    O = Outbox<RECORDS, SENSORS, BLOCKS>,
> {
    key: Key,
    board: u32,
    boot: u32,
    identity: Identity,
    sensors: Vec<Sensor, MAX_SENSORS>,
    settings: Settings,
    outbox: O,
    guard: ReplayGuard,
    counter: u64,
    echo: Option<TimeEcho>,
    identity_known: bool,
    started_us: u64,
    heard_us: Option<u64>,
    sent_us: Option<u64>,
    backlog_us: Option<u64>,
    patience: Patience,
    refused: u32,
    host_version: Option<u8>,
    battery: Battery,
    signal: Signal,
    counters: BoardCounters,
}

impl<const RECORDS: usize, const SENSORS: usize, const BLOCKS: usize> BoardLink<RECORDS, SENSORS, BLOCKS> {
    /// The link of a boot, with an empty store.
    ///
    /// `boot` must be greater than at any start before under this key (see the crate's documentation); `sensors` beyond
    /// [`MAX_SENSORS`] are ignored.
    pub fn new(
        board: u32,
        key: Key,
        boot: u32,
        identity: Identity,
        sensors: &[Sensor],
        settings: Settings,
        now_us: u64,
    ) -> Self {
        Self::resume(board, key, boot, identity, sensors, settings, now_us, Outbox::new(boot))
    }
}

impl<const RECORDS: usize, const SENSORS: usize, const BLOCKS: usize, O> BoardLink<RECORDS, SENSORS, BLOCKS, O>
where
    O: BorrowMut<Outbox<RECORDS, SENSORS, BLOCKS>>,
{
    /// The link of a boot that has a store already: one that it found retained and whole, or one that began with it.
    #[expect(clippy::too_many_arguments, reason = "what a boot knows; a struct of the same fields would be no clearer")]
    pub fn resume(
        board: u32,
        key: Key,
        boot: u32,
        identity: Identity,
        sensors: &[Sensor],
        settings: Settings,
        now_us: u64,
        mut outbox: O,
    ) -> Self {
        outbox.borrow_mut().resume();
        Self {
            key,
            board,
            boot,
            identity: Identity {
                capacity: u32::try_from(Outbox::<RECORDS, SENSORS, BLOCKS>::capacity()).unwrap_or(u32::MAX),
                ..identity
            },
            sensors: sensors.iter().copied().take(MAX_SENSORS).collect(),
            settings,
            outbox,
            guard: ReplayGuard::default(),
            counter: 0,
            echo: None,
            identity_known: false,
            started_us: now_us,
            heard_us: None,
            sent_us: None,
            backlog_us: None,
            patience: Patience::default(),
            refused: 0,
            host_version: None,
            battery: Battery::NotMeasured,
            signal: Signal::NotMeasured,
            counters: BoardCounters::default(),
        }
    }

    /// The settings in force.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The store.
    pub fn outbox(&self) -> &Outbox<RECORDS, SENSORS, BLOCKS> {
        self.outbox.borrow()
    }

    /// Gives the store back, to be retained over a reset.
    pub fn into_outbox(self) -> O {
        self.outbox
    }

    /// The schema version of a host that could not be understood, to be shown to somebody; none while all is well.
    pub fn host_version(&self) -> Option<u8> {
        self.host_version
    }

    /// When the host was last heard.
    pub fn heard_us(&self) -> Option<u64> {
        self.heard_us
    }

    /// Notes how the board is, for the next reports.
    pub fn set_health(&mut self, battery: Battery, signal: Signal, counters: BoardCounters) {
        (self.battery, self.signal, self.counters) = (battery, signal, counters);
    }

    /// Stores what the sensors read at `time_us`; returns the record's sequence.
    ///
    /// A reading that is missing at the end counts as absent, one too many is ignored.
    pub fn record(&mut self, time_us: u64, readings: &[Reading]) -> u64 {
        let readings =
            (0..self.sensors.len()).map(|index| readings.get(index).copied().unwrap_or(Reading::Absent)).collect();
        self.outbox.borrow_mut().push(self.boot, time_us, readings)
    }

    /// The next datagram to send now, as the number of its bytes in `buffer`; call until there is none.
    pub fn poll(&mut self, now_us: u64, buffer: &mut [u8; MAX_DATAGRAM]) -> Option<usize> {
        let pace = self.pace(now_us);
        let bytes = MAX_MESSAGE - REPORT_OVERHEAD;
        let live = self.outbox().live();
        let from_live = self.outbox().len() - live.min(MAX_BATCH);
        let batch = if self.is_alone(now_us) {
            if self.sent_us.is_some_and(|sent| now_us.saturating_sub(sent) < pace.resend_after_us) {
                return None;
            }
            self.patience.lose();
            let index = match live {
                0 => self.outbox().backlog(pace),
                _ => Some(from_live),
            };
            match index {
                Some(index) => self.outbox.borrow_mut().batch(index, &self.sensors, bytes, pace),
                None => self.outbox().empty_batch(&self.sensors),
            }
        } else if self.live_due_us(live).is_some_and(|due| due <= now_us) {
            self.outbox.borrow_mut().batch(from_live, &self.sensors, bytes, pace)
        } else if let Some(index) = self.backlog_to_send(pace) {
            self.backlog_us = Some(now_us);
            let resends = self.outbox().resends();
            let batch = self.outbox.borrow_mut().batch(index, &self.sensors, bytes, pace);
            if self.outbox().resends() > resends {
                self.patience.lose();
            }
            batch
        } else if self.sent_us.is_none_or(|sent| now_us.saturating_sub(sent) >= HEARTBEAT_US) {
            self.outbox().empty_batch(&self.sensors)
        } else {
            return None;
        };
        self.sent_us = Some(now_us);
        let report = Report {
            sent_us: now_us,
            echo: self.echo.take(),
            identity: (!self.identity_known).then_some(self.identity),
            health: Health {
                battery: self.battery,
                signal: self.signal,
                counters: Counters {
                    reads_failed: self.counters.reads_failed,
                    bus_recoveries: self.counters.bus_recoveries,
                    records_dropped: self.outbox().dropped(),
                    resends: self.outbox().resends(),
                    datagrams_refused: self.refused,
                },
            },
            settings_revision: self.settings.revision,
            batch,
        };
        let length = postcard::to_slice(&BoardMessage::Report(report), &mut buffer[HEADER_LENGTH..]).ok()?.len();
        let header = self.next_header(Kind::Message);
        Some(seal::seal(&self.key, &header, buffer, length))
    }

    /// The time at which [`BoardLink::poll`] next has something to send, if nothing else happens; it may have passed.
    pub fn next_poll_us(&self, now_us: u64) -> u64 {
        let wait = self.resend_after_us(now_us);
        let Some(sent) = self.sent_us else {
            return now_us;
        };
        if self.is_alone(now_us) {
            return sent.saturating_add(wait);
        }
        let pace = self.pace(now_us);
        let live = self.outbox().live();
        let spaced = self.backlog_us.map_or(0, |last| last.saturating_add(BACKLOG_SPACING_US));
        let backlog = match self.outbox().backlog(pace) {
            Some(_) if self.outbox().in_flight(pace) < IN_FLIGHT => Some(now_us.max(spaced)),
            _ => self.outbox().next_due_us(wait).map(|due| due.max(spaced)),
        };
        let heartbeat = sent.saturating_add(HEARTBEAT_US);
        [self.live_due_us(live), backlog].into_iter().flatten().fold(heartbeat, u64::min)
    }

    /// Takes a datagram that came, decrypting it in place.
    ///
    /// # Errors
    ///
    /// The reason why it was dropped; it is counted and must not be answered.
    pub fn receive<'a>(&mut self, now_us: u64, datagram: &'a mut [u8]) -> Result<Heard<'a>, Refused> {
        let outcome = self.take(now_us, datagram);
        if outcome.is_err() {
            self.refused = self.refused.saturating_add(1);
        }
        outcome
    }

    /// The datagram that says how far a board is with a new program, as the number of its bytes in `buffer`.
    pub fn seal_update(&mut self, report: &UpdateReport, buffer: &mut [u8; MAX_DATAGRAM]) -> Option<usize> {
        let length = postcard::to_slice(report, &mut buffer[HEADER_LENGTH..]).ok()?.len();
        let header = self.next_header(Kind::Update);
        Some(seal::seal(&self.key, &header, buffer, length))
    }

    fn next_header(&mut self, kind: Kind) -> Header {
        let counter = self.counter;
        self.counter += 1;
        Header {
            version: SCHEMA_VERSION,
            direction: Direction::ToHost,
            kind,
            board: self.board,
            epoch: self.boot,
            counter,
        }
    }

    fn take<'a>(&mut self, now_us: u64, datagram: &'a mut [u8]) -> Result<Heard<'a>, Refused> {
        let (header, message) = seal::open(&self.key, self.board, Direction::ToBoard, datagram)?;
        self.guard.admit(&header)?;
        if header.version != SCHEMA_VERSION {
            self.host_version = Some(header.version);
            return Err(Refused::Version { theirs: header.version });
        }
        if header.kind == Kind::Update {
            let order = UpdateOrder::parse(message)?;
            if order.boot() != self.boot {
                return Err(Refused::OtherBoot);
            }
            self.heard_us = Some(now_us);
            return Ok(Heard { released: 0, settings_changed: false, update: Some(order) });
        }
        if header.kind != Kind::Message {
            return Err(Refused::Malformed);
        }
        let (HostMessage::Answer(answer), rest) = postcard::take_from_bytes(message).map_err(|_| Refused::Malformed)?;
        if !rest.is_empty() {
            return Err(Refused::Malformed);
        }
        if answer.boot != self.boot {
            return Err(Refused::OtherBoot);
        }
        let was_alone = self.is_alone(now_us);
        self.host_version = None;
        self.heard_us = Some(now_us);
        self.identity_known = answer.identity_known;
        self.echo = Some(TimeEcho { host_us: answer.host_us, received_us: now_us });
        let settings_changed = answer.settings.revision > self.settings.revision;
        if settings_changed {
            self.settings = answer.settings;
        }
        if was_alone {
            self.patience.find();
        }
        let patience = &mut self.patience;
        self.outbox.borrow().latencies(&answer.acknowledgement, now_us, |latency_us| patience.hear(latency_us));
        let released = self.outbox.borrow_mut().acknowledge(&answer.acknowledgement);
        Ok(Heard { released, settings_changed, update: None })
    }

    fn is_alone(&self, now_us: u64) -> bool {
        now_us.saturating_sub(self.heard_us.unwrap_or(self.started_us)) >= ALONE_US
    }

    fn resend_after_us(&self, now_us: u64) -> u64 {
        if self.is_alone(now_us) { self.patience.wait_alone_us() } else { self.patience.wait_us() }
    }

    fn pace(&self, now_us: u64) -> Pace {
        Pace { now_us, resend_after_us: self.resend_after_us(now_us) }
    }

    /// When the live records are due: at once when a batch is full, else when its last record should have been taken.
    fn live_due_us(&self, live: usize) -> Option<u64> {
        let length = usize::from(self.settings.batch_length).clamp(1, MAX_BATCH);
        let oldest = self.outbox().live_since_us(live)?;
        if live >= length {
            return Some(0);
        }
        let period = u64::from(self.settings.sampling_period_ms) * 1000;
        // The batch's last record is taken so long after its first.
        Some(oldest.saturating_add(period * u64::from(self.settings.batch_length.saturating_sub(1))))
    }

    fn backlog_to_send(&self, pace: Pace) -> Option<usize> {
        let spaced = self.backlog_us.is_none_or(|last| pace.now_us.saturating_sub(last) >= BACKLOG_SPACING_US);
        if !spaced {
            return None;
        }
        self.outbox().backlog(pace).filter(|_| self.outbox().in_flight(pace) < IN_FLIGHT)
    }
}
