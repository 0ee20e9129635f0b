//! What the library's tests run on: simulated time, and a simulated bus with thermometers whose faults are on request.
#![allow(dead_code, reason = "each test binary uses its part")]

pub mod flash;

use std::cell::{RefCell, RefMut};
use std::collections::BTreeMap;
use std::future::{Future, pending};
use std::pin::pin;
use std::rc::Rc;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};

use embassy_time::{Duration, Instant, MockDriver, Timer};
use embedded_hal_async::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use thermokin_firmware::bus::SensorBus;

/// The simulated clock is one for the whole process: a test holds it while it runs.
pub fn simulated_time() -> MutexGuard<'static, ()> {
    static CLOCK: Mutex<()> = Mutex::new(());
    let guard = CLOCK.lock().unwrap_or_else(PoisonError::into_inner);
    MockDriver::get().reset();
    guard
}

/// Runs a future to its end, with time passing in steps of 100 µs whenever it waits; panics after an hour.
pub fn run<F: Future>(future: F) -> F::Output {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    let end = Instant::now() + Duration::from_secs(3600);
    while Instant::now() < end {
        if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
            return output;
        }
        MockDriver::get().advance(Duration::from_micros(100));
    }
    panic!("still waiting after an hour");
}

/// How a simulated thermometer behaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Behaviour {
    /// As its datasheet says.
    Healthy,
    /// It does not acknowledge: it is not there.
    Gone,
    /// Transfers fail with an error of the bus.
    Failing,
    /// It holds the bus: transfers do not end.
    Holding,
}

/// A thermometer of the LM75's family: converts once when told to, and shows the result when it is done.
#[derive(Debug, Clone)]
pub struct Device {
    pub behaviour: Behaviour,
    /// What it would read now, in counts.
    pub temperature: i16,
    pub conversion: Duration,
    pub configuration: u8,
    /// Configurations written, in order.
    pub written: Vec<u8>,
    pointer: u8,
    result: i16,
    ready_at: Option<Instant>,
}

impl Device {
    pub fn max30205(temperature: i16) -> Self {
        Self {
            behaviour: Behaviour::Healthy,
            temperature,
            conversion: Duration::from_millis(50),
            configuration: 0,
            written: Vec::new(),
            pointer: 0,
            result: 0,
            ready_at: None,
        }
    }

    /// Loses its supply for a moment.
    pub fn brown_out(&mut self) {
        (self.configuration, self.pointer, self.result, self.ready_at) = (0, 0, 0, None);
    }

    fn write(&mut self, bytes: &[u8]) {
        self.pointer = bytes[0];
        if let (1, [_, configuration]) = (self.pointer, bytes) {
            self.written.push(*configuration);
            // The one-shot bit always reads 0.
            self.configuration = configuration & 0x7F;
            if configuration & 0x81 == 0x81 {
                self.ready_at = Some(Instant::now() + self.conversion);
            }
        }
    }

    fn read(&mut self, bytes: &mut [u8]) {
        if self.ready_at.is_some_and(|ready| Instant::now() >= ready) {
            self.result = self.temperature;
            self.ready_at = None;
        }
        match self.pointer {
            0 => bytes.copy_from_slice(&self.result.to_be_bytes()),
            1 => bytes.copy_from_slice(&[self.configuration]),
            other => panic!("register {other} was read"),
        }
    }
}

/// A bus on which each transfer takes 0.3 ms. A clone is the same bus: the test keeps one, the sampler has the other.
#[derive(Debug, Clone, Default)]
pub struct Bus(Rc<RefCell<Wires>>);

#[derive(Debug, Default)]
struct Wires {
    devices: BTreeMap<u8, Device>,
    recoveries: u32,
}

impl Bus {
    pub fn of<const N: usize>(devices: [(u8, Device); N]) -> Self {
        Self(Rc::new(RefCell::new(Wires { devices: devices.into(), recoveries: 0 })))
    }

    /// The device at an address.
    pub fn device(&self, address: u8) -> RefMut<'_, Device> {
        RefMut::map(self.0.borrow_mut(), |wires| wires.devices.get_mut(&address).expect("a device of the test"))
    }

    /// How often it was set up anew; that frees it from whoever holds it.
    pub fn recoveries(&self) -> u32 {
        self.0.borrow().recoveries
    }
}

impl ErrorType for Bus {
    type Error = ErrorKind;
}

impl I2c for Bus {
    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), ErrorKind> {
        assert_eq!(operations.len(), 1, "a repeated start: some controllers have none");
        Timer::after(Duration::from_micros(300)).await;
        let held = self.0.borrow().devices.values().any(|device| device.behaviour == Behaviour::Holding);
        if held {
            return pending().await;
        }
        let mut wires = self.0.borrow_mut();
        let device = wires.devices.get_mut(&address).filter(|device| device.behaviour != Behaviour::Gone);
        let device = device.ok_or(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address))?;
        if device.behaviour == Behaviour::Failing {
            return Err(ErrorKind::ArbitrationLoss);
        }
        match &mut operations[0] {
            Operation::Write(bytes) => device.write(bytes),
            Operation::Read(bytes) => device.read(bytes),
        }
        Ok(())
    }
}

impl SensorBus for Bus {
    async fn recover(&mut self) {
        let mut wires = self.0.borrow_mut();
        wires.recoveries += 1;
        for device in wires.devices.values_mut().filter(|device| device.behaviour == Behaviour::Holding) {
            device.behaviour = Behaviour::Healthy;
        }
    }
}
