//! What the run's data can tell: singular values, correlated parameters, what cannot be told.

use serde_json::{Value, json};

use super::figure::{Figure, axis, layout, short, trace, with};
use super::table::{Form, Table, list, shown, strings};

/// More pairs than this are for programs.
const MOST_PAIRS: usize = 24;

/// The chapter, without its plot.
pub fn chapter(results: &Value) -> String {
    let own = &results["identification"];
    if !own.is_object() {
        return "<p>The run alone does not allow an identification; see the notes on its data.</p>".to_owned();
    }
    let number = |pointer: &str, form: Form| {
        let text = own.pointer(pointer).and_then(|value| shown(value, form)).unwrap_or_else(|| "–".to_owned());
        format!("<span data-from=\"/identification{pointer}\">{text}</span>")
    };
    let mut html = format!(
        "<p>{} combinations of parameters can be told from these data; the condition is {} (the effect of the best known \
         combination over that of the least known).</p>",
        number("/observability/rank", Form::Whole),
        number("/observability/condition", Form::Fixed(1.0, 0)),
    );
    let mut lines = strings(&own["observability"]["unidentifiable"]);
    lines.extend(strings(&own["observability"]["weak"]));
    html += &list(&lines);
    let pairs = own["correlations"].as_array().map_or(0, Vec::len);
    if pairs == 0 {
        return html + "<p>No two parameters are correlated by more than 0.9.</p>";
    }
    let mut table =
        Table::new(results, "Parameters that are correlated by more than 0.9", &["parameter", "with", "correlation"]);
    for row in 0..pairs.min(MOST_PAIRS) {
        let at = format!("/identification/correlations/{row}");
        table.row(own["correlations"][row]["parameters"][0].as_str().unwrap_or(""));
        table.cell(&format!("{at}/parameters/1"), Form::Text, "–");
        table.cell(&format!("{at}/correlation"), Form::Signed(1.0, 4), "–");
        table.end_row();
    }
    html += &table.finish();
    if pairs > MOST_PAIRS {
        html += &format!("<p class=\"note\">The {MOST_PAIRS} strongest of {pairs}; the others are in the JSON.</p>");
    }
    html
}

/// The singular values.
pub fn figure(results: &Value) -> Option<Figure> {
    let values = results["identification"]["observability"]["singular_values"].as_array()?;
    let numbers: Vec<usize> = (1..=values.len()).collect();
    let y = values.iter().map(|value| short(value.as_f64().unwrap_or(f64::NAN))).collect();
    let marks = json!({"marker": {"color": "@geometric", "size": 7}, "line": {"color": "@geometric", "width": 1}});
    Some(Figure {
        id: "singular-values".to_owned(),
        title: "Singular values of the identification".to_owned(),
        caption:
            "Each is how strongly the data see one combination of parameters, in units of the noise; a gap would part \
                  what is told from what is not."
                .to_owned(),
        alt: format!("{} singular values in falling order on a logarithmic axis", values.len()),
        height: 320,
        traces: vec![with(trace("singular values", "lines+markers", json!(numbers), y), marks)],
        layout: layout([
            ("xaxis", axis("number")),
            ("yaxis", with(axis("singular value"), json!({"type": "log", "exponentformat": "power", "dtick": 1}))),
            ("showlegend", json!(false)),
        ]),
    })
}
