//! An arm from a table of Denavit-Hartenberg parameters, as makers and papers print them: a row a joint, in metres or
//! millimetres, radians or degrees.

use std::path::Path;

use super::convention::Convention;
use super::description::{Joint, JointKind, Transform};
use super::frame::Frame;
use super::parametrise::{Axes, frame_of};
use crate::input::InputError;
use crate::table::{Row, Table};

/// In which order the four motions of a row follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DhOrder {
    /// `Tz(d) Rz(theta) Tx(a) Rx(alpha)`: the joint first.
    Standard,
    /// `Rx(alpha) Tx(a) Rz(theta) Tz(d)` (Craig): the link before it first.
    Modified,
}

/// A column in one of two units, and what makes SI of it.
fn column(table: &Table<'_>, names: [(&str, f64); 2]) -> Result<(usize, f64), InputError> {
    let found = names.iter().find_map(|(name, factor)| Some((table.column(name)?, *factor)));
    found.ok_or_else(|| table.header_error(format!("expected the column {} or {}", names[0].0, names[1].0)))
}

/// The axes and the end of the arm of a table with the columns d_m (or d_mm), theta_rad (or theta_deg), a_m, alpha_rad, and
/// where they are wanted joint (revolute or prismatic), min and max (in theta's unit, or d's). The world is the arm's base.
///
/// # Errors
/// Columns that are missing, cells that are none of these; `file` is named.
pub fn from_dh_rows(file: &Path, bytes: &[u8], order: DhOrder) -> Result<Axes, InputError> {
    let mut table = Table::open(file, bytes, &[])?;
    let lengths = |table: &Table<'_>, symbol: &str| {
        column(table, [(&format!("{symbol}_m"), 1.0), (&format!("{symbol}_mm"), 1e-3)])
    };
    let angles = |table: &Table<'_>, symbol: &str| {
        column(table, [(&format!("{symbol}_rad"), 1.0), (&format!("{symbol}_deg"), 1_f64.to_radians())])
    };
    let (d, theta) = (lengths(&table, "d")?, angles(&table, "theta")?);
    let (a, alpha) = (lengths(&table, "a")?, angles(&table, "alpha")?);
    let (kind, min, max) = (table.column("joint"), table.column("min"), table.column("max"));
    let mut at = Frame::identity();
    let mut axes = Vec::new();
    while let Some(row) = table.next_row()? {
        let of = |(column, factor): (usize, f64), unit: &str| Ok(factor * row.number(column, unit)?);
        let (d_m, theta_rad) = (of(d, "a length")?, of(theta, "an angle")?);
        let (a_m, alpha_rad) = (of(a, "a length")?, of(alpha, "an angle")?);
        let kind = match kind.map(|column| row.name(column, "revolute or prismatic")).transpose()? {
            None | Some("revolute") => JointKind::Revolute,
            Some("prismatic") => JointKind::Prismatic,
            Some(_) => return Err(row.unexpected(kind.unwrap_or_default(), "revolute or prismatic")),
        };
        let factor = if kind == JointKind::Revolute { theta.1 } else { d.1 };
        let limit = |column: Option<usize>| limit(&row, column, factor);
        let joint = Joint { kind, min: limit(min)?, max: limit(max)?, gear_ratio: None };
        let motion = |values: [f64; 4]| {
            frame_of(&Transform { convention: Convention::Dh, joint: None, values: values.to_vec() })
        };
        match order {
            DhOrder::Standard => {
                axes.push((at, joint));
                at = at.then(&motion([d_m, theta_rad, a_m, alpha_rad]));
            }
            DhOrder::Modified => {
                at = at.then(&motion([0.0, 0.0, a_m, alpha_rad]));
                axes.push((at, joint));
                at = at.then(&motion([d_m, theta_rad, 0.0, 0.0]));
            }
        }
    }
    if axes.is_empty() {
        return Err(InputError::of_file(file, "holds no row; expected one a joint"));
    }
    Ok(Axes { joints: axes, flange: at })
}

fn limit(row: &Row<'_>, column: Option<usize>, factor: f64) -> Result<Option<f64>, InputError> {
    let Some(column) = column else { return Ok(None) };
    Ok(row.optional_number(column, "a limit of the joint")?.map(|value| factor * value))
}
