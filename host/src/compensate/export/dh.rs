//! A table of Denavit-Hartenberg parameters with the corrected values, for controllers that take one, and back.

use std::fmt::Write as _;

use crate::robot::{Between, Convention, Joint, JointKind, NearlyParallel, Robot, Symbol, Transform, parametrise};

/// Why there is no table, or a text is none.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DhError {
    /// The arm has no Denavit-Hartenberg parameters that are worth anything.
    #[error(transparent)]
    NearlyParallel(#[from] NearlyParallel),
    /// A row that cannot be read.
    #[error("line {0}: expected the row of a transform as thermokin export writes it")]
    Row(usize),
}

const HEADER: &str = "transform,convention,joint,d_m,theta_rad,a_m,alpha_rad,b_m,beta_rad";

/// The table of a robot with these values of its parameters: `Tz(d) Rz(theta) Tx(a) Rx(alpha) Ty(b) Ry(beta)`, a row a
/// transform; b and beta are other than zero at both ends, and between nearly parallel axes where those may be there.
///
/// # Errors
/// Nearly parallel axes where only Denavit-Hartenberg is allowed.
pub fn dh_table(robot: &Robot, values: &[f64], between: Between) -> Result<String, DhError> {
    let mut text = format!("{HEADER}\n");
    for (number, transform) in parametrise(&robot.axes(values), between)?.iter().enumerate() {
        let joint = match transform.joint.as_ref().map(|joint| joint.kind) {
            None => "",
            Some(JointKind::Revolute) => "revolute",
            Some(JointKind::Prismatic) => "prismatic",
        };
        let values = Symbol::ALL.map(|symbol| format!("{:?}", transform.value(symbol))).join(",");
        // Writing to a text does not fail.
        let _ = writeln!(text, "{number},{},{joint},{values}", transform.convention.name());
    }
    Ok(text)
}

/// The transforms of a table that [`dh_table`] wrote.
///
/// # Errors
/// The line of a row that is none.
pub fn from_dh_table(text: &str) -> Result<Vec<Transform>, DhError> {
    let row = |line: usize, text: &str| -> Option<Transform> {
        let cells: Vec<&str> = text.split(',').collect();
        let convention = [Convention::Dh, Convention::Hayati, Convention::Full];
        let convention = convention.into_iter().find(|one| Some(one.name()) == cells.get(1).copied())?;
        let of = |kind| Some(Joint { kind, min: None, max: None, gear_ratio: None });
        let joint = match *cells.get(2)? {
            "" => None,
            "revolute" => of(JointKind::Revolute),
            "prismatic" => of(JointKind::Prismatic),
            _ => return None,
        };
        let six: Vec<f64> = cells.get(3..)?.iter().map(|cell| cell.parse().ok()).collect::<Option<_>>()?;
        let values = convention.symbols().iter().map(|&symbol| six.get(symbol as usize).copied());
        let transform = Transform { convention, joint, values: values.collect::<Option<_>>()? };
        (cells.first()?.parse() == Ok(line - 2) && six.len() == 6).then_some(transform)
    };
    (1..).zip(text.lines()).skip(1).map(|(line, text)| row(line, text).ok_or(DhError::Row(line))).collect()
}
