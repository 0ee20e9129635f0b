//! Reads all sensors of the board at one time: one owner of the bus, one status a sensor, whatever the others do.

use core::ops::Add;

use embassy_time::{Duration, Instant, Timer};
use embedded_hal_async::i2c::{Error as _, ErrorKind};
use heapless::Vec;
use thermokin_protocol::{Reading, Sensor};

use crate::board::SENSORS;
use crate::bus::SensorBus;
use crate::log::{alarm, info};
use crate::power::SampleCost;
use crate::sensor::{Error, Fault, Thermometer, part};

/// Transfers that fail one after another, for other reasons than a missing acknowledge, before the bus is set up anew.
const FAILURES_BEFORE_RECOVERY: u8 = 3;
const NONE: Duration = Duration::from_ticks(0);

/// What all sensors read at one time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    /// The board's clock when the conversions were started, in microseconds; the sensors follow each other by less than
    /// a millisecond.
    pub time_us: u64,
    /// One reading a sensor, in the order of the board's sensors.
    pub readings: Vec<Reading, SENSORS>,
}

/// A sensor that cannot be: the second one at an address, at an address that the part cannot have, or beyond the last that
/// the board has room for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BadAddress(pub u8);

/// The owner of the bus and of all sensors on it.
#[derive(Debug)]
pub struct Sampler<B> {
    bus: B,
    sensors: Vec<Attached, SENSORS>,
    reads_failed: u32,
    bus_recoveries: u32,
    failures_in_a_row: u8,
}

#[derive(Debug)]
struct Attached {
    thermometer: Thermometer,
    state: State,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Configured, and asleep between samples.
    Ready,
    /// Never seen, or not answering any more: it is configured before its next conversion.
    Lost,
    /// It was told to convert.
    Converting,
    /// This sample gets no counts from it.
    Failed(Reading),
}

impl<B: SensorBus> Sampler<B> {
    /// A sampler of some sensors; nothing is sent to them yet.
    ///
    /// # Errors
    ///
    /// When two sensors have one address, or one has an address that its part cannot have, or there are too many.
    pub fn new(bus: B, sensors: &[Sensor]) -> Result<Self, BadAddress> {
        let mut attached: Vec<Attached, SENSORS> = Vec::new();
        for sensor in sensors {
            let refused = BadAddress(sensor.address);
            let thermometer = Thermometer::new(part(sensor.kind), sensor.address).ok_or(refused)?;
            if attached.iter().any(|other| other.thermometer.address() == sensor.address) {
                return Err(refused);
            }
            attached.push(Attached { thermometer, state: State::Lost }).map_err(|_| refused)?;
        }
        Ok(Self { bus, sensors: attached, reads_failed: 0, bus_recoveries: 0, failures_in_a_row: 0 })
    }

    /// How many reads failed.
    pub fn reads_failed(&self) -> u32 {
        self.reads_failed
    }

    /// How many times the bus was set up anew.
    pub fn bus_recoveries(&self) -> u32 {
        self.bus_recoveries
    }

    /// How long a conversion of the slowest sensor takes.
    pub fn conversion(&self) -> Duration {
        let slowest = self.sensors.iter().map(|sensor| sensor.thermometer.part().conversion).max();
        slowest.unwrap_or(NONE)
    }

    /// Has all sensors convert at once and reads them; each that fails costs its own reading only. Also gives what that took.
    ///
    /// # Cancellation safety
    ///
    /// A sample that is dropped is lost; the next one is unaffected.
    pub async fn sample(&mut self) -> (Sample, SampleCost) {
        let started = Instant::now();
        for index in 0..self.sensors.len() {
            self.sensors[index].state = match self.start(index).await {
                Ok(()) => State::Converting,
                Err(reading) => State::Failed(reading),
            };
        }
        let waiting = Instant::now();
        let converting = self.sensors.iter().filter(|sensor| sensor.state == State::Converting);
        let converting: Duration = converting.map(|sensor| sensor.thermometer.part().conversion).fold(NONE, Add::add);
        if converting > NONE {
            Timer::at(waiting + self.conversion()).await;
        }
        let waited = waiting.elapsed();
        let mut readings = Vec::new();
        for index in 0..self.sensors.len() {
            let reading = match self.sensors[index].state {
                State::Failed(reading) => reading,
                _ => self.read(index).await,
            };
            let failed = matches!(reading, Reading::Absent | Reading::BusError);
            self.sensors[index].state = if failed { State::Lost } else { State::Ready };
            self.reads_failed = self.reads_failed.saturating_add(u32::from(failed));
            // One reading a sensor, and both lists hold at most SENSORS.
            let _ = readings.push(reading);
        }
        let awake = started.elapsed().checked_sub(waited).unwrap_or(NONE);
        (Sample { time_us: started.as_micros(), readings }, SampleCost { awake, converting })
    }

    async fn start(&mut self, index: usize) -> Result<(), Reading> {
        let Attached { thermometer, state } = self.sensors[index];
        if state != State::Ready {
            if let Err(error) = thermometer.configure(&mut self.bus).await {
                return Err(self.failed(error, false).await);
            }
            info!("sensor {=u8:#x} taken up", thermometer.address());
        }
        match thermometer.start(&mut self.bus).await {
            Ok(()) => Ok(()),
            Err(error) => Err(self.failed(error, state == State::Ready).await),
        }
    }

    async fn read(&mut self, index: usize) -> Reading {
        let thermometer = self.sensors[index].thermometer;
        match thermometer.counts(&mut self.bus).await {
            Ok(counts) => {
                self.failures_in_a_row = 0;
                if thermometer.part().counts.contains(&counts) {
                    Reading::Ok(counts)
                } else {
                    Reading::OutOfRange(counts)
                }
            }
            Err(error) => self.failed(error, true).await,
        }
    }

    /// What a failed transfer leaves as a reading; frees the bus where that is called for.
    async fn failed(&mut self, error: Error<B::Error>, was_there: bool) -> Reading {
        let Error { address, register, fault } = error;
        let (reading, stuck) = match fault {
            Fault::Bus(code) => match code.kind() {
                ErrorKind::NoAcknowledge(_) => (Reading::Absent, false),
                _ => (Reading::BusError, self.one_more_failure()),
            },
            Fault::ReadBack { .. } => (Reading::BusError, self.one_more_failure()),
            Fault::Stuck => (Reading::BusError, true),
        };
        if was_there {
            alarm!("sensor {=u8:#x} lost at register {=u8}", address, register as u8);
        }
        if stuck {
            self.failures_in_a_row = 0;
            self.bus_recoveries = self.bus_recoveries.saturating_add(1);
            alarm!("bus set up anew, {=u32} times by now", self.bus_recoveries);
            self.bus.recover().await;
        }
        reading
    }

    fn one_more_failure(&mut self) -> bool {
        self.failures_in_a_row = self.failures_in_a_row.saturating_add(1);
        self.failures_in_a_row >= FAILURES_BEFORE_RECOVERY
    }
}
