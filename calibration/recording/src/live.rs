//! Writes a take while it happens: what is on disk stays readable, whatever becomes of the process.

use std::{
    fs::{File, OpenOptions},
    io::{Seek, Write},
    path::{Path, PathBuf},
};

use nalgebra::Isometry3;
use palpate_robot_model::Station;

use crate::{
    LogLevel, RecordingError, Span, SpanKind, TactileSampleRef, TakeMeta, TakeWriter, format::secs_from_ns,
};

/// A chunk of the file is completed at least this often, in the time of the samples: a killed process loses less than a
/// second of its take. Half of it, so that a burst of late samples does not use it up.
const FLUSH_PERIOD_NS: u64 = 500_000_000;
/// A remark is made at a moment, but a span has to have a length.
const NOTE_LENGTH_NS: u64 = 1_000_000;

/// A take that is being recorded: a [`TakeWriter`] that hands its data to the operating system as time goes by.
///
/// A failure to write ends the take: from then on every call gives an error, and what was handed over before can be
/// read after [`close_partial`](crate::close_partial). That a sample is refused (times that do not increase, readings
/// that are no numbers) leaves the take as it was.
pub struct LiveTake<W: Write + Seek = File> {
    writer: TakeWriter<W>,
    path: PathBuf,
    newest_ns: u64,
    flushed_ns: u64,
    failed: bool,
}

impl LiveTake<File> {
    /// Starts a take in a new file at `path`; one that is there is refused, never overwritten.
    ///
    /// `start_unix_ns` is the wall-clock time of the take's start; all later times are relative to it.
    pub fn create(
        path: &Path,
        station: &Station,
        meta: &TakeMeta,
        start_unix_ns: u64,
    ) -> Result<Self, RecordingError> {
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(path)
            .map_err(RecordingError::io("make", path))?;
        Self::new(file, path, station, meta, start_unix_ns)
    }
}

impl<W: Write + Seek> LiveTake<W> {
    /// Starts a take on `sink`; `path` names it in errors.
    ///
    /// The sink must not hold data back: what was written has to survive the process.
    pub fn new(
        sink: W,
        path: &Path,
        station: &Station,
        meta: &TakeMeta,
        start_unix_ns: u64,
    ) -> Result<Self, RecordingError> {
        let mut writer =
            TakeWriter::new(sink, station, meta, start_unix_ns).map_err(|error| error.about(path))?;
        // From here on the file says what it is.
        writer.flush().map_err(|error| error.about(path))?;
        Ok(Self { writer, path: path.to_owned(), newest_ns: 0, flushed_ns: 0, failed: false })
    }

    /// The file being written.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Time of the newest sample since the start, s.
    pub fn elapsed_s(&self) -> f64 {
        secs_from_ns(self.newest_ns)
    }

    /// Whether writing has failed, so that nothing can be added any more.
    pub fn failed(&self) -> bool {
        self.failed
    }

    /// Measured joint positions at `time_ns` since the start.
    pub fn joints(&mut self, time_ns: u64, positions: &[f64]) -> Result<(), RecordingError> {
        self.write(time_ns, |writer| writer.joints(time_ns, positions))
    }

    /// Commanded joint positions at `time_ns` since the start.
    pub fn commands(&mut self, time_ns: u64, positions: &[f64]) -> Result<(), RecordingError> {
        self.write(time_ns, |writer| writer.commands(time_ns, positions))
    }

    /// Where the object is at `time_ns` since the start, in the base frame.
    pub fn object_pose(
        &mut self,
        time_ns: u64,
        base_from_object: &Isometry3<f64>,
    ) -> Result<(), RecordingError> {
        self.write(time_ns, |writer| writer.object_pose(time_ns, base_from_object))
    }

    /// One sample of stream `stream_idx` of the layout that arrived at `time_ns` since the start.
    pub fn tactile(
        &mut self,
        stream_idx: usize,
        time_ns: u64,
        sample: TactileSampleRef<'_>,
    ) -> Result<(), RecordingError> {
        self.write(time_ns, |writer| writer.tactile(stream_idx, time_ns, sample))
    }

    /// A marked span that is over.
    pub fn span(&mut self, span: &Span) -> Result<(), RecordingError> {
        self.write(0, |writer| writer.span(span))
    }

    /// A remark at `time_ns` since the start; a bare mark where `text` is empty.
    pub fn note(&mut self, time_ns: u64, text: &str) -> Result<(), RecordingError> {
        self.span(&Span {
            kind: SpanKind::Note,
            start_s: secs_from_ns(time_ns),
            end_s: secs_from_ns(time_ns.saturating_add(NOTE_LENGTH_NS)),
            label: text.to_owned(),
        })
    }

    /// A line for people at `time_ns` since the start; `source` says who says so.
    pub fn log(
        &mut self,
        time_ns: u64,
        level: LogLevel,
        source: &str,
        text: &str,
    ) -> Result<(), RecordingError> {
        self.write(0, |writer| writer.log(time_ns, level, source, text))
    }

    /// Hands everything so far to the operating system.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.write(0, TakeWriter::flush)?;
        self.flushed_ns = self.newest_ns;
        Ok(())
    }

    /// Completes the take and gives the sink back.
    pub fn finish(self) -> Result<W, RecordingError> {
        let Self { writer, path, failed, .. } = self;
        if failed {
            return Err(already_failed(&path));
        }
        writer.finish().map_err(|error| error.about(&path))
    }

    fn write(
        &mut self,
        time_ns: u64,
        write: impl FnOnce(&mut TakeWriter<W>) -> Result<(), RecordingError>,
    ) -> Result<(), RecordingError> {
        if self.failed {
            return Err(already_failed(&self.path));
        }
        let mut outcome = write(&mut self.writer);
        if outcome.is_ok() {
            self.newest_ns = self.newest_ns.max(time_ns);
            if self.newest_ns - self.flushed_ns >= FLUSH_PERIOD_NS {
                self.flushed_ns = self.newest_ns;
                outcome = self.writer.flush();
            }
        }
        outcome.map_err(|error| {
            let error = error.about(&self.path);
            self.failed = matches!(error, RecordingError::Io { .. });
            error
        })
    }
}

fn already_failed(path: &Path) -> RecordingError {
    RecordingError::content(path, "take", "writing it failed before; start another take")
}
