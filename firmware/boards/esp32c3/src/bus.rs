//! The sensors' bus: I2C 0, and its two pins as plain ones while a stuck bus is clocked free.

use defmt::warn;
use embassy_time::Delay;
use embedded_hal_async::i2c::{ErrorType, I2c as AsyncI2c, Operation};
use esp_hal::Async;
use esp_hal::gpio::{DriveMode, Level, Output, OutputConfig, Pull};
use esp_hal::i2c::master::{Config, Error, I2c};
use esp_hal::peripherals::{GPIO6, GPIO7, I2C0};
use thermokin_firmware::bus::{SensorBus, nine_clocks};

/// I2C 0 on GPIO6 (SDA) and GPIO7 (SCL), 100 kHz: the cables along a link are long.
pub struct Bus {
    controller: I2C0<'static>,
    sda: GPIO6<'static>,
    scl: GPIO7<'static>,
}

impl Bus {
    /// The bus of a controller and two pins.
    pub fn new(controller: I2C0<'static>, sda: GPIO6<'static>, scl: GPIO7<'static>) -> Self {
        Self { controller, sda, scl }
    }

    /// The controller, set up for one transaction: a dropped or failed one leaves nothing behind.
    fn controller(&mut self) -> I2c<'_, Async> {
        I2c::new(self.controller.reborrow(), Config::default())
            .expect("the default configuration is valid")
            .with_sda(self.sda.reborrow())
            .with_scl(self.scl.reborrow())
            .into_async()
    }
}

impl ErrorType for Bus {
    type Error = Error;
}

impl AsyncI2c for Bus {
    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), Error> {
        AsyncI2c::transaction(&mut self.controller(), address, operations).await
    }
}

impl SensorBus for Bus {
    async fn recover(&mut self) {
        let open_drain = OutputConfig::default().with_drive_mode(DriveMode::OpenDrain).with_pull(Pull::Up);
        let mut scl = Output::new(self.scl.reborrow(), Level::High, open_drain);
        let mut sda = Output::new(self.sda.reborrow(), Level::High, open_drain).into_flex();
        sda.set_input_enable(true);
        if let Ok(false) = nine_clocks(&mut scl, &mut sda, &mut Delay).await {
            warn!("nine clocks did not free the bus");
        }
    }
}
