//! The network: the LM3S6965's Ethernet controller as an embassy-net driver, and as the radio that this board lacks.

use core::cell::Cell;
use core::task::Context;

use critical_section::Mutex;
use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState, RxToken, TxToken};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::waitqueue::GenericAtomicWaker;
use thermokin_firmware::Radio;
use thermokin_protocol::Signal;

use crate::register::{Register, unmask};

/// The controller's interrupt.
pub const INTERRUPT: u16 = 42;

const INTERRUPTS: Register = Register::new(0x4004_8000);
const INTERRUPT_MASK: Register = Register::new(0x4004_8004);
const RECEIVE_CONTROL: Register = Register::new(0x4004_8008);
const TRANSMIT_CONTROL: Register = Register::new(0x4004_800C);
const DATA: Register = Register::new(0x4004_8010);
const ADDRESS_0: Register = Register::new(0x4004_8014);
const ADDRESS_1: Register = Register::new(0x4004_8018);
const PACKETS: Register = Register::new(0x4004_8034);
const TRANSMIT: Register = Register::new(0x4004_8038);

const RECEIVED: u32 = 1 << 0;
/// Receiver on, FIFO emptied.
const RECEIVE: u32 = 1 << 0;
const EMPTY_FIFO: u32 = 1 << 4;
/// Transmitter on, short frames padded, checksum appended, full duplex.
const TRANSMIT_SETTINGS: u32 = 0b1111;
/// Addresses and type, which the length of a frame in the transmit FIFO leaves out.
const HEADER: usize = 14;
/// A frame's length, in the receive FIFO, counts itself and the checksum too.
const RECEIVE_EXTRA: usize = 6;
const LONGEST_FRAME: usize = 1514;

static WAKER: GenericAtomicWaker<CriticalSectionRawMutex> = GenericAtomicWaker::new(CriticalSectionRawMutex::new());
/// Whether the cable counts as plugged in: off between bursts.
static UP: Mutex<Cell<bool>> = Mutex::new(Cell::new(false));

/// The controller.
#[derive(Debug)]
pub struct Ethernet {
    address: [u8; 6],
    frame: [u8; LONGEST_FRAME + 2],
}

impl Ethernet {
    /// The controller, receiving nothing yet. There is one, and one owner.
    pub fn new() -> Self {
        let (low, high) = (ADDRESS_0.read().to_le_bytes(), ADDRESS_1.read().to_le_bytes());
        RECEIVE_CONTROL.write(EMPTY_FIFO);
        TRANSMIT_CONTROL.write(TRANSMIT_SETTINGS);
        INTERRUPTS.write(u32::MAX);
        INTERRUPT_MASK.write(RECEIVED);
        unmask(INTERRUPT);
        Self { address: [low[0], low[1], low[2], low[3], high[0], high[1]], frame: [0; LONGEST_FRAME + 2] }
    }

    /// Takes the next frame out of the FIFO: its length in `frame`, from its second byte on.
    fn take_frame(&mut self) -> usize {
        let [low, high, first, second] = DATA.read().to_le_bytes();
        let length = usize::from(u16::from_le_bytes([low, high]));
        [self.frame[0], self.frame[1]] = [first, second];
        // The frame's first two bytes came with its length; the checksum at its end is read and dropped.
        for word in 0..length.saturating_sub(4).div_ceil(4) {
            let bytes = DATA.read().to_le_bytes();
            let at = 2 + word * 4;
            if let Some(place) = self.frame.get_mut(at..at + 4) {
                place.copy_from_slice(&bytes);
            }
        }
        length.saturating_sub(RECEIVE_EXTRA).min(LONGEST_FRAME)
    }
}

/// A frame came.
pub fn received() {
    // The frames wait in the FIFO; the interrupt is let through again once they were taken.
    INTERRUPTS.write(RECEIVED);
    WAKER.wake();
}

impl Driver for Ethernet {
    type RxToken<'a> = Frame<'a>;
    type TxToken<'a> = Transmitter;

    fn receive(&mut self, context: &mut Context<'_>) -> Option<(Frame<'_>, Transmitter)> {
        WAKER.register(context.waker());
        if PACKETS.read() == 0 || !is_up() {
            return None;
        }
        let length = self.take_frame();
        Some((Frame(&mut self.frame[..length]), Transmitter))
    }

    fn transmit(&mut self, _: &mut Context<'_>) -> Option<Transmitter> {
        // A frame is gone by the time that the next one can be written.
        Some(Transmitter)
    }

    fn link_state(&mut self, context: &mut Context<'_>) -> LinkState {
        WAKER.register(context.waker());
        if is_up() { LinkState::Up } else { LinkState::Down }
    }

    fn capabilities(&self) -> Capabilities {
        let mut capabilities = Capabilities::default();
        capabilities.max_transmission_unit = LONGEST_FRAME;
        capabilities
    }

    fn hardware_address(&self) -> HardwareAddress {
        HardwareAddress::Ethernet(self.address)
    }
}

/// A frame that was received.
#[derive(Debug)]
pub struct Frame<'a>(&'a mut [u8]);

impl RxToken for Frame<'_> {
    fn consume<T, F: FnOnce(&mut [u8]) -> T>(self, use_frame: F) -> T {
        use_frame(self.0)
    }
}

/// The permission to send a frame.
#[derive(Debug)]
pub struct Transmitter;

impl TxToken for Transmitter {
    fn consume<T, F: FnOnce(&mut [u8]) -> T>(self, length: usize, fill: F) -> T {
        let mut frame = [0; LONGEST_FRAME + 2];
        let length = length.min(LONGEST_FRAME);
        let result = fill(&mut frame[2..2 + length]);
        if !is_up() {
            return result;
        }
        frame[..2].copy_from_slice(&(length.saturating_sub(HEADER) as u16).to_le_bytes());
        // The FIFO takes whole words; the controller sends as many bytes as the length says.
        for word in frame[..(length + 2).next_multiple_of(4).min(LONGEST_FRAME + 2)].chunks_exact(4) {
            DATA.write(u32::from_le_bytes([word[0], word[1], word[2], word[3]]));
        }
        TRANSMIT.write(1);
        result
    }
}

fn is_up() -> bool {
    critical_section::with(|cs| UP.borrow(cs).get())
}

/// The cable in the place of a radio: down, nothing passes.
#[derive(Debug)]
pub struct Cable;

impl Cable {
    fn set(&mut self, up: bool) {
        let before = critical_section::with(|cs| UP.borrow(cs).replace(up));
        if before != up {
            RECEIVE_CONTROL.write(if up { RECEIVE } else { EMPTY_FIFO });
            WAKER.wake();
        }
    }
}

impl Radio for Cable {
    async fn up(&mut self) {
        self.set(true);
    }

    async fn down(&mut self) {
        self.set(false);
    }

    fn signal(&mut self) -> Signal {
        Signal::NotMeasured
    }
}
