//! The thermometers: one file a part, and what all parts of the LM75's family share.

mod lm75;
mod max30205;
mod tmp105;

pub use lm75::{Error, Fault, Part, Register, TRANSFER_LIMIT, Thermometer};
pub use max30205::MAX30205;
pub use tmp105::TMP105;

use thermokin_protocol::SensorKind;

/// The part that answers for a kind of sensor: the LM75 family is read through the TMP105, its finest 12-bit member.
pub fn part(kind: SensorKind) -> &'static Part {
    match kind {
        SensorKind::Max30205 => &MAX30205,
        SensorKind::Lm75 => &TMP105,
    }
}
