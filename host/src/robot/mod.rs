//! The arm: its description (`robot.toml`, from a URDF or a table, and as a drawing), its kinematics, and the torques of gravity on it.
//!
//! Knows nothing of data or of files of runs. Lengths in metres, angles in radians.

mod chain;
mod convention;
mod description;
mod dh_rows;
mod drawing;
mod file;
mod frame;
mod gravity;
mod parameter;
mod parametrise;
mod remarks;
mod shipped;
mod urdf;

pub use chain::{Chain, JointState, Posture, Prepared, Twist};
pub use convention::{Convention, Symbol};
pub use description::{Body, Joint, JointKind, Robot, Sensor, Target, ThermalChoice, Transform};
pub use dh_rows::{DhOrder, from_dh_rows};
pub use drawing::drawing;
pub use frame::{Frame, centre_lines};
pub use gravity::{Payload, gravity_torques};
pub use parameter::ParameterId;
pub use parametrise::{Axes, Between, NearlyParallel, frame_of, parametrise};
pub use shipped::{SHIPPED, shipped};
pub use urdf::{UrdfError, from_urdf, urdf};
