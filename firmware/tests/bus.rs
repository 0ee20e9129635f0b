//! Nine clocks against a part that holds SDA in the middle of a byte.

mod common;

use std::cell::RefCell;
use std::convert::Infallible;

use common::{run, simulated_time};
use embassy_time::Delay;
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use thermokin_firmware::bus::nine_clocks;

/// A part that lets go of SDA after a number of clocks, and the clocks and stops that it saw.
#[derive(Debug, Default)]
struct Wires {
    clocks_to_go: u32,
    clocks: u32,
    stops: u32,
    scl_low: bool,
    sda_low: bool,
}

struct Scl<'a>(&'a RefCell<Wires>);
struct Sda<'a>(&'a RefCell<Wires>);

impl ErrorType for Scl<'_> {
    type Error = Infallible;
}

impl ErrorType for Sda<'_> {
    type Error = Infallible;
}

impl OutputPin for Scl<'_> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().scl_low = true;
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        let mut wires = self.0.borrow_mut();
        if wires.scl_low {
            wires.scl_low = false;
            wires.clocks += 1;
            wires.clocks_to_go = wires.clocks_to_go.saturating_sub(1);
        }
        Ok(())
    }
}

impl OutputPin for Sda<'_> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().sda_low = true;
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        let mut wires = self.0.borrow_mut();
        if wires.sda_low && !wires.scl_low && wires.clocks_to_go == 0 {
            wires.stops += 1;
        }
        wires.sda_low = false;
        Ok(())
    }
}

impl InputPin for Sda<'_> {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        let wires = self.0.borrow();
        Ok(!wires.sda_low && wires.clocks_to_go == 0)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

fn clear(clocks_to_go: u32) -> (bool, Wires) {
    let wires = RefCell::new(Wires { clocks_to_go, ..Wires::default() });
    let free = run(nine_clocks(&mut Scl(&wires), &mut Sda(&wires), &mut Delay)).unwrap();
    (free, wires.into_inner())
}

#[test]
fn a_part_is_clocked_until_it_lets_go_and_then_stopped() {
    let _time = simulated_time();
    for needed in 0..=9 {
        let (free, wires) = clear(needed);
        assert_eq!((free, wires.clocks, wires.stops), (true, needed, 1), "needed {needed} clocks");
    }
}

#[test]
fn a_shorted_wire_is_told_after_nine_clocks() {
    let _time = simulated_time();
    let (free, wires) = clear(u32::MAX);
    assert_eq!((free, wires.clocks), (false, 9));
}
