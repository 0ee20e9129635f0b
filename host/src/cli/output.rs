//! Where results go: words on standard output, JSON where it is asked for.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::Failure;

/// The option that every computing command has.
#[derive(Debug, Args)]
pub struct JsonOption {
    /// Write the results as one JSON object to FILE; - is standard output, which then carries nothing else
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

impl JsonOption {
    /// Whether words belong on standard output.
    pub fn leaves_words(&self) -> bool {
        self.json.as_deref() != Some(Path::new("-"))
    }

    /// Writes `result`, where JSON was asked for.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, result: &impl Serialize) -> Result<(), Failure> {
        let Some(file) = &self.json else { return Ok(()) };
        let mut text = serde_json::to_string_pretty(result)
            .map_err(|error| Failure::Work(format!("the results as JSON: {error}")))?;
        text.push('\n');
        if !self.leaves_words() {
            return std::io::stdout()
                .write_all(text.as_bytes())
                .map_err(|error| Failure::Work(format!("standard output: {error}")));
        }
        std::fs::write(file, text)
            .map_err(|error| Failure::Work(format!("{}: cannot be written: {error}", file.display())))
    }
}

/// Writes a file whole, or not at all.
///
/// # Errors
/// When the folder or the disk does not take it.
pub fn write_whole(file: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(".part");
    let part = file.with_file_name(name);
    std::fs::write(&part, bytes).and_then(|()| std::fs::rename(&part, file)).map_err(|error| {
        // The part is of no use to anyone; that it cannot be removed is no further news.
        let _ = std::fs::remove_file(&part);
        Failure::Work(format!("{}: cannot be written: {error}", file.display()))
    })
}
