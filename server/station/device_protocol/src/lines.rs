//! The ASCII lines of tactile boards: numbers between blanks, one line for a sample or for a row of one.
//!
//! The lines have neither number nor checksum, so a lost line goes unnoticed; new firmware should send
//! [`crate::framed`].

use crate::DecodeCounters;

/// The longest line that a decoder waits for, line end included.
const MAX_LINE_LEN: usize = 512;

/// Why a line was refused, counted for each reason; the sum is [`DecodeCounters::malformed`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LineErrors {
    /// Another number of values than the board has.
    pub count: u64,
    /// Something that is no finite number.
    pub number: u64,
    /// No line end for longer than any line is.
    pub too_long: u64,
}

/// Incremental decoder for lines with a fixed number of values: one for each sensor of a TwinTac board, one for each
/// column of a matrix. Empty lines are dropped silently.
#[derive(Debug, Clone)]
pub struct LineDecoder {
    num_values: usize,
    buffer: Vec<u8>,
    /// Inside a line that was already refused for its length.
    skipping: bool,
    counters: DecodeCounters,
    errors: LineErrors,
}

impl LineDecoder {
    /// A decoder for lines of `num_values` numbers.
    pub fn new(num_values: usize) -> Self {
        Self {
            num_values,
            buffer: Vec::new(),
            skipping: false,
            counters: DecodeCounters::default(),
            errors: LineErrors::default(),
        }
    }

    /// Takes the next bytes and gives the values of each line that they complete.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<Vec<f64>> {
        bytes.iter().filter_map(|&byte| self.feed_byte(byte)).collect()
    }

    /// What became of the bytes so far.
    pub fn counters(&self) -> DecodeCounters {
        self.counters
    }

    /// Refused lines by reason.
    pub fn errors(&self) -> LineErrors {
        self.errors
    }

    /// Bytes of a line that has begun.
    pub fn pending(&self) -> &[u8] {
        &self.buffer
    }

    fn feed_byte(&mut self, byte: u8) -> Option<Vec<f64>> {
        self.buffer.push(byte);
        if byte != b'\n' {
            if self.buffer.len() >= MAX_LINE_LEN {
                self.counters.drop_bytes(self.buffer.len());
                self.buffer.clear();
                if !self.skipping {
                    self.counters.malformed += 1;
                    self.errors.too_long += 1;
                }
                self.skipping = true;
            }
            return None;
        }
        let line = std::mem::take(&mut self.buffer);
        let refuse = std::mem::take(&mut self.skipping) || line.iter().all(u8::is_ascii_whitespace);
        let values = if refuse { Err(None) } else { parse(&line, self.num_values).map_err(Some) };
        match values {
            Ok(values) => {
                self.counters.deliver(line.len());
                Some(values)
            }
            Err(reason) => {
                self.counters.drop_bytes(line.len());
                match reason {
                    Some(Refused::Count) => self.errors.count += 1,
                    Some(Refused::Number) => self.errors.number += 1,
                    None => return None,
                }
                self.counters.malformed += 1;
                None
            }
        }
    }
}

enum Refused {
    Count,
    Number,
}

fn parse(line: &[u8], num_values: usize) -> Result<Vec<f64>, Refused> {
    let text = std::str::from_utf8(line).map_err(|_| Refused::Number)?;
    let number = |word: &str| word.parse().ok().filter(|value: &f64| value.is_finite());
    let values: Option<Vec<f64>> = text.split_ascii_whitespace().map(number).collect();
    values
        .ok_or(Refused::Number)
        .and_then(|values| if values.len() == num_values { Ok(values) } else { Err(Refused::Count) })
}

/// A line as a TwinTac board sends it, two digits behind the point.
pub fn encode_twintac(values: &[f64]) -> String {
    line(values.iter().map(|value| format!("{value:.2}")))
}

/// A row as the FSR matrix sends it.
pub fn encode_fsr_row(values: &[i32]) -> String {
    line(values.iter().map(i32::to_string))
}

fn line(words: impl Iterator<Item = String>) -> String {
    let mut line = words.collect::<Vec<_>>().join(" ");
    line.push('\n');
    line
}

/// Rows to frames of a matrix. Nothing in a row says which it is; only the pause between frames does. The driver, which
/// has the clock, says when a pause was longer than the rows of one frame are apart.
#[derive(Debug, Clone)]
pub struct RowAssembler {
    num_rows: usize,
    rows: Vec<Vec<f64>>,
    dropped_rows: u64,
}

impl RowAssembler {
    /// An assembler of frames of `num_rows` rows.
    pub fn new(num_rows: usize) -> Self {
        Self { num_rows, rows: Vec::new(), dropped_rows: 0 }
    }

    /// Takes the next row; the last of a frame gives all of its values, row by row.
    pub fn push(&mut self, row: Vec<f64>) -> Option<Vec<f64>> {
        self.rows.push(row);
        (self.rows.len() >= self.num_rows).then(|| std::mem::take(&mut self.rows).concat())
    }

    /// A pause: the next row is the first of a frame. Rows of an incomplete one are dropped.
    pub fn pause(&mut self) {
        self.dropped_rows += self.rows.len() as u64;
        self.rows.clear();
    }

    /// Rows dropped so far.
    pub fn dropped_rows(&self) -> u64 {
        self.dropped_rows
    }
}
