//! A board: bus, network, watchdog, supply and configuration, and the three loops that run on them.

use core::cell::{Cell, RefCell};

use embassy_futures::join::join3;
use embassy_net::Stack;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::signal::Signal as Notice;
use embassy_time::{Duration, Instant, Timer};
use thermokin_protocol::{Battery, BoardCounters, BoardLink, Configuration, Outbox, Signal};

use crate::bus::SensorBus;
use crate::grid::Grid;
use crate::log::{alarm, info};
use crate::power::{Currents, Duty};
use crate::sampler::{BadAddress, Sampler};
use crate::update::Updates;
use crate::uplink::Uplink;
use crate::vigil::Vigil;

/// How often the other two are looked after, and the board notes how it is.
const WATCH_PERIOD: Duration = Duration::from_secs(1);
/// How often the duty cycles and what they cost are logged, in those periods.
const BUDGET_EVERY: u32 = 60;

/// The most sensors that a board of this firmware has.
pub const SENSORS: usize = 4;

/// The newest records that are held in full: what is sent at once and what is under way; older ones are coded.
const IN_FULL: usize = 128;

/// The records that the host does not have yet: a number of blocks of up to 32, beside the newest. In a static, for it is
/// most of the RAM.
pub type Store<const BLOCKS: usize> = Outbox<IN_FULL, SENSORS, BLOCKS>;

/// The protocol's end on the board.
pub type Link<const BLOCKS: usize> = BoardLink<IN_FULL, SENSORS, BLOCKS, &'static mut Store<BLOCKS>>;

/// The part of the network that draws the current.
pub trait Radio {
    /// Switches it on; returns when that is under way, the network's configuration says when it has come.
    fn up(&mut self) -> impl Future<Output = ()>;
    /// Switches it off.
    fn down(&mut self) -> impl Future<Output = ()>;
    /// How strong the host's side is received.
    fn signal(&mut self) -> Signal;
}

/// A watchdog that resets the board when it has not been fed for longer than twenty seconds or so.
pub trait Watchdog {
    /// All is well.
    fn feed(&mut self);
    /// It will not be fed again: a board whose chip does not tell after a reset that it came from the watchdog notes so.
    fn give_up(&mut self) {}
}

/// What the board runs on.
pub trait Supply {
    /// Measures the battery.
    fn battery(&mut self) -> impl Future<Output = Battery>;
}

/// Everything that one board differs in from another.
pub struct Board<'a, B, R, W, S> {
    /// The sensors' bus.
    pub bus: B,
    /// The network; somebody else runs it.
    pub stack: Stack<'a>,
    /// What carries the network.
    pub radio: R,
    /// The watchdog, already running.
    pub watchdog: W,
    /// What the board runs on.
    pub supply: S,
    /// Who the board is and where its host is.
    pub configuration: &'a Configuration,
    /// What the board's parts draw.
    pub currents: Currents,
    /// New programs over the air, on a board that has room for a second one.
    pub updates: Option<&'a mut dyn Updates>,
    /// Restarts the board, into a new program for instance.
    pub restart: fn() -> !,
}

/// What the loops of a board share; all of them run on one executor, one at a time.
pub(crate) struct Shared<'a, const BLOCKS: usize> {
    /// The protocol's end, which holds the records.
    pub(crate) link: RefCell<Link<BLOCKS>>,
    /// A record was stored.
    pub(crate) recorded: Notice<NoopRawMutex, ()>,
    /// Who progressed.
    pub(crate) vigil: Vigil,
    /// What was done.
    pub(crate) duty: RefCell<Duty>,
    /// The battery's last measurement.
    pub(crate) battery: Cell<Battery>,
    /// What failed.
    pub(crate) counters: Cell<BoardCounters>,
    /// New programs over the air.
    pub(crate) updates: RefCell<Option<&'a mut dyn Updates>>,
    /// Restarts the board.
    pub(crate) restart: fn() -> !,
}

impl<B: SensorBus, R: Radio, W: Watchdog, S: Supply> Board<'_, B, R, W, S> {
    /// Samples, sends and watches over both, for ever; `link` holds the records that the host does not have yet.
    ///
    /// # Errors
    ///
    /// Only at once, when the configuration names a sensor at an address that it cannot have.
    pub async fn run<const BLOCKS: usize>(self, link: Link<BLOCKS>) -> Result<(), BadAddress> {
        let sampler = Sampler::new(self.bus, &self.configuration.sensors)?;
        let shared = Shared {
            link: RefCell::new(link),
            recorded: Notice::new(),
            vigil: Vigil::new(Instant::now()),
            duty: RefCell::new(Duty::new(Instant::now())),
            battery: Cell::new(Battery::NotMeasured),
            counters: Cell::new(BoardCounters::default()),
            updates: RefCell::new(self.updates),
            restart: self.restart,
        };
        let mut uplink = Uplink::new(self.stack, self.radio, self.configuration);
        let watching = watch(&shared, self.watchdog, self.supply, self.currents, self.configuration.sensors.len());
        join3(sample(&shared, sampler), uplink.run(&shared), watching).await;
        Ok(())
    }
}

impl<const BLOCKS: usize> Shared<'_, BLOCKS> {
    fn period(&self) -> Duration {
        Duration::from_millis(u64::from(self.link.borrow().settings().sampling_period_ms))
    }
}

/// Stores what the sensors read, at the times of the grid.
async fn sample<B: SensorBus, const BLOCKS: usize>(shared: &Shared<'_, BLOCKS>, mut sampler: Sampler<B>) {
    let mut grid = Grid::new(shared.period(), Instant::now());
    loop {
        if grid.period() != shared.period() {
            grid.set_period(shared.period(), Instant::now());
        }
        let missed = grid.missed();
        grid.tick().await;
        let (sample, cost) = sampler.sample().await;
        shared.link.borrow_mut().record(sample.time_us, &sample.readings);
        shared.recorded.signal(());
        shared
            .counters
            .set(BoardCounters { reads_failed: sampler.reads_failed(), bus_recoveries: sampler.bus_recoveries() });
        shared.duty.borrow_mut().sampled(cost, grid.worst_lateness());
        if grid.missed() > missed {
            alarm!("{=u32} sampling times missed by now", grid.missed());
        }
        shared.vigil.sampled(Instant::now());
    }
}

/// Feeds the watchdog while the others progress, measures the battery, and logs what the board costs.
async fn watch<W: Watchdog, S: Supply, const BLOCKS: usize>(
    shared: &Shared<'_, BLOCKS>,
    mut watchdog: W,
    mut supply: S,
    currents: Currents,
    sensors: usize,
) {
    let mut given_up = false;
    let mut rounds = 0;
    let started = Instant::now();
    loop {
        let patience = shared.updates.borrow().as_ref().and_then(|updates| updates.patience());
        if patience.is_some_and(|patience| started.elapsed() > patience) {
            alarm!("the new program has not reached the host in time: restart");
            (shared.restart)();
        }
        match shared.vigil.starving(Instant::now(), shared.period()) {
            None => {
                watchdog.feed();
                given_up = false;
            }
            Some(starving) if !given_up => {
                alarm!("the watchdog is not fed any more: part {=u8} stands still", starving as u8);
                watchdog.give_up();
                given_up = true;
            }
            Some(_) => {}
        }
        shared.battery.set(supply.battery().await);
        rounds += 1;
        if rounds == BUDGET_EVERY {
            rounds = 0;
            log_budget(shared, currents, sensors);
        }
        Timer::after(WATCH_PERIOD).await;
    }
}

fn log_budget<const BLOCKS: usize>(shared: &Shared<'_, BLOCKS>, currents: Currents, sensors: usize) {
    let now = Instant::now();
    let duty = shared.duty.borrow();
    let budget = currents.budget(&duty, shared.link.borrow().settings().power, sensors, now);
    info!(
        "{=u32} samples, worst {=u64} us late; radio up {=u64} ms, {=u32} bursts, {=u32} datagrams, {=u32} bytes",
        duty.samples,
        duty.worst_lateness.as_micros(),
        duty.radio_up(now).as_millis(),
        duty.bursts,
        duty.datagrams_sent,
        duty.bytes_sent
    );
    info!("would draw {=u32} uA in the mean: {=u32} h on a cell of 1000 mAh", budget.mean_ua, budget.hours);
}
