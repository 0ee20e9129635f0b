//! The sensors' bus: what the sampler asks of it beyond transfers, and the nine clocks that free it.

use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;

/// An I2C bus that can be set up anew after it got stuck.
pub trait SensorBus: I2c {
    /// Frees the bus (see [`nine_clocks`]) and sets its controller up anew.
    fn recover(&mut self) -> impl Future<Output = ()>;
}

/// Half a clock at 100 kHz.
const HALF_CLOCK_US: u32 = 5;

/// Frees a bus whose SDA some part holds low in the middle of a byte: clocks until it lets go, nine times at most, then
/// a stop. Both pins are open drain, and the controller has let go of them. Returns whether SDA is high in the end.
///
/// Nine clocks are what the I2C specification (NXP UM10204, 3.1.16) asks for: eight bits and the acknowledge.
///
/// # Errors
///
/// When a pin's own error says so; on-chip pins have none.
pub async fn nine_clocks<C, D, P>(scl: &mut C, sda: &mut D, delay: &mut P) -> Result<bool, D::Error>
where
    C: OutputPin<Error = D::Error>,
    D: InputPin + OutputPin,
    P: DelayNs,
{
    sda.set_high()?;
    for _ in 0..9 {
        if sda.is_high()? {
            break;
        }
        scl.set_low()?;
        delay.delay_us(HALF_CLOCK_US).await;
        scl.set_high()?;
        delay.delay_us(HALF_CLOCK_US).await;
    }
    sda.set_low()?;
    delay.delay_us(HALF_CLOCK_US).await;
    sda.set_high()?;
    delay.delay_us(HALF_CLOCK_US).await;
    sda.is_high()
}
