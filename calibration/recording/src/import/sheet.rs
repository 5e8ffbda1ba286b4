//! Delimited text in any of the forms that loggers write: rows of cells, with the line that each is on.

use std::{ops::ControlFlow, path::Path};

use super::{
    columns::{Assignment, TimeSource},
    config::{Delimiter, FileConfig},
    table::{LineCounter, Table, csv_error},
    units,
};
use crate::RecordingError;

/// What is done with a row: its line, its cells.
type Visit<'a> = dyn FnMut(u64, &[&str]) -> Result<ControlFlow<()>, RecordingError> + 'a;

/// The first row: the line it is on and its cells. `None` for a file without rows.
pub(super) fn first_row(
    path: &Path,
    bytes: &[u8],
    config: &FileConfig,
) -> Result<Option<(u64, Vec<String>)>, RecordingError> {
    let mut first = None;
    rows(path, bytes, config, &mut |line, cells| {
        first = Some((line, cells.iter().map(|&cell| cell.to_owned()).collect()));
        Ok(ControlFlow::Break(()))
    })?;
    Ok(first)
}

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

/// Calls `visit` with every row until it breaks off.
fn rows(path: &Path, bytes: &[u8], config: &FileConfig, visit: &mut Visit<'_>) -> Result<(), RecordingError> {
    // Spreadsheets like to begin a file with a byte order mark.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let bytes = after_lines(bytes, config.skip_lines);
    let first_line = config.skip_lines as u64 + 1;
    if config.lines_per_row == 1 {
        return lines(path, bytes, first_line, config, visit);
    }
    let mut row: Vec<String> = Vec::new();
    let (mut num_lines, mut row_line) = (0, first_line);
    let mut broke_off = false;
    lines(path, bytes, first_line, config, &mut |line, cells| {
        if num_lines == 0 {
            row_line = line;
        }
        row.extend(cells.iter().map(|&cell| cell.to_owned()));
        num_lines += 1;
        if num_lines < config.lines_per_row {
            return Ok(ControlFlow::Continue(()));
        }
        let cells: Vec<&str> = row.iter().map(String::as_str).collect();
        let flow = visit(row_line, &cells)?;
        broke_off = flow.is_break();
        row.clear();
        num_lines = 0;
        Ok(flow)
    })?;
    if num_lines > 0 && !broke_off {
        let problem = format!(
            "the row that begins here has {num_lines} of {} lines (lines_per_row); was the file cut off?",
            config.lines_per_row
        );
        return Err(RecordingError::content(path, format!("line {row_line}"), problem));
    }
    Ok(())
}

/// As [`rows`], line by line.
fn lines(
    path: &Path,
    bytes: &[u8],
    first_line: u64,
    config: &FileConfig,
    visit: &mut Visit<'_>,
) -> Result<(), RecordingError> {
    let delimiter = match config.delimiter {
        Delimiter::Comma => b',',
        Delimiter::Semicolon => b';',
        Delimiter::Tab => b'\t',
        Delimiter::Blanks => return blank_separated(path, bytes, first_line, config, visit),
    };
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        // Ragged rows are refused by the caller, with a line and a count.
        .flexible(true)
        .trim(csv::Trim::All)
        .delimiter(delimiter)
        .comment(config.comment.and_then(|comment| u8::try_from(comment).ok()))
        .from_reader(bytes);
    let mut record = csv::StringRecord::new();
    let mut counter = LineCounter::new(bytes, first_line);
    while reader.read_record(&mut record).map_err(|error| csv_error(path, &error))? {
        let line = counter.line_of(record.position().map_or(0, csv::Position::byte));
        let cells: Vec<&str> = record.iter().collect();
        if visit(line, &cells)?.is_break() {
            break;
        }
    }
    Ok(())
}

fn blank_separated(
    path: &Path,
    bytes: &[u8],
    first_line: u64,
    config: &FileConfig,
    visit: &mut Visit<'_>,
) -> Result<(), RecordingError> {
    for (idx, line) in bytes.split(|&byte| byte == b'\n').enumerate() {
        let number = first_line + idx as u64;
        let Ok(text) = std::str::from_utf8(line) else {
            let problem = "not UTF-8 text; save the file in UTF-8";
            return Err(RecordingError::content(path, format!("line {number}"), problem));
        };
        let text = text.trim();
        if text.is_empty() || config.comment.is_some_and(|comment| text.starts_with(comment)) {
            continue;
        }
        let cells: Vec<&str> = text.split_whitespace().collect();
        if visit(number, &cells)?.is_break() {
            break;
        }
    }
    Ok(())
}

/// What follows the first `num_lines` lines.
fn after_lines(bytes: &[u8], num_lines: usize) -> &[u8] {
    (0..num_lines).fold(bytes, |rest, _| {
        let end = rest.iter().position(|&byte| byte == b'\n').map_or(rest.len(), |end| end + 1);
        &rest[end..]
    })
}
