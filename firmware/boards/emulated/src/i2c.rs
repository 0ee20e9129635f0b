//! The sensors' bus: I2C master 0 of the LM3S6965, polled.
//!
//! QEMU's model knows no repeated start: a transaction of several operations is done with a stop after each.

use embedded_hal_async::i2c::{Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use thermokin_firmware::bus::SensorBus;

use crate::register::Register;

const ADDRESS: Register = Register::new(0x4002_0000);
const CONTROL: Register = Register::new(0x4002_0004);
const DATA: Register = Register::new(0x4002_0008);
const TIMER_PERIOD: Register = Register::new(0x4002_000C);
const CONFIGURATION: Register = Register::new(0x4002_0020);

/// Commands, written to the control register.
const RUN: u32 = 1 << 0;
const START: u32 = 1 << 1;
const STOP: u32 = 1 << 2;
const ACKNOWLEDGE: u32 = 1 << 3;
/// Status, read from it.
const BUSY: u32 = 1 << 0;
const ERROR: u32 = 1 << 1;
const ADDRESS_NOT_ACKNOWLEDGED: u32 = 1 << 2;
const DATA_NOT_ACKNOWLEDGED: u32 = 1 << 3;
const ARBITRATION_LOST: u32 = 1 << 4;
/// The configuration that makes it a master.
const MASTER: u32 = 1 << 4;
/// 12.5 MHz / (2 · (6 + 4) · (1 + 6)): 89 kHz, the fastest that stays below 100.
const PERIOD: u32 = 6;
/// A byte takes 9 clocks of 11 µs; polled this often it has had its time.
const POLLS: u32 = 10_000;

/// A transfer that failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// Nobody answers at the address.
    AddressNotAcknowledged,
    /// A byte was not taken.
    DataNotAcknowledged,
    /// Another master has the bus.
    ArbitrationLost,
    /// The controller did not end.
    Stuck,
}

impl Error for Failure {
    fn kind(&self) -> ErrorKind {
        match self {
            Failure::AddressNotAcknowledged => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address),
            Failure::DataNotAcknowledged => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Data),
            Failure::ArbitrationLost => ErrorKind::ArbitrationLoss,
            Failure::Stuck => ErrorKind::Bus,
        }
    }
}

/// I2C master 0, on pins PB2 and PB3.
#[derive(Debug)]
pub struct Master(());

impl Master {
    /// The master, set up; the clock must have been started. There is one, and one owner.
    pub fn new() -> Self {
        set_up();
        Self(())
    }

    fn write_all(&mut self, address: u8, bytes: &[u8]) -> Result<(), Failure> {
        ADDRESS.write(u32::from(address) << 1);
        for (index, &byte) in bytes.iter().enumerate() {
            DATA.write(u32::from(byte));
            command(edge(index == 0, START) | edge(index + 1 == bytes.len(), STOP) | RUN)?;
        }
        Ok(())
    }

    fn read_all(&mut self, address: u8, bytes: &mut [u8]) -> Result<(), Failure> {
        ADDRESS.write(u32::from(address) << 1 | 1);
        let last = bytes.len().saturating_sub(1);
        for (index, byte) in bytes.iter_mut().enumerate() {
            command(edge(index == 0, START) | edge(index == last, STOP) | edge(index != last, ACKNOWLEDGE) | RUN)?;
            // The register holds one byte.
            *byte = DATA.read() as u8;
        }
        Ok(())
    }
}

fn set_up() {
    CONFIGURATION.write(0);
    CONFIGURATION.write(MASTER);
    TIMER_PERIOD.write(PERIOD);
}

fn edge(condition: bool, bit: u32) -> u32 {
    if condition { bit } else { 0 }
}

/// Gives a command and waits for its end; after a failure the bus is stopped.
fn command(bits: u32) -> Result<(), Failure> {
    CONTROL.write(bits);
    let status = (0..POLLS).map(|_| CONTROL.read()).find(|status| status & BUSY == 0).ok_or(Failure::Stuck)?;
    if status & (ERROR | ARBITRATION_LOST) == 0 {
        return Ok(());
    }
    if status & ARBITRATION_LOST != 0 {
        return Err(Failure::ArbitrationLost);
    }
    if bits & STOP == 0 {
        CONTROL.write(STOP);
    }
    match status & (ADDRESS_NOT_ACKNOWLEDGED | DATA_NOT_ACKNOWLEDGED) {
        DATA_NOT_ACKNOWLEDGED => Err(Failure::DataNotAcknowledged),
        _ => Err(Failure::AddressNotAcknowledged),
    }
}

impl ErrorType for Master {
    type Error = Failure;
}

impl I2c for Master {
    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), Failure> {
        operations.iter_mut().try_for_each(|operation| match operation {
            Operation::Read(bytes) => self.read_all(address, bytes),
            Operation::Write(bytes) => self.write_all(address, bytes),
        })
    }
}

impl SensorBus for Master {
    /// The emulated wires cannot be stuck: there is only the controller to set up anew.
    async fn recover(&mut self) {
        set_up();
    }
}
