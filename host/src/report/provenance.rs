//! How to make the page again: the command, the versions, and what went in, by its SHA-256.

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::table::{Form, Table, escaped};

/// What a page was made of and by.
#[derive(Debug, Clone, Serialize)]
pub struct Provenance {
    /// The command as it was given.
    pub command: String,
    /// thermokin's version.
    pub version: &'static str,
    /// The charting library and its version.
    pub charts: &'static str,
    /// What was read.
    pub inputs: Vec<InputFile>,
}

/// A file that was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct InputFile {
    /// Where it was.
    pub file: PathBuf,
    /// Its SHA-256 in hexadecimal digits.
    pub sha256: String,
}

/// A file that cannot be read a second time.
#[derive(Debug, thiserror::Error)]
#[error("{file}: cannot be read: {source}")]
pub struct ProvenanceError {
    file: String,
    source: std::io::Error,
}

/// The SHA-256 of a file.
///
/// # Errors
/// When it cannot be read.
pub fn sha256_of(file: &Path) -> Result<InputFile, ProvenanceError> {
    let bytes = std::fs::read(file).map_err(|source| ProvenanceError { file: file.display().to_string(), source })?;
    let sha256 = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(InputFile { file: file.to_owned(), sha256 })
}

/// The files of a run that are there, and its robot description.
///
/// # Errors
/// When one cannot be read.
pub fn sha256_of_run(folder: &Path, robot: &Path) -> Result<Vec<InputFile>, ProvenanceError> {
    let names = ["run.toml", "poses.csv", "points.csv", "temperatures.csv", "motion.csv", "distances.csv"];
    let own = names.iter().map(|name| folder.join(name)).filter(|file| file.is_file());
    own.chain(std::iter::once(robot.to_owned())).map(|file| sha256_of(&file)).collect()
}

/// The chapter.
pub fn chapter(results: &Value) -> String {
    let own = &results["provenance"];
    let text = |field: &str| escaped(own[field].as_str().unwrap_or(""));
    let mut table = Table::new(results, "SHA-256 of what was read", &["file", "SHA-256"]);
    for (row, input) in own["inputs"].as_array().into_iter().flatten().enumerate() {
        table.row(input["file"].as_str().unwrap_or(""));
        table.cell(&format!("/provenance/inputs/{row}/sha256"), Form::Text, "–");
        table.end_row();
    }
    format!(
        "<p>The same command on the same files gives this page byte for byte:</p><pre tabindex=\"0\"><code>{}</code></pre>\
         <p>thermokin {}; plots by {}. The numbers of this page are also in it as JSON, in the element \
         <code>results</code>.</p><div class=\"hashes\">{}</div>",
        text("command"),
        text("version"),
        text("charts"),
        table.finish()
    )
}
