//! The link board on an ESP32-C3 (a Seeed XIAO or any other that brings out GPIO2, 6 and 7).
//!
//! | pin | for |
//! | --- | --- |
//! | GPIO6, GPIO7 | SDA and SCL of the sensors, with pull-ups of 4.7 kΩ |
//! | GPIO2 | half of the battery's voltage, from a divider of two equal resistors |
//!
//! The configuration lies in a partition of its own, so that one image serves all boards and holds no secret.
#![no_std]
#![no_main]

mod bus;
mod flash;
mod radio;

use core::panic::PanicInfo;

use defmt::{error, info};
use embassy_executor::Spawner;
use embassy_net::{Config as NetConfig, Runner, StackResources};
use esp_hal::analog::adc::{Adc, AdcCalCurve, AdcConfig, AdcPin, Attenuation};
use esp_hal::clock::CpuClock;
use esp_hal::peripherals::{ADC1, GPIO2, WIFI};
use esp_hal::rng::Rng;
use esp_hal::rtc_cntl::{Rtc, Rwdt, RwdtStage, SocResetReason};
use esp_hal::system::reset_reason;
use esp_hal::timer::timg::TimerGroup;
use esp_hal::{Blocking, Config, ram, time};
use esp_println as _;
use esp_radio::wifi::Interface;
use portable_atomic::{AtomicU32, Ordering};
use static_cell::{ConstStaticCell, StaticCell};
use thermokin_firmware::power::ESP32C3_MAX30205;
use thermokin_firmware::update::{Start, Updates};
use thermokin_firmware::{Board, Link, Store, Supply, VERSION, Watchdog};
use thermokin_protocol::{Battery, Configuration, Identity, ResetReason, Settings, Wifi};

use crate::bus::Bus;
use crate::radio::Station;

esp_bootloader_esp_idf::esp_app_desc!();

/// The blocks of records that fit the RAM beside the radio's heap.
const BLOCKS: usize = 736;
/// The radio's heap: the part that the second-stage bootloader no longer needs, and the rest.
const RECLAIMED_HEAP: usize = 64 * 1024;
const FURTHER_HEAP: usize = 36 * 1024;

static STORE: ConstStaticCell<Store<BLOCKS>> = ConstStaticCell::new(Store::new(0));

#[esp_rtos::main]
async fn main(spawner: Spawner) {
    let peripherals = esp_hal::init(Config::default().with_cpu_clock(CpuClock::max()));
    esp_alloc::heap_allocator!(#[esp_hal::ram(reclaimed)] size: RECLAIMED_HEAP);
    esp_alloc::heap_allocator!(size: FURTHER_HEAP);
    let timers = TimerGroup::new(peripherals.TIMG0);
    let sleep = esp_rtos::sleep::configure(peripherals.LPWR);
    esp_rtos::start_with_idle_hook(timers.timer0, peripherals.FROM_CPU_INTR0, sleep.light_sleep_hook);

    // What cannot go on from here is reset by the watchdog: a program on trial that cannot start is gone back from.
    let watchdog = Dog::start(Rtc::new(peripherals.RTC_TIMER));
    let mut flash = flash::open(peripherals.FLASH);
    let begun = flash::begin_boot(&mut flash);
    let key = begun.as_ref().ok().and_then(|(configuration, _)| configuration.update_key);
    let mut updater = match flash::take_up_update(flash, key) {
        Some((_, Start::Restart)) => restart(),
        Some((updater, Start::Run)) => Some(updater),
        None => None,
    };
    let (configuration, boot) = match begun {
        Ok((configuration, boot)) => {
            static CONFIGURATION: StaticCell<Configuration> = StaticCell::new();
            (&*CONFIGURATION.init(configuration), boot)
        }
        Err(unconfigured) => {
            error!("nothing can be done: {}", unconfigured);
            return;
        }
    };
    let reset = why_reset();
    info!("board {=u32}, boot {=u32} after {}", configuration.board, boot, reset);
    let Some(credentials) = &configuration.wifi else {
        error!("nothing can be done: the configuration names no network");
        return;
    };

    static RESOURCES: StaticCell<StackResources<4>> = StaticCell::new();
    let random = Rng::new();
    let seed = u64::from(random.random()) << 32 | u64::from(random.random());
    let (stack, runner) = embassy_net::new(
        Interface::station(),
        NetConfig::dhcpv4(Default::default()),
        RESOURCES.init(StackResources::new()),
        seed,
    );
    match (run_network(runner), run_radio(peripherals.WIFI, credentials)) {
        (Ok(network), Ok(radio)) => {
            spawner.spawn(network);
            spawner.spawn(radio);
        }
        _ => unreachable!("the only instance of each task is spawned once"),
    }

    let store = STORE.take();
    store.begin(boot);
    let link = Link::resume(
        configuration.board,
        configuration.key.clone(),
        boot,
        // The link knows its store's capacity.
        Identity { firmware: VERSION, reset, capacity: 0 },
        &configuration.sensors,
        Settings::default(),
        embassy_time::Instant::now().as_micros(),
        store,
    );
    let board = Board {
        bus: Bus::new(peripherals.I2C0, peripherals.GPIO6, peripherals.GPIO7),
        stack,
        radio: Station::new(),
        watchdog,
        supply: Cell::new(peripherals.ADC1, peripherals.GPIO2),
        configuration,
        currents: ESP32C3_MAX30205,
        updates: updater.as_mut().map(|updater| updater as &mut dyn Updates),
        restart,
    };
    if let Err(bad) = board.run(link).await {
        error!("nothing can be done: {}", bad);
    }
}

#[embassy_executor::task]
async fn run_network(mut runner: Runner<'static, Interface>) -> ! {
    runner.run().await
}

#[embassy_executor::task]
async fn run_radio(wifi: WIFI<'static>, credentials: &'static Wifi) -> ! {
    radio::run(wifi, credentials).await
}

/// Set by a panic, in memory that a reset leaves alone: the chip itself cannot tell it from a restart that was asked for.
#[ram(unstable(rtc_fast, persistent))]
static PANICKED: AtomicU32 = AtomicU32::new(0);
/// What a panic sets; with the power the memory may become anything.
const PANIC: u32 = 0x7061_6E69;

/// What the chip tells about its last reset.
fn why_reset() -> ResetReason {
    use SocResetReason::{
        ChipPowerOn, CoreDeepSleep, CoreMwdt0, CoreMwdt1, CoreRtcWdt, CoreSw, CoreUsbJtag, CoreUsbUart, Cpu0Mwdt0,
        Cpu0Mwdt1, Cpu0RtcWdt, Cpu0Sw, SysBrownOut, SysRtcWdt, SysSuperWdt,
    };
    let reason = match reset_reason() {
        Some(ChipPowerOn) => ResetReason::PowerOn,
        Some(SysBrownOut) => ResetReason::Brownout,
        Some(CoreMwdt0 | CoreMwdt1 | CoreRtcWdt | Cpu0Mwdt0 | Cpu0Mwdt1 | Cpu0RtcWdt | SysRtcWdt | SysSuperWdt) => {
            ResetReason::Watchdog
        }
        Some(CoreSw | Cpu0Sw) if PANICKED.load(Ordering::Relaxed) == PANIC => ResetReason::Panic,
        Some(CoreSw | Cpu0Sw) => ResetReason::Software,
        Some(CoreUsbUart | CoreUsbJtag) => ResetReason::External,
        Some(CoreDeepSleep) => ResetReason::Wake,
        Some(_) | None => ResetReason::Unknown,
    };
    PANICKED.store(0, Ordering::Relaxed);
    reason
}

fn restart() -> ! {
    esp_hal::system::software_reset()
}

/// The watchdog of the RTC; it stands still while the chip sleeps.
struct Dog(Rwdt);

impl Dog {
    fn start(rtc: Rtc<'static>) -> Self {
        let mut watchdog = rtc.rwdt;
        watchdog.enable();
        watchdog.set_timeout(RwdtStage::Stage0, time::Duration::from_secs(20));
        Self(watchdog)
    }
}

impl Watchdog for Dog {
    fn feed(&mut self) {
        self.0.feed();
    }
}

/// The battery, through the divider on GPIO2.
struct Cell {
    converter: Adc<'static, ADC1<'static>, Blocking>,
    pin: AdcPin<GPIO2<'static>, ADC1<'static>, AdcCalCurve<ADC1<'static>>>,
}

impl Cell {
    fn new(converter: ADC1<'static>, pin: GPIO2<'static>) -> Self {
        let mut config = AdcConfig::new();
        let pin = config.enable_pin_with_cal(pin, Attenuation::_11dB);
        Self { converter: Adc::new(converter, config), pin }
    }
}

impl Supply for Cell {
    async fn battery(&mut self) -> Battery {
        // A conversion takes microseconds; a converter that is not ready then has nothing to say.
        let half = (0..1000).find_map(|_| self.converter.read_oneshot(&mut self.pin).ok());
        half.map_or(Battery::NotMeasured, |millivolts| Battery::Millivolts(millivolts.saturating_mul(2)))
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    error!("panic: {}", defmt::Display2Format(info));
    PANICKED.store(PANIC, Ordering::Relaxed);
    esp_hal::system::software_reset()
}
