//! What lies in flash beside the program: the configuration, and the log of boot numbers.

use defmt::Format;
use esp_hal::peripherals::FLASH;
use esp_storage::{FlashStorage, FlashStorageError};
use thermokin_firmware::boots::{BootsError, next_boot};
use thermokin_protocol::{BadPage, Configuration, MAX_PAGE};

/// Where partitions.csv has the configuration.
const CONFIGURATION: u32 = 0x3F_D000;
/// Where partitions.csv has the two sectors of boot numbers.
const BOOTS: u32 = 0x3F_E000;

/// Why the board does not know who it is.
#[derive(Debug, Format)]
pub enum Unconfigured {
    /// The flash cannot be read.
    Flash,
    /// There is no configuration, or none that makes sense.
    Page(BadPage),
    /// No boot number could be written, so nothing may be sent.
    Boots,
}

/// Reads the configuration and takes this boot's number. The flash stands still while the program runs from it, so this
/// is done once, before the radio is up.
pub fn begin_boot(flash: FLASH<'static>) -> Result<(Configuration, u32), Unconfigured> {
    let mut flash = FlashStorage::new(flash);
    let mut page = [0; MAX_PAGE];
    flash.read(CONFIGURATION, &mut page).map_err(|_| Unconfigured::Flash)?;
    let configuration = Configuration::from_page(&page).map_err(Unconfigured::Page)?;
    let boot = next_boot(&mut flash, BOOTS, configuration.first_boot)
        .map_err(|_: BootsError<FlashStorageError>| Unconfigured::Boots)?;
    Ok((configuration, boot))
}
