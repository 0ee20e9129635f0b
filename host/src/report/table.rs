//! Tables and numbers of the page, written from the results: a cell is given the JSON pointer of its number, shows it and
//! names it in `data-from`.

use std::fmt::Write;

use serde_json::Value;

/// Text as HTML.
pub fn escaped(text: &str) -> String {
    let mut html = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => html.push_str("&amp;"),
            '<' => html.push_str("&lt;"),
            '>' => html.push_str("&gt;"),
            '"' => html.push_str("&quot;"),
            c => html.push(c),
        }
    }
    html
}

/// How a number is shown.
#[derive(Debug, Clone, Copy)]
pub enum Form {
    /// Times a factor, with so many decimals.
    Fixed(f64, usize),
    /// The same with a sign.
    Signed(f64, usize),
    /// With so many decimals and a power of ten.
    Power(usize),
    /// A whole number.
    Whole,
    /// Text as it is.
    Text,
}

/// A number in words, without a table.
pub fn shown(value: &Value, form: Form) -> Option<String> {
    match (form, value) {
        (_, Value::Null) => None,
        (Form::Text, Value::String(text)) => Some(escaped(text)),
        (Form::Text, other) => Some(escaped(&other.to_string())),
        (Form::Whole, value) => value.as_f64().map(|number| format!("{number:.0}")),
        (Form::Fixed(factor, decimals), value) => {
            value.as_f64().map(|number| format!("{:.decimals$}", factor * number))
        }
        (Form::Signed(factor, decimals), value) => {
            value.as_f64().map(|number| format!("{:+.decimals$}", factor * number))
        }
        (Form::Power(decimals), value) => value.as_f64().map(|number| format!("{number:.decimals$e}")),
    }
}

/// A table that is being written.
pub struct Table<'a> {
    results: &'a Value,
    html: String,
}

impl<'a> Table<'a> {
    /// A table with a caption and the heads of its columns.
    pub fn new(results: &'a Value, caption: &str, heads: &[&str]) -> Self {
        let mut html = format!(
            "<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"{0}\"><table><caption>{0}</caption><thead><tr>",
            escaped(caption)
        );
        for head in heads {
            // Writing to a string does not fail.
            let _ = write!(html, "<th scope=\"col\">{}</th>", escaped(head));
        }
        html.push_str("</tr></thead><tbody>");
        Self { results, html }
    }

    /// Begins a row with its head.
    pub fn row(&mut self, head: &str) {
        let _ = write!(self.html, "<tr><th scope=\"row\">{}</th>", escaped(head));
    }

    /// A cell that shows what a pointer leads to; `absent` where there is nothing.
    pub fn cell(&mut self, pointer: &str, form: Form, absent: &str) {
        let value = self.results.pointer(pointer).unwrap_or(&Value::Null);
        let Some(text) = shown(value, form) else {
            let _ = write!(self.html, "<td class=\"absent\">{}</td>", escaped(absent));
            return;
        };
        let _ = match form {
            Form::Text => write!(self.html, "<td data-from=\"{pointer}\">{text}</td>"),
            Form::Fixed(factor, _) | Form::Signed(factor, _) => {
                write!(self.html, "<td class=\"n\" data-from=\"{pointer}\" data-factor=\"{factor}\">{text}</td>")
            }
            Form::Power(_) | Form::Whole => write!(self.html, "<td class=\"n\" data-from=\"{pointer}\">{text}</td>"),
        };
    }

    /// A cell of words that no number stands behind.
    pub fn words(&mut self, text: &str) {
        let _ = write!(self.html, "<td>{}</td>", escaped(text));
    }

    /// Ends a row.
    pub fn end_row(&mut self) {
        self.html.push_str("</tr>");
    }

    /// The table's HTML.
    pub fn finish(mut self) -> String {
        self.html.push_str("</tbody></table></div>");
        self.html
    }
}

/// A list of sentences; nothing where there are none.
pub fn list(lines: &[String]) -> String {
    if lines.is_empty() {
        return String::new();
    }
    let items: String = lines.iter().map(|line| format!("<li>{}</li>", escaped(line))).collect();
    format!("<ul>{items}</ul>")
}

/// The strings of a JSON list.
pub fn strings(value: &Value) -> Vec<String> {
    value.as_array().into_iter().flatten().filter_map(|line| line.as_str().map(str::to_owned)).collect()
}
