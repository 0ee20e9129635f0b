//! What a plot is: traces and a layout for the library that draws, with a title, a sentence that says what it shows, and
//! words for those who do not see it. Colours are names (`@geometric`); the page knows them in light, dark and print.

use serde_json::{Map, Value, json};

/// A plot.
#[derive(Debug, Clone)]
pub struct Figure {
    /// Its name within the page.
    pub id: String,
    /// What stands above it.
    pub title: String,
    /// What it shows and how to read it.
    pub caption: String,
    /// The same for those who do not see it, with what comes out.
    pub alt: String,
    /// Its height on the screen, CSS pixels.
    pub height: u32,
    /// The traces.
    pub traces: Vec<Value>,
    /// The axes.
    pub layout: Value,
}

/// A number with five digits, which is more than a plot can show; null where there is none.
pub fn short(value: f64) -> Value {
    let five: f64 = format!("{value:.4e}").parse().unwrap_or(f64::NAN);
    if five.is_finite() { json!(five) } else { Value::Null }
}

/// Many numbers.
pub fn shorts(values: impl IntoIterator<Item = f64>) -> Value {
    values.into_iter().map(short).collect()
}

/// How a level is drawn: by colour and by shape, since not everyone sees colours and not every printer has them.
pub fn level_style(level: usize) -> (&'static str, &'static str, &'static str) {
    [
        ("@nominal", "circle-open", "dot"),
        ("@geometric", "square", "dash"),
        ("@thermal", "diamond", "solid"),
        ("@extended", "triangle-up", "solid"),
    ][level.min(3)]
}

/// The colour of a link's or a sensor's line: nine of them, then again.
pub fn series_color(place: usize) -> String {
    format!("@series{}", place % 9)
}

/// A trace of two dimensions.
pub fn trace(name: &str, mode: &str, x: Value, y: Value) -> Value {
    json!({ "type": "scatter", "name": name, "mode": mode, "x": x, "y": y })
}

/// An object with the fields of another put over it.
pub fn with(mut base: Value, more: Value) -> Value {
    if let (Value::Object(base), Value::Object(more)) = (&mut base, more) {
        base.extend(more);
    }
    base
}

/// An axis with a title.
pub fn axis(title: &str) -> Value {
    json!({ "title": { "text": title } })
}

/// A layout of named axes.
pub fn layout<const N: usize>(axes: [(&str, Value); N]) -> Value {
    Value::Object(axes.into_iter().map(|(name, axis)| (name.to_owned(), axis)).collect::<Map<_, _>>())
}

impl Figure {
    /// The figure as the page's script takes it.
    pub fn to_json(&self) -> Value {
        json!({ "id": self.id, "height": self.height, "data": self.traces, "layout": self.layout })
    }

    /// How many points it draws: null separators are none.
    pub fn points(&self) -> usize {
        self.traces
            .iter()
            .filter_map(|trace| trace["y"].as_array())
            .map(|values| values.iter().filter(|value| !value.is_null()).count())
            .sum()
    }
}
