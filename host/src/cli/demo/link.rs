//! A twin's temperatures the long way round: virtual link boards read them, speak the real protocol over loopback to the real
//! logger, and what a run gets is the export of the log.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use thermokin_protocol::Settings;

use super::super::Failure;
use super::super::board::{Wanted, add_boards, boards_of, places, registry_or_new};
use super::super::progress::Steps;
use super::unwritable;
use crate::logger::engine::{Engine, Tally};
use crate::logger::export::{ExportError, Exported, LoggedRun, export};
use crate::logger::registry::Registry;
use crate::logger::scenario::Recorded;
use crate::logger::serve::{Options, ServeError, State, View, Wish, serve};
use crate::logger::store::Rotation;
use crate::logger::virtual_board::{Faults, Simulation, simulate};
use crate::robot::Robot;
use crate::run::{Run, TemperatureLog};

/// The twin's clock runs this many times as fast as that of its boards.
pub const SPEED: f64 = 2500.0;
/// A board's sampling period: 12.5 s of the twin's time. Its records go out twenty at a time.
const PERIOD_MS: u32 = 5;
const BATCH: u16 = 20;
/// How long boards read on after the twin's last temperature, and then wait for the logger's word, s.
const MARGIN_S: f64 = 0.3;
const DRAIN_S: f64 = 30.0;

/// A logger at work, and the boards that it knows.
pub struct Link {
    store: PathBuf,
    registry: Registry,
    wanted: Vec<Wanted>,
    address: SocketAddr,
    wishes: Sender<Wish>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<Tally, ServeError>>>,
}

/// Shows nothing; says where the logger listens, and hands it wishes.
struct Quiet {
    listens: Option<Sender<SocketAddr>>,
    wishes: Receiver<Wish>,
}

impl View for Quiet {
    fn say(&mut self, _time_us: u64, _text: &str) {}

    fn show(&mut self, _engine: &Engine, state: &State, _now_us: u64) -> Vec<Wish> {
        if let Some(listens) = self.listens.take() {
            // Who does not want to know any more has given up.
            let _ = listens.send(state.listen);
        }
        self.wishes.try_iter().collect()
    }
}

/// A time within the log, on the host's clock, s.
#[derive(Debug, Clone)]
pub struct Span(LoggedRun);

impl Link {
    /// Starts a logger for a robot's boards; its store and registry lie in a folder.
    ///
    /// # Errors
    /// A registry or a store that cannot be used, and no address to listen on.
    pub fn start(robot: &Robot, folder: &Path) -> Result<Self, Failure> {
        let description = folder.join("robot.toml");
        std::fs::create_dir_all(folder)
            .and_then(|()| std::fs::write(&description, robot.to_toml()))
            .map_err(|error| unwritable(&description, &error))?;
        let path = folder.join("boards.toml");
        let mut registry = registry_or_new(&path)?;
        let wanted = boards_of(robot);
        add_boards(&mut registry, &robot.name, &wanted)?;
        registry.settings = Settings { sampling_period_ms: PERIOD_MS, batch_length: BATCH, ..registry.settings };
        registry.write(&path)?;
        let store = folder.join("log");
        let options = Options {
            listen: ([127, 0, 0, 1], 0).into(),
            store: store.clone(),
            registry: path,
            robot: Some(description),
            run: None,
            rotation: Rotation::default(),
            gather_us: 50_000,
        };
        let (listens, where_to) = channel();
        let (wishes, wished) = channel();
        let stop = Arc::new(AtomicBool::new(false));
        let thread = std::thread::Builder::new().name("logger".to_owned()).spawn({
            let stop = stop.clone();
            move || serve(&options, &stop, &mut Quiet { listens: Some(listens), wishes: wished })
        });
        let thread = thread.map_err(|error| Failure::Work(format!("the logger: {error}")))?;
        let address = match where_to.recv_timeout(Duration::from_secs(30)) {
            Ok(address) => address,
            Err(RecvTimeoutError::Timeout) => return Err(Failure::Work("the logger does not begin".to_owned())),
            // It has ended, and says why.
            Err(RecvTimeoutError::Disconnected) => {
                return Err(ended(thread)
                    .err()
                    .unwrap_or_else(|| Failure::Work("the logger has ended before it began".to_owned())));
            }
        };
        Ok(Self { store, registry, wanted, address, wishes, stop, thread: Some(thread) })
    }

    /// How many boards there are.
    pub fn boards(&self) -> usize {
        self.wanted.len()
    }

    /// For how long boards read a run, s.
    fn lasts_s(run: &Run) -> f64 {
        let last = |log: &TemperatureLog| {
            log.series.iter().filter_map(|series| series.times_s().last()).copied().fold(0.0, f64::max)
        };
        run.temperatures.as_ref().map_or(0.0, last) / SPEED + MARGIN_S
    }

    /// How many steps it takes to log a run.
    pub fn steps(run: &Run) -> u64 {
        Self::lasts_s(run) as u64
    }

    /// Has the boards read a run's temperatures and tell them to the logger, until the last is acknowledged.
    ///
    /// # Errors
    /// Readings that the logger does not acknowledge.
    pub fn log(&self, name: &str, run: &Run, robot: &Robot, seed: u64, steps: &Steps) -> Result<Span, Failure> {
        let Some(log) = &run.temperatures else {
            return Err(Failure::Work(format!("{name} has no temperatures")));
        };
        let recorded = Recorded::of(log, robot);
        let scenario = move |board: u32, address: u8, seconds: f64| recorded.celsius(board, address, seconds * SPEED);
        let lasts_s = Self::lasts_s(run);
        // A logger that is gone says so when it is asked for its last words.
        let _ = self.wishes.send(Wish::StartRun(name.to_owned()));
        let simulation = Simulation {
            places: places(&self.registry, &self.wanted),
            host: self.address,
            settings: self.registry.settings,
            faults: Faults::default(),
            seed,
            duration_s: Some(lasts_s),
            drain_s: DRAIN_S,
            scenario: &scenario,
            keep_truth: false,
        };
        let outcome = simulate::<4096>(simulation, &AtomicBool::new(false), |_| steps.done())
            .map_err(|error| Failure::Work(format!("{}: {error}", self.address)))?;
        let _ = self.wishes.send(Wish::StopRun);
        if outcome.held > 0 {
            let held = outcome.held;
            return Err(Failure::Work(format!("{name}: {held} records wait for the logger in vain")));
        }
        // The boards' own beginning: a mark comes a few milliseconds late, which here are seconds.
        let start_s = outcome.start_us as f64 / 1e6;
        Ok(Span(LoggedRun { name: name.to_owned(), start_s, stop_s: Some(start_s + lasts_s) }))
    }

    /// Ends the logger; what it took.
    ///
    /// # Errors
    /// What went wrong with it.
    pub fn end(&mut self) -> Result<Tally, Failure> {
        self.stop.store(true, Ordering::Relaxed);
        match self.thread.take() {
            Some(thread) => ended(thread),
            None => Ok(Tally::default()),
        }
    }

    /// The temperatures of a run as they were logged, at the twin's times. What is read by no board (the air, by a thermometer
    /// on the wall) stays as it is. The export itself is left in `file`.
    ///
    /// # Errors
    /// A log that cannot be read, and a disk that does not take the file.
    pub fn export(&self, span: &Span, run: &Run, file: &Path) -> Result<(TemperatureLog, Exported), Failure> {
        let mut bytes = Vec::new();
        let exported = export(&self.store, Some(&span.0), &|_| (), &mut bytes).map_err(|error| match error {
            ExportError::Input(error) => Failure::Input(error),
            ExportError::Output(error) => unwritable(file, &error),
        })?;
        std::fs::write(file, bytes).map_err(|error| unwritable(file, &error))?;
        let logged = TemperatureLog::read(file, &mut Vec::new())?;
        let others = run.temperatures.iter().flat_map(|log| {
            let others = log.sensors.iter().zip(&log.series).filter(|(name, _)| logged.index_of(name).is_none());
            others.flat_map(|(name, series)| readings(name, series, 1.0))
        });
        let own = logged.sensors.iter().zip(&logged.series).flat_map(|(name, series)| readings(name, series, SPEED));
        Ok((TemperatureLog::from_readings(own.chain(others)), exported))
    }
}

/// The readings of a series, with times so many times as long.
fn readings<'s>(
    name: &'s str,
    series: &'s crate::run::TemperatureSeries,
    factor: f64,
) -> impl Iterator<Item = (f64, &'s str, f64)> {
    series.times_s().iter().zip(series.celsius()).map(move |(time, celsius)| (factor * time, name, *celsius))
}

fn ended(thread: JoinHandle<Result<Tally, ServeError>>) -> Result<Tally, Failure> {
    match thread.join() {
        Ok(outcome) => outcome.map_err(super::super::log::failure),
        Err(panic) => std::panic::resume_unwind(panic),
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        // What went wrong before is what is told.
        let _ = self.end();
    }
}
