//! What the board costs: duty cycles that the firmware counts itself, and the mean current that the datasheets' figures
//! make of them.

use embassy_time::{Duration, Instant};
use thermokin_protocol::PowerMode;

/// The capacity of the cell that hours are stated for, in mAh.
pub const CELL_MAH: u32 = 1000;

/// What the parts of a board draw, in µA at the cell, each from a datasheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Currents {
    /// The chip asleep, its RAM and clock kept, radio off.
    pub asleep: u32,
    /// The chip awake and working, radio off.
    pub awake: u32,
    /// The radio up all the time, in modem sleep, the chip idle in between: the mean of listening and dozing.
    pub live: u32,
    /// The radio up in a burst: receiving without a pause.
    pub receiving: u32,
    /// The radio sending.
    pub sending: u32,
    /// The time that sending one datagram takes beside its bytes: preamble, headers, contention and acknowledge.
    pub datagram_overhead: Duration,
    /// The time on air of one byte, in nanoseconds.
    pub byte_ns: u32,
    /// One sensor converting.
    pub sensor_converting: u32,
    /// One sensor in shutdown.
    pub sensor_asleep: u32,
}

/// The ESP32-C3 with MAX30205 sensors.
///
/// ESP32-C3 series datasheet, "Current consumption": light sleep 130 µA; CPU running at 160 MHz, radio off, 23 mA; idle
/// in modem sleep 16 mA; receiving 84 mA; sending 802.11b at 1 Mbit/s 335 mA. MAX30205 datasheet 19-8226: 600 µA (typical)
/// while converting, 3.5 µA (maximum) in shutdown. Assumed: live listens 3 ms every third beacon (3 · 102.4 ms) and
/// idles awake between, 16 mA + 84 mA · 3/307; datagrams go out at 1 Mbit/s, the dearest rate, with 1 ms of overhead;
/// regulator and charger draw nothing.
pub const ESP32C3_MAX30205: Currents = Currents {
    asleep: 130,
    awake: 23_000,
    live: 16_000 + 84_000 * 3 / 307,
    receiving: 84_000,
    sending: 335_000,
    datagram_overhead: Duration::from_millis(1),
    byte_ns: 8_000,
    sensor_converting: 600,
    sensor_asleep: 4,
};

/// What one sample took.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SampleCost {
    /// Time in which the chip worked at transfers, not waiting for conversions.
    pub awake: Duration,
    /// Time that sensors converted, each counted for itself.
    pub converting: Duration,
}

/// Duty cycles, counted since the start.
#[derive(Debug, Clone)]
pub struct Duty {
    started: Instant,
    /// Samples taken.
    pub samples: u32,
    /// Time in which the chip worked at the sensors' transfers.
    pub awake: Duration,
    /// Time that sensors converted, each counted for itself.
    pub converting: Duration,
    /// Datagrams sent.
    pub datagrams_sent: u32,
    /// Bytes sent in them, UDP payload.
    pub bytes_sent: u32,
    /// How often the radio was switched on.
    pub bursts: u32,
    radio_up: Duration,
    radio_up_since: Option<Instant>,
    /// The most that a sample was ever taken after its time.
    pub worst_lateness: Duration,
}

impl Duty {
    /// Nothing counted yet.
    pub fn new(now: Instant) -> Self {
        let none = Duration::from_ticks(0);
        Self {
            started: now,
            samples: 0,
            awake: none,
            converting: none,
            datagrams_sent: 0,
            bytes_sent: 0,
            bursts: 0,
            radio_up: none,
            radio_up_since: None,
            worst_lateness: none,
        }
    }

    /// Counts a sample; `worst_lateness` is the grid's.
    pub fn sampled(&mut self, cost: SampleCost, worst_lateness: Duration) {
        self.samples += 1;
        self.awake += cost.awake;
        self.converting += cost.converting;
        self.worst_lateness = worst_lateness;
    }

    /// Counts a datagram of a number of bytes.
    pub fn sent(&mut self, bytes: usize) {
        self.datagrams_sent = self.datagrams_sent.wrapping_add(1);
        self.bytes_sent = self.bytes_sent.wrapping_add(u32::try_from(bytes).unwrap_or(u32::MAX));
    }

    /// The radio was switched on.
    pub fn radio_switched_on(&mut self, now: Instant) {
        self.bursts = self.bursts.wrapping_add(1);
        self.radio_up_since.get_or_insert(now);
    }

    /// The radio was switched off.
    pub fn radio_switched_off(&mut self, now: Instant) {
        self.radio_up = self.radio_up(now);
        self.radio_up_since = None;
    }

    /// How long the radio was up.
    pub fn radio_up(&self, now: Instant) -> Duration {
        self.radio_up
            + self.radio_up_since.map_or(Duration::from_ticks(0), |since| now.saturating_duration_since(since))
    }
}

/// What a board costs in the mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Budget {
    /// The mean current, in µA.
    pub mean_ua: u32,
    /// The hours that a cell of [`CELL_MAH`] lasts.
    pub hours: u32,
}

impl Currents {
    /// The budget of a board with `sensors` sensors in a power mode, from the duty cycles counted until now.
    pub fn budget(&self, duty: &Duty, mode: PowerMode, sensors: usize, now: Instant) -> Budget {
        let elapsed = now.saturating_duration_since(duty.started).as_micros().max(1);
        let sending_us = u64::from(duty.datagrams_sent) * self.datagram_overhead.as_micros()
            + u64::from(duty.bytes_sent) * u64::from(self.byte_ns) / 1000;
        let radio_us = duty.radio_up(now).as_micros().min(elapsed);
        let awake_us = duty.awake.as_micros();
        let listening = match mode {
            PowerMode::Live => self.live,
            PowerMode::Burst => self.receiving,
        };
        // Charge in µA·µs; the parts of the time exclude each other but for the sensors', which come on top.
        let charge = [
            (sending_us, self.sending),
            (radio_us.saturating_sub(sending_us), listening),
            (awake_us, self.awake),
            (elapsed.saturating_sub(radio_us + awake_us), self.asleep),
            (duty.converting.as_micros(), self.sensor_converting),
            (elapsed * sensors as u64, self.sensor_asleep),
        ];
        let charge: u128 = charge.iter().map(|&(time, current)| u128::from(time) * u128::from(current)).sum();
        let mean_ua = u32::try_from(charge / u128::from(elapsed)).unwrap_or(u32::MAX);
        Budget { mean_ua, hours: CELL_MAH * 1000 / mean_ua.max(1) }
    }
}
