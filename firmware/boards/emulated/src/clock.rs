//! The board's microsecond clock, and embassy's time driver on it.
//!
//! SysTick counts 80 ns steps down from 2^24 and wraps every 1.34 s; timer 0 counts whole seconds. The seconds say how
//! often SysTick has wrapped, so nobody has to count the wraps: an emulator that is not scheduled for seconds loses none.
//! Timer 1 is the alarm.

use core::cell::{Cell, RefCell};
use core::task::Waker;

use critical_section::{CriticalSection, Mutex};
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;

use crate::register::{Register, unmask};

/// The interrupt of timer 1's half A.
pub const ALARM_INTERRUPT: u16 = 21;

const RCC: Register = Register::new(0x400F_E060);
const RCGC1: Register = Register::new(0x400F_E104);
const SYSTICK_CONTROL: Register = Register::new(0xE000_E010);
const SYSTICK_RELOAD: Register = Register::new(0xE000_E014);
const SYSTICK_CURRENT: Register = Register::new(0xE000_E018);

/// The registers of a general-purpose timer.
struct Timer {
    configuration: Register,
    mode: Register,
    control: Register,
    interrupts: Register,
    clear: Register,
    load: Register,
    matches: Register,
    value: Register,
}

impl Timer {
    const fn new(base: usize) -> Self {
        Self {
            configuration: Register::new(base),
            mode: Register::new(base + 0x04),
            control: Register::new(base + 0x0C),
            interrupts: Register::new(base + 0x18),
            clear: Register::new(base + 0x24),
            load: Register::new(base + 0x28),
            matches: Register::new(base + 0x30),
            value: Register::new(base + 0x48),
        }
    }
}

const SECONDS: Timer = Timer::new(0x4003_0000);
const ALARM: Timer = Timer::new(0x4003_1000);

/// 200 MHz divided by 16 (system divider 15, in use): 12.5 MHz.
const CLOCK_12_5_MHZ: u32 = 15 << 23 | 1 << 22;
const TICKS_PER_SECOND: u64 = 12_500_000;
const WRAP: u64 = 1 << 24;
/// The longest alarm, well within 32 bits of ticks; a later one is set in steps.
const LONGEST_ALARM_US: u64 = 100_000_000;

struct Clock {
    /// What timer 0 showed at the start; a reset does not take it back to zero.
    first_second: Mutex<Cell<Option<u32>>>,
    /// The last time that was told: time never runs back.
    latest_us: Mutex<Cell<u64>>,
    queue: Mutex<RefCell<Queue>>,
}

embassy_time_driver::time_driver_impl!(static CLOCK: Clock = Clock {
    first_second: Mutex::new(Cell::new(None)),
    latest_us: Mutex::new(Cell::new(0)),
    queue: Mutex::new(RefCell::new(Queue::new())),
});

/// Starts the clock, at zero. Before, it stands still there.
pub fn start() {
    RCC.write(CLOCK_12_5_MHZ);
    RCGC1.write(RCGC1.read() | 1 << 16 | 1 << 17 | 1 << 12);
    SECONDS.control.write(0);
    SECONDS.configuration.write(1);
    SECONDS.matches.write(u32::MAX);
    ALARM.control.write(0);
    ALARM.configuration.write(0);
    ALARM.mode.write(1);
    ALARM.clear.write(u32::MAX);
    ALARM.interrupts.write(1);
    SYSTICK_CONTROL.write(0);
    SYSTICK_RELOAD.write(WRAP as u32 - 1);
    critical_section::with(|cs| {
        SECONDS.control.write(1);
        // Writing the current value clears it; enabled, on the processor's clock, without its interrupt.
        SYSTICK_CURRENT.write(0);
        SYSTICK_CONTROL.write(0b101);
        CLOCK.first_second.borrow(cs).set(Some(SECONDS.value.read()));
    });
    unmask(ALARM_INTERRUPT);
}

/// The alarm went off.
pub fn alarm() {
    ALARM.clear.write(u32::MAX);
    critical_section::with(|cs| CLOCK.wake_due(cs));
}

impl Clock {
    fn now_us(&self, cs: CriticalSection<'_>) -> u64 {
        let Some(first) = self.first_second.borrow(cs).get() else {
            return 0;
        };
        let seconds = u64::from(SECONDS.value.read().wrapping_sub(first));
        let within_wrap = (WRAP - u64::from(SYSTICK_CURRENT.read())) % WRAP;
        // The middle of the second is within 0.5 s of now; half a wrap is 0.67 s.
        let roughly = seconds * TICKS_PER_SECOND + TICKS_PER_SECOND / 2;
        let wraps = (roughly + WRAP / 2).saturating_sub(within_wrap) / WRAP;
        let now = (wraps * WRAP + within_wrap) * 2 / 25;
        let latest = self.latest_us.borrow(cs);
        latest.set(latest.get().max(now));
        latest.get()
    }

    /// Wakes all whose time has come, and sets the alarm to the next.
    fn wake_due(&self, cs: CriticalSection<'_>) {
        let now = self.now_us(cs);
        let next = self.queue.borrow(cs).borrow_mut().next_expiration(now);
        if next == u64::MAX {
            return;
        }
        let ticks = next.saturating_sub(now).clamp(1, LONGEST_ALARM_US) * 25 / 2;
        ALARM.control.write(0);
        // At most 1.25e9 ticks: the clamp keeps them within 32 bits.
        ALARM.load.write(ticks as u32 + 1);
        ALARM.control.write(1);
    }
}

impl Driver for Clock {
    fn now(&self) -> u64 {
        critical_section::with(|cs| self.now_us(cs))
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            if self.queue.borrow(cs).borrow_mut().schedule_wake(at, waker) {
                self.wake_due(cs);
            }
        });
    }
}
