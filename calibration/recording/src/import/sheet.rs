//! Times and values of delimited text, by the columns that a mapping assigns.

use std::{ops::ControlFlow, path::Path};

use super::{
    columns::{Assignment, TimeSource},
    config::FileConfig,
    rows::rows,
    table::Table,
    units,
};
use crate::RecordingError;

/// Times and the converted values of every assigned column; NaN where a cell is empty.
///
/// Refused with line and column: ragged rows, what is no finite number, times that do not increase, no rows, and, if
/// `binary`, readings that are neither 0 nor 1.
pub(super) fn values(
    path: &Path,
    bytes: &[u8],
    config: &FileConfig,
    assignment: &Assignment,
    binary: bool,
) -> Result<Table, RecordingError> {
    let mut table = Table::default();
    let mut is_header = config.header;
    let mut last_line = 1;
    rows(path, bytes, config, &mut |line, cells| {
        last_line = line;
        if std::mem::take(&mut is_header) {
            return Ok(ControlFlow::Continue(()));
        }
        if cells.len() != assignment.num_columns {
            let problem = format!(
                "ragged row: {} values, expected {} as in the {}",
                cells.len(),
                assignment.num_columns,
                if config.header { "header" } else { "first row" }
            );
            return Err(RecordingError::content(path, format!("line {line}"), problem));
        }
        push_row(path, config, assignment, binary, &mut table, line, cells)?;
        Ok(ControlFlow::Continue(()))
    })?;
    if table.times_s.is_empty() {
        let problem = "no rows after the header; the file is empty";
        return Err(RecordingError::content(path, format!("line {}", last_line + 1), problem));
    }
    Ok(table)
}

fn push_row(
    path: &Path,
    config: &FileConfig,
    assignment: &Assignment,
    binary: bool,
    table: &mut Table,
    line: u64,
    cells: &[&str],
) -> Result<(), RecordingError> {
    let time_s = match &assignment.time {
        TimeSource::Rate { rate_hz, offset_s } => table.times_s.len() as f64 / rate_hz + offset_s,
        TimeSource::Column { column, header, unit, offset_s } => {
            let place = || {
                format!(
                    "line {line}, column {} ({})",
                    column + 1,
                    if header.is_empty() { "time" } else { header }
                )
            };
            let text = cells[*column];
            let whole = text.parse().ok().and_then(|whole| units::whole_seconds(whole, unit));
            let time_s = match whole {
                Some(time_s) => time_s,
                None => {
                    let number = number(text, config.decimal_comma)
                        .map_err(|problem| RecordingError::content(path, place(), problem))?;
                    units::converted(number, unit, "s").unwrap_or(number)
                }
            };
            let time_s = if *offset_s == 0.0 { time_s } else { time_s + offset_s };
            if let Some(&last_s) = table.times_s.last().filter(|&&last_s| time_s <= last_s) {
                let problem = format!("time {time_s} s does not come after {last_s} s; times must increase");
                return Err(RecordingError::content(path, place(), problem));
            }
            time_s
        }
    };
    table.times_s.push(time_s);
    for cell in &assignment.cells {
        let text = cells[cell.column];
        if text.is_empty() {
            table.values.push(f64::NAN);
            continue;
        }
        let error = |problem: String| RecordingError::content(path, cell.place(line), problem);
        let number = match text {
            "true" | "True" | "TRUE" if binary => 1.0,
            "false" | "False" | "FALSE" if binary => 0.0,
            text => number(text, config.decimal_comma).map_err(error)?,
        };
        let value = cell.converted(number);
        if !value.is_finite() {
            return Err(error(format!(
                "{text} becomes {value} by scale, offset and unit, expected a finite number"
            )));
        }
        if binary && cell.is_channel() && value != 0.0 && value != 1.0 {
            return Err(error(format!("{value} is neither 0 nor 1, but take.toml says `binary = true`")));
        }
        table.values.push(value);
    }
    table.lines.push(line);
    Ok(())
}

fn number(text: &str, decimal_comma: bool) -> Result<f64, String> {
    let value = if decimal_comma { text.replace(',', ".").parse() } else { text.parse::<f64>() };
    match value {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(value) => Err(format!("{value} is not finite; leave the row out or mend the recording")),
        Err(_) if text.contains(',') && !decimal_comma => Err(format!(
            "{text:?} is not a number; with decimal commas say decimal_comma = true in a mapping file"
        )),
        Err(_) => Err(format!("{text:?} is not a number")),
    }
}
