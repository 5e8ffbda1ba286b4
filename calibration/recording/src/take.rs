//! A take in memory.

use std::path::Path;

use nalgebra::Isometry3;
use palpate_robot_model::Station;

use crate::RecordingError;

/// A take, read and checked: times increase, every value is finite, every sample has its stream's channels.
#[derive(Clone, Debug)]
pub struct Take {
    /// Id: the file's stem, e.g. `take-03`.
    pub id: String,
    /// What it is about.
    pub meta: TakeMeta,
    /// The station attached to it.
    pub station: Station,
    /// Measured joint positions.
    pub joints: JointLog,
    /// Tactile streams, in the layout's order.
    pub streams: Vec<StreamLog>,
    /// Marked spans, by start.
    pub spans: Vec<Span>,
}

/// What a take is about (MCAP metadata `palpate.take`).
#[derive(Clone, Debug, PartialEq)]
pub struct TakeMeta {
    /// Object id.
    pub object: String,
    /// Pose of the object in the base frame.
    pub base_from_object: Isometry3<f64>,
    /// Primitive, e.g. `tap`.
    pub primitive: String,
    /// Whether the fixture that held the object is trusted.
    pub fixture_trusted: bool,
    /// Who recorded it, for people; may be empty.
    pub operator: String,
    /// Software that wrote it.
    pub software: String,
}

/// Joint positions over a take.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointLog {
    /// Host time since the take's start, s, strictly increasing.
    pub times_s: Vec<f64>,
    /// `num_frames x num_dofs`, row-major, rad or m.
    pub positions: Vec<f64>,
}

/// One tactile stream over a take.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StreamLog {
    /// Host time since the take's start, s, strictly increasing.
    pub times_s: Vec<f64>,
    /// The device's own time, s since its start; empty where the device gives none.
    pub device_times_s: Vec<f64>,
    /// `num_samples x num_channels_of_stream`, row-major, raw units; empty for binary takes.
    pub raw: Vec<f32>,
    /// `num_samples x num_channels_of_stream`, row-major.
    pub active: Vec<bool>,
    /// Per channel, the mean raw reading over the baseline span; empty for binary takes.
    pub reference: Vec<f32>,
}

/// A marked span of a take.
#[derive(Clone, Debug, PartialEq)]
pub struct Span {
    /// What it marks.
    pub kind: SpanKind,
    /// Start since the take's start, s.
    pub start_s: f64,
    /// End since the take's start, s.
    pub end_s: f64,
    /// For repetitions: which motion; equal for motions that repeat each other.
    pub label: String,
}

/// What a span marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpanKind {
    /// No touch: reference values come from it.
    Baseline,
    /// One of several repetitions of the same motion.
    Repetition,
    /// A remark.
    Note,
}

impl Take {
    /// Reads the MCAP file at `path`.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        let _ = path;
        todo!()
    }

    /// Real activations in effect at each joint frame, `[frame * num_channels + channel]`: each stream's newest sample
    /// at or before the frame (the first sample before that).
    pub fn active_at_frames(&self) -> Vec<bool> {
        todo!()
    }

    /// Number of joint frames.
    pub fn num_frames(&self) -> usize {
        self.joints.times_s.len()
    }
}
