//! Access to the chip's registers: the one place of this board where memory is read and written by address.

/// A 32-bit register of a peripheral.
#[derive(Debug, Clone, Copy)]
pub struct Register(usize);

impl Register {
    /// The register at an address of the LM3S6965's peripheral space (datasheet DS-LM3S6965, chapter 3.3).
    ///
    /// # Panics
    ///
    /// When the address lies elsewhere or is not that of a word; in a constant, that fails the build.
    pub const fn new(address: usize) -> Self {
        assert!(
            address >= 0x4000_0000 && address < 0xE010_0000 && address.is_multiple_of(4),
            "no peripheral's register"
        );
        Self(address)
    }

    /// Reads it.
    pub fn read(self) -> u32 {
        // SAFETY: `new` admits peripheral words only, which are always mapped and hold no object of this program.
        unsafe { core::ptr::with_exposed_provenance::<u32>(self.0).read_volatile() }
    }

    /// Writes it.
    pub fn write(self, value: u32) {
        // SAFETY: as for reading; no peripheral of this chip writes to memory by itself (nobody sets up its DMA).
        unsafe { core::ptr::with_exposed_provenance_mut::<u32>(self.0).write_volatile(value) }
    }
}

/// Lets an interrupt of the chip's come through.
pub fn unmask(interrupt: u16) {
    // SAFETY: no critical section of this program relies on interrupts masked one by one.
    unsafe { cortex_m::peripheral::NVIC::unmask(Interrupt(interrupt)) }
}

/// Keeps an interrupt of the chip's back.
pub fn mask(interrupt: u16) {
    cortex_m::peripheral::NVIC::mask(Interrupt(interrupt));
}

#[derive(Debug, Clone, Copy)]
struct Interrupt(u16);

// SAFETY: the number is the position in the NVIC, constant for a value, and below 240.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self.0
    }
}
