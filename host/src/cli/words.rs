//! Numbers as people read them: millimetres, degrees, micrometres a kelvin.

use crate::model::{Errors, Growth, ParameterEstimate};

/// One row of the table of errors.
pub fn errors(name: &str, errors: &Errors) -> String {
    format!("  {name:<12} {:9.3} {:8.3} {:8.3}", errors.mean_mm, errors.rms_mm, errors.max_mm)
}

/// One row of the table of parameters: lengths in millimetres, angles in degrees.
pub fn estimate(estimate: &ParameterEstimate) -> String {
    let (factor, unit) = if estimate.unit == "rad" { (1f64.to_degrees(), "°") } else { (1e3, "mm") };
    let interval = match estimate.half_width {
        Some(half) => format!("{:.4}", factor * half),
        None => "held".to_owned(),
    };
    format!(
        "  {:<8} {:13.4} {:13.4} {:+13.4} {interval:>9} {unit}",
        estimate.name,
        factor * estimate.nominal,
        factor * estimate.value,
        factor * (estimate.value - estimate.nominal),
    )
}

/// One row of the table of thermal coefficients, with the thesis's value beside it.
pub fn growth(growth: &Growth, factor: f64, beside: Option<f64>) -> String {
    let unit = if growth.parameter.symbol.is_angle() { "µrad/K" } else { "µm/K" };
    let beside = beside.map_or_else(|| "-".to_owned(), |value| format!("{:+.3}", value * 1e6));
    format!(
        "  {:<6} {:<8} {:+28.3} ± {:.3} {beside:>12} {unit}",
        growth.parameter.to_string(),
        growth.sensor,
        growth.coefficient * 1e6,
        factor * growth.sigma * 1e6,
    )
}
