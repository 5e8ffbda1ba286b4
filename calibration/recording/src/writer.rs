//! Writes takes as MCAP.

use std::io::{Seek, Write};

use palpate_robot_model::Station;

use crate::{RecordingError, Span, TakeMeta};

/// Writes one take, message by message. What was flushed survives a crash.
pub struct TakeWriter<W: Write + Seek> {
    writer: mcap::Writer<W>,
}

/// One tactile sample to be written.
#[derive(Clone, Copy, Debug)]
pub struct TactileSampleRef<'a> {
    /// Raw readings of the stream's channels; empty where the hardware gives events only.
    pub raw: &'a [f32],
    /// Activations of the stream's channels.
    pub active: &'a [bool],
    /// The device's own time, ns since its start; 0 where it gives none.
    pub device_time_ns: u64,
}

impl<W: Write + Seek> TakeWriter<W> {
    /// Starts a take: schemas, channels, the station's texts as attachments, metadata.
    /// `start_unix_ns` is the wall-clock time of the take's start; all later times are relative to it.
    pub fn new(sink: W, station: &Station, meta: &TakeMeta, start_unix_ns: u64) -> Result<Self, RecordingError> {
        let _ = (sink, station, meta, start_unix_ns);
        todo!()
    }

    /// Measured joint positions at `time_ns` since the start (`foxglove.JointStates`).
    pub fn joints(&mut self, time_ns: u64, positions: &[f64]) -> Result<(), RecordingError> {
        let _ = (time_ns, positions, &mut self.writer);
        todo!()
    }

    /// One sample of stream `stream_idx` of the layout that arrived at `time_ns` since the start.
    pub fn tactile(
        &mut self,
        stream_idx: usize,
        time_ns: u64,
        sample: TactileSampleRef<'_>,
    ) -> Result<(), RecordingError> {
        let _ = (stream_idx, time_ns, sample);
        todo!()
    }

    /// A marked span.
    pub fn span(&mut self, span: &Span) -> Result<(), RecordingError> {
        let _ = span;
        todo!()
    }

    /// Makes everything so far readable even if the process dies now.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        todo!()
    }

    /// Completes the file.
    pub fn finish(self) -> Result<W, RecordingError> {
        todo!()
    }
}
