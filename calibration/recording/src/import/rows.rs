//! Delimited text in any of the forms that loggers write: rows of cells, with the line that each is on.

use std::{ops::ControlFlow, path::Path};

use super::config::{Delimiter, FileConfig};
use crate::RecordingError;

/// What is done with a row: its line, its cells.
pub(super) type Visit<'a> = dyn FnMut(u64, &[&str]) -> Result<ControlFlow<()>, RecordingError> + 'a;

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

/// Calls `visit` with every row until it breaks off.
pub(super) fn rows(
    path: &Path,
    bytes: &[u8],
    config: &FileConfig,
    visit: &mut Visit<'_>,
) -> Result<(), RecordingError> {
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

/// Counts lines by bytes: the library's own count stops short of the line feed of a CRLF and of blank lines.
pub(super) struct LineCounter<'a> {
    bytes: &'a [u8],
    position: usize,
    line: u64,
}

impl<'a> LineCounter<'a> {
    /// Counts in `bytes`, the first line of which is `first_line`.
    pub(super) fn new(bytes: &'a [u8], first_line: u64) -> Self {
        Self { bytes, position: 0, line: first_line }
    }

    /// Line of the record whose reading began at `byte`, which must not go back.
    pub(super) fn line_of(&mut self, byte: u64) -> u64 {
        let begin = usize::try_from(byte).unwrap_or(usize::MAX);
        while let Some(&current) = self.bytes.get(self.position) {
            let is_break = matches!(current, b'\n' | b'\r');
            if self.position >= begin && !is_break {
                break;
            }
            self.position += 1;
            // A CRLF is one break; it counts at its line feed.
            if current == b'\n' || (current == b'\r' && self.bytes.get(self.position) != Some(&b'\n')) {
                self.line += 1;
            }
        }
        self.line
    }
}

pub(super) fn csv_error(path: &Path, error: &csv::Error) -> RecordingError {
    let place = error.position().map_or("file".to_owned(), |position| format!("line {}", position.line()));
    let problem = match error.kind() {
        csv::ErrorKind::Utf8 { .. } => "not UTF-8 text; save the file as CSV in UTF-8".to_owned(),
        _ => error.to_string(),
    };
    RecordingError::content(path, place, problem)
}
