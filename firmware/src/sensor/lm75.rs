//! What the LM75's family of thermometers has in common: registers, one-shot conversions, and errors that say where.
//!
//! A read is a write of the register's number and then a read, each a transfer of its own with a stop between them: all
//! parts keep the register pointer, so this runs on controllers without a repeated start too.

use core::ops::RangeInclusive;

use embassy_time::{Duration, with_timeout};
use embedded_hal_async::i2c::I2c;

/// The longest that one transfer may take: 3 bytes at 100 kHz are 0.3 ms; what takes longer is a stuck bus.
pub const TRANSFER_LIMIT: Duration = Duration::from_millis(10);

/// The registers that all parts of the family have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Register {
    /// The last conversion, 16 bits, read only.
    Temperature = 0,
    /// The configuration, 8 bits.
    Configuration = 1,
    /// The lower limit of the alarm, 16 bits.
    Hysteresis = 2,
    /// The upper limit of the alarm, 16 bits.
    Overtemperature = 3,
}

/// What distinguishes one part from another.
#[derive(Debug)]
pub struct Part {
    /// The 7-bit addresses that its pins select.
    pub addresses: RangeInclusive<u8>,
    /// The configuration that puts it to sleep.
    pub shutdown: u8,
    /// The configuration that has it convert once and sleep again.
    pub one_shot: u8,
    /// The bit of the configuration that does not read back as written.
    pub one_shot_bit: u8,
    /// The longest time that a conversion takes.
    pub conversion: Duration,
    /// The counts, 1/256 °C each, of its operating range.
    pub counts: RangeInclusive<i16>,
}

/// A transfer with a thermometer that failed: which one, which register, and how.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Error<E> {
    /// The thermometer's address.
    pub address: u8,
    /// The register that was written or read.
    pub register: Register,
    /// What went wrong.
    pub fault: Fault<E>,
}

/// How a transfer failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fault<E> {
    /// The bus reports an error of its own.
    Bus(E),
    /// It did not end within [`TRANSFER_LIMIT`].
    Stuck,
    /// The configuration does not read back as it was written.
    ReadBack {
        /// What was written.
        wrote: u8,
        /// What was read.
        read: u8,
    },
}

/// One thermometer at its address. It owns no bus: each call borrows the one that all of them share.
#[derive(Debug, Clone, Copy)]
pub struct Thermometer {
    address: u8,
    part: &'static Part,
}

impl Thermometer {
    /// A thermometer at a 7-bit address, or nothing if the part cannot have that address.
    pub fn new(part: &'static Part, address: u8) -> Option<Self> {
        part.addresses.contains(&address).then_some(Self { address, part })
    }

    /// Its 7-bit address.
    pub fn address(&self) -> u8 {
        self.address
    }

    /// What part it is.
    pub fn part(&self) -> &'static Part {
        self.part
    }

    /// Puts it to sleep and checks that its configuration reads back.
    ///
    /// # Errors
    ///
    /// When a transfer fails, or [`Fault::ReadBack`] when something else answers at the address.
    pub async fn configure<B: I2c>(&self, bus: &mut B) -> Result<(), Error<B::Error>> {
        let wrote = self.part.shutdown;
        self.write(bus, Register::Configuration, wrote).await?;
        let [read] = self.read(bus, Register::Configuration).await?;
        if (read ^ wrote) & !self.part.one_shot_bit == 0 {
            Ok(())
        } else {
            Err(self.error(Register::Configuration, Fault::ReadBack { wrote, read }))
        }
    }

    /// Starts one conversion, after which it sleeps again; the whole configuration is written, so a part that lost its
    /// supply in between converts just the same.
    ///
    /// # Errors
    ///
    /// When the transfer fails.
    pub async fn start<B: I2c>(&self, bus: &mut B) -> Result<(), Error<B::Error>> {
        self.write(bus, Register::Configuration, self.part.one_shot).await
    }

    /// Reads the last conversion: counts of 1/256 °C.
    ///
    /// # Errors
    ///
    /// When a transfer fails.
    pub async fn counts<B: I2c>(&self, bus: &mut B) -> Result<i16, Error<B::Error>> {
        self.read(bus, Register::Temperature).await.map(i16::from_be_bytes)
    }

    async fn write<B: I2c>(&self, bus: &mut B, register: Register, value: u8) -> Result<(), Error<B::Error>> {
        let bytes = [register as u8, value];
        let transfer = with_timeout(TRANSFER_LIMIT, bus.write(self.address, &bytes)).await;
        self.outcome(register, transfer)
    }

    async fn read<B: I2c, const BYTES: usize>(
        &self,
        bus: &mut B,
        register: Register,
    ) -> Result<[u8; BYTES], Error<B::Error>> {
        let pointer = [register as u8];
        let transfer = with_timeout(TRANSFER_LIMIT, bus.write(self.address, &pointer)).await;
        self.outcome(register, transfer)?;
        let mut bytes = [0; BYTES];
        let transfer = with_timeout(TRANSFER_LIMIT, bus.read(self.address, &mut bytes)).await;
        self.outcome(register, transfer)?;
        Ok(bytes)
    }

    fn outcome<E>(
        &self,
        register: Register,
        transfer: Result<Result<(), E>, embassy_time::TimeoutError>,
    ) -> Result<(), Error<E>> {
        match transfer {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(self.error(register, Fault::Bus(error))),
            Err(embassy_time::TimeoutError) => Err(self.error(register, Fault::Stuck)),
        }
    }

    fn error<E>(&self, register: Register, fault: Fault<E>) -> Error<E> {
        Error { address: self.address, register, fault }
    }
}
