//! Hidden effects: an independent simulator of calibration campaigns, the oracle that knows what it hid, and the judge of
//! `thermokin discover`.
//!
//! Nothing here uses the host's kinematics, heat or effects: an error there must not hide in the test of it. The parts:
//! [`arm`] and [`arms`] say what moves, [`schedule`] when, [`heat`] how warm, [`world`] puts them together; [`kind`] and
//! [`effect`] say what is hidden, [`readings`] what the temperature log says, [`draw`] chooses and sizes effects, [`oracle`]
//! weighs them, [`case`] makes a run of it all, [`folder`] writes it.

pub mod arm;
pub mod arms;
pub mod case;
pub mod draw;
pub mod effect;
pub mod floor;
pub mod folder;
pub mod heat;
pub mod kind;
pub mod naming;
pub mod oracle;
pub mod random;
pub mod readings;
pub mod schedule;
pub mod world;
