//! What outlives a reset: three words of RAM that the start leaves alone. With the power they become anything, so they
//! carry a check.
//!
//! The emulated flash cannot be programmed, so this is also where the boot number lives: within one run of the emulator it
//! counts up from the configuration's first one, and each run is given a first one that is greater than all before.

use core::sync::atomic::{AtomicU32, Ordering};

use thermokin_protocol::ResetReason;

// The section is outside what the start-up code writes; the initial values are never loaded.
#[unsafe(link_section = ".uninit.retained")]
static BOOT: AtomicU32 = AtomicU32::new(0);
#[unsafe(link_section = ".uninit.retained")]
static NOTE: AtomicU32 = AtomicU32::new(0);
#[unsafe(link_section = ".uninit.retained")]
static CHECK: AtomicU32 = AtomicU32::new(0);

/// Makes a check of words that are all zero, as emulated RAM begins, a wrong one.
const SALT: u32 = 0x7468_6B6E;

/// What the program can note about the reset that is about to come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Note {
    /// Nothing: a reset now comes from outside.
    None = 0,
    /// The watchdog is not fed any more.
    Watchdog = 1,
    /// The program panicked.
    Panic = 2,
    /// The program restarts the board.
    Restart = 3,
}

/// Begins a boot: its number, at least `first`, and why it came.
pub fn begin_boot(first: u32) -> (u32, ResetReason) {
    let (boot, note) = (BOOT.load(Ordering::Relaxed), NOTE.load(Ordering::Relaxed));
    let whole = CHECK.load(Ordering::Relaxed) == check(boot, note);
    let (boot, reason) = if whole {
        let reason = match note {
            note if note == Note::Watchdog as u32 => ResetReason::Watchdog,
            note if note == Note::Panic as u32 => ResetReason::Panic,
            note if note == Note::Restart as u32 => ResetReason::Software,
            _ => ResetReason::External,
        };
        ((boot + 1).max(first), reason)
    } else {
        (first, ResetReason::PowerOn)
    };
    BOOT.store(boot, Ordering::Relaxed);
    note_reset(Note::None);
    (boot, reason)
}

/// Notes why the next reset comes.
pub fn note_reset(note: Note) {
    NOTE.store(note as u32, Ordering::Relaxed);
    CHECK.store(check(BOOT.load(Ordering::Relaxed), note as u32), Ordering::Relaxed);
}

fn check(boot: u32, note: u32) -> u32 {
    !(boot ^ note.rotate_left(16) ^ SALT)
}
