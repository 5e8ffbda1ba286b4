//! CSV tables of times and readings, checked cell by cell.

use std::path::Path;

use super::{
    config::FileConfig,
    rows::{LineCounter, csv_error, first_row},
};
use crate::RecordingError;

/// One file: times and `num_rows x num_columns` values, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Table {
    pub(crate) times_s: Vec<f64>,
    pub(crate) values: Vec<f64>,
    /// Line of each row, for errors that show later.
    pub(crate) lines: Vec<u64>,
}

/// What the columns of a file are.
pub(crate) struct Columns {
    /// Header is `t_s`, then this and the column's number: `q0,q1,...`.
    pub(crate) prefix: char,
    /// What each column is called by the station, for errors.
    pub(crate) ids: Vec<String>,
    /// What `ids` are: `joint` or `channel`.
    pub(crate) what: &'static str,
    /// Whether only 0 and 1 may appear.
    pub(crate) binary: bool,
}

impl Columns {
    /// Where a value is, for errors: line, column, and what the station calls it.
    pub(crate) fn place(&self, line: u64, column: usize) -> String {
        let Self { prefix, what, ids, .. } = self;
        format!("line {line}, column {} ({prefix}{column}, {what} {:?})", column + 2, ids[column])
    }
}

impl Table {
    /// Reads a file's bytes; `path` names it in errors. Refused with line and column: a wrong header, a ragged row,
    /// what is no finite number, a time that does not increase, no rows.
    pub(crate) fn parse(path: &Path, bytes: &[u8], columns: &Columns) -> Result<Self, RecordingError> {
        // Spreadsheets like to begin a file with a byte order mark.
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            // Ragged rows are refused below, with a line and a count.
            .flexible(true)
            .trim(csv::Trim::All)
            .from_reader(bytes);
        let mut record = csv::StringRecord::new();
        let mut table = Self::default();
        let mut has_header = false;
        let mut lines = LineCounter::new(bytes, 1);
        while reader.read_record(&mut record).map_err(|error| csv_error(path, &error))? {
            let line = lines.line_of(record.position().map_or(0, csv::Position::byte));
            if !has_header {
                check_header(path, line, &record, columns)?;
                has_header = true;
                continue;
            }
            table.push_row(path, line, &record, columns)?;
        }
        if !has_header {
            let problem = format!("the file is empty, expected the header {}", header_of(columns));
            return Err(RecordingError::content(path, "line 1", problem));
        }
        if table.times_s.is_empty() {
            return Err(RecordingError::content(
                path,
                "line 2",
                "no rows after the header; the stream is empty",
            ));
        }
        Ok(table)
    }

    /// Refuses a file whose header is not that of `columns`.
    pub(crate) fn check_header(path: &Path, bytes: &[u8], columns: &Columns) -> Result<(), RecordingError> {
        match first_row(path, bytes, &FileConfig::plain())? {
            Some((line, cells)) => check_header(path, line, &csv::StringRecord::from(cells), columns),
            None => Self::parse(path, bytes, columns).map(drop),
        }
    }

    /// Values of one row.
    pub(crate) fn row(&self, row: usize, num_columns: usize) -> &[f64] {
        &self.values[row * num_columns..(row + 1) * num_columns]
    }

    fn push_row(
        &mut self,
        path: &Path,
        line: u64,
        record: &csv::StringRecord,
        columns: &Columns,
    ) -> Result<(), RecordingError> {
        let expected = columns.ids.len() + 1;
        if record.len() != expected {
            let problem = format!(
                "ragged row: {} values, expected {expected} (t_s and {} {}s)",
                record.len(),
                columns.ids.len(),
                columns.what
            );
            return Err(RecordingError::content(path, format!("line {line}"), problem));
        }
        for (column, text) in record.iter().enumerate() {
            let error = |problem: String| {
                let place = match column.checked_sub(1) {
                    None => format!("line {line}, column 1 (t_s)"),
                    Some(value) => columns.place(line, value),
                };
                Err(RecordingError::content(path, place, problem))
            };
            let value = match text.parse::<f64>() {
                Ok(value) if value.is_finite() => value,
                Ok(value) => {
                    return error(format!("{value} is not finite; leave the row out or mend the recording"));
                }
                Err(_) => return error(format!("{text:?} is not a number")),
            };
            if column == 0 {
                if let Some(&last_s) = self.times_s.last().filter(|&&last_s| value <= last_s) {
                    return error(format!(
                        "time {value} s does not come after {last_s} s; times must increase"
                    ));
                }
                self.times_s.push(value);
            } else {
                if columns.binary && value != 0.0 && value != 1.0 {
                    return error(format!("{value} is neither 0 nor 1, but take.toml says `binary = true`"));
                }
                self.values.push(value);
            }
        }
        self.lines.push(line);
        Ok(())
    }
}

fn header_of(columns: &Columns) -> String {
    match columns.ids.len() {
        0 => "t_s".to_owned(),
        1 => format!("t_s,{0}0", columns.prefix),
        2 => format!("t_s,{0}0,{0}1", columns.prefix),
        num => format!("t_s,{0}0,...,{0}{1}", columns.prefix, num - 1),
    }
}

fn check_header(
    path: &Path,
    line: u64,
    record: &csv::StringRecord,
    columns: &Columns,
) -> Result<(), RecordingError> {
    let expected = columns.ids.len() + 1;
    if record.len() != expected {
        let problem = format!(
            "{} {} columns beside t_s, the station has {}; expected the header {}",
            record.len().saturating_sub(1),
            columns.what,
            columns.ids.len(),
            header_of(columns)
        );
        return Err(RecordingError::content(path, format!("line {line}"), problem));
    }
    for (column, found) in record.iter().enumerate() {
        let wanted = match column.checked_sub(1) {
            None => "t_s".to_owned(),
            Some(value) => format!("{}{value}", columns.prefix),
        };
        if found != wanted {
            let place = format!("line {line}, column {}", column + 1);
            let problem = format!("header {found:?}, expected {wanted:?} as in {}", header_of(columns));
            return Err(RecordingError::content(path, place, problem));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn ids(num: usize) -> Vec<String> {
        (0..num).map(|idx| format!("pad.{idx}")).collect()
    }

    fn parse(text: &str, num: usize) -> Result<Table, String> {
        let columns = Columns { prefix: 'v', ids: ids(num), what: "channel", binary: false };
        Table::parse(Path::new("pad.csv"), text.as_bytes(), &columns).map_err(|error| error.to_string())
    }

    proptest! {
        #[test]
        fn what_was_printed_is_read_back(rows in prop::collection::vec(prop::array::uniform3(-1e6..1e6_f64), 1..40)) {
            let mut text = "t_s,v0,v1,v2\n".to_owned();
            for (row, [a, b, c]) in rows.iter().enumerate() {
                text += &format!("{}, {a} ,{b},{c}\r\n", row as f64 * 0.025);
            }
            let table = parse(&text, 3).unwrap();
            prop_assert_eq!(&table.values, &rows.concat());
            prop_assert_eq!(table.lines, (2..2 + rows.len() as u64).collect::<Vec<_>>());
        }

        #[test]
        fn any_bytes_give_a_table_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let columns = Columns { prefix: 'v', ids: ids(2), what: "channel", binary: true };
            let _ = Table::parse(Path::new("pad.csv"), &bytes, &columns);
        }
    }

    #[test]
    fn errors_name_line_column_and_channel() {
        let cases = [
            ("", "pad.csv: line 1: the file is empty, expected the header t_s,v0,v1"),
            ("t_s,v0,v1\n", "pad.csv: line 2: no rows after the header; the stream is empty"),
            (
                "t_s,v0\n0,1\n",
                "pad.csv: line 1: 1 channel columns beside t_s, the station has 2; expected the header t_s,v0,v1",
            ),
            ("t_s,v1,v0\n", "pad.csv: line 1, column 2: header \"v1\", expected \"v0\" as in t_s,v0,v1"),
            (
                "t_s,v0,v1\n0,1,2\n1,2\n",
                "pad.csv: line 3: ragged row: 2 values, expected 3 (t_s and 2 channels)",
            ),
            (
                "t_s,v0,v1\n0,1,2\n1,2,3,4\n",
                "pad.csv: line 3: ragged row: 4 values, expected 3 (t_s and 2 channels)",
            ),
            (
                "t_s,v0,v1\n0,1,2\n0,1,2\n",
                "pad.csv: line 3, column 1 (t_s): time 0 s does not come after 0 s; times must increase",
            ),
            (
                "t_s,v0,v1\n0,1,nan\n",
                "pad.csv: line 2, column 3 (v1, channel \"pad.1\"): NaN is not finite; leave the row out or mend the recording",
            ),
            ("t_s,v0,v1\n0,1,\n", "pad.csv: line 2, column 3 (v1, channel \"pad.1\"): \"\" is not a number"),
            (
                "t_s,v0,v1\ninf,1,1\n",
                "pad.csv: line 2, column 1 (t_s): inf is not finite; leave the row out or mend the recording",
            ),
        ];
        for (text, message) in cases {
            assert_eq!(parse(text, 2).unwrap_err(), message, "for {text:?}");
        }
    }

    #[test]
    fn lines_are_counted_as_an_editor_counts_them() {
        for (text, line) in [
            ("t_s,v0\r\n0,1\r\n1,x\r\n", 3),
            ("t_s,v0\n\n0,1\n\n\n1,x\n", 6),
            ("t_s,v0\r0,1\r1,x\r", 3),
            ("t_s,v0\r\n\r\n0,1\r\n1,x", 4),
        ] {
            let error = parse(text, 1).unwrap_err();
            assert!(error.starts_with(&format!("pad.csv: line {line}, column 2")), "{text:?}: {error}");
        }
    }

    #[test]
    fn binary_files_hold_only_0_and_1() {
        let columns = Columns { prefix: 'v', ids: ids(1), what: "channel", binary: true };
        let error =
            Table::parse(Path::new("a.csv"), b"t_s,v0\n0,1\n1,0.5\n", &columns).unwrap_err().to_string();
        assert!(error.contains("line 3, column 2") && error.contains("neither 0 nor 1"), "{error}");
        assert!(Table::parse(Path::new("a.csv"), b"\xef\xbb\xbft_s,v0\n0,1\n1,0.0\n", &columns).is_ok());
    }
}
