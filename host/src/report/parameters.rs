//! The parameters and the thermal coefficients of a model, as results and as tables.

use serde_json::{Value, json};

use super::table::{Form, Table};
use crate::model::Model;

/// The model's parameters and places of targets, with their intervals.
pub fn parameters(model: &Model) -> Value {
    model
        .estimates
        .iter()
        .map(|estimate| {
            json!({
                "name": estimate.name, "unit": estimate.unit, "nominal": estimate.nominal, "value": estimate.value,
                "correction": estimate.value - estimate.nominal, "sigma": estimate.sigma,
                "half_width": estimate.half_width,
                "low": estimate.half_width.map(|half| estimate.value - half),
                "high": estimate.half_width.map(|half| estimate.value + half),
                "identifiable": estimate.sigma.is_some(),
            })
        })
        .collect()
}

/// The model's thermal coefficients, with their intervals.
pub fn coefficients(model: &Model) -> Value {
    // The model keeps the width of the intervals of its parameters only; the factor is the same for all of its values.
    let factor = model
        .estimates
        .iter()
        .find_map(|estimate| Some(estimate.half_width? / estimate.sigma.filter(|sigma| *sigma > 0.0)?))
        .unwrap_or(1.96);
    model
        .growth
        .iter()
        .map(|growth| {
            let reference = model.temperatures.iter().find(|reference| reference.sensor == growth.sensor);
            json!({
                "parameter": growth.parameter.to_string(), "sensor": growth.sensor,
                "unit": format!("{}/K", growth.parameter.symbol.unit()),
                "value": growth.coefficient, "sigma": growth.sigma, "half_width": factor * growth.sigma,
                "low": growth.coefficient - factor * growth.sigma, "high": growth.coefficient + factor * growth.sigma,
                "reference_c": reference.map(|reference| reference.celsius),
                "lowest_c": reference.map(|reference| reference.lowest),
                "highest_c": reference.map(|reference| reference.highest),
            })
        })
        .collect()
}

/// The chapter on parameters.
pub fn parameter_chapter(results: &Value) -> String {
    let mut table = Table::new(
        results,
        "Parameters, lengths in millimetres and angles in degrees",
        &["parameter", "nominal", "value", "correction", "± 95 %", "unit", "identifiable"],
    );
    for (row, parameter) in results["parameters"].as_array().into_iter().flatten().enumerate() {
        let angle = parameter["unit"] == "rad";
        let factor = if angle { 1f64.to_degrees() } else { 1e3 };
        table.row(parameter["name"].as_str().unwrap_or(""));
        let at = |field: &str| format!("/parameters/{row}/{field}");
        table.cell(&at("nominal"), Form::Fixed(factor, 4), "–");
        table.cell(&at("value"), Form::Fixed(factor, 4), "–");
        table.cell(&at("correction"), Form::Signed(factor, 4), "–");
        table.cell(&at("half_width"), Form::Fixed(factor, 4), "held");
        table.words(if angle { "°" } else { "mm" });
        table.words(if parameter["identifiable"] == true { "yes" } else { "no: held" });
        table.end_row();
    }
    format!(
        "{}<p class=\"note\">What is held keeps the value that it had when the rest was found: these data cannot tell it from \
         other parameters, or tell it too weakly. Use all values of one model together.</p>",
        table.finish()
    )
}

/// The chapter on thermal coefficients.
pub fn coefficient_chapter(results: &Value) -> String {
    let coefficients = results["thermal_coefficients"].as_array().map_or(&[][..], Vec::as_slice);
    if coefficients.is_empty() {
        return "<p>The model has no thermal coefficients.</p>".to_owned();
    }
    let mut table = Table::new(
        results,
        "Thermal coefficients, micrometres or microradians for each kelvin above the reference",
        &["parameter", "sensor", "value", "± 95 %", "unit", "reference °C", "calibrated from °C", "to °C"],
    );
    for (row, coefficient) in coefficients.iter().enumerate() {
        table.row(coefficient["parameter"].as_str().unwrap_or(""));
        let at = |field: &str| format!("/thermal_coefficients/{row}/{field}");
        table.cell(&at("sensor"), Form::Text, "–");
        table.cell(&at("value"), Form::Signed(1e6, 3), "–");
        table.cell(&at("half_width"), Form::Fixed(1e6, 3), "–");
        table.words(if coefficient["unit"] == "rad/K" { "µrad/K" } else { "µm/K" });
        for field in ["reference_c", "lowest_c", "highest_c"] {
            table.cell(&at(field), Form::Fixed(1.0, 2), "–");
        }
        table.end_row();
    }
    table.finish()
}
