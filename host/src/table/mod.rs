//! Delimited text with a header, both ways. It owns separators, decimal commas and the numbering of lines, for every room
//! that reads or writes tables.

pub(crate) mod parquet;
mod reader;
mod writer;

use std::io;
use std::path::PathBuf;

pub(crate) use parquet::Column;
pub(crate) use reader::{Layout, Row, Table, is_usable_name, numbered_suffix};
pub(crate) use writer::TableWriter;

/// Why a table, or a folder of them, was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// It holds what could not be read back.
    #[error("{}: {message}", file.display())]
    Content {
        /// The file that would have held it.
        file: PathBuf,
        /// What is wrong and what was expected.
        message: String,
    },
    /// The disk did not take it.
    #[error("{}: cannot be written: {source}", file.display())]
    Disk {
        /// The file or folder in question.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}
