//! The thermometers' driver against a simulated part.

mod common;

use common::{Behaviour, Bus, Device, run, simulated_time};
use embassy_time::Timer;
use embedded_hal_async::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use thermokin_firmware::sensor::{Error, Fault, MAX30205, Register, TMP105, Thermometer};

#[test]
fn all_32_addresses_of_the_max30205_are_taken_and_no_other() {
    let taken: Vec<u8> = (0..=0x7F).filter(|&address| Thermometer::new(&MAX30205, address).is_some()).collect();
    assert_eq!(taken, (0x40..=0x5F).collect::<Vec<_>>());
}

#[test]
fn counts_are_16_bit_twos_complement() {
    let _time = simulated_time();
    for counts in [0, 1, -1, 37 * 256, i16::MAX, i16::MIN, -10 * 256 + 128] {
        let mut bus = Bus::of([(0x48, Device::max30205(counts))]);
        let thermometer = Thermometer::new(&MAX30205, 0x48).unwrap();
        let read = run(async {
            thermometer.configure(&mut bus).await?;
            thermometer.start(&mut bus).await?;
            Timer::after(thermometer.part().conversion).await;
            thermometer.counts(&mut bus).await
        });
        assert_eq!(read, Ok(counts));
    }
}

#[test]
fn a_conversion_leaves_the_part_asleep_and_in_its_normal_format() {
    let _time = simulated_time();
    let mut bus = Bus::of([(0x48, Device::max30205(0))]);
    let thermometer = Thermometer::new(&MAX30205, 0x48).unwrap();
    run(async {
        thermometer.configure(&mut bus).await.unwrap();
        thermometer.start(&mut bus).await.unwrap();
    });
    // Datasheet, table 4: bit 7 one-shot, bit 5 data format (clear: normal), bit 0 shutdown.
    assert_eq!(bus.device(0x48).written, [0x01, 0x81]);
    assert_eq!(bus.device(0x48).configuration, 0x01);
}

#[test]
fn the_tmp105_is_asked_for_12_bits() {
    let _time = simulated_time();
    let mut bus = Bus::of([(0x48, Device::max30205(0))]);
    let thermometer = Thermometer::new(&TMP105, 0x48).unwrap();
    run(thermometer.start(&mut bus)).unwrap();
    assert_eq!(bus.device(0x48).written, [0xE1]);
}

#[test]
fn an_error_says_where_and_how() {
    let _time = simulated_time();
    let thermometer = Thermometer::new(&MAX30205, 0x4A).unwrap();
    let fails = |behaviour, register, fault| {
        let mut bus = Bus::of([(0x4A, Device::max30205(0))]);
        bus.device(0x4A).behaviour = behaviour;
        let error = match register {
            Register::Temperature => run(thermometer.counts(&mut bus)).unwrap_err(),
            _ => run(thermometer.configure(&mut bus)).unwrap_err(),
        };
        assert_eq!(error, Error { address: 0x4A, register, fault });
    };
    let absent = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
    fails(Behaviour::Gone, Register::Configuration, Fault::Bus(absent));
    fails(Behaviour::Failing, Register::Temperature, Fault::Bus(ErrorKind::ArbitrationLoss));
    fails(Behaviour::Holding, Register::Temperature, Fault::Stuck);
}

#[test]
fn something_else_at_the_address_is_noticed() {
    let _time = simulated_time();
    let thermometer = Thermometer::new(&MAX30205, 0x48).unwrap();
    let error = run(thermometer.configure(&mut Deaf)).unwrap_err();
    assert_eq!(error.fault, Fault::ReadBack { wrote: 0x01, read: 0xFF });
}

/// Acknowledges everything and drives nothing.
struct Deaf;

impl ErrorType for Deaf {
    type Error = ErrorKind;
}

impl I2c for Deaf {
    async fn transaction(&mut self, _address: u8, operations: &mut [Operation<'_>]) -> Result<(), ErrorKind> {
        for operation in operations {
            if let Operation::Read(bytes) = operation {
                bytes.fill(0xFF);
            }
        }
        Ok(())
    }
}
