//! Tables of other programs: comments, columns split by blanks, no header, columns by name or number, times, names and
//! visits out of any of them.

use std::borrow::Cow;
use std::fs;
use std::path::{Path, PathBuf};

use regex::Regex;

use super::mapping::{Column, Files, LayoutToml, Mapping, Names, OneOrMany, Separator};
use super::time::{Moment, TimeToml};
use crate::input::InputError;
use crate::table::{Layout, Row, Table};

/// A file as it lay on the disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Its path.
    pub path: PathBuf,
    /// What it holds.
    pub bytes: Vec<u8>,
}

/// What stands in the place of a column's name for the name of the file itself.
const FILE_NAME: &str = "@file";

/// Marks of lines that are no data, where the mapping says nothing: those of SpatialAnalyzer, and of most others.
const COMMENTS: [&str; 2] = ["//", "#"];

impl Files {
    /// The files from the disk, in the order of the mapping; those of one `*` in the order of their names.
    pub(super) fn load(&self, mapping: &Mapping) -> Result<Vec<Source>, InputError> {
        let mut paths = Vec::new();
        for pattern in &self.patterns {
            let found = matching(pattern)?;
            if found.is_empty() {
                let message = format!("no file is like {}; expected one at least", pattern.display());
                return Err(InputError::at_line(&mapping.file, self.line, message));
            }
            paths.extend(found);
        }
        let read = |path: PathBuf| match fs::read(&path) {
            Ok(bytes) => Ok(Source { path, bytes }),
            Err(error) => Err(InputError::of_file(&path, format!("cannot be read: {error}"))),
        };
        paths.into_iter().map(read).collect()
    }
}

fn matching(pattern: &Path) -> Result<Vec<PathBuf>, InputError> {
    let name = pattern.file_name().map(|name| name.to_string_lossy()).unwrap_or_default();
    if !name.contains('*') {
        return Ok(vec![pattern.to_owned()]);
    }
    let folder = pattern.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let failed = |error: &dyn std::fmt::Display| InputError::of_file(folder, format!("cannot be read: {error}"));
    let like: Vec<String> = name.split('*').map(regex::escape).collect();
    let like = Regex::new(&format!("^{}$", like.join(".*"))).map_err(|error| failed(&error))?;
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(|error| failed(&error))? {
        let path = entry.map_err(|error| failed(&error))?.path();
        if path.is_file() && path.file_name().is_some_and(|name| like.is_match(&name.to_string_lossy())) {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// A file's text made fit for the table reader, without moving a byte: lines that are no data are blanked, and where blanks
/// split columns, the first of each becomes a tab.
pub(super) struct Prepared<'a> {
    source: &'a Source,
    bytes: Cow<'a, [u8]>,
    layout: Layout,
}

impl<'a> Prepared<'a> {
    pub(super) fn new(source: &'a Source, layout: &LayoutToml) -> Self {
        let mut bytes = Cow::Borrowed(source.bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&source.bytes));
        let marks: Vec<&[u8]> = match &layout.comments {
            Some(marks) => marks.iter().map(|mark| mark.trim().as_bytes()).collect(),
            None => COMMENTS.iter().map(|mark| mark.as_bytes()).collect(),
        };
        let mut at = 0;
        let mut number = 0;
        while at < bytes.len() {
            let end = bytes[at..].iter().position(|&byte| byte == b'\n').map_or(bytes.len(), |found| at + found);
            let line = bytes[at..end].trim_ascii_start();
            if number < layout.skip_lines || marks.iter().any(|mark| line.starts_with(mark)) {
                blank(&mut bytes.to_mut()[at..end]);
            }
            at = end + 1;
            number += 1;
        }
        let headless = layout.header == Some(false);
        let by_blanks = match layout.separator {
            Some(separator) => separator == Separator::Space,
            None => headless && !first_line(&bytes).iter().any(|byte| b",;\t".contains(byte)),
        };
        if by_blanks {
            split_by_blanks(bytes.to_mut());
        }
        let separator = match layout.separator {
            _ if by_blanks => Some(b'\t'),
            Some(Separator::Comma) => Some(b','),
            Some(Separator::Semicolon) => Some(b';'),
            Some(Separator::Tab | Separator::Space) => Some(b'\t'),
            // A number may hold a decimal comma where something else splits the columns.
            None if headless => [b';', b'\t'].into_iter().find(|separator| first_line(&bytes).contains(separator)),
            None => None,
        };
        Self { source, bytes, layout: Layout { separator, headless, foreign: true } }
    }

    /// The table, whose header must have the columns that are named.
    pub(super) fn table(&self, columns: &[&Column]) -> Result<Table<'_>, InputError> {
        let named: Vec<&str> = columns
            .iter()
            .filter_map(|column| match column {
                Column::Name(name) if name != FILE_NAME => Some(name.as_str()),
                _ => None,
            })
            .collect();
        Table::open_as(&self.source.path, &self.bytes, self.layout, &named)
    }
}

/// Blanks a line but for the carriage return that may end it.
fn blank(line: &mut [u8]) {
    let end = if line.ends_with(b"\r") { line.len() - 1 } else { line.len() };
    line[..end].fill(b' ');
}

fn first_line(bytes: &[u8]) -> &[u8] {
    let bytes = bytes.trim_ascii_start();
    bytes.split(|&byte| byte == b'\n').next().unwrap_or_default()
}

/// Makes a tab of the first blank between two words of a line; what stands in quotes is one word.
fn split_by_blanks(bytes: &mut [u8]) {
    for line in bytes.split_mut(|&byte| byte == b'\n') {
        let (mut in_word, mut in_quotes, mut pending) = (false, false, None);
        for at in 0..line.len() {
            if line[at] == b'"' {
                in_quotes = !in_quotes;
            }
            if !in_quotes && matches!(line[at], b' ' | b'\t' | b'\r') {
                if line[at] == b'\t' {
                    line[at] = b' ';
                }
                if in_word {
                    pending = Some(at);
                }
                in_word = false;
            } else {
                if let Some(between) = pending.take() {
                    line[between] = b'\t';
                }
                in_word = true;
            }
        }
    }
}

/// Where a column is in a table.
pub(super) fn place(table: &Table<'_>, column: &Column) -> Result<usize, InputError> {
    match column {
        Column::Name(name) => table.required(name),
        Column::Number(number) if (1..=table.width()).contains(number) => Ok(number - 1),
        Column::Number(number) => {
            Err(table.header_error(format!("has {} columns, but the mapping names column {number}", table.width())))
        }
    }
}

/// Columns whose cells are joined to one text.
pub(super) struct Text {
    places: Vec<Option<usize>>,
    between: &'static str,
    /// What stands for the file's name.
    file: String,
}

impl Text {
    /// `between` stands between the cells: `::` in names, as SpatialAnalyzer writes them.
    pub(super) fn new(
        table: &Table<'_>,
        source: &Source,
        columns: &OneOrMany<Column>,
        between: &'static str,
    ) -> Result<Self, InputError> {
        let of = |column: &Column| match column {
            Column::Name(name) if name == FILE_NAME => Ok(None),
            column => place(table, column).map(Some),
        };
        let file = source.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { places: columns.as_slice().iter().map(of).collect::<Result<_, _>>()?, between, file })
    }

    pub(super) fn of<'r>(&'r self, row: &'r Row<'_>) -> Cow<'r, str> {
        let cell = |place: &Option<usize>| match place {
            Some(place) => row.text(*place),
            None => Cow::Borrowed(self.file.as_str()),
        };
        match self.places.as_slice() {
            [one] => cell(one),
            many => Cow::Owned(many.iter().map(cell).collect::<Vec<_>>().join(self.between)),
        }
    }

    /// A column to blame.
    fn column(&self) -> Option<usize> {
        self.places.iter().flatten().next().copied()
    }

    /// What is wrong with the text.
    pub(super) fn unexpected(&self, row: &Row<'_>, expected: &str) -> InputError {
        match self.column() {
            Some(column) if self.places.len() == 1 => row.unexpected(column, expected),
            _ => {
                let found: String = self.of(row).chars().take(60).collect();
                row.error(format!("found \"{}\", expected {expected}", found.escape_debug()))
            }
        }
    }
}

/// The times of a table.
pub(super) struct Times<'m> {
    text: Text,
    time: &'m TimeToml,
}

impl<'m> Times<'m> {
    pub(super) fn new(
        table: &Table<'_>,
        source: &Source,
        time: Option<&'m TimeToml>,
    ) -> Result<Option<Self>, InputError> {
        let Some(time) = time else { return Ok(None) };
        Ok(Some(Self { text: Text::new(table, source, &time.column, " ")?, time }))
    }

    pub(super) fn of(&self, row: &Row<'_>) -> Result<Moment, InputError> {
        self.time.moment(&self.text.of(row)).map_err(|expected| self.text.unexpected(row, &expected))
    }
}

/// Which visit a row belongs to, where it says so.
pub(super) struct Keys<'m> {
    columns: Option<(usize, Option<usize>)>,
    names: &'m Names,
}

/// The visit of a row: cycle and pose.
pub(super) type Key = (u32, u32);

impl<'m> Keys<'m> {
    pub(super) fn new(
        table: &Table<'_>,
        names: &'m Names,
        cycle: Option<&Column>,
        pose: Option<&Column>,
    ) -> Result<Self, InputError> {
        let columns = match cycle {
            Some(cycle) => Some((place(table, cycle)?, pose.map(|pose| place(table, pose)).transpose()?)),
            None => None,
        };
        Ok(Self { columns, names })
    }

    /// The cycle, and the pose where there is a column for it.
    pub(super) fn cycle_and_pose(&self, row: &Row<'_>) -> Result<Option<(u32, Option<u32>)>, InputError> {
        let Some((cycle, pose)) = self.columns else { return Ok(None) };
        let from = |column: usize, first: u32| {
            let found = row.whole(column)?;
            found.checked_sub(first).ok_or_else(|| row.unexpected(column, &format!("a whole number from {first}")))
        };
        let pose = pose.map(|pose| from(pose, self.names.first_pose)).transpose()?;
        Ok(Some((from(cycle, self.names.first_cycle)?, pose)))
    }

    pub(super) fn of(&self, row: &Row<'_>) -> Result<Option<Key>, InputError> {
        Ok(self.cycle_and_pose(row)?.and_then(|(cycle, pose)| Some((cycle, pose?))))
    }
}

impl Names {
    /// The name and the visit in a text; none of it where the pattern does not fit or the name is to be ignored.
    pub(super) fn parts(&self, text: &str) -> Option<(String, Option<Key>)> {
        let Some(pattern) = &self.pattern else { return self.renamed(text).map(|name| (name, None)) };
        let found = pattern.captures(text)?;
        let number = |group: &str, first: u32| found.name(group)?.as_str().parse::<u32>().ok()?.checked_sub(first);
        let key = match (found.name("cycle"), found.name("pose")) {
            (None, None) => None,
            _ => Some((number("cycle", self.first_cycle)?, number("pose", self.first_pose)?)),
        };
        let name = found.name("target").map_or("", |name| name.as_str());
        self.renamed(name.trim()).map(|name| (name, key))
    }

    /// The name that a run gives what a file calls `name`; none where it is to be ignored.
    pub(super) fn renamed(&self, name: &str) -> Option<String> {
        if self.ignore.iter().any(|ignored| ignored == name) {
            return None;
        }
        Some(self.rename.get(name).map_or(name, String::as_str).to_owned())
    }
}
