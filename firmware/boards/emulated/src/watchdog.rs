//! The LM3S6965's watchdog: resets the board when it was not fed for twenty seconds.

use thermokin_firmware::Watchdog;

use crate::register::{Register, mask, unmask};
use crate::retained::{Note, note_reset};

/// The watchdog's interrupt.
pub const INTERRUPT: u16 = 18;

const RCGC0: Register = Register::new(0x400F_E100);
const LOAD: Register = Register::new(0x4000_0000);
const CONTROL: Register = Register::new(0x4000_0008);
const CLEAR: Register = Register::new(0x4000_000C);

/// The watchdog's clock gate.
const GATE: u32 = 1 << 3;
/// Counting with an interrupt at the first time, and resetting at the second time that it runs out.
const COUNT_AND_RESET: u32 = 0b11;
/// 10 s at 12.5 MHz, twice.
const HALF: u32 = 125_000_000;

/// The watchdog, running.
#[derive(Debug)]
pub struct Dog(());

impl Dog {
    /// Starts it; nothing but a reset stops it.
    pub fn start() -> Self {
        RCGC0.write(RCGC0.read() | GATE);
        LOAD.write(HALF);
        CONTROL.write(COUNT_AND_RESET);
        unmask(INTERRUPT);
        Self(())
    }
}

/// Half of the time has passed: a program that hangs in its tasks cannot note any more why the reset comes.
pub fn hungry() {
    note_reset(Note::Watchdog);
    // Clearing it would be feeding.
    mask(INTERRUPT);
}

impl Watchdog for Dog {
    fn feed(&mut self) {
        // Clearing the first half's interrupt loads the whole time again, and so does writing the load.
        CLEAR.write(1);
        LOAD.write(HALF);
        note_reset(Note::None);
        unmask(INTERRUPT);
    }

    fn give_up(&mut self) {
        note_reset(Note::Watchdog);
    }
}
