//! The radio: Wi-Fi as a station, up or down as the uplink asks.
//!
//! A task of its own holds the controller while the radio is up, and drops it to switch the radio off, which lets the
//! chip sleep: esp-radio holds a wake lock as long as the controller lives.

use defmt::{info, warn};
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal as Notice;
use embassy_time::{Duration, Timer, with_timeout};
use esp_hal::peripherals::WIFI;
use esp_radio::wifi::sta::StationConfig;
use esp_radio::wifi::{AuthenticationMethodConfig, Config, ControllerConfig, PowerSaveMode, WifiController, WifiError};
use portable_atomic::{AtomicI8, Ordering};
use thermokin_firmware::Radio;
use thermokin_protocol::{Signal, Wifi};

/// The wait before joining is tried again.
const REJOIN: Duration = Duration::from_secs(2);
/// How often the signal's strength is measured.
const MEASURE: Duration = Duration::from_secs(5);
/// Beacon intervals that the station may sleep through in live mode: 0.3 s.
const LISTEN_INTERVAL: u16 = 3;
/// No signal was measured.
const NO_SIGNAL: i8 = i8::MIN;

static WANTED: Notice<CriticalSectionRawMutex, bool> = Notice::new();
static STRENGTH: AtomicI8 = AtomicI8::new(NO_SIGNAL);

/// The uplink's end.
pub struct Station {
    up: bool,
}

impl Station {
    /// The radio, down.
    pub fn new() -> Self {
        Self { up: false }
    }

    fn set(&mut self, up: bool) {
        if self.up != up {
            self.up = up;
            WANTED.signal(up);
        }
    }
}

impl Radio for Station {
    async fn up(&mut self) {
        self.set(true);
    }

    async fn down(&mut self) {
        self.set(false);
    }

    fn signal(&mut self) -> Signal {
        match STRENGTH.load(Ordering::Relaxed) {
            NO_SIGNAL => Signal::NotMeasured,
            dbm => Signal::Dbm(dbm),
        }
    }
}

/// The radio's end: joins the network whenever the radio is to be up.
pub async fn run(mut wifi: WIFI<'static>, credentials: &'static Wifi) -> ! {
    let mut wanted = false;
    loop {
        while !wanted {
            wanted = WANTED.wait().await;
        }
        match stay_joined(wifi.reborrow(), credentials).await {
            Ok(now_wanted) => wanted = now_wanted,
            Err(error) => {
                warn!("the radio cannot be used: {}", error);
                if let Either::First(now_wanted) = select(WANTED.wait(), Timer::after(REJOIN)).await {
                    wanted = now_wanted;
                }
            }
        }
        STRENGTH.store(NO_SIGNAL, Ordering::Relaxed);
    }
}

/// Joins, again and again, until something else is wanted than a radio that is up.
async fn stay_joined(wifi: WIFI<'_>, credentials: &Wifi) -> Result<bool, WifiError> {
    let authentication = match credentials.password.as_str() {
        "" => AuthenticationMethodConfig::Open,
        password => AuthenticationMethodConfig::Wpa2Personal(password.try_into()?),
    };
    let station = StationConfig::default()
        .with_ssid(credentials.ssid.as_str().try_into()?)
        .with_authentication(authentication)
        .with_listen_interval(LISTEN_INTERVAL);
    let initial = ControllerConfig::default().with_initial_config(Config::Station(station));
    let mut controller = WifiController::new(wifi, initial)?;
    controller.set_power_saving(PowerSaveMode::Maximum)?;
    loop {
        match select(WANTED.wait(), controller.connect_async()).await {
            Either::First(wanted) => return Ok(wanted),
            Either::Second(Ok(_)) => info!("joined the network"),
            Either::Second(Err(error)) => {
                warn!("could not join the network: {}", error);
                if let Either::First(wanted) = select(WANTED.wait(), Timer::after(REJOIN)).await {
                    return Ok(wanted);
                }
                continue;
            }
        }
        loop {
            let dbm = controller.rssi().ok().and_then(|dbm| i8::try_from(dbm).ok());
            STRENGTH.store(dbm.unwrap_or(NO_SIGNAL), Ordering::Relaxed);
            match select(WANTED.wait(), with_timeout(MEASURE, controller.wait_for_disconnect_async())).await {
                Either::First(wanted) => return Ok(wanted),
                Either::Second(Ok(_)) => break,
                Either::Second(Err(_)) => {}
            }
        }
        info!("lost the network");
    }
}
