//! What is wrong with a file that a user gave us: one line that names the file, the line and what was expected.

use std::path::{Path, PathBuf};

/// A file that cannot be used as it is.
///
/// Displayed as `FILE:LINE: what is wrong and what was expected`; the command line ends with exit code 2 on it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}{}: {message}", file.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
pub struct InputError {
    /// The file as the user named it.
    pub file: PathBuf,
    /// The line, counted from 1, where one can be named.
    pub line: Option<usize>,
    /// What is wrong and what was expected, in one line.
    pub message: String,
}

impl InputError {
    /// An error of the file as a whole.
    pub fn of_file(file: &Path, message: impl Into<String>) -> Self {
        Self { file: file.to_owned(), line: None, message: message.into() }
    }

    /// An error at a line, counted from 1.
    pub fn at_line(file: &Path, line: usize, message: impl Into<String>) -> Self {
        Self { file: file.to_owned(), line: Some(line), message: message.into() }
    }

    /// What the parser of a TOML file says, in one line.
    pub fn of_toml(file: &Path, text: &str, error: &toml::de::Error) -> Self {
        let line = error.span().map(|span| line_of_offset(text, span.start));
        let message = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
        Self { file: file.to_owned(), line, message }
    }
}

/// The line, counted from 1, of a byte offset in a text.
pub fn line_of_offset(text: &str, offset: usize) -> usize {
    1 + text.as_bytes()[..offset.min(text.len())].iter().filter(|&&byte| byte == b'\n').count()
}
