//! The arms whose descriptions ship with thermokin.

use std::path::Path;

use super::description::Robot;

/// Name for the command line and text of each shipped `robot.toml`.
pub const SHIPPED: [(&str, &str); 5] = [
    ("comau-nj-130-2.0", include_str!("../../robots/comau-nj-130-2.0.toml")),
    ("staubli-tx90", include_str!("../../robots/staubli-tx90.toml")),
    ("staubli-tx2-90l", include_str!("../../robots/staubli-tx2-90l.toml")),
    ("abb-irb-120", include_str!("../../robots/abb-irb-120.toml")),
    ("universal-robots-ur10", include_str!("../../robots/universal-robots-ur10.toml")),
];

/// A shipped arm by its name.
pub fn shipped(name: &str) -> Option<Robot> {
    let (_, text) = SHIPPED.iter().find(|(own, _)| *own == name)?;
    // The texts are part of the program and a test reads every one of them.
    Some(Robot::parse(Path::new(name), text).expect("a shipped robot.toml is valid"))
}
