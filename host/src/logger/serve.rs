//! The logger at work: one thread hears and answers, another writes and syncs.

use std::collections::HashMap;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use super::engine::{Engine, Tally};
use super::group::{Group, MarkKind};
use super::program::SignedProgram;
use super::registry::Registry;
use super::sink::{Sink, SinkError};
use super::status::{Status, interval_us};
use super::store::{Attachment, Finished, Rotation, Store, StoreError};
use crate::input::InputError;
use crate::robot::Robot;

/// How long the ear waits for a datagram before it looks at everything else.
const PATIENCE: Duration = Duration::from_millis(5);
/// How often the slow things are looked at: silence, files that changed, the view.
const TICK_US: u64 = 250_000;
/// How often a sink that failed is tried again.
const RETRY_US: u64 = 1_000_000;
/// The socket's buffer asked for: what 10,000 boards send while a thread is held up for a quarter of a second.
const SOCKET_BUFFER: usize = 8 << 20;

/// What the logger is to do.
#[derive(Debug, Clone)]
pub struct Options {
    /// Where to listen.
    pub listen: SocketAddr,
    /// The folder of log files.
    pub store: PathBuf,
    /// The registry of boards.
    pub registry: PathBuf,
    /// The robot that the sensors sit on.
    pub robot: Option<PathBuf>,
    /// The run to start at once.
    pub run: Option<String>,
    /// When a file is full.
    pub rotation: Rotation,
    /// How long a group gathers before it is synced, in microseconds.
    pub gather_us: u64,
}

/// Why the logger cannot start, or had to stop.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address cannot be listened on.
    #[error("{address}: {error}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        error: io::Error,
    },
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The registry or robot.toml.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The end of the store's file could not be written; everything acknowledged is stored.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// The operating system.
    #[error("{0}")]
    System(io::Error),
}

/// What a person wants.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Wish {
    /// To stop.
    Stop,
    /// To start a run, which ends the one before.
    StartRun(String),
    /// To end the run.
    StopRun,
    /// To mark a step.
    Mark(String),
    /// To offer a board a new program: its number, the offer's, the program's patience on trial in seconds, and the file.
    Update(u32, u32, u16, PathBuf),
}

impl Wish {
    /// Reads a wish from its words, `run NAME`, `stop-run`, `mark TEXT`, `update BOARD ORDER SECONDS FILE` or `stop`.
    pub fn parse(text: &str) -> Option<Self> {
        let (verb, rest) = text.split_once(' ').unwrap_or((text, ""));
        match (verb, rest.trim()) {
            ("stop", "") => Some(Wish::Stop),
            ("stop-run", "") => Some(Wish::StopRun),
            ("run", name) if !name.is_empty() => Some(Wish::StartRun(name.to_owned())),
            ("mark", text) if !text.is_empty() => Some(Wish::Mark(text.to_owned())),
            ("update", rest) => {
                let mut parts = rest.splitn(4, ' ');
                let (board, order) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
                let patience_s = parts.next()?.parse().ok()?;
                Some(Wish::Update(board, order, patience_s, parts.next()?.into()))
            }
            _ => None,
        }
    }
}

/// Who watches the logger: a terminal, a line log, a test.
pub trait View {
    /// Something was said.
    fn say(&mut self, time_us: u64, text: &str);
    /// The state, four times a second; returns what the person wants.
    fn show(&mut self, engine: &Engine, state: &State, now_us: u64) -> Vec<Wish>;
}

/// What the engine does not know.
#[derive(Debug, Clone)]
pub struct State {
    /// Where the logger listens.
    pub listen: SocketAddr,
    /// The folder of log files.
    pub store: PathBuf,
    /// The run that goes on, and when it began on the host's clock in microseconds.
    pub run: Option<(String, u64)>,
    /// Free bytes on the store's disk.
    pub free: Option<u64>,
}

/// The host's clock: the time of day at the start, run on by a clock that never steps.
#[derive(Debug, Clone, Copy)]
pub struct HostClock {
    start_us: u64,
    start: Instant,
}

impl HostClock {
    /// A clock that starts now.
    pub fn start() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { start_us: since.as_micros() as u64, start: Instant::now() }
    }

    /// Microseconds since 1970.
    pub fn now_us(&self) -> u64 {
        self.start_us + self.start.elapsed().as_micros() as u64
    }
}

/// Where a running logger takes wishes from other processes.
pub fn control_path(store: &Path) -> PathBuf {
    store.join("control.sock")
}

/// Hears boards until it is told to stop; `stop` may be set by a signal.
pub fn serve(options: &Options, stop: &AtomicBool, view: &mut dyn View) -> Result<Tally, ServeError> {
    let clock = HostClock::start();
    let registry = Registry::read(&options.registry)?;
    let mut attachments = Vec::new();
    let mut names = HashMap::new();
    if let Some(path) = &options.robot {
        names = sensor_names(&Robot::read(path)?, path)?;
        let data = std::fs::read(path).map_err(|error| InputError::of_file(path, error.to_string()))?;
        attachments.push(Attachment { name: "robot.toml".into(), media_type: "application/toml".into(), data });
    }
    attachments.push(settings_attachment(&registry));
    let socket = UdpSocket::bind(options.listen)
        .and_then(|socket| socket.set_read_timeout(Some(PATIENCE)).map(|()| socket))
        .map_err(|error| ServeError::Listen { address: options.listen, error })?;
    // Only root may have more than the kernel's limit; one that gives less only means more datagrams that are sent twice.
    let _ = rustix::net::sockopt::set_socket_recv_buffer_size_force(&socket, SOCKET_BUFFER)
        .or_else(|_| rustix::net::sockopt::set_socket_recv_buffer_size(&socket, SOCKET_BUFFER));
    let listen = socket.local_addr().unwrap_or(options.listen);
    let (store, finished) = Store::open(&options.store, options.rotation, attachments, clock.now_us())?;
    let unnamed = match &options.robot {
        None => Some("no robot.toml given: sensors are named by board and address".to_owned()),
        Some(path) if names.is_empty() => {
            Some(format!("{} puts no sensor on a board: sensors are named by board and address", path.display()))
        }
        Some(_) => None,
    };
    let engine = Engine::new(store.epoch(), &registry, names, store.states().clone());
    let state = State { listen, store: options.store.clone(), run: None, free: None };
    let control = control(&options.store);
    let mut logger = Logger {
        clock,
        socket,
        control,
        engine,
        state,
        writer: Writer::start(Box::new(store)).map_err(ServeError::System)?,
        registry: Watched::new(&options.registry),
        gather_us: options.gather_us,
        closed_us: 0,
        retry_us: 0,
        tick_us: 0,
        slow_us: 0,
        told_us: 0,
    };
    for Finished { path, cut } in finished {
        let text = format!(
            "finished {}, which was left open; {cut} torn bytes cut, none of them acknowledged",
            path.display()
        );
        view.say(logger.clock.now_us(), &text);
    }
    view.say(logger.clock.now_us(), &format!("listening on {listen}, storing in {}", options.store.display()));
    if let Some(words) = unnamed {
        view.say(logger.clock.now_us(), &words);
    }
    if let Some(name) = &options.run {
        logger.wish(Wish::StartRun(name.clone()), view, stop);
    }
    while !stop.load(Ordering::Relaxed) {
        logger.turn(view, stop);
    }
    logger.end(view)
}

/// The settings as they ride along in each file; no key is in them.
fn settings_attachment(registry: &Registry) -> Attachment {
    let settings = &registry.settings;
    let data = format!(
        "revision = {}\nsampling_period_ms = {}\nbatch_length = {}\npower = \"{:?}\"\n",
        settings.revision, settings.sampling_period_ms, settings.batch_length, settings.power
    );
    Attachment { name: "settings.toml".into(), media_type: "application/toml".into(), data: data.into_bytes() }
}

/// Which sensor sits at which address of which board.
fn sensor_names(robot: &Robot, path: &Path) -> Result<HashMap<(u32, u8), String>, InputError> {
    let mut names = HashMap::new();
    for sensor in &robot.sensors {
        if let (Some(board), Some(address)) = (sensor.board, sensor.address)
            && let Some(other) = names.insert((board, address), sensor.name.clone())
        {
            let message = format!(
                "sensors {other} and {} both have board {board} and address 0x{address:02X}, expected one sensor a place",
                sensor.name
            );
            return Err(InputError::of_file(path, message));
        }
    }
    Ok(names)
}

/// The socket for wishes; without one (a path too long, say) the logger works all the same.
fn control(store: &Path) -> Option<UnixDatagram> {
    let path = control_path(store);
    // The store is locked, so a socket that is there belongs to nobody.
    let _ = std::fs::remove_file(&path);
    let socket = UnixDatagram::bind(&path).ok()?;
    socket.set_nonblocking(true).ok()?;
    Some(socket)
}

struct Logger {
    clock: HostClock,
    socket: UdpSocket,
    control: Option<UnixDatagram>,
    engine: Engine,
    state: State,
    writer: Writer,
    registry: Watched,
    gather_us: u64,
    closed_us: u64,
    retry_us: u64,
    tick_us: u64,
    slow_us: u64,
    told_us: u64,
}

impl Logger {
    fn turn(&mut self, view: &mut dyn View, stop: &AtomicBool) {
        self.hear();
        if let Some(outcome) = self.writer.outcome() {
            self.settle(outcome);
        }
        let now_us = self.clock.now_us();
        let due = now_us.saturating_sub(self.closed_us) >= self.gather_us && now_us >= self.retry_us;
        if due && self.writer.is_idle() {
            self.closed_us = now_us;
            if let Some(group) = self.engine.close_group(now_us) {
                self.writer.give(group);
            }
        }
        self.answer();
        self.hear_wishes(view, stop);
        if now_us.saturating_sub(self.tick_us) >= TICK_US {
            self.tick_us = now_us;
            self.tick(now_us, view, stop);
        }
    }

    /// Takes what has come, for a few milliseconds at most.
    fn hear(&mut self) {
        let begun = Instant::now();
        let mut buffer = [0; 2048];
        // Errors of earlier answers (a board that is gone) are reported here too; they mean nothing.
        while let Ok((length, from)) = self.socket.recv_from(&mut buffer) {
            if let Some(notice) = self.engine.on_datagram(from, &mut buffer[..length], self.clock.now_us()) {
                let _ = self.socket.send_to(&notice, from);
            }
            if begun.elapsed() >= PATIENCE {
                break;
            }
        }
    }

    fn answer(&mut self) {
        let (clock, socket) = (self.clock, &self.socket);
        self.engine.answers(
            || clock.now_us(),
            |address, datagram| {
                // An answer that cannot be sent is a datagram lost.
                let _ = socket.send_to(datagram, address);
            },
        );
    }

    fn settle(&mut self, outcome: Result<(), (Group, SinkError)>) {
        let now_us = self.clock.now_us();
        match outcome {
            Ok(()) => self.engine.committed(now_us),
            Err((group, error)) => {
                self.retry_us = now_us + RETRY_US;
                self.engine.failed(group, now_us, &error.to_string());
            }
        }
    }

    fn tick(&mut self, now_us: u64, view: &mut dyn View, stop: &AtomicBool) {
        self.engine.on_tick(now_us);
        if now_us.saturating_sub(self.slow_us) >= 8 * TICK_US {
            self.slow_us = now_us;
            self.look_at_disk(now_us);
            match self.registry.changed() {
                Some(Ok(registry)) => self.engine.take_registry(&registry),
                Some(Err(error)) => view.say(now_us, &format!("the registry stays as it was: {error}")),
                None => {}
            }
        }
        if now_us.saturating_sub(self.told_us) >= interval_us(self.engine.boards().len()) {
            self.told_us = now_us;
            self.tell_others(now_us);
        }
        for text in self.engine.watch_mut().take_unsaid() {
            view.say(now_us, &text);
            self.engine.note_warning(now_us, text);
        }
        for wish in view.show(&self.engine, &self.state, now_us) {
            self.wish(wish, view, stop);
        }
    }

    /// Takes what other terminals ask for. In every turn: the time of a mark is the time at which it is heard here.
    fn hear_wishes(&mut self, view: &mut dyn View, stop: &AtomicBool) {
        let mut buffer = [0; 512];
        while let Some(Ok(length)) = self.control.as_ref().map(|control| control.recv(&mut buffer)) {
            if let Some(wish) = std::str::from_utf8(&buffer[..length]).ok().and_then(Wish::parse) {
                self.wish(wish, view, stop);
            }
        }
    }

    fn tell_others(&mut self, now_us: u64) {
        // It is for people, and written again in a moment; what keeps the store from being written is told elsewhere.
        let _ = Status::of(&self.engine, now_us).write(&self.state.store);
    }

    fn look_at_disk(&mut self, now_us: u64) {
        let Ok(disk) = rustix::fs::statvfs(&self.state.store) else {
            return;
        };
        let free = disk.f_bavail * disk.f_frsize;
        self.state.free = Some(free);
        self.engine.on_disk(free, now_us);
    }

    fn wish(&mut self, wish: Wish, view: &mut dyn View, stop: &AtomicBool) {
        let now_us = self.clock.now_us();
        match wish {
            Wish::Stop => stop.store(true, Ordering::Relaxed),
            Wish::StartRun(name) => {
                self.wish(Wish::StopRun, view, stop);
                view.say(now_us, &format!("run {name} begins"));
                self.engine.mark(now_us, MarkKind::RunStart, name.clone());
                self.state.run = Some((name, now_us));
            }
            Wish::StopRun => {
                if let Some((name, _)) = self.state.run.take() {
                    view.say(now_us, &format!("run {name} ends"));
                    self.engine.mark(now_us, MarkKind::RunStop, name);
                }
            }
            Wish::Mark(text) => {
                view.say(now_us, &format!("mark: {text}"));
                self.engine.mark(now_us, MarkKind::Mark, text);
            }
            Wish::Update(board, order, patience_s, file) => {
                let bytes = std::fs::read(&file).map_err(|error| error.to_string());
                match bytes.and_then(|bytes| SignedProgram::from_bytes(&bytes)) {
                    Ok(program) => self.engine.updates_mut().begin(board, order, patience_s, Arc::new(program)),
                    Err(error) => {
                        view.say(now_us, &format!("no new program for board {board}: {}: {error}", file.display()))
                    }
                }
            }
        }
    }

    /// Makes durable what gathered, answers a last time, and ends the file in good order.
    fn end(mut self, view: &mut dyn View) -> Result<Tally, ServeError> {
        self.wish(Wish::StopRun, view, &AtomicBool::new(true));
        for _ in 0..2 {
            if let Some(outcome) = self.writer.wait() {
                self.settle(outcome);
            }
            if let Some(group) = self.engine.close_group(self.clock.now_us()) {
                self.writer.give(group);
            }
        }
        if let Some(outcome) = self.writer.wait() {
            self.settle(outcome);
        }
        self.answer();
        self.tell_others(self.clock.now_us());
        if self.control.is_some() {
            let _ = std::fs::remove_file(control_path(&self.state.store));
        }
        self.writer.finish()?;
        Ok(*self.engine.tally())
    }
}

/// The thread that writes and syncs, one group at a time.
struct Writer {
    groups: Option<SyncSender<Group>>,
    outcomes: Receiver<Result<(), (Group, SinkError)>>,
    thread: Option<JoinHandle<Result<(), SinkError>>>,
    busy: bool,
}

impl Writer {
    fn start(mut sink: Box<dyn Sink>) -> io::Result<Self> {
        let (groups, inbox) = sync_channel::<Group>(1);
        let (outbox, outcomes) = channel();
        let thread = std::thread::Builder::new().name("writer".into()).spawn(move || {
            for group in inbox {
                let outcome = sink.take(&group).map_err(|error| (group, error));
                if outbox.send(outcome).is_err() {
                    break;
                }
            }
            sink.finish()
        })?;
        Ok(Self { groups: Some(groups), outcomes, thread: Some(thread), busy: false })
    }

    fn is_idle(&self) -> bool {
        !self.busy
    }

    fn give(&mut self, group: Group) {
        if let Some(groups) = &self.groups {
            self.busy = groups.send(group).is_ok();
        }
    }

    fn outcome(&mut self) -> Option<Result<(), (Group, SinkError)>> {
        match self.outcomes.try_recv() {
            Ok(outcome) => {
                self.busy = false;
                Some(outcome)
            }
            Err(TryRecvError::Empty | TryRecvError::Disconnected) => None,
        }
    }

    fn wait(&mut self) -> Option<Result<(), (Group, SinkError)>> {
        while self.busy {
            match self.outcomes.recv_timeout(Duration::from_secs(60)) {
                Ok(outcome) => {
                    self.busy = false;
                    return Some(outcome);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => self.busy = false,
            }
        }
        None
    }

    fn finish(mut self) -> Result<(), SinkError> {
        self.groups = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(outcome)) => outcome,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Ok(()),
        }
    }
}

/// A registry that is read again when its file changes.
struct Watched {
    path: PathBuf,
    seen: Option<SystemTime>,
}

impl Watched {
    fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), seen: modified(path) }
    }

    fn changed(&mut self) -> Option<Result<Registry, InputError>> {
        let now = modified(&self.path);
        if now == self.seen {
            return None;
        }
        self.seen = now;
        Some(Registry::read(&self.path))
    }
}

fn modified(path: &Path) -> Option<SystemTime> {
    path.metadata().and_then(|metadata| metadata.modified()).ok()
}

/// A flag that SIGINT, SIGTERM and SIGHUP set.
pub fn stop_on_signals() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        // A second signal ends the process at once: everything acknowledged is on disk at any moment.
        signal_hook::flag::register_conditional_default(signal, Arc::clone(&stop))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}
