//! What the page says of the run and the model before anything is judged.

use serde_json::Value;

use super::table::{Form, shown};

/// One line: what was measured.
pub fn line(results: &Value) -> String {
    let text = |pointer: &str, form: Form| {
        results.pointer(pointer).and_then(|value| shown(value, form)).unwrap_or_else(|| "–".to_owned())
    };
    format!(
        "{} · run {} · {} visits, {} points within {} hours · model {}",
        text("/robot", Form::Text),
        text("/run/name", Form::Text),
        text("/on_run/visits", Form::Whole),
        text("/on_run/points", Form::Whole),
        text("/run/hours", Form::Fixed(1.0, 1)),
        text("/model", Form::Text),
    )
}
