//! The link board on the LM3S6965 evaluation board that QEMU emulates: the same firmware, for tests without hardware.
//!
//! Its configuration is the last page of flash, which whoever starts the emulator writes.
#![no_std]
#![no_main]

mod clock;
mod ethernet;
mod flash;
mod i2c;
mod log;
mod register;
mod retained;
mod watchdog;

use core::panic::PanicInfo;

use defmt::{error, info};
use embassy_executor::Spawner;
use embassy_net::{Config, Runner, StackResources};
use static_cell::{ConstStaticCell, StaticCell};
use thermokin_firmware::power::ESP32C3_MAX30205;
use thermokin_firmware::update::{Start, Updater, Updates};
use thermokin_firmware::{Board, Link, Store, Supply, VERSION};
use thermokin_protocol::update::Target;
use thermokin_protocol::{Battery, Configuration, Identity, MAX_PAGE, Settings};

use crate::ethernet::{Cable, Ethernet};
use crate::flash::{Chip, LAYOUT};
use crate::i2c::Master;
use crate::retained::Note;
use crate::watchdog::Dog;

/// The blocks of records that fit the 64 KiB of this board beside everything else.
const BLOCKS: usize = 64;

static STORE: ConstStaticCell<Store<BLOCKS>> = ConstStaticCell::new(Store::new(0));

/// Where the configuration lies: the last KiB of flash, outside the linker's map.
const CONFIGURATION_PAGE: usize = 0x0003_FC00;

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    clock::start();
    // What cannot go on from here is reset by the watchdog, as on the other board.
    let watchdog = Dog::start();
    let configuration = match Configuration::from_page(configuration_page()) {
        Ok(configuration) => {
            static CONFIGURATION: StaticCell<Configuration> = StaticCell::new();
            CONFIGURATION.init(configuration)
        }
        Err(bad) => {
            error!("nothing can be done: {}", bad);
            return;
        }
    };
    let (boot, reset) = retained::begin_boot(configuration.first_boot);
    info!("board {=u32}, boot {=u32} after {}", configuration.board, boot, reset);
    let mut updater = configuration.update_key.and_then(take_up_update);

    static RESOURCES: StaticCell<StackResources<4>> = StaticCell::new();
    let seed = u64::from(configuration.board) << 32 | u64::from(boot);
    let (stack, runner) = embassy_net::new(
        Ethernet::new(),
        Config::dhcpv4(Default::default()),
        RESOURCES.init(StackResources::new()),
        seed,
    );
    match run_network(runner) {
        Ok(token) => spawner.spawn(token),
        Err(_) => unreachable!("the task's only instance is spawned once"),
    }

    // The link knows its store's capacity.
    let identity = Identity { firmware: VERSION, reset, capacity: 0 };
    let store = STORE.take();
    store.begin(boot);
    let link = Link::resume(
        configuration.board,
        configuration.key.clone(),
        boot,
        identity,
        &configuration.sensors,
        Settings::default(),
        embassy_time::Instant::now().as_micros(),
        store,
    );
    let board = Board {
        bus: Master::new(),
        stack,
        radio: Cable,
        watchdog,
        supply: Mains,
        configuration,
        // What the same duty would cost on the board that is glued to robots.
        currents: ESP32C3_MAX30205,
        updates: updater.as_mut().map(|updater| updater as &mut dyn Updates),
        restart,
    };
    if let Err(bad) = board.run(link).await {
        error!("nothing can be done: {}", bad);
    }
}

#[embassy_executor::task]
async fn run_network(mut runner: Runner<'static, Ethernet>) -> ! {
    runner.run().await
}

/// A configuration that names a key for programs belongs to an emulator that was started with a flash chip for them.
fn take_up_update(key: [u8; 32]) -> Option<Updater<Chip>> {
    match Chip::open().and_then(|chip| Updater::start(chip, LAYOUT, Target::Emulated, Some(key), None)) {
        Ok((updater, Start::Run)) => Some(updater),
        Ok((_, Start::Restart)) => restart(),
        Err(unreachable) => {
            error!("no new programs: {}", unreachable);
            None
        }
    }
}

fn restart() -> ! {
    retained::note_reset(Note::Restart);
    cortex_m::peripheral::SCB::sys_reset()
}

/// The emulator runs on no battery.
struct Mains;

impl Supply for Mains {
    async fn battery(&mut self) -> Battery {
        Battery::NotMeasured
    }
}

fn configuration_page() -> &'static [u8] {
    let page = core::ptr::with_exposed_provenance(CONFIGURATION_PAGE);
    // SAFETY: the page is flash, readable, beyond the 255 KiB that the map gives to the program, and never written.
    unsafe { core::slice::from_raw_parts(page, MAX_PAGE) }
}

/// All interrupts of the chip: those that this board lets through.
// SAFETY: it touches nothing but what critical sections guard.
#[cortex_m_rt::exception]
unsafe fn DefaultHandler(interrupt: i16) {
    match interrupt.try_into() {
        Ok(clock::ALARM_INTERRUPT) => clock::alarm(),
        Ok(ethernet::INTERRUPT) => ethernet::received(),
        Ok(watchdog::INTERRUPT) => watchdog::hungry(),
        _ => panic!("an interrupt that nobody let through"),
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    error!("panic: {}", defmt::Display2Format(info));
    retained::note_reset(Note::Panic);
    cortex_m::peripheral::SCB::sys_reset()
}
