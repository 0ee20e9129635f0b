//! Link boards simulated on this machine: the same protocol from the same crate, with a channel that can be bad.
//!
//! Every record that a board takes is written down, with its fate, so that a log can be held against the truth.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, HashMap, VecDeque};
use std::io::{self, BufWriter, Write};
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use thermokin_protocol::{
    Battery, BoardCounters, BoardLink, Firmware, Header, Identity, Key, MAX_DATAGRAM, Outbox, Reading, ResetReason,
    Sensor, SensorKind, Settings, Signal,
};

use super::serve::HostClock;

/// What goes wrong between the boards and the host. Probabilities are of each datagram, in both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Faults {
    /// The probability that it is lost.
    pub loss: f64,
    /// The probability that it comes twice.
    pub duplicate: f64,
    /// The probability that it is held back by up to a second, so that others overtake it.
    pub reorder: f64,
    /// The delay of every datagram: uniform from nothing to this many milliseconds.
    pub delay_ms: f64,
    /// The probability that a bit of it is flipped.
    pub corrupt: f64,
    /// With each datagram, the probability that an earlier one of the boards' is sent again as an attacker would.
    pub replay: f64,
    /// The mean time between two reboots of a board, in seconds; 0 is never.
    pub reboot_s: f64,
    /// The probability that a board's store survives its reboot.
    pub retain: f64,
    /// How many of the boards have a wrong key.
    pub bad_keys: usize,
}

impl Default for Faults {
    /// Nothing goes wrong.
    fn default() -> Self {
        Self {
            loss: 0.0,
            duplicate: 0.0,
            reorder: 0.0,
            delay_ms: 0.0,
            corrupt: 0.0,
            replay: 0.0,
            reboot_s: 0.0,
            retain: 1.0,
            bad_keys: 0,
        }
    }
}

/// A board to simulate.
#[derive(Debug, Clone)]
pub struct Place {
    /// Its number.
    pub board: u32,
    /// Its key.
    pub key: Key,
    /// The I2C addresses of its sensors.
    pub sensors: Vec<u8>,
    /// The boot number to begin with.
    pub first_boot: u32,
}

/// Temperatures in degrees Celsius of a board's sensor at a time since the start.
pub type Scenario = dyn Fn(u32, u8, f64) -> Option<f64>;

/// What to simulate.
pub struct Simulation<'a> {
    /// The boards.
    pub places: Vec<Place>,
    /// Where the host listens.
    pub host: SocketAddr,
    /// The settings that the boards begin with; the host may change them.
    pub settings: Settings,
    /// What goes wrong.
    pub faults: Faults,
    /// The seed of everything random.
    pub seed: u64,
    /// How long to take records, in seconds; none is until stopped.
    pub duration_s: Option<f64>,
    /// How long to go on without new records until the host has everything, in seconds.
    pub drain_s: f64,
    /// The temperatures.
    pub scenario: &'a Scenario,
    /// Whether to write down every record.
    pub keep_truth: bool,
}

/// What a simulation came to.
#[derive(Debug, Default)]
pub struct Outcome {
    /// When the scenario's time began, on the host's clock in microseconds.
    pub start_us: u64,
    /// Records taken.
    pub taken: u64,
    /// Records that the host acknowledged.
    pub acknowledged: u64,
    /// Records that full stores thinned out.
    pub thinned: u64,
    /// Records that were held when a store lost its power.
    pub powered_off: u64,
    /// Records still held at the end.
    pub held: u64,
    /// Datagrams sent by the boards, as they gave them to the channel.
    pub sent: u64,
    /// Reboots.
    pub reboots: u64,
    /// Datagrams replayed.
    pub replayed: u64,
    /// The schema version of a host that the boards could not understand.
    pub host_version: Option<u8>,
    /// The longest time, in seconds, between taking a record and having its acknowledgement.
    pub slowest_s: f64,
    /// Every record, if it was kept.
    pub truth: Vec<Truth>,
}

/// One record as the board took it.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// The board.
    pub board: u32,
    /// The store that numbered it.
    pub store: u32,
    /// Its number.
    pub sequence: u64,
    /// The boot on whose clock it was taken.
    pub boot: u32,
    /// When, on the board's clock in microseconds.
    pub board_us: u64,
    /// When, on the host's clock in microseconds.
    pub host_us: u64,
    /// The raw counts of each sensor.
    pub counts: Vec<i16>,
    /// What became of it.
    pub fate: Fate,
}

/// What became of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// The host acknowledged it.
    Acknowledged,
    /// A full store thinned it out.
    Thinned,
    /// Its store lost power.
    PoweredOff,
    /// The board holds it still.
    Held,
}

impl Fate {
    /// Its word in a truth file.
    pub fn name(self) -> &'static str {
        match self {
            Fate::Acknowledged => "acknowledged",
            Fate::Thinned => "thinned",
            Fate::PoweredOff => "powered_off",
            Fate::Held => "held",
        }
    }
}

/// SplitMix64.
#[derive(Debug, Clone)]
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn happens(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.uniform() < probability
    }
}

struct Board<const RECORDS: usize> {
    place: Place,
    link: Option<Box<BoardLink<RECORDS>>>,
    boot: u32,
    /// The host's clock when the board's showed nothing, and how much faster the board's runs.
    started_us: u64,
    drift: f64,
    next_sample_us: u64,
    reboot_us: u64,
    /// When its turn is, on the host's clock.
    due_us: u64,
    /// What it holds, by sequence: the place of the record in the truth, and the time it was taken.
    held: BTreeMap<u64, (usize, u64)>,
    /// It has a wrong key: what it takes is no part of the truth.
    forger: bool,
}

impl<const RECORDS: usize> Board<RECORDS> {
    fn board_us(&self, host_us: u64) -> u64 {
        let since = host_us.saturating_sub(self.started_us) as f64;
        (since * (1.0 + self.drift)) as u64
    }

    fn host_us(&self, board_us: u64) -> u64 {
        self.started_us + (board_us as f64 / (1.0 + self.drift)).ceil() as u64
    }
}

/// A datagram under way: when it arrives, a tie-breaker, where to, and its bytes.
type UnderWay = Reverse<(u64, u64, Option<u32>, Vec<u8>)>;

struct Channel {
    faults: Faults,
    under_way: BinaryHeap<UnderWay>,
    count: u64,
    captured: VecDeque<Vec<u8>>,
    replayed: u64,
}

impl Channel {
    /// Sends a datagram on its way: to a board, or to the host.
    fn send(&mut self, random: &mut Random, now_us: u64, to: Option<u32>, datagram: &[u8]) {
        let faults = self.faults;
        if faults.replay > 0.0 && to.is_none() {
            if self.captured.len() < 4096 {
                self.captured.push_back(datagram.to_vec());
            } else if random.happens(0.05) {
                self.captured.pop_front();
                self.captured.push_back(datagram.to_vec());
            }
            if random.happens(faults.replay) {
                let index = (random.next() % self.captured.len() as u64) as usize;
                let again = self.captured[index].clone();
                self.replayed += 1;
                self.push(now_us, None, again);
            }
        }
        if random.happens(faults.loss) {
            return;
        }
        for _ in 0..1 + u64::from(random.happens(faults.duplicate)) {
            let mut delay_us = random.uniform() * faults.delay_ms * 1e3;
            if random.happens(faults.reorder) {
                delay_us += random.uniform() * 1e6;
            }
            let mut copy = datagram.to_vec();
            if random.happens(faults.corrupt) {
                let bit = random.next() as usize % (copy.len() * 8);
                copy[bit / 8] ^= 1 << (bit % 8);
            }
            self.push(now_us + delay_us as u64, to, copy);
        }
    }

    fn push(&mut self, at_us: u64, to: Option<u32>, datagram: Vec<u8>) {
        self.count += 1;
        self.under_way.push(Reverse((at_us, self.count, to, datagram)));
    }

    fn arrived(&mut self, now_us: u64) -> Option<(Option<u32>, Vec<u8>)> {
        if self.under_way.peek()?.0.0 > now_us {
            return None;
        }
        self.under_way.pop().map(|Reverse((_, _, to, datagram))| (to, datagram))
    }
}

/// Simulates boards whose stores have room for `RECORDS` records, until the time is over or `stop` is set; `progress` is
/// called about once a second.
pub fn simulate<const RECORDS: usize>(
    simulation: Simulation<'_>,
    stop: &AtomicBool,
    mut progress: impl FnMut(&Outcome),
) -> io::Result<Outcome> {
    let clock = HostClock::start();
    let local: SocketAddr = if simulation.host.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
    let socket = UdpSocket::bind(local)?;
    socket.connect(simulation.host)?;
    socket.set_nonblocking(true)?;
    let _ = rustix::net::sockopt::set_socket_recv_buffer_size(&socket, 8 << 20);
    let start_us = clock.now_us();
    let count = simulation.places.len();
    let mut random = Random(simulation.seed);
    let faults = simulation.faults;
    let mut channel =
        Channel { faults, under_way: BinaryHeap::new(), count: 0, captured: VecDeque::new(), replayed: 0 };
    let period_us = u64::from(simulation.settings.sampling_period_ms) * 1000;
    let mut boards: Vec<Board<RECORDS>> = Vec::with_capacity(count);
    for (index, mut place) in simulation.places.into_iter().enumerate() {
        let forger = index + faults.bad_keys >= count;
        if forger {
            place.key = Key::from_bytes(std::array::from_fn(|_| random.next() as u8));
        }
        let boot = place.first_boot.max((start_us / 1_000_000) as u32);
        // Boards are not switched on at the same moment: their grids spread over a period.
        let started_us = start_us + random.next() % period_us.max(1);
        let drift = (random.uniform() - 0.5) * 80e-6;
        let mut board = Board {
            place,
            link: None,
            boot,
            started_us,
            drift,
            next_sample_us: 0,
            reboot_us: next_reboot(&mut random, faults, started_us),
            due_us: started_us,
            held: BTreeMap::new(),
            forger,
        };
        board.link = Some(Box::new(new_link(&board, simulation.settings, Outbox::new(boot))));
        boards.push(board);
    }
    // Answers go to the boards, not to those who claim their numbers.
    let by_number: HashMap<u32, usize> =
        boards.iter().enumerate().filter(|(_, b)| !b.forger).map(|(index, b)| (b.place.board, index)).collect();
    let mut due: BinaryHeap<Reverse<(u64, usize)>> =
        boards.iter().enumerate().map(|(index, board)| Reverse((board.started_us, index))).collect();
    let mut outcome = Outcome { start_us, ..Outcome::default() };
    let until_us = simulation.duration_s.map_or(u64::MAX, |seconds| start_us + (seconds * 1e6) as u64);
    let give_up_us = until_us.saturating_add((simulation.drain_s * 1e6) as u64);
    let (mut buffer, mut told_us) = ([0; MAX_DATAGRAM], start_us);
    let mut in_buffer = [0; 2048];
    loop {
        let now_us = clock.now_us();
        let stopped = stop.load(Ordering::Relaxed);
        let drained = now_us >= until_us && boards.iter().all(|board| board.held.is_empty());
        if stopped || drained || now_us >= give_up_us {
            break;
        }
        for _ in 0..256 {
            let Ok(length) = socket.recv(&mut in_buffer) else {
                break;
            };
            if let Ok(header) = Header::parse(&in_buffer[..length]) {
                channel.send(&mut random, now_us, Some(header.board), &in_buffer[..length]);
            }
        }
        while let Some((to, mut datagram)) = channel.arrived(now_us) {
            match to {
                // Nobody listens while the host is down; that is a datagram lost.
                None => drop(socket.send(&datagram)),
                Some(number) => {
                    if let Some(&index) = by_number.get(&number) {
                        hear(&mut boards[index], now_us, &mut datagram, &mut outcome);
                        boards[index].due_us = now_us;
                        due.push(Reverse((now_us, index)));
                    }
                }
            }
        }
        let mut worked = 0;
        while let Some(&Reverse((at_us, index))) = due.peek() {
            if at_us > now_us || worked >= 512 {
                break;
            }
            due.pop();
            let board = &mut boards[index];
            // An answer brought the board's turn forward: this was its turn before.
            if board.due_us != at_us {
                continue;
            }
            worked += 1;
            if now_us >= board.reboot_us {
                reboot(board, &mut random, faults, now_us, simulation.settings, &mut outcome);
            }
            if now_us < until_us {
                sample(board, now_us, simulation.scenario, start_us, simulation.keep_truth, &mut outcome);
            }
            let board_us = board.board_us(now_us);
            let Some(link) = &mut board.link else {
                continue;
            };
            while let Some(length) = link.poll(board_us, &mut buffer) {
                outcome.sent += 1;
                channel.send(&mut random, now_us, None, &buffer[..length]);
            }
            let poll_us = link.next_poll_us(board_us);
            let mut next_us = board.host_us(poll_us).max(now_us + 1000).min(board.reboot_us);
            if now_us < until_us {
                next_us = next_us.min(board.host_us(board.next_sample_us));
            }
            board.due_us = next_us.max(now_us + 1);
            due.push(Reverse((board.due_us, index)));
        }
        if now_us - told_us >= 1_000_000 {
            told_us = now_us;
            progress(&outcome);
        }
        if worked < 512 {
            std::thread::sleep(Duration::from_micros(500));
        }
    }
    outcome.replayed = channel.replayed;
    outcome.held = boards.iter().map(|board| board.held.len() as u64).sum();
    Ok(outcome)
}

fn next_reboot(random: &mut Random, faults: Faults, now_us: u64) -> u64 {
    if faults.reboot_s <= 0.0 {
        return u64::MAX;
    }
    // At least a second apart: boot numbers that begin with the time of day must not outrun it.
    now_us + 1_000_000 + (-random.uniform().max(1e-12).ln() * faults.reboot_s * 1e6) as u64
}

fn new_link<const RECORDS: usize>(
    board: &Board<RECORDS>,
    settings: Settings,
    outbox: Outbox<RECORDS>,
) -> BoardLink<RECORDS> {
    let identity = Identity {
        firmware: Firmware { major: 0, minor: 1, patch: 0 },
        reset: ResetReason::PowerOn,
        capacity: RECORDS as u32,
    };
    let sensors: Vec<Sensor> =
        board.place.sensors.iter().map(|&address| Sensor { address, kind: SensorKind::Max30205 }).collect();
    let (place, now_us) = (&board.place, 0);
    BoardLink::resume(place.board, place.key.clone(), board.boot, identity, &sensors, settings, now_us, outbox)
}

fn reboot<const RECORDS: usize>(
    board: &mut Board<RECORDS>,
    random: &mut Random,
    faults: Faults,
    now_us: u64,
    settings: Settings,
    outcome: &mut Outcome,
) {
    outcome.reboots += 1;
    board.boot += 1;
    board.started_us = now_us;
    board.next_sample_us = 0;
    board.reboot_us = next_reboot(random, faults, now_us);
    let before = board.link.take().map(|link| link.into_outbox());
    let outbox = match before {
        Some(outbox) if random.happens(faults.retain) => outbox,
        _ => {
            for (_, (place, _)) in std::mem::take(&mut board.held) {
                outcome.powered_off += 1;
                set_fate(outcome, place, Fate::PoweredOff);
            }
            Outbox::new(board.boot)
        }
    };
    board.link = Some(Box::new(new_link(board, settings, outbox)));
}

fn sample<const RECORDS: usize>(
    board: &mut Board<RECORDS>,
    now_us: u64,
    scenario: &Scenario,
    start_us: u64,
    keep_truth: bool,
    outcome: &mut Outcome,
) {
    let board_us = board.board_us(now_us);
    while board.next_sample_us <= board_us {
        let at_us = board.next_sample_us;
        let host_us = board.host_us(at_us);
        let seconds = host_us.saturating_sub(start_us) as f64 / 1e6;
        let readings: Vec<Reading> = board
            .place
            .sensors
            .iter()
            .map(|&address| match scenario(board.place.board, address, seconds) {
                Some(celsius) => Reading::Ok((celsius * 256.0).round() as i16),
                None => Reading::Absent,
            })
            .collect();
        let Some(link) = &mut board.link else {
            return;
        };
        let signal = Signal::Dbm(-50 - (board.place.board % 30) as i8);
        let battery = Battery::Millivolts(4100_u16.saturating_sub((seconds / 60.0) as u16));
        link.set_health(battery, signal, BoardCounters::default());
        let dropped = link.outbox().dropped();
        let sequence = link.record(at_us, &readings);
        board.next_sample_us += u64::from(link.settings().sampling_period_ms.max(1)) * 1000;
        let place = outcome.truth.len();
        outcome.taken += u64::from(!board.forger);
        if keep_truth && !board.forger {
            let counts = readings
                .iter()
                .map(|reading| match reading {
                    Reading::Ok(counts) | Reading::OutOfRange(counts) => *counts,
                    Reading::Absent | Reading::BusError => i16::MIN,
                })
                .collect();
            outcome.truth.push(Truth {
                board: board.place.board,
                store: link.outbox().store(),
                sequence,
                boot: board.boot,
                board_us: at_us,
                host_us,
                counts,
                fate: Fate::Held,
            });
        }
        if !board.forger {
            board.held.insert(sequence, (place, host_us));
        }
        if link.outbox().dropped() != dropped {
            let left: BTreeSet<u64> = link.outbox().sequences().collect();
            board.held.retain(|sequence, (place, _)| {
                let held = left.contains(sequence);
                if !held {
                    outcome.thinned += 1;
                    set_fate(outcome, *place, Fate::Thinned);
                }
                held
            });
        }
    }
}

fn hear<const RECORDS: usize>(board: &mut Board<RECORDS>, now_us: u64, datagram: &mut [u8], outcome: &mut Outcome) {
    let board_us = board.board_us(now_us);
    let Some(link) = &mut board.link else {
        return;
    };
    let heard = link.receive(board_us, datagram);
    outcome.host_version = link.host_version().or(outcome.host_version);
    // A datagram that is refused is counted by the board and reported to the host.
    let Ok(heard) = heard else {
        return;
    };
    if heard.released == 0 {
        return;
    }
    let left: BTreeSet<u64> = link.outbox().sequences().collect();
    board.held.retain(|sequence, (place, taken_us)| {
        let held = left.contains(sequence);
        if !held {
            outcome.acknowledged += 1;
            outcome.slowest_s = outcome.slowest_s.max(now_us.saturating_sub(*taken_us) as f64 / 1e6);
            set_fate(outcome, *place, Fate::Acknowledged);
        }
        held
    });
}

fn set_fate(outcome: &mut Outcome, place: usize, fate: Fate) {
    if let Some(truth) = outcome.truth.get_mut(place) {
        truth.fate = fate;
    }
}

/// Writes the truth as CSV: `board,store,sequence,boot,board_us,host_us,fate,counts` with counts separated by spaces.
pub fn write_truth(path: &Path, truth: &[Truth]) -> io::Result<()> {
    let mut out = BufWriter::new(std::fs::File::create(path)?);
    writeln!(out, "board,store,sequence,boot,board_us,host_us,fate,counts")?;
    for record in truth {
        let counts: Vec<String> = record.counts.iter().map(ToString::to_string).collect();
        writeln!(
            out,
            "{},{},{},{},{},{},{},{}",
            record.board,
            record.store,
            record.sequence,
            record.boot,
            record.board_us,
            record.host_us,
            record.fate.name(),
            counts.join(" ")
        )?;
    }
    out.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()
}

/// A body that warms by `rise` kelvin with a time constant of ten minutes, a little different at each sensor, with the
/// noise of a sensor: what boards read where no scenario is given.
pub fn warming(board: u32, address: u8, seconds: f64) -> Option<f64> {
    let place = f64::from(board % 97) * 0.13 + f64::from(address & 0x1F) * 0.37;
    let mut noise = Random(u64::from(board) << 32 ^ u64::from(address) << 24 ^ (seconds * 1000.0) as u64);
    let rise = 6.0 + place.sin().abs() * 4.0;
    Some(21.0 + place % 1.0 + rise * (1.0 - (-seconds / 600.0).exp()) + (noise.uniform() - 0.5) * 0.03)
}
