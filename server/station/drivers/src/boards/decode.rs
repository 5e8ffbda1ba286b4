//! Samples from the bytes of a board, with the time at which they came.
//!
//! The rows of a matrix have no number: which is the first only shows in the pause before it. A frame right after a pause
//! is believed at once. Those behind it, which came without one because nobody read for a while, are believed when the next
//! pause shows that all of them were whole; after a damaged row nothing is until a pause. A wrong frame would be worse than a
//! missing one: its readings would be those of other taxels.

use palpate_device_protocol::framed::{self, SampleDecoder};
use palpate_device_protocol::lines::LineDecoder;

/// A pause between rows is at least this share of the time between frames.
const PAUSE_SHARE: f64 = 0.3;
/// Until the time between frames is known, a pause is this long, ns; and whatever it is, between these.
const FIRST_PAUSE_NS: f64 = 5e6;
const SHORTEST_PAUSE_NS: f64 = 1.5e6;
const LONGEST_PAUSE_NS: f64 = 50e6;
/// Times between lines that the mean of them is taken over.
const MEAN_OVER: f64 = 64.0;
/// Frames that may wait for a pause: fewer than the system buffers, so that none of their rows was thrown away.
const MOST_WAITING: usize = 8;
/// A sample later than this many usual intervals is a gap.
const LATE_INTERVALS: f64 = 3.0;
/// No board is faster than this, ns; samples that a busy computer reads all together only seem to be.
const SHORTEST_INTERVAL_NS: f64 = 100_000.0;

/// One sample of all of a board's channels.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sample {
    /// The board's count.
    pub(crate) sequence: Option<u32>,
    /// The board's time, us.
    pub(crate) device_us: Option<u64>,
    /// When the last of it was read, ns: before the newest bytes, if those were what showed that it is whole.
    pub(crate) received_ns: u64,
    pub(crate) raw: Vec<f32>,
}

/// Decodes what one opening of a board's port gives: lines, or binary frames as soon as there is one. A frame has a
/// checksum, and bytes that no line of text has, so there is no doubt.
#[derive(Debug)]
pub(crate) struct BoardDecoder {
    num_channels: usize,
    lines: Lines,
    framed: Framed,
    num_gaps: u64,
    last_sample_ns: Option<u64>,
    sample_interval: Interval,
}

#[derive(Debug, Default)]
struct Framed {
    decoder: SampleDecoder,
    /// Whether this board sends frames.
    is_spoken: bool,
    last_sequence: Option<u32>,
    /// Frames with another number of channels, and the number that the last one had.
    num_others: u64,
    other_channels: Option<usize>,
}

#[derive(Debug)]
struct Lines {
    decoder: LineDecoder,
    values_per_row: usize,
    rows_per_sample: usize,
    /// The line that was under way when the port was opened is over.
    has_begun: bool,
    /// Rows since the last pause or the frame right after it, with when they were read, ns.
    rows: Vec<(u64, Vec<f64>)>,
    /// Whether the first of `rows` is known to be the first of a frame.
    in_step: bool,
    /// Whether there was a frame since the last pause, so that `rows` wait for the next.
    is_late: bool,
    dropped_rows: u64,
    /// Rows before the first pause: up to a frame of them is the one that was under way when the port was opened.
    early_rows: usize,
    last_row_ns: Option<u64>,
    row_interval: Interval,
}

/// A mean that forgets.
#[derive(Clone, Copy, Debug, Default)]
struct Interval {
    mean_ns: f64,
    count: f64,
}

impl Interval {
    fn add(&mut self, interval_ns: u64) {
        self.count = (self.count + 1.0).min(MEAN_OVER);
        self.mean_ns += (interval_ns as f64 - self.mean_ns) / self.count;
    }

    /// Once enough are known.
    fn mean_ns(&self) -> Option<f64> {
        (self.count >= 16.0).then_some(self.mean_ns.max(SHORTEST_INTERVAL_NS))
    }
}

impl BoardDecoder {
    /// A decoder for a board of `num_channels` channels, on so many lines if it sends lines.
    pub(crate) fn new(num_channels: usize, lines_per_sample: usize) -> Self {
        Self {
            num_channels,
            lines: Lines::new(num_channels, lines_per_sample.max(1)),
            framed: Framed::default(),
            num_gaps: 0,
            last_sample_ns: None,
            sample_interval: Interval::default(),
        }
    }

    /// Takes bytes that came together and gives the samples that they complete.
    pub(crate) fn feed(&mut self, received_ns: u64, bytes: &[u8]) -> Vec<Sample> {
        let (mut samples, num_lost) = self.framed.feed(received_ns, bytes, self.num_channels);
        self.num_gaps += num_lost;
        if !self.framed.is_spoken {
            samples = self.lines.feed(received_ns, bytes);
        }
        for sample in &samples {
            let Some(last_ns) = self.last_sample_ns.replace(sample.received_ns) else { continue };
            let since_ns = sample.received_ns.saturating_sub(last_ns);
            if sample.sequence.is_none()
                && let Some(mean_ns) = self.sample_interval.mean_ns()
                && since_ns as f64 > LATE_INTERVALS * mean_ns
            {
                self.num_gaps += (since_ns as f64 / mean_ns).round() as u64 - 1;
            } else {
                self.sample_interval.add(since_ns);
            }
        }
        samples
    }

    /// Lines, rows and frames that were dropped.
    pub(crate) fn num_bad(&self) -> u64 {
        if self.framed.is_spoken {
            let counters = self.framed.decoder.counters();
            counters.malformed + counters.crc_errors + self.framed.num_others
        } else {
            self.lines.decoder.counters().malformed + self.lines.dropped_rows
        }
    }

    /// Samples that did not come in time, or not at all.
    pub(crate) fn num_gaps(&self) -> u64 {
        self.num_gaps
    }

    /// Why there are bytes but no samples, and what to do.
    pub(crate) fn problem(&self) -> String {
        match self.framed.other_channels {
            Some(other_channels) => format!(
                "the board sends frames of {other_channels} channels, expected {}; correct `num_channels` in the \
                 station's file, or the port",
                self.num_channels
            ),
            None if self.framed.is_spoken => {
                "the board sends bytes, but no valid frames any more; check its cable".to_owned()
            }
            None => self.lines.problem(),
        }
    }
}

impl Framed {
    /// Samples, and how many are missing among them.
    fn feed(&mut self, received_ns: u64, bytes: &[u8], num_channels: usize) -> (Vec<Sample>, u64) {
        let (mut samples, mut num_lost) = (Vec::new(), 0);
        for sample in self.decoder.feed(bytes) {
            self.is_spoken = true;
            if sample.raw.len() != num_channels {
                self.num_others += 1;
                self.other_channels = Some(sample.raw.len());
                continue;
            }
            self.other_channels = None;
            if let Some(last) = self.last_sequence.replace(sample.sequence) {
                // A count that falls is a board that started anew.
                let step = sample.sequence.wrapping_sub(last);
                num_lost += u64::from(if step < u32::MAX / 2 { step.saturating_sub(1) } else { 0 });
            }
            samples.push(of_framed(received_ns, &sample));
        }
        (samples, num_lost)
    }
}

fn of_framed(received_ns: u64, sample: &framed::Sample) -> Sample {
    Sample {
        received_ns,
        sequence: Some(sample.sequence),
        device_us: Some(sample.device_time_us),
        raw: sample.raw.iter().map(|&raw| f32::from(raw)).collect(),
    }
}

impl Lines {
    fn new(num_channels: usize, rows_per_sample: usize) -> Self {
        let values_per_row = num_channels / rows_per_sample;
        Self {
            decoder: LineDecoder::new(values_per_row),
            values_per_row,
            rows_per_sample,
            has_begun: false,
            rows: Vec::new(),
            in_step: rows_per_sample == 1,
            is_late: false,
            dropped_rows: 0,
            early_rows: 0,
            last_row_ns: None,
            row_interval: Interval::default(),
        }
    }

    fn feed(&mut self, received_ns: u64, bytes: &[u8]) -> Vec<Sample> {
        let mut bytes = bytes;
        if !self.has_begun {
            let Some(end) = bytes.iter().position(|&byte| byte == b'\n') else { return Vec::new() };
            self.has_begun = true;
            bytes = &bytes[end + 1..];
        }
        let mut samples = Vec::new();
        for piece in bytes.split_inclusive(|&byte| byte == b'\n') {
            let malformed = self.decoder.counters().malformed;
            let row = self.decoder.feed(piece).pop();
            if self.decoder.counters().malformed > malformed {
                // Which row that was nobody knows.
                samples.extend(self.note_row(received_ns));
                self.lose_step();
            } else if let Some(row) = row {
                samples.extend(self.note_row(received_ns));
                samples.extend(self.take(received_ns, row));
            }
        }
        samples
    }

    /// Some row came: was there a pause before it? Gives the frames that waited for one.
    fn note_row(&mut self, received_ns: u64) -> Vec<Sample> {
        let Some(last_ns) = self.last_row_ns.replace(received_ns) else { return Vec::new() };
        if self.rows_per_sample == 1 {
            return Vec::new();
        }
        let since_ns = received_ns.saturating_sub(last_ns);
        let mut waited = Vec::new();
        if since_ns as f64 > self.pause_ns() {
            if self.in_step && self.is_late && self.rows.len().is_multiple_of(self.rows_per_sample) {
                let rows = std::mem::take(&mut self.rows);
                waited.extend(rows.chunks_exact(self.rows_per_sample).map(of_rows));
            }
            self.lose_step();
            self.in_step = true;
        }
        self.row_interval.add(since_ns);
        waited
    }

    fn pause_ns(&self) -> f64 {
        let frame_ns = self.row_interval.mean_ns().map(|mean_ns| mean_ns * self.rows_per_sample as f64);
        frame_ns.map_or(FIRST_PAUSE_NS, |ns| (PAUSE_SHARE * ns).clamp(SHORTEST_PAUSE_NS, LONGEST_PAUSE_NS))
    }

    fn lose_step(&mut self) {
        self.dropped_rows += self.rows.len() as u64;
        self.rows.clear();
        self.in_step = self.rows_per_sample == 1;
        self.is_late = false;
    }

    fn take(&mut self, received_ns: u64, row: Vec<f64>) -> Option<Sample> {
        if !self.in_step {
            // A frame that began before the port was open is neither damaged nor missing.
            if self.early_rows < self.rows_per_sample {
                self.early_rows += 1;
            } else {
                self.dropped_rows += 1;
            }
            return None;
        }
        self.early_rows = self.rows_per_sample;
        self.rows.push((received_ns, row));
        if self.rows.len() > MOST_WAITING * self.rows_per_sample {
            self.lose_step();
            return None;
        }
        if self.is_late || self.rows.len() < self.rows_per_sample {
            return None;
        }
        self.is_late = self.rows_per_sample > 1;
        let sample = of_rows(&self.rows);
        self.rows.clear();
        Some(sample)
    }

    fn problem(&self) -> String {
        let (errors, expected) = (self.decoder.errors(), self.values_per_row);
        if errors.count > errors.number.max(errors.too_long) {
            format!(
                "the board's lines have another number of values than the {expected} expected; correct `num_channels` \
                 and `lines_per_sample` in the station's file, or the port"
            )
        } else if errors.number + errors.too_long > 0 || self.decoder.counters().frames == 0 {
            "the board sends bytes, but no lines of numbers; check `baud` of the board in the station's file, and that \
             this is the board's port"
                .to_owned()
        } else {
            format!(
                "the board's rows come without a pause between every {} of them, so which is the first cannot be told; make its \
                 firmware send the rows of a frame back to back, or binary frames",
                self.rows_per_sample
            )
        }
    }
}

/// The rows of a frame as a sample.
fn of_rows(rows: &[(u64, Vec<f64>)]) -> Sample {
    Sample {
        sequence: None,
        device_us: None,
        received_ns: rows.last().map_or(0, |(received_ns, _)| *received_ns),
        raw: rows.iter().flat_map(|(_, row)| row).map(|value| *value as f32).collect(),
    }
}

#[cfg(test)]
mod tests;
