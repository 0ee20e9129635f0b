//! The arm: its description (`robot.toml`), its kinematics, and the torques of gravity on it.
//!
//! Knows nothing of data or of files of runs. Lengths in metres, angles in radians.

mod chain;
mod convention;
mod description;
mod file;
mod frame;
mod gravity;
mod parameter;
mod remarks;
mod shipped;

pub use chain::{Chain, JointState, Posture, Prepared, Twist};
pub use convention::{Convention, Symbol};
pub use description::{Body, Joint, JointKind, Robot, Sensor, Target, ThermalChoice, Transform};
pub use frame::Frame;
pub use gravity::{Payload, gravity_torques};
pub use parameter::ParameterId;
pub use shipped::{SHIPPED, shipped};
