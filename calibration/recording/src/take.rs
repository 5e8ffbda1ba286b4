//! A take in memory.

use std::path::Path;

use nalgebra::Isometry3;
use palpate_robot_model::{FixedBox, ObjectPath, Station, Tare};

use crate::{
    RecordingError, decode,
    files::{MAX_TAKE_BYTES, read_file},
    format,
};

/// A take, read and checked: times increase, every value is finite, every sample has its stream's channels.
#[derive(Clone, Debug)]
pub struct Take {
    /// Id: the file's stem, e.g. `take-03`.
    pub id: String,
    /// What it is about.
    pub meta: TakeMeta,
    /// Wall-clock time of the take's start, ns since 1970; what counts from the take's start counts from here.
    pub start_unix_ns: u64,
    /// The station attached to it.
    pub station: Station,
    /// Measured joint positions.
    pub joints: JointLog,
    /// Commanded joint positions; empty where none were recorded.
    pub commands: JointLog,
    /// Where the object is over time; empty for one that stands still at [`TakeMeta::base_from_object`].
    pub object_poses: PoseLog,
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
    /// Pose of the object in the base frame; of one that moves, at the start.
    pub base_from_object: Isometry3<f64>,
    /// Primitive, e.g. `tap`.
    pub primitive: String,
    /// Whether the fixture that held the object is trusted.
    pub fixture_trusted: bool,
    /// Who recorded it, for people; may be empty.
    pub operator: String,
    /// Software that wrote it.
    pub software: String,
    /// What else stands there and can be touched, and does not move; empty for an object on its own.
    pub surroundings: Vec<FixedBox>,
}

/// Joint positions over a take.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointLog {
    /// Host time since the take's start, s, strictly increasing.
    pub times_s: Vec<f64>,
    /// `num_frames x num_dofs`, row-major, rad or m.
    pub positions: Vec<f64>,
}

/// Poses of an object over a take.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseLog {
    /// Host time since the take's start, s, strictly increasing.
    pub times_s: Vec<f64>,
    /// base_from_object at each of these times.
    pub poses: Vec<Isometry3<f64>>,
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
    /// Per channel, the mean raw reading over the first baseline span that holds samples; empty for binary takes. The
    /// first reading where none does.
    pub reference: Vec<f32>,
    /// Those of later baseline spans, by time.
    pub later_references: Vec<Reference>,
    /// For taxels of several axes, what each measured.
    pub axes: AxesLog,
}

/// Readings that later ones count from.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// From when on, s since the take's start: the start of the baseline span, in which nothing touches already.
    pub from_s: f64,
    /// Per channel, the mean raw reading over the span.
    pub readings: Vec<f32>,
}

/// What the axes of a stream's taxels measured over a take.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AxesLog {
    /// Host time since the take's start, s, strictly increasing: those of the stream's samples.
    pub times_s: Vec<f64>,
    /// `num_samples x num_channels_of_stream x num_axes`, row-major, raw units; empty for streams of one axis.
    pub values: Vec<f32>,
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

/// What could be read of a damaged take.
#[derive(Clone, Debug)]
pub struct Recovered {
    /// Everything before the damage.
    pub take: Take,
    /// Where the file is damaged and how; `None` if it is whole.
    pub damage: Option<String>,
}

impl Take {
    /// Reads the MCAP file at `path`.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        let bytes = read_file(path, MAX_TAKE_BYTES)?;
        Self::from_bytes(path, &bytes)
    }

    /// Reads a take from the bytes of an MCAP file. `path` gives its id and names it in errors.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, RecordingError> {
        let decoded = decode::decode(path, bytes)?;
        if let Some(damage) = decoded.damage {
            return Err(damage.into_error(path));
        }
        decoded.take.check_order(path)?;
        Ok(decoded.take)
    }

    /// Reads what is intact of a file that was cut off or damaged: everything up to the last good chunk.
    ///
    /// Refused as by [`Take::read`] if no intact chunk holds every stream.
    pub fn recover(path: &Path) -> Result<Recovered, RecordingError> {
        let bytes = read_file(path, MAX_TAKE_BYTES)?;
        let decoded = decode::decode(path, &bytes)?;
        decoded.take.check_order(path)?;
        let damage = decoded.damage.map(|damage| damage.into_error(path).to_string());
        Ok(Recovered { take: decoded.take, damage })
    }

    /// Real activations in effect at each joint frame, `[frame * num_channels + channel]`: each stream's newest sample
    /// at or before the frame (the first sample before that).
    pub fn active_at_frames(&self) -> Vec<bool> {
        let num_frames = self.num_frames();
        let num_channels = self.station.layout.num_channels();
        let mut active = vec![false; num_frames * num_channels];
        for (stream, log) in self.station.layout.streams.iter().zip(&self.streams) {
            let width = stream.channels.len();
            let mut num_arrived = 0;
            for (frame, &frame_time_s) in self.joints.times_s.iter().enumerate() {
                while log.times_s.get(num_arrived).is_some_and(|&time_s| time_s <= frame_time_s) {
                    num_arrived += 1;
                }
                let sample = num_arrived.saturating_sub(1);
                let Some(newest) = log.active.get(sample * width..(sample + 1) * width) else { continue };
                let first = frame * num_channels + stream.channels.start;
                active[first..first + width].copy_from_slice(newest);
            }
        }
        active
    }

    /// Where the object is at each joint frame.
    pub fn object_path(&self) -> ObjectPath {
        self.object_path_at(&self.joints.times_s)
    }

    /// Where the object is at each of `times_s` since the take's start; see [`PoseLog::at`].
    pub fn object_path_at(&self, times_s: &[f64]) -> ObjectPath {
        match self.object_poses.poses.as_slice() {
            [] => ObjectPath::Still(self.meta.base_from_object),
            [only] => ObjectPath::Still(*only),
            _ => ObjectPath::Moving(
                times_s.iter().filter_map(|&time_s| self.object_poses.at(time_s)).collect(),
            ),
        }
    }

    /// When references were taken anew, by time: of every baseline span but the first.
    pub fn tares(&self) -> Vec<Tare> {
        let tare = |span: &Span| Tare { from_s: span.start_s, taken_s: 0.5 * (span.start_s + span.end_s) };
        self.spans.iter().filter(|span| span.kind == SpanKind::Baseline).skip(1).map(tare).collect()
    }

    /// Number of joint frames.
    pub fn num_frames(&self) -> usize {
        self.joints.times_s.len()
    }

    /// Time between the first and the last joint frame, s.
    pub fn duration_s(&self) -> f64 {
        match (self.joints.times_s.first(), self.joints.times_s.last()) {
            (Some(first), Some(last)) => last - first,
            _ => 0.0,
        }
    }

    /// Whether raw readings were recorded beside the binary ones.
    pub fn has_raw(&self) -> bool {
        self.streams.iter().any(|stream| !stream.raw.is_empty())
    }

    /// The logs by topic: joints, commands, the object's poses, then the streams.
    fn times_by_topic(&self) -> impl Iterator<Item = (String, &[f64])> {
        let joints = [
            (format::JOINT_STATES_TOPIC.to_owned(), self.joints.times_s.as_slice()),
            (format::JOINT_COMMANDS_TOPIC.to_owned(), self.commands.times_s.as_slice()),
            (format::OBJECT_POSE_TOPIC.to_owned(), self.object_poses.times_s.as_slice()),
        ];
        let streams = self.station.layout.streams.iter().zip(&self.streams);
        let topics = streams.flat_map(|(stream, log)| {
            [
                (format::tactile_topic(&stream.id), log.times_s.as_slice()),
                (format::axes_topic(&stream.id), log.axes.times_s.as_slice()),
            ]
        });
        joints.into_iter().chain(topics)
    }

    /// Host times must increase on every topic.
    pub(crate) fn check_order(&self, path: &Path) -> Result<(), RecordingError> {
        for (topic, times_s) in self.times_by_topic() {
            if let Some(before) = times_s.windows(2).position(|pair| pair[1] <= pair[0]) {
                let (earlier, later) = (times_s[before], times_s[before + 1]);
                return Err(RecordingError::content(
                    path,
                    format!("{topic}: message {}", before + 2),
                    format!(
                        "its time {later} s does not come after {earlier} s of the message before; host times must \
                         increase, so record with a monotonic clock or leave the take out"
                    ),
                ));
            }
        }
        Ok(())
    }
}

impl StreamLog {
    /// The reference that counts at `time_s` since the take's start, one reading a channel; empty for binary takes.
    pub fn reference_at(&self, time_s: f64) -> &[f32] {
        let num_before = self.later_references.partition_point(|later| later.from_s <= time_s);
        match num_before.checked_sub(1) {
            Some(newest) => &self.later_references[newest].readings,
            None => &self.reference,
        }
    }

    /// Every reference of the take, one reading a channel each, by time.
    pub fn references(&self) -> impl Iterator<Item = &[f32]> {
        let later = self.later_references.iter().map(|later| later.readings.as_slice());
        std::iter::once(self.reference.as_slice()).chain(later)
    }

    /// The readings of the channel in `column` less the reference that counts at their time, raw units; `width` is the
    /// number of the stream's channels. None for binary takes.
    pub fn above_reference(&self, column: usize, width: usize) -> impl Iterator<Item = f64> + '_ {
        self.times_s.iter().zip(self.raw.chunks_exact(width.max(1))).filter_map(move |(&time_s, readings)| {
            let reference = self.reference_at(time_s).get(column)?;
            Some(f64::from(*readings.get(column)?) - f64::from(*reference))
        })
    }

    /// Finds the references in the baselines of `spans`, which are in order. `width` is the number of the stream's
    /// channels.
    pub(crate) fn find_references(&mut self, width: usize, spans: &[Span]) {
        let baselines = spans.iter().filter(|span| span.kind == SpanKind::Baseline);
        let mut found = baselines.filter_map(|span| {
            Some(Reference { from_s: span.start_s, readings: self.mean_readings(width, span)? })
        });
        let first = found.next();
        let later = found.collect();
        self.reference = match first {
            Some(first) => first.readings,
            None => self.raw.get(..width).unwrap_or_default().to_vec(),
        };
        self.later_references = later;
    }

    /// Mean raw reading of each channel over the samples in `span`; `None` if there are none.
    fn mean_readings(&self, width: usize, span: &Span) -> Option<Vec<f32>> {
        let mut sums = vec![0.0_f64; width];
        let mut num_samples = 0_usize;
        for (&time_s, readings) in self.times_s.iter().zip(self.raw.chunks_exact(width.max(1))) {
            if span.start_s <= time_s && time_s <= span.end_s {
                num_samples += 1;
                for (sum, &reading) in sums.iter_mut().zip(readings) {
                    *sum += f64::from(reading);
                }
            }
        }
        (num_samples > 0).then(|| sums.iter().map(|sum| (sum / num_samples as f64) as f32).collect())
    }
}

impl PoseLog {
    /// The pose at `time_s`: between two poses, on the straight line from one origin to the other and on the shortest turn from
    /// one rotation to the other (slerp), at an even pace; before the first and after the last, that one. `None` of an
    /// empty log.
    pub fn at(&self, time_s: f64) -> Option<Isometry3<f64>> {
        let num_before = self.times_s.partition_point(|&pose_s| pose_s <= time_s);
        let before =
            num_before.checked_sub(1).and_then(|idx| Some((self.times_s[idx], self.poses.get(idx)?)));
        let after = self.times_s.get(num_before).zip(self.poses.get(num_before));
        match (before, after) {
            (Some((from_s, from)), Some((to_s, to))) => {
                let share = (time_s - from_s) / (to_s - from_s);
                if share == 0.0 {
                    return Some(*from);
                }
                // A half turn has no shortest way; any is as good.
                let pose = from.try_lerp_slerp(to, share, 1e-9);
                Some(pose.unwrap_or(if share < 0.5 { *from } else { *to }))
            }
            (Some((_, pose)), None) | (None, Some((_, pose))) => Some(*pose),
            (None, None) => None,
        }
    }

    /// The farthest that the object is from where it was first, m, and the largest turn from how it was first, rad.
    pub fn farthest(&self) -> (f64, f64) {
        let Some(first) = self.poses.first() else { return (0.0, 0.0) };
        self.poses.iter().fold((0.0, 0.0), |(far_m, turned_rad): (f64, f64), pose| {
            let moved_m = (pose.translation.vector - first.translation.vector).norm();
            (far_m.max(moved_m), turned_rad.max(pose.rotation.angle_to(&first.rotation)))
        })
    }
}
