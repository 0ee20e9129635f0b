//! The conventions by which one frame of the chain follows another, and the symbols of their parameters.

use std::fmt;

use serde::{Deserialize, Serialize};

/// One of the six elementary motions that every convention is made of.
///
/// All conventions are the product `Tz(d) Rz(theta) Tx(a) Rx(alpha) Ty(b) Ry(beta)` with some factors left out
/// (contract `robot.md`; thesis section 4.2.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Symbol {
    /// Translation along z, metres.
    D,
    /// Rotation about z, radians.
    Theta,
    /// Translation along x, metres.
    A,
    /// Rotation about x, radians.
    Alpha,
    /// Translation along y, metres.
    B,
    /// Rotation about y, radians.
    Beta,
}

impl Symbol {
    /// All symbols in the order in which their motions are applied.
    pub const ALL: [Symbol; 6] = [Symbol::D, Symbol::Theta, Symbol::A, Symbol::Alpha, Symbol::B, Symbol::Beta];

    /// The name as it is written in files: `d`, `theta`, `a`, `alpha`, `b` or `beta`.
    pub fn name(self) -> &'static str {
        match self {
            Symbol::D => "d",
            Symbol::Theta => "theta",
            Symbol::A => "a",
            Symbol::Alpha => "alpha",
            Symbol::B => "b",
            Symbol::Beta => "beta",
        }
    }

    /// Whether the parameter is an angle (radians) rather than a length (metres).
    pub fn is_angle(self) -> bool {
        matches!(self, Symbol::Theta | Symbol::Alpha | Symbol::Beta)
    }

    /// The SI unit of the parameter.
    pub fn unit(self) -> &'static str {
        if self.is_angle() { "rad" } else { "m" }
    }
}

impl fmt::Display for Symbol {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// How a transform is parametrised (contract `robot.md`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Convention {
    /// Denavit-Hartenberg: `Tz(d) Rz(theta) Tx(a) Rx(alpha)`. Singular between parallel axes.
    Dh,
    /// Hayati-Mirmirani: `Rz(theta) Tx(a) Rx(alpha) Ry(beta)`. Singular between perpendicular axes.
    Hayati,
    /// All six: `Tz(d) Rz(theta) Tx(a) Rx(alpha) Ty(b) Ry(beta)`, for the end frame.
    Full,
}

impl Convention {
    /// The symbols of the convention's parameters in their order.
    pub fn symbols(self) -> &'static [Symbol] {
        match self {
            Convention::Dh => &[Symbol::D, Symbol::Theta, Symbol::A, Symbol::Alpha],
            Convention::Hayati => &[Symbol::Theta, Symbol::A, Symbol::Alpha, Symbol::Beta],
            Convention::Full => &Symbol::ALL,
        }
    }

    /// The name as it is written in files.
    pub fn name(self) -> &'static str {
        match self {
            Convention::Dh => "dh",
            Convention::Hayati => "hayati",
            Convention::Full => "full",
        }
    }
}
