//! Tables as Parquet files, without arrow.

use std::{fs::File, path::Path, sync::Arc};

use parquet::{
    basic::Compression,
    data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, FloatType, Int64Type},
    errors::ParquetError,
    file::{
        metadata::KeyValue,
        properties::WriterProperties,
        writer::{SerializedFileWriter, SerializedRowGroupWriter},
    },
    schema::parser::parse_message_type,
};

use crate::ExportError;

/// The values of a column, row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Values {
    F32(Vec<f32>),
    F64(Vec<f64>),
    I64(Vec<i64>),
    Bool(Vec<bool>),
    Text(Vec<String>),
    /// Where a row may have none.
    OptBool(Vec<Option<bool>>),
    /// Where a row may have none.
    OptText(Vec<Option<String>>),
}

/// A column of a table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Column {
    pub(crate) name: String,
    pub(crate) values: Values,
    /// `None`: a value a row; `Some(n)`: a list of `n` values a row.
    pub(crate) per_row: Option<usize>,
}

impl Column {
    /// A column of one value a row.
    pub(crate) fn plain(name: impl Into<String>, values: Values) -> Self {
        Self { name: name.into(), values, per_row: None }
    }

    /// A column of `per_row` values a row, at least one.
    pub(crate) fn list(name: impl Into<String>, per_row: usize, values: Values) -> Self {
        Self { name: name.into(), values, per_row: Some(per_row) }
    }

    fn declaration(&self) -> String {
        let (kind, annotation) = match self.values {
            Values::F32(_) => ("float", ""),
            Values::F64(_) => ("double", ""),
            Values::I64(_) => ("int64", ""),
            Values::Bool(_) | Values::OptBool(_) => ("boolean", ""),
            Values::Text(_) | Values::OptText(_) => ("binary", " (STRING)"),
        };
        let name = &self.name;
        match self.per_row {
            None => format!("optional {kind} {name}{annotation};\n"),
            Some(_) => format!(
                "optional group {name} (LIST) {{ repeated group list {{ optional {kind} element{annotation}; }} }}\n"
            ),
        }
    }
}

/// A table that grows by groups of rows.
pub(crate) struct Table {
    writer: SerializedFileWriter<File>,
}

impl Table {
    /// A new file at `path` with the columns of `like`.
    pub(crate) fn create(
        path: &Path,
        like: &[Column],
        metadata: Option<KeyValue>,
    ) -> Result<Self, ExportError> {
        let file = File::create(path).map_err(ExportError::io("write", path))?;
        let declarations: String = like.iter().map(Column::declaration).collect();
        let make = || {
            let schema = parse_message_type(&format!("message schema {{\n{declarations}}}"))?;
            let properties = WriterProperties::builder()
                .set_compression(Compression::SNAPPY)
                .set_key_value_metadata(metadata.map(|entry| vec![entry]))
                .build();
            SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties))
        };
        Ok(Self { writer: make().map_err(ExportError::parquet(path))? })
    }

    /// Adds rows; `columns` are those that the table was made with, by name, order and kind.
    pub(crate) fn append(&mut self, columns: &[Column]) -> Result<(), ParquetError> {
        let mut group = self.writer.next_row_group()?;
        for column in columns {
            write(&mut group, column)?;
        }
        group.close().map(drop)
    }

    /// Bytes that went to the file so far.
    pub(crate) fn num_bytes(&self) -> usize {
        self.writer.bytes_written()
    }

    /// Completes the file.
    pub(crate) fn finish(self) -> Result<(), ParquetError> {
        self.writer.close().map(drop)
    }
}

/// Writes a whole table.
pub(crate) fn write_table(
    path: &Path,
    columns: &[Column],
    metadata: Option<KeyValue>,
) -> Result<(), ExportError> {
    let mut table = Table::create(path, columns, metadata)?;
    table.append(columns).and_then(|()| table.finish()).map_err(ExportError::parquet(path))
}

fn write(group: &mut SerializedRowGroupWriter<'_, File>, column: &Column) -> Result<(), ParquetError> {
    let missing = || ParquetError::General("the table has fewer columns than its rows".to_owned());
    let mut writer = group.next_column()?.ok_or_else(missing)?;
    let present = if column.per_row.is_some() { 3 } else { 1 };
    let levels = |count: usize| {
        let repetitions =
            column.per_row.map(|per_row| (0..count).map(|idx| i16::from(idx % per_row != 0)).collect());
        (vec![present; count], repetitions)
    };
    let known = |is_known: &mut dyn Iterator<Item = bool>| -> Vec<i16> { is_known.map(i16::from).collect() };
    let bytes = |text: &String| ByteArray::from(text.as_str());
    type Levels = (Vec<i16>, Option<Vec<i16>>);
    match &column.values {
        Values::F32(values) => {
            let (present, repeated): Levels = levels(values.len());
            writer.typed::<FloatType>().write_batch(values, Some(&present), repeated.as_deref())?
        }
        Values::F64(values) => {
            let (present, repeated): Levels = levels(values.len());
            writer.typed::<DoubleType>().write_batch(values, Some(&present), repeated.as_deref())?
        }
        Values::I64(values) => {
            let (present, repeated): Levels = levels(values.len());
            writer.typed::<Int64Type>().write_batch(values, Some(&present), repeated.as_deref())?
        }
        Values::Bool(values) => {
            let (present, repeated): Levels = levels(values.len());
            writer.typed::<BoolType>().write_batch(values, Some(&present), repeated.as_deref())?
        }
        Values::Text(values) => {
            let (present, repeated): Levels = levels(values.len());
            let values: Vec<ByteArray> = values.iter().map(bytes).collect();
            writer.typed::<ByteArrayType>().write_batch(&values, Some(&present), repeated.as_deref())?
        }
        Values::OptBool(values) => {
            let present = known(&mut values.iter().map(Option::is_some));
            let values: Vec<bool> = values.iter().copied().flatten().collect();
            writer.typed::<BoolType>().write_batch(&values, Some(&present), None)?
        }
        Values::OptText(values) => {
            let present = known(&mut values.iter().map(Option::is_some));
            let values: Vec<ByteArray> = values.iter().flatten().map(bytes).collect();
            writer.typed::<ByteArrayType>().write_batch(&values, Some(&present), None)?
        }
    };
    writer.close()
}
