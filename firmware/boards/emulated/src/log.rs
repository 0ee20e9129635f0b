//! The log: defmt's frames on UART 0, which the emulator writes to a file.

use core::cell::RefCell;

use critical_section::{Mutex, RestoreState};
use defmt::Encoder;

use crate::register::Register;

const DATA: Register = Register::new(0x4000_C000);
const FLAGS: Register = Register::new(0x4000_C018);
const TRANSMIT_FULL: u32 = 1 << 5;

struct State {
    encoder: Encoder,
    restore: RestoreState,
}

static STATE: Mutex<RefCell<State>> =
    Mutex::new(RefCell::new(State { encoder: Encoder::new(), restore: RestoreState::invalid() }));

fn send(bytes: &[u8]) {
    for &byte in bytes {
        while FLAGS.read() & TRANSMIT_FULL != 0 {}
        DATA.write(u32::from(byte));
    }
}

#[defmt::global_logger]
struct Uart;

// SAFETY: a frame is written in one critical section, from `acquire` to `release`; defmt calls them in pairs.
unsafe impl defmt::Logger for Uart {
    fn acquire() {
        // SAFETY: `release` ends it.
        let restore = unsafe { critical_section::acquire() };
        critical_section::with(|cs| {
            let mut state = STATE.borrow_ref_mut(cs);
            state.restore = restore;
            state.encoder.start_frame(send);
        });
    }

    unsafe fn flush() {}

    unsafe fn write(bytes: &[u8]) {
        critical_section::with(|cs| STATE.borrow_ref_mut(cs).encoder.write(bytes, send));
    }

    unsafe fn release() {
        let restore = critical_section::with(|cs| {
            let mut state = STATE.borrow_ref_mut(cs);
            state.encoder.end_frame(send);
            state.restore
        });
        // SAFETY: this is what `acquire` returned.
        unsafe { critical_section::release(restore) };
    }
}
