//! Tables as Parquet files, which DuckDB, pandas, MATLAB and Spark read: columns with types, without compression.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::Field;
use parquet::schema::types::Type;

use super::reader::Row;
use crate::input::InputError;

/// A column of a table: its name, and its cells from the first row to the last; none where a cell is empty.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Column {
    pub(crate) name: String,
    pub(crate) cells: Cells,
}

/// The cells of a column.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Cells {
    /// Doubles.
    Numbers(Vec<Option<f64>>),
    /// 64-bit integers.
    Whole(Vec<Option<i64>>),
    /// UTF-8.
    Names(Vec<Option<String>>),
}

/// Rows that are written in one group: readers take a group at a time into memory.
const ROWS_A_GROUP: usize = 1 << 20;

impl Column {
    /// A column of numbers.
    pub(crate) fn numbers(name: impl Into<String>, cells: Vec<Option<f64>>) -> Self {
        Self { name: name.into(), cells: Cells::Numbers(cells) }
    }

    /// A column of whole numbers.
    pub(crate) fn whole(name: impl Into<String>, cells: Vec<Option<i64>>) -> Self {
        Self { name: name.into(), cells: Cells::Whole(cells) }
    }

    /// A column of names.
    pub(crate) fn names(name: impl Into<String>, cells: Vec<Option<String>>) -> Self {
        Self { name: name.into(), cells: Cells::Names(cells) }
    }

    /// Adds a cell of a delimited table.
    ///
    /// # Errors
    /// A cell of another type than the column's.
    pub(crate) fn push(&mut self, row: &Row<'_>, place: usize) -> Result<(), InputError> {
        match &mut self.cells {
            Cells::Numbers(cells) => cells.push(row.optional_number(place, "a number")?),
            Cells::Whole(cells) => cells.push(match row.optional_number(place, "a whole number")? {
                Some(value) if value.fract() != 0.0 => return Err(row.unexpected(place, "a whole number")),
                value => value.map(|value| value as i64),
            }),
            Cells::Names(cells) if row.is_empty(place) => cells.push(None),
            Cells::Names(cells) => cells.push(Some(row.name(place, "a name")?.to_owned())),
        }
        Ok(())
    }

    /// How many cells there are.
    pub(crate) fn len(&self) -> usize {
        match &self.cells {
            Cells::Numbers(cells) => cells.len(),
            Cells::Whole(cells) => cells.len(),
            Cells::Names(cells) => cells.len(),
        }
    }

    fn has_gaps(&self) -> bool {
        match &self.cells {
            Cells::Numbers(cells) => cells.iter().any(Option::is_none),
            Cells::Whole(cells) => cells.iter().any(Option::is_none),
            Cells::Names(cells) => cells.iter().any(Option::is_none),
        }
    }

    fn schema(&self) -> Result<Type, ParquetError> {
        let (physical, logical) = match &self.cells {
            Cells::Numbers(_) => (Physical::DOUBLE, None),
            Cells::Whole(_) => (Physical::INT64, None),
            Cells::Names(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let repetition = if self.has_gaps() { Repetition::OPTIONAL } else { Repetition::REQUIRED };
        Type::primitive_type_builder(&self.name, physical)
            .with_repetition(repetition)
            .with_logical_type(logical)
            .build()
    }
}

/// What is there of some cells, and for a column with gaps which are.
fn split<T, V>(cells: &[Option<T>], gaps: bool, value: impl Fn(&T) -> V) -> (Vec<V>, Option<Vec<i16>>) {
    let levels = gaps.then(|| cells.iter().map(|cell| i16::from(cell.is_some())).collect());
    (cells.iter().flatten().map(value).collect(), levels)
}

/// Writes columns of equal length into a file.
///
/// # Errors
/// A disk that does not take it.
pub(crate) fn write(file: &Path, columns: &[Column]) -> Result<(), ParquetError> {
    let fields = columns.iter().map(|column| Ok(Arc::new(column.schema()?))).collect::<Result<_, ParquetError>>()?;
    let schema = Arc::new(Type::group_type_builder("table").with_fields(fields).build()?);
    let made_by = concat!("thermokin ", env!("CARGO_PKG_VERSION")).to_owned();
    let properties = Arc::new(WriterProperties::builder().set_created_by(made_by).build());
    let mut writer = SerializedFileWriter::new(File::create(file)?, schema, properties)?;
    let rows = columns.first().map_or(0, Column::len);
    for from in (0..rows).step_by(ROWS_A_GROUP) {
        let to = rows.min(from + ROWS_A_GROUP);
        let mut group = writer.next_row_group()?;
        for column in columns {
            let Some(mut out) = group.next_column()? else { break };
            let gaps = column.has_gaps();
            match &column.cells {
                Cells::Numbers(cells) => {
                    let (values, levels) = split(&cells[from..to], gaps, |&value| value);
                    out.typed::<DoubleType>().write_batch(&values, levels.as_deref(), None)?;
                }
                Cells::Whole(cells) => {
                    let (values, levels) = split(&cells[from..to], gaps, |&value| value);
                    out.typed::<Int64Type>().write_batch(&values, levels.as_deref(), None)?;
                }
                Cells::Names(cells) => {
                    let (values, levels) = split(&cells[from..to], gaps, |value| ByteArray::from(value.as_str()));
                    out.typed::<ByteArrayType>().write_batch(&values, levels.as_deref(), None)?;
                }
            }
            out.close()?;
        }
        group.close()?;
    }
    writer.close()?;
    Ok(())
}

/// Whether a file holds these columns, to the last bit.
///
/// # Errors
/// A file that cannot be read as Parquet.
pub(crate) fn holds(file: &Path, columns: &[Column]) -> Result<bool, ParquetError> {
    let reader = SerializedFileReader::new(File::open(file)?)?;
    let mut count = 0;
    for (row, read) in reader.get_row_iter(None)?.enumerate() {
        let read = read?;
        count += 1;
        if read.len() != columns.len() || row >= columns[0].len() {
            return Ok(false);
        }
        for ((name, field), column) in read.get_column_iter().zip(columns) {
            let same = match (field, &column.cells) {
                (Field::Null, Cells::Numbers(cells)) => cells[row].is_none(),
                (Field::Null, Cells::Whole(cells)) => cells[row].is_none(),
                (Field::Null, Cells::Names(cells)) => cells[row].is_none(),
                (Field::Double(read), Cells::Numbers(cells)) => {
                    cells[row].is_some_and(|cell| cell.to_bits() == read.to_bits())
                }
                (Field::Long(read), Cells::Whole(cells)) => cells[row] == Some(*read),
                (Field::Str(read), Cells::Names(cells)) => cells[row].as_ref() == Some(read),
                _ => false,
            };
            if !same || *name != column.name {
                return Ok(false);
            }
        }
    }
    Ok(count == columns.first().map_or(0, Column::len))
}
