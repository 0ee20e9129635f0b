//! What lies in flash beside the program: the configuration, the log of boot numbers, and the second slot with what
//! belongs to it.

use defmt::{Format, error};
use esp_bootloader_esp_idf::partitions::{PARTITION_TABLE_MAX_LEN, read_partition_table};
use esp_hal::peripherals::FLASH;
use esp_storage::{FlashStorage, FlashStorageError};
use thermokin_firmware::boots::{BootsError, next_boot};
use thermokin_firmware::update::{Layout, Slot, Start, Updater};
use thermokin_protocol::update::Target;
use thermokin_protocol::{BadPage, Configuration, MAX_PAGE};

/// Where partitions.csv has the configuration.
const CONFIGURATION: u32 = 0x3F_D000;
/// Where partitions.csv has the two sectors of boot numbers.
const BOOTS: u32 = 0x3F_E000;
/// Where partitions.csv has the two sectors that remember how an update goes.
const UPDATES: u32 = 0xC000;
/// Where partitions.csv has the bootloader's choice of a slot.
const OTADATA: u32 = 0x9000;
/// Where partitions.csv has the two slots.
const OTA_0: u32 = 0x1_0000;
const OTA_1: u32 = 0x20_0000;
const SLOT_LENGTH: u32 = 0x1F_0000;

#[cfg(feature = "esp32c3")]
const TARGET: Target = Target::Esp32c3;
#[cfg(feature = "esp32c6")]
const TARGET: Target = Target::Esp32c6;

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
/// is done before the radio is up.
pub fn begin_boot(flash: &mut FlashStorage<'static>) -> Result<(Configuration, u32), Unconfigured> {
    let mut page = [0; MAX_PAGE];
    flash.read(CONFIGURATION, &mut page).map_err(|_| Unconfigured::Flash)?;
    let configuration = Configuration::from_page(&page).map_err(Unconfigured::Page)?;
    let boot = next_boot(flash, BOOTS, configuration.first_boot)
        .map_err(|_: BootsError<FlashStorageError>| Unconfigured::Boots)?;
    Ok((configuration, boot))
}

/// The flash; there is one.
pub fn open(flash: FLASH<'static>) -> FlashStorage<'static> {
    FlashStorage::new(flash)
}

/// Takes up an update that an earlier boot began; none if the flash fails. A program on trial is counted here, and gone
/// back from, so nothing that can fail comes before.
pub fn take_up_update(
    mut flash: FlashStorage<'static>,
    key: Option<[u8; 32]>,
) -> Option<(Updater<FlashStorage<'static>>, Start)> {
    let layout = Layout { journal: UPDATES, otadata: OTADATA, slots: [OTA_0, OTA_1], slot_length: SLOT_LENGTH };
    let running = running(&mut flash);
    match Updater::start(flash, layout, TARGET, key, running) {
        Ok(taken_up) => Some(taken_up),
        Err(failed) => {
            error!("no new programs: {}", defmt::Debug2Format(&failed));
            None
        }
    }
}

/// The slot that the bootloader mapped, if it is one of the two.
fn running(flash: &mut FlashStorage<'static>) -> Option<Slot> {
    let mut table = [0; PARTITION_TABLE_MAX_LEN];
    let booted = read_partition_table(flash, &mut table).ok()?.booted_partition().ok()??;
    match booted.offset() {
        OTA_0 => Some(Slot::A),
        OTA_1 => Some(Slot::B),
        _ => None,
    }
}
