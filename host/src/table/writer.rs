//! Delimited text with a header, written: commas, line feeds, numbers in full precision.

use std::path::PathBuf;

use csv::ByteRecord;

use super::WriteError;
use super::reader::is_usable_name;

/// A table being written.
pub(crate) struct TableWriter {
    file: PathBuf,
    writer: csv::Writer<Vec<u8>>,
    row: ByteRecord,
    columns: usize,
    line: usize,
}

impl TableWriter {
    /// Begins a table with its header. `file` only names it in errors.
    pub(crate) fn new(file: PathBuf, header: &[String]) -> Result<Self, WriteError> {
        let writer = csv::WriterBuilder::new().flexible(true).from_writer(Vec::new());
        let row = ByteRecord::from(header.iter().map(String::as_bytes).collect::<Vec<_>>());
        let mut table = Self { file, writer, row, columns: header.len(), line: 0 };
        table.end_row()?;
        Ok(table)
    }

    /// Adds a number to the row.
    pub(crate) fn number(&mut self, value: f64) -> Result<(), WriteError> {
        if !value.is_finite() {
            return Err(self.error(format!("a number is {value}; expected a finite one")));
        }
        self.row.push_field(value.to_string().as_bytes());
        Ok(())
    }

    /// Adds numbers to the row.
    pub(crate) fn numbers(&mut self, values: &[f64]) -> Result<(), WriteError> {
        values.iter().try_for_each(|&value| self.number(value))
    }

    /// Adds numbers to the row, or as many empty fields where there are none.
    pub(crate) fn optional_numbers(&mut self, values: Option<&[f64]>, columns: usize) -> Result<(), WriteError> {
        match values {
            Some(values) => self.numbers(values),
            None => {
                self.empty(columns);
                Ok(())
            }
        }
    }

    /// Adds a whole number to the row.
    pub(crate) fn whole(&mut self, value: i64) {
        self.row.push_field(value.to_string().as_bytes());
    }

    /// Adds empty fields to the row.
    pub(crate) fn empty(&mut self, columns: usize) {
        (0..columns).for_each(|_| self.row.push_field(b""));
    }

    /// Adds a name to the row.
    pub(crate) fn name(&mut self, name: &str) -> Result<(), WriteError> {
        if !is_usable_name(name) {
            return Err(self.error(format!(
                "the name \"{}\" cannot be written; expected one line without spaces around it",
                name.escape_debug()
            )));
        }
        self.row.push_field(name.as_bytes());
        Ok(())
    }

    /// Ends the row that the fields were added to.
    pub(crate) fn end_row(&mut self) -> Result<(), WriteError> {
        self.line += 1;
        if self.row.len() != self.columns {
            return Err(self.error(format!("a row has {} fields; expected {}", self.row.len(), self.columns)));
        }
        self.writer.write_byte_record(&self.row).map_err(|error| self.error(error.to_string()))?;
        self.row.clear();
        Ok(())
    }

    /// The table's bytes.
    pub(crate) fn finish(self) -> Result<Vec<u8>, WriteError> {
        let file = self.file;
        self.writer
            .into_inner()
            .map_err(|error| WriteError::Content { file, message: format!("cannot be written: {}", error.error()) })
    }

    fn error(&self, message: String) -> WriteError {
        WriteError::Content { file: self.file.clone(), message: format!("line {}: {message}", self.line + 1) }
    }
}
