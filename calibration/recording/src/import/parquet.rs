//! Parquet files as the CSV file that they would be, so that names, units, mapping and checks are those of CSV.
//!
//! Columns of numbers, truth values and time stamps become columns of the same name, missing values empty cells. A time stamp
//! becomes a whole number, and its unit goes into the header. Columns of another kind (text, lists, structures) become columns
//! of empty cells, so that they can be ignored as in a CSV file. Row `n` of the table is line `n + 1`, the header line 1.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
};

use bytes::Bytes;
use parquet::{
    basic::{ConvertedType, LogicalType, TimeUnit},
    column::reader::{ColumnReader, ColumnReaderImpl},
    data_type::DataType,
    errors::ParquetError,
    file::reader::{FileReader, SerializedFileReader},
    schema::types::ColumnDescriptor,
};

use super::config::{Delimiter, FileConfig};
use crate::RecordingError;

/// How names of Parquet files end.
pub(super) const ENDING: &str = ".parquet";
/// First bytes of every Parquet file.
const MAGIC: &[u8] = b"PAR1";
/// Most values that are decoded at a time, so that a small file which claims many takes no memory for them.
const BATCH: usize = 1 << 14;
/// Most columns of a file; more are a damaged header.
const MAX_COLUMNS: usize = 1 << 16;

/// Whether the file at `path` that begins with `bytes` is one of Parquet.
pub(super) fn is_parquet(path: &Path, bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC) || path.to_string_lossy().ends_with(ENDING)
}

/// The table in `bytes` as CSV text of at most `max_bytes`. `config` is what a mapping file says of it.
///
/// Refused: what is no Parquet file or a damaged one, a table without columns, a table that is too large as text, and a
/// mapping that says how text is written, which a Parquet file has none of.
pub(super) fn as_csv(
    path: &Path,
    bytes: Vec<u8>,
    config: &FileConfig,
    max_bytes: u64,
) -> Result<Vec<u8>, RecordingError> {
    if let Some(field) = text_field(config) {
        let problem =
            format!("is about text, which a Parquet file is not; take it out for {}", path.display());
        return Err(RecordingError::content(path, field, problem));
    }
    let bytes = Bytes::from(bytes);
    // The decoder gives errors for nearly all damage, but a byte changed in the right place makes it panic: a page that
    // needs a dictionary which is not there, for one. That must not end the studio.
    let converted = catch_unwind(AssertUnwindSafe(|| converted(bytes, max_bytes)));
    converted.unwrap_or_else(|_| Err("its data contradict each other".to_owned())).map_err(|problem| {
        let problem = format!("cannot be read as Parquet: {problem}; write it again, or as CSV");
        RecordingError::content(path, "file", problem)
    })
}

/// The first field of a mapping that says how a text file is written and is not as usual.
fn text_field(config: &FileConfig) -> Option<&'static str> {
    let fields = [
        ("skip_lines", config.skip_lines != 0),
        ("header", !config.header),
        ("delimiter", config.delimiter != Delimiter::Comma),
        ("decimal_comma", config.decimal_comma),
        ("comment", config.comment.is_some()),
        ("lines_per_row", config.lines_per_row != 1),
    ];
    fields.into_iter().find(|(_, is_set)| *is_set).map(|(field, _)| field)
}

fn converted(bytes: Bytes, max_bytes: u64) -> Result<Vec<u8>, String> {
    let reader = SerializedFileReader::new(bytes).map_err(|err| said(&err))?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    if schema.num_columns() == 0 || schema.num_columns() > MAX_COLUMNS {
        return Err(format!("it has {} columns, expected 1 to {MAX_COLUMNS}", schema.num_columns()));
    }
    let mut text = Text { out: Vec::new(), max_bytes };
    let kinds: Vec<Kind> = schema.columns().iter().map(|column| Kind::of(column)).collect();
    let headers =
        schema.columns().iter().zip(&kinds).map(|(column, kind)| kind.header(&column.path().string()));
    text.header(headers)?;
    for group_idx in 0..reader.num_row_groups() {
        let group = reader.get_row_group(group_idx).map_err(|err| said(&err))?;
        if group.num_columns() != kinds.len() {
            return Err(format!(
                "row group {group_idx} has {} columns, expected {}",
                group.num_columns(),
                kinds.len()
            ));
        }
        // The decoder asserts this instead of saying it.
        let is_before = |offset: Option<i64>| offset.is_some_and(|offset| offset < 0);
        let out_of_file = group.metadata().columns().iter().any(|chunk| {
            chunk.compressed_size() < 0
                || is_before(Some(chunk.data_page_offset()))
                || is_before(chunk.dictionary_page_offset())
        });
        if out_of_file {
            return Err(format!("row group {group_idx} says that it begins before the file"));
        }
        let num_rows =
            usize::try_from(group.metadata().num_rows()).map_err(|_| "a negative number of rows")?;
        let mut columns = Vec::with_capacity(kinds.len());
        for (idx, kind) in kinds.iter().enumerate() {
            columns.push(match kind {
                Kind::Other => None,
                _ => Some(Column {
                    reader: group.get_column_reader(idx).map_err(|err| said(&err))?,
                    max_def_level: schema.column(idx).max_def_level(),
                    kind: *kind,
                }),
            });
        }
        let mut done = 0;
        while done < num_rows {
            let batch = BATCH.min(num_rows - done);
            let mut cells: Vec<Option<Vec<Value>>> = Vec::with_capacity(columns.len());
            for column in &mut columns {
                cells.push(column.as_mut().map(|column| column.read(batch)).transpose()?);
            }
            for row in 0..batch {
                text.row(
                    cells.iter().map(|column| column.as_ref().map_or(Value::None, |values| values[row])),
                )?;
            }
            done += batch;
        }
    }
    Ok(text.out)
}

/// What is done with a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Whole numbers, as they are.
    Plain,
    /// The same without a sign: stored as signed ones.
    Unsigned,
    /// Whole numbers of this unit of time.
    Time(&'static str),
    /// Neither numbers nor truth values.
    Other,
}

impl Kind {
    fn of(column: &ColumnDescriptor) -> Self {
        use parquet::basic::Type;
        if column.max_rep_level() > 0 || column.path().parts().len() != 1 {
            return Self::Other;
        }
        let unit = |unit: &TimeUnit| match unit {
            TimeUnit::MILLIS => "ms",
            TimeUnit::MICROS => "us",
            TimeUnit::NANOS => "ns",
        };
        match (column.physical_type(), column.logical_type_ref(), column.converted_type()) {
            (Type::INT96, ..) => Self::Time("ns"),
            (Type::INT32 | Type::INT64, Some(LogicalType::Timestamp(time) | LogicalType::Time(time)), _) => {
                Self::Time(unit(&time.unit))
            }
            (
                Type::INT32 | Type::INT64,
                None,
                ConvertedType::TIMESTAMP_MILLIS | ConvertedType::TIME_MILLIS,
            ) => Self::Time("ms"),
            (Type::INT64, None, ConvertedType::TIMESTAMP_MICROS | ConvertedType::TIME_MICROS) => {
                Self::Time("us")
            }
            (Type::INT32 | Type::INT64, Some(LogicalType::Integer(int)), _) if !int.is_signed => {
                Self::Unsigned
            }
            (Type::INT32, None, ConvertedType::UINT_8 | ConvertedType::UINT_16 | ConvertedType::UINT_32)
            | (Type::INT64, None, ConvertedType::UINT_64) => Self::Unsigned,
            (Type::INT32 | Type::INT64, Some(LogicalType::Integer(_)), _)
            | (Type::BOOLEAN | Type::FLOAT | Type::DOUBLE, ..) => Self::Plain,
            (
                Type::INT32 | Type::INT64,
                None,
                ConvertedType::NONE
                | ConvertedType::INT_8
                | ConvertedType::INT_16
                | ConvertedType::INT_32
                | ConvertedType::INT_64,
            ) => Self::Plain,
            // Decimals and dates are whole numbers of something else.
            _ => Self::Other,
        }
    }

    /// The header of a column of this kind called `name`.
    fn header(self, name: &str) -> String {
        match self {
            Self::Time(unit) => format!("{name} [{unit}]"),
            _ => name.to_owned(),
        }
    }
}

/// A cell.
#[derive(Clone, Copy, Debug)]
enum Value {
    None,
    Whole(i64),
    Unsigned(u64),
    Float(f64),
    Truth(bool),
}

struct Column {
    reader: ColumnReader,
    max_def_level: i16,
    kind: Kind,
}

impl Column {
    /// The next `count` cells.
    fn read(&mut self, count: usize) -> Result<Vec<Value>, String> {
        let is_unsigned = self.kind == Kind::Unsigned;
        let levels = self.max_def_level;
        match &mut self.reader {
            ColumnReader::BoolColumnReader(reader) => {
                cells(reader, levels, count, |&value| Value::Truth(value))
            }
            ColumnReader::Int32ColumnReader(reader) if is_unsigned => {
                cells(reader, levels, count, |&value| Value::Unsigned(u64::from(value.cast_unsigned())))
            }
            ColumnReader::Int32ColumnReader(reader) => {
                cells(reader, levels, count, |&value| Value::Whole(i64::from(value)))
            }
            ColumnReader::Int64ColumnReader(reader) if is_unsigned => {
                cells(reader, levels, count, |&value| Value::Unsigned(value.cast_unsigned()))
            }
            ColumnReader::Int64ColumnReader(reader) => {
                cells(reader, levels, count, |&value| Value::Whole(value))
            }
            ColumnReader::Int96ColumnReader(reader) => {
                cells(reader, levels, count, |value| Value::Whole(value.to_nanos()))
            }
            // The text of a float's double has all its digits, so that no bit changes.
            ColumnReader::FloatColumnReader(reader) => {
                cells(reader, levels, count, |&value| Value::Float(f64::from(value)))
            }
            ColumnReader::DoubleColumnReader(reader) => {
                cells(reader, levels, count, |&value| Value::Float(value))
            }
            ColumnReader::ByteArrayColumnReader(_) | ColumnReader::FixedLenByteArrayColumnReader(_) => {
                Ok(vec![Value::None; count])
            }
        }
    }
}

/// The next `count` cells of a column without lists.
fn cells<T: DataType>(
    reader: &mut ColumnReaderImpl<T>,
    max_def_level: i16,
    count: usize,
    value: impl Fn(&T::T) -> Value,
) -> Result<Vec<Value>, String> {
    let mut cells = Vec::with_capacity(count);
    while cells.len() < count {
        let (mut levels, mut values) = (Vec::new(), Vec::new());
        let (_, num_values, num_levels) = reader
            .read_records(count - cells.len(), Some(&mut levels), None, &mut values)
            .map_err(|err| said(&err))?;
        let mut values = values.iter().take(num_values);
        if max_def_level == 0 {
            if num_values == 0 {
                return Err("a column ends before its last row".to_owned());
            }
            cells.extend(values.map(&value));
            continue;
        }
        if num_levels == 0 {
            return Err("a column ends before its last row".to_owned());
        }
        for &level in levels.iter().take(num_levels) {
            cells.push(if level == max_def_level {
                value(values.next().ok_or("a column has fewer values than it says")?)
            } else {
                Value::None
            });
        }
    }
    if cells.len() > count {
        return Err("a column has more values than rows".to_owned());
    }
    Ok(cells)
}

/// CSV text that grows up to a limit.
struct Text {
    out: Vec<u8>,
    max_bytes: u64,
}

impl Text {
    fn header(&mut self, names: impl Iterator<Item = String>) -> Result<(), String> {
        for (idx, name) in names.enumerate() {
            if idx > 0 {
                self.out.push(b',');
            }
            // A name with a line end would be a second row.
            let name: String = name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
            if name.contains([',', '"']) {
                self.out.extend(format!("\"{}\"", name.replace('"', "\"\"")).bytes());
            } else {
                self.out.extend(name.bytes());
            }
        }
        self.end_row()
    }

    fn row(&mut self, cells: impl Iterator<Item = Value>) -> Result<(), String> {
        use std::io::Write as _;
        let mut num_cells = 0;
        for cell in cells {
            if num_cells > 0 {
                self.out.push(b',');
            }
            num_cells += 1;
            let written = match cell {
                Value::None => Ok(()),
                Value::Whole(value) => write!(self.out, "{value}"),
                Value::Unsigned(value) => write!(self.out, "{value}"),
                // What pandas writes for a missing value of a column of floats.
                Value::Float(value) if value.is_nan() => Ok(()),
                Value::Float(value) => write!(self.out, "{value:?}"),
                Value::Truth(value) => self.out.write_all(if value { b"1" } else { b"0" }),
            };
            written.map_err(|err| err.to_string())?;
        }
        if num_cells == 1 && self.out.last().is_none_or(|&last| last == b'\n') {
            // A line without anything on it would be no row.
            self.out.extend(b"\"\"");
        }
        self.end_row()
    }

    fn end_row(&mut self) -> Result<(), String> {
        self.out.push(b'\n');
        if self.out.len() as u64 > self.max_bytes {
            return Err(format!(
                "as text it is larger than {} bytes, which is the most that is read",
                self.max_bytes
            ));
        }
        Ok(())
    }
}

/// What the decoder says, on one line.
fn said(err: &ParquetError) -> String {
    let text = err.to_string();
    let text = text.strip_prefix("Parquet error: ").unwrap_or(&text);
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests;
