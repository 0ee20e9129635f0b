//! Delimited text with a header, read: columns found by name, cells as numbers or names, each fault with its line.

use std::cell::{Cell, OnceCell};
use std::path::Path;

use csv::ByteRecord;

use crate::input::InputError;

/// A delimited file being read row by row.
///
/// Commas separate; semicolons and tabs do where the header splits by them, and numbers may then have a decimal comma,
/// as spreadsheets of many countries write them.
pub(crate) struct Table<'a> {
    head: Head<'a>,
    reader: csv::Reader<&'a [u8]>,
    record: ByteRecord,
}

/// How a table is laid out, where its header is not to say so.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Layout {
    /// What stands between the columns; absent: what splits the header best.
    pub(crate) separator: Option<u8>,
    /// There is no header: the columns are called 1, 2, and so on.
    pub(crate) headless: bool,
    /// Columns that nobody asks for may be called as they like, twice the same as well.
    pub(crate) foreign: bool,
}

/// What stays the same from row to row.
struct Head<'a> {
    file: &'a Path,
    bytes: &'a [u8],
    separator: u8,
    names: Vec<String>,
    header_offset: usize,
    point_offset: Cell<Option<usize>>,
    comma_offset: Cell<Option<usize>>,
    /// Where lines end, found when the first line is asked for.
    line_ends: OnceCell<Vec<usize>>,
}

/// One row of a table.
pub(crate) struct Row<'t> {
    head: &'t Head<'t>,
    record: &'t ByteRecord,
    /// Where the row begins, in bytes: [`Table::line_at`] makes a line of it.
    pub(crate) offset: usize,
}

impl<'a> Table<'a> {
    /// Opens a table that must have the given columns.
    ///
    /// # Errors
    /// No header, a column twice, or required columns missing, which are named.
    pub(crate) fn open(file: &'a Path, bytes: &'a [u8], required: &[&str]) -> Result<Self, InputError> {
        Self::open_as(file, bytes, Layout::default(), required)
    }

    /// Opens a table of another layout.
    ///
    /// # Errors
    /// As [`Table::open`].
    pub(crate) fn open_as(
        file: &'a Path,
        bytes: &'a [u8],
        layout: Layout,
        required: &[&str],
    ) -> Result<Self, InputError> {
        if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
            return Err(InputError::at_line(file, 1, "is UTF-16 text; expected UTF-8 (save it as \"CSV UTF-8\")"));
        }
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let separator = layout.separator.unwrap_or_else(|| separator_of(bytes, required));
        let mut builder = csv::ReaderBuilder::new();
        builder.has_headers(false).flexible(true).delimiter(separator);
        let reader = builder.from_reader(bytes);
        let head = Head {
            file,
            bytes,
            separator,
            names: Vec::new(),
            header_offset: 0,
            point_offset: Cell::new(None),
            comma_offset: Cell::new(None),
            line_ends: OnceCell::new(),
        };
        let mut table = Self { head, reader, record: ByteRecord::new() };
        let Some(header_offset) = table.advance()? else {
            let expected = match layout.headless {
                true => "rows".to_owned(),
                false => format!("a header with the columns {}", required.join(", ")),
            };
            return Err(InputError::at_line(file, 1, format!("is empty; expected {expected}")));
        };
        table.head.header_offset = header_offset;
        if layout.headless {
            table.head.names = (1..=table.record.len()).map(|number| number.to_string()).collect();
            // What was taken for a header is the first row.
            table.reader = builder.from_reader(bytes);
        } else {
            table.head.names = table.record.iter().map(|cell| quoted_text(cell.trim_ascii())).collect();
        }
        table.check_header(required, layout.foreign)?;
        Ok(table)
    }

    fn check_header(&self, required: &[&str], foreign: bool) -> Result<(), InputError> {
        let names = &self.head.names;
        let mut sorted: Vec<&str> = names.iter().map(String::as_str).filter(|name| !name.is_empty()).collect();
        sorted.sort_unstable();
        let matters = |name: &str| !foreign || required.contains(&name);
        if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1] && matters(pair[0])) {
            return Err(self.header_error(format!("the column {} stands twice; expected it once", pair[0])));
        }
        let missing: Vec<&str> = required.iter().copied().filter(|name| self.column(name).is_none()).collect();
        if missing.is_empty() {
            return Ok(());
        }
        Err(self.header_error(format!(
            "the column{} {} {} missing; found {}",
            if missing.len() == 1 { "" } else { "s" },
            missing.join(", "),
            if missing.len() == 1 { "is" } else { "are" },
            shortened(&sorted.join(", "), 200),
        )))
    }

    /// The index of a column.
    pub(crate) fn column(&self, name: &str) -> Option<usize> {
        self.head.names.iter().position(|known| known == name)
    }

    /// The columns' names.
    pub(crate) fn names(&self) -> &[String] {
        &self.head.names
    }

    /// How many columns there are.
    pub(crate) fn width(&self) -> usize {
        self.head.names.len()
    }

    /// The index of a column that [`Table::open`] was told to require.
    pub(crate) fn required(&self, name: &str) -> Result<usize, InputError> {
        self.column(name).ok_or_else(|| self.header_error(format!("the column {name} is missing")))
    }

    /// The indices of the columns `prefix1` to `prefixN`; empty where there is none.
    ///
    /// # Errors
    /// A number left out between 1 and N.
    pub(crate) fn numbered(&self, prefix: &str) -> Result<Vec<usize>, InputError> {
        let mut numbers: Vec<(usize, usize)> = self
            .head
            .names
            .iter()
            .enumerate()
            .filter_map(|(index, name)| numbered_suffix(name, prefix).map(|number| (number, index)))
            .collect();
        numbers.sort_unstable();
        for (expected, &(number, _)) in (1..).zip(&numbers) {
            if number != expected {
                return Err(self.header_error(format!(
                    "has the column {prefix}{number} but not {prefix}{expected}; expected {prefix}1 to \
                     {prefix}{number} without a gap"
                )));
            }
        }
        Ok(numbers.into_iter().map(|(_, index)| index).collect())
    }

    /// Says which columns are ignored and how the file differs from the contract's form.
    pub(crate) fn note_form(&self, known: impl Fn(&str) -> bool, notes: &mut Vec<String>) {
        let file = file_name(self.head.file);
        match self.head.separator {
            b';' => notes.push(format!("{file}: read with semicolons between the columns")),
            b'\t' => notes.push(format!("{file}: read with tabs between the columns")),
            _ => {}
        }
        let ignored: Vec<&str> =
            self.head.names.iter().map(String::as_str).filter(|name| !name.is_empty() && !known(name)).collect();
        if !ignored.is_empty() {
            notes.push(format!(
                "{file}: unknown column{} {} ignored",
                if ignored.len() == 1 { "" } else { "s" },
                shortened(&ignored.join(", "), 200)
            ));
        }
    }

    /// Says that numbers were read with a decimal comma, once all rows have been.
    pub(crate) fn note_decimal_comma(&self, notes: &mut Vec<String>) {
        if self.head.comma_offset.get().is_some() {
            notes.push(format!("{}: numbers read with a decimal comma", file_name(self.head.file)));
        }
    }

    /// The next row that holds anything.
    ///
    /// # Errors
    /// A row with more or fewer fields than the header.
    pub(crate) fn next_row(&mut self) -> Result<Option<Row<'_>>, InputError> {
        let Some(offset) = self.advance()? else { return Ok(None) };
        let (found, expected) = (self.record.len(), self.head.names.len());
        if found != expected {
            let hint = if self.head.separator == b',' && found > expected {
                " (a decimal comma needs semicolons between the columns)"
            } else {
                ""
            };
            return Err(self.error_at(
                offset,
                format!(
                    "has {found} field{}; expected {expected} as in the header{hint}",
                    if found == 1 { "" } else { "s" }
                ),
            ));
        }
        Ok(Some(Row { head: &self.head, record: &self.record, offset }))
    }

    /// Reads the next record that is not blank and gives the offset where it begins.
    fn advance(&mut self) -> Result<Option<usize>, InputError> {
        loop {
            let more = self
                .reader
                .read_byte_record(&mut self.record)
                .map_err(|error| InputError::of_file(self.head.file, format!("cannot be read as a table: {error}")))?;
            if !more {
                return Ok(None);
            }
            if self.record.iter().any(|cell| !cell.trim_ascii().is_empty()) {
                let start = self.record.position().map_or(0, |position| position.byte() as usize);
                return Ok(Some(start.min(self.head.bytes.len())));
            }
        }
    }

    /// The line, counted from 1, of a row's offset.
    pub(crate) fn line_at(&self, offset: usize) -> usize {
        self.head.line_at(offset)
    }

    /// An error at a row's offset.
    pub(crate) fn error_at(&self, offset: usize, message: impl Into<String>) -> InputError {
        InputError::at_line(self.head.file, self.line_at(offset), message)
    }

    /// An error of the header.
    pub(crate) fn header_error(&self, message: impl Into<String>) -> InputError {
        self.error_at(self.head.header_offset, message)
    }
}

impl Head<'_> {
    /// A record's reported offset lies before the line ends that precede it (blank lines, the second half of CRLF), so
    /// those are skipped first. A lone carriage return ends a line too.
    fn line_at(&self, offset: usize) -> usize {
        let skipped = self.bytes[offset..].iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
        let is_end = |index: &usize| {
            self.bytes[*index] == b'\n' || (self.bytes[*index] == b'\r' && self.bytes.get(index + 1) != Some(&b'\n'))
        };
        let ends = self.line_ends.get_or_init(|| (0..self.bytes.len()).filter(is_end).collect());
        1 + ends.partition_point(|&end| end < offset + skipped)
    }
}

impl Row<'_> {
    /// The row's line, counted from 1.
    pub(crate) fn line(&self) -> usize {
        self.head.line_at(self.offset)
    }

    fn cell(&self, column: usize) -> &[u8] {
        self.record.get(column).unwrap_or_default().trim_ascii()
    }

    /// A cell as text, without the spaces around it; bytes that are no UTF-8 are shown as �.
    pub(crate) fn text(&self, column: usize) -> std::borrow::Cow<'_, str> {
        String::from_utf8_lossy(self.cell(column))
    }

    /// Whether a cell is empty.
    pub(crate) fn is_empty(&self, column: usize) -> bool {
        self.cell(column).is_empty()
    }

    /// A finite number. `expected` says what it stands for, with its unit.
    pub(crate) fn number(&self, column: usize, expected: &str) -> Result<f64, InputError> {
        let cell = self.cell(column);
        let text = str::from_utf8(cell).unwrap_or_default();
        let parsed = match text.parse::<f64>() {
            Ok(value) => {
                if self.head.separator != b',' && cell.contains(&b'.') {
                    self.head.point_offset.set(self.head.point_offset.get().or(Some(self.offset)));
                    self.refuse_mixed_decimals(column)?;
                }
                Some(value)
            }
            Err(_) if self.head.separator != b',' && cell.contains(&b',') && !cell.contains(&b'.') => {
                self.head.comma_offset.set(self.head.comma_offset.get().or(Some(self.offset)));
                self.refuse_mixed_decimals(column)?;
                text.replacen(',', ".", 1).parse().ok()
            }
            Err(_) => None,
        };
        parsed.filter(|value| value.is_finite()).ok_or_else(|| self.unexpected(column, expected))
    }

    /// A file with both 1.234 and 1,234 has been through a program that read one of them as a thousand.
    fn refuse_mixed_decimals(&self, column: usize) -> Result<(), InputError> {
        let (Some(point), Some(comma)) = (self.head.point_offset.get(), self.head.comma_offset.get()) else {
            return Ok(());
        };
        let (other, at) = if point < comma { ("point", point) } else { ("comma", comma) };
        let at = if point == comma { self.offset } else { at };
        Err(self.error(format!(
            "column {}: decimal points and decimal commas are mixed (line {} has a decimal {other}); expected one of them \
             throughout",
            self.head.names[column],
            self.head.line_at(at),
        )))
    }

    /// A number that may be left empty.
    pub(crate) fn optional_number(&self, column: usize, expected: &str) -> Result<Option<f64>, InputError> {
        if self.is_empty(column) { Ok(None) } else { self.number(column, expected).map(Some) }
    }

    /// Numbers in several columns, of which either all or none may be empty.
    pub(crate) fn optional_numbers(&self, columns: &[usize], expected: &str) -> Result<Option<Vec<f64>>, InputError> {
        if columns.is_empty() || columns.iter().all(|&column| self.is_empty(column)) {
            return Ok(None);
        }
        columns.iter().map(|&column| self.number(column, expected)).collect::<Result<_, _>>().map(Some)
    }

    /// A whole number from 0. `3.0` is one as well: tables that had gaps are often saved so.
    pub(crate) fn whole(&self, column: usize) -> Result<u32, InputError> {
        let text = str::from_utf8(self.cell(column)).unwrap_or_default();
        if let Ok(value) = text.parse() {
            return Ok(value);
        }
        let expected = "a whole number from 0";
        let value = self.number(column, expected)?;
        if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
            Ok(value as u32)
        } else {
            Err(self.unexpected(column, expected))
        }
    }

    /// A name.
    pub(crate) fn name(&self, column: usize, expected: &str) -> Result<&str, InputError> {
        str::from_utf8(self.cell(column))
            .ok()
            .filter(|name| is_usable_name(name))
            .ok_or_else(|| self.unexpected(column, expected))
    }

    /// An error about one cell: what was found and what was expected.
    pub(crate) fn unexpected(&self, column: usize, expected: &str) -> InputError {
        let cell = self.cell(column);
        let found = if cell.is_empty() { "nothing".to_owned() } else { format!("\"{}\"", quoted_text(cell)) };
        self.error(format!("column {}: found {found}, expected {expected}", self.head.names[column]))
    }

    /// An error about the row.
    pub(crate) fn error(&self, message: impl Into<String>) -> InputError {
        InputError::at_line(self.head.file, self.head.line_at(self.offset), message)
    }
}

/// Whether a name survives being written and read: not empty, no space around it, on one line.
pub(crate) fn is_usable_name(name: &str) -> bool {
    !name.is_empty() && name.trim_ascii() == name && !name.chars().any(char::is_control)
}

/// The number N of a column called `prefixN`, written as a person would.
pub(crate) fn numbered_suffix(name: &str, prefix: &str) -> Option<usize> {
    let digits = name.strip_prefix(prefix)?;
    let plain = !digits.starts_with('0') && digits.bytes().all(|byte| byte.is_ascii_digit());
    if plain { digits.parse().ok() } else { None }
}

/// The separator by which the first line gives most of the required names; a comma where none does better.
fn separator_of(bytes: &[u8], required: &[&str]) -> u8 {
    let text = bytes.trim_ascii_start();
    let header = text.split(|&byte| byte == b'\n' || byte == b'\r').next().unwrap_or_default();
    let found = |separator: u8| {
        header
            .split(|&byte| byte == separator)
            .map(|cell| cell.trim_ascii())
            .map(|cell| cell.strip_prefix(b"\"").and_then(|cell| cell.strip_suffix(b"\"")).unwrap_or(cell))
            .filter(|cell| required.iter().any(|name| name.as_bytes() == *cell))
            .count()
    };
    let mut best = b',';
    for separator in [b';', b'\t'] {
        if found(separator) > found(best) {
            best = separator;
        }
    }
    best
}

/// What a cell holds, fit for a message of one line.
fn quoted_text(cell: &[u8]) -> String {
    let text: String = String::from_utf8_lossy(cell).chars().flat_map(char::escape_debug).collect();
    shortened(&text, 60)
}

fn shortened(text: &str, limit: usize) -> String {
    match text.char_indices().nth(limit) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// The last part of a file's path, by which notes call it.
fn file_name(file: &Path) -> String {
    file.file_name().unwrap_or(file.as_os_str()).to_string_lossy().into_owned()
}
