//! Writes takes as MCAP.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    io::{Seek, Write},
};

use mcap::{Attachment, WriteOptions, records::MessageHeader, records::Metadata};
use nalgebra::Isometry3;
use palpate_messages::{
    descriptor_set,
    foxglove::{JointState, JointStates, Log, Pose, PoseInFrame, Quaternion, Vector3, log::Level},
    proto::{Marker, TactileAxes, TactileSample, marker::Kind},
};
use palpate_robot_model::{Station, TaxelAxes};

use crate::{
    RecordingError, Span, SpanKind, TakeMeta,
    format::{
        AXES_SCHEMA, FORMAT, JOINT_COMMANDS_TOPIC, JOINT_STATES_SCHEMA, JOINT_STATES_TOPIC, LOG_SCHEMA,
        LOG_TOPIC, MARKER_SCHEMA, MARKERS_TOPIC, OBJECT_POSE_TOPIC, POSE_SCHEMA, PROTOBUF,
        STATION_ATTACHMENT, TACTILE_SCHEMA, TACTILE_TOPIC_PREFIX, TAKE_METADATA, UNIT_TOLERANCE, axes_topic,
        join_boxes, join_numbers, ns_from_secs, pose_numbers, split_boxes, tactile_topic, timestamp_from_ns,
    },
};

/// Writes one take, message by message. What was flushed survives a crash.
///
/// What it is given is checked as the reader would check it, so that no take is written that cannot be read.
/// Dropping the writer completes the file as far as it goes but hides errors; [`TakeWriter::finish`] reports them.
pub struct TakeWriter<W: Write + Seek> {
    writer: mcap::Writer<W>,
    start_unix_ns: u64,
    /// Names of the degrees of freedom, in the station's order.
    joint_names: Vec<String>,
    /// Name of the link that poses are given in.
    base: String,
    joints: Topic,
    commands: Option<Topic>,
    object_pose: Option<Topic>,
    streams: Vec<StreamTopic>,
    markers: Topic,
    log: Option<Topic>,
}

/// A channel of the file and what was last written to it.
struct Topic {
    name: String,
    channel_id: u16,
    sequence: u32,
    last_time_ns: Option<u64>,
}

struct StreamTopic {
    topic: Topic,
    channel_ids: Vec<String>,
    /// Whether the samples so far carried raw readings.
    has_raw: Option<bool>,
    num_axes: usize,
    axes: Option<Topic>,
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

/// How much a line of the take's log matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogLevel {
    /// Interesting to the operator.
    Info,
    /// Done differently than asked.
    Warning,
    /// Data was lost.
    Error,
}

impl<W: Write + Seek> TakeWriter<W> {
    /// Starts a take: schemas, channels, the station's texts as attachments, metadata.
    /// `start_unix_ns` is the wall-clock time of the take's start; all later times are relative to it.
    pub fn new(
        sink: W,
        station: &Station,
        meta: &TakeMeta,
        start_unix_ns: u64,
    ) -> Result<Self, RecordingError> {
        if !meta.surroundings.is_empty() && split_boxes(&join_boxes(&meta.surroundings)).is_none() {
            let problem =
                format!("{:?}; expected boxes with finite poses and edges above 0", meta.surroundings);
            return Err(refused("surroundings", problem));
        }
        let options = WriteOptions::new()
            .library(format!("palpate_recording {}", env!("CARGO_PKG_VERSION")))
            // The bytes of a take depend on its content only, not on how many cores wrote it.
            .compression_threads(0)
            // A chunk goes out in one piece once it is complete, not as a stub whose lengths follow later: what a killed
            // process leaves is whole chunks.
            .disable_seeking(true);
        let mut writer = options.create(sink).map_err(write_error(TAKE_METADATA))?;

        // Attachments and metadata come first, so that a file that was cut off still says what it is.
        writer
            .write_metadata(&Metadata {
                name: TAKE_METADATA.to_owned(),
                metadata: metadata_of(station, meta, start_unix_ns),
            })
            .map_err(write_error(TAKE_METADATA))?;
        let station_file = (STATION_ATTACHMENT, station.files.station_toml.as_bytes());
        let named_files = station.files.files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice()));
        for (name, bytes) in std::iter::once(station_file).chain(named_files) {
            writer
                .attach(&Attachment {
                    log_time: start_unix_ns,
                    create_time: start_unix_ns,
                    name: name.to_owned(),
                    media_type: media_type(name).to_owned(),
                    data: Cow::Borrowed(bytes),
                })
                .map_err(write_error(name))?;
        }

        let joints = Topic::add(&mut writer, JOINT_STATES_TOPIC, JOINT_STATES_SCHEMA, &BTreeMap::new())?;
        let mut streams = Vec::with_capacity(station.layout.streams.len());
        for stream in &station.layout.streams {
            let channel_ids: Vec<String> = station.layout.channels[stream.channels.clone()]
                .iter()
                .map(|channel| channel.id.clone())
                .collect();
            // So that the file can be understood without the layout.
            let about = BTreeMap::from([
                ("channels".to_owned(), channel_ids.join(",")),
                ("raw_unit".to_owned(), stream.raw_unit.clone()),
                ("rate_hz".to_owned(), stream.rate_hz.to_string()),
            ]);
            let topic = Topic::add(&mut writer, &tactile_topic(&stream.id), TACTILE_SCHEMA, &about)?;
            let num_axes = stream.axes.count();
            streams.push(StreamTopic { topic, channel_ids, has_raw: None, num_axes, axes: None });
        }
        let markers = Topic::add(&mut writer, MARKERS_TOPIC, MARKER_SCHEMA, &BTreeMap::new())?;
        let joint_names = station.robot.dofs().map(|joint| joint.name.clone()).collect();
        let base = station.robot.links.first().map(|link| link.name.clone()).unwrap_or_default();
        Ok(Self {
            writer,
            start_unix_ns,
            joint_names,
            base,
            joints,
            commands: None,
            object_pose: None,
            streams,
            markers,
            log: None,
        })
    }

    /// Measured joint positions at `time_ns` since the start (`foxglove.JointStates`).
    pub fn joints(&mut self, time_ns: u64, positions: &[f64]) -> Result<(), RecordingError> {
        let unix_ns = self.unix_ns(time_ns);
        let message = joint_states(&self.joints.name, &self.joint_names, unix_ns, positions)?;
        self.joints.advance(time_ns)?;
        self.joints.write(&mut self.writer, unix_ns, unix_ns, &message)
    }

    /// Commanded joint positions at `time_ns` since the start (`foxglove.JointStates`).
    pub fn commands(&mut self, time_ns: u64, positions: &[f64]) -> Result<(), RecordingError> {
        let unix_ns = self.unix_ns(time_ns);
        let message = joint_states(JOINT_COMMANDS_TOPIC, &self.joint_names, unix_ns, positions)?;
        let topic = match &mut self.commands {
            Some(topic) => topic,
            None => self.commands.insert(Topic::add(
                &mut self.writer,
                JOINT_COMMANDS_TOPIC,
                JOINT_STATES_SCHEMA,
                &BTreeMap::new(),
            )?),
        };
        topic.advance(time_ns)?;
        topic.write(&mut self.writer, unix_ns, unix_ns, &message)
    }

    /// Where the object is at `time_ns` since the start, in the base frame (`foxglove.PoseInFrame`). An object that stands
    /// still needs none: it stays where the take's [`TakeMeta`] has it.
    pub fn object_pose(
        &mut self,
        time_ns: u64,
        base_from_object: &Isometry3<f64>,
    ) -> Result<(), RecordingError> {
        let unix_ns = self.unix_ns(time_ns);
        let (position_m, quaternion_wxyz) = pose_numbers(base_from_object);
        let ([x, y, z], [w, i, j, k]) = (position_m, quaternion_wxyz);
        let norm = base_from_object.rotation.quaternion().norm();
        let is_rotation = (norm - 1.0).abs() <= UNIT_TOLERANCE;
        if !position_m.iter().all(|number| number.is_finite()) || !is_rotation {
            let problem = format!(
                "position {position_m:?} m, quaternion {quaternion_wxyz:?}; expected finite numbers and a unit quaternion"
            );
            return Err(refused(OBJECT_POSE_TOPIC, problem));
        }
        let topic = match &mut self.object_pose {
            Some(topic) => topic,
            None => self.object_pose.insert(Topic::add(
                &mut self.writer,
                OBJECT_POSE_TOPIC,
                POSE_SCHEMA,
                &BTreeMap::new(),
            )?),
        };
        topic.advance(time_ns)?;
        let message = PoseInFrame {
            timestamp: Some(timestamp_from_ns(unix_ns)),
            frame_id: self.base.clone(),
            pose: Some(Pose {
                position: Some(Vector3 { x, y, z }),
                orientation: Some(Quaternion { x: i, y: j, z: k, w }),
            }),
        };
        topic.write(&mut self.writer, unix_ns, unix_ns, &message)
    }

    /// One sample of stream `stream_idx` of the layout that arrived at `time_ns` since the start.
    pub fn tactile(
        &mut self,
        stream_idx: usize,
        time_ns: u64,
        sample: TactileSampleRef<'_>,
    ) -> Result<(), RecordingError> {
        let unix_ns = self.unix_ns(time_ns);
        let num_streams = self.streams.len();
        let Some(stream) = self.streams.get_mut(stream_idx) else {
            return Err(refused(
                "/tactile",
                format!("stream {stream_idx} of a layout with {num_streams} streams"),
            ));
        };
        let num_channels = stream.channel_ids.len();
        let topic = &mut stream.topic;
        if sample.active.len() != num_channels {
            let problem = format!("{} activations, expected {num_channels}", sample.active.len());
            return Err(refused(&topic.name, problem));
        }
        if !sample.raw.is_empty() && sample.raw.len() != num_channels {
            let problem = format!("{} raw readings, expected {num_channels} or none", sample.raw.len());
            return Err(refused(&topic.name, problem));
        }
        if let Some(channel) = sample.raw.iter().position(|reading| !reading.is_finite()) {
            let problem = format!("channel {:?} reads {}", stream.channel_ids[channel], sample.raw[channel]);
            return Err(refused(&topic.name, problem));
        }
        let has_raw = !sample.raw.is_empty();
        if *stream.has_raw.get_or_insert(has_raw) != has_raw {
            return Err(refused(&topic.name, "some samples have raw readings and some have none"));
        }
        topic.advance(time_ns)?;
        let message = TactileSample {
            timestamp: Some(timestamp_from_ns(unix_ns)),
            device_time_ns: sample.device_time_ns,
            sequence: topic.sequence,
            raw: sample.raw.to_vec(),
            active: sample.active.to_vec(),
        };
        let publish_ns = if sample.device_time_ns == 0 { unix_ns } else { sample.device_time_ns };
        topic.write(&mut self.writer, unix_ns, publish_ns, &message)
    }

    /// What the axes of stream `stream_idx` measured in its sample of the same time: `num_channels x num_axes`,
    /// row-major.
    pub fn axes(&mut self, stream_idx: usize, time_ns: u64, values: &[f32]) -> Result<(), RecordingError> {
        let unix_ns = self.unix_ns(time_ns);
        let num_streams = self.streams.len();
        let Some(StreamTopic { topic: samples, channel_ids, num_axes, axes, .. }) =
            self.streams.get_mut(stream_idx)
        else {
            let problem = format!("stream {stream_idx} of a layout with {num_streams} streams");
            return Err(refused("/tactile_axes", problem));
        };
        let num_axes = *num_axes;
        let names = &TaxelAxes::NAMES[..num_axes];
        let stream = samples.name.strip_prefix(TACTILE_TOPIC_PREFIX).unwrap_or_default();
        let name = axes_topic(stream);
        if num_axes == 1 || values.len() != channel_ids.len() * num_axes {
            let problem = format!(
                "{} numbers, the layout has {} channels and axes {names:?} for each in this stream",
                values.len(),
                channel_ids.len()
            );
            return Err(refused(&name, problem));
        }
        if let Some(cell) = values.iter().position(|value| !value.is_finite()) {
            let axis = names[cell % num_axes];
            let problem =
                format!("channel {:?}, axis {axis}, reads {}", channel_ids[cell / num_axes], values[cell]);
            return Err(refused(&name, problem));
        }
        let topic = match axes {
            Some(topic) => topic,
            None => {
                let about = BTreeMap::from([
                    ("channels".to_owned(), channel_ids.join(",")),
                    ("axes".to_owned(), names.join(",")),
                ]);
                axes.insert(Topic::add(&mut self.writer, &name, AXES_SCHEMA, &about)?)
            }
        };
        topic.advance(time_ns)?;
        let message = TactileAxes {
            timestamp: Some(timestamp_from_ns(unix_ns)),
            axes: num_axes as u32,
            values: values.to_vec(),
        };
        topic.write(&mut self.writer, unix_ns, unix_ns, &message)
    }

    /// A marked span.
    pub fn span(&mut self, span: &Span) -> Result<(), RecordingError> {
        let (Some(start_ns), Some(end_ns)) = (ns_from_secs(span.start_s), ns_from_secs(span.end_s)) else {
            let problem = format!(
                "a span from {} s to {} s; both must be finite, not negative",
                span.start_s, span.end_s
            );
            return Err(refused(MARKERS_TOPIC, problem));
        };
        if end_ns <= start_ns {
            let problem = format!("a span from {} s to {} s ends before it starts", span.start_s, span.end_s);
            return Err(refused(MARKERS_TOPIC, problem));
        }
        let kind = match span.kind {
            SpanKind::Baseline => Kind::Baseline,
            SpanKind::Repetition => Kind::Repetition,
            SpanKind::Note => Kind::Note,
        };
        let start_unix_ns = self.unix_ns(start_ns);
        let message = Marker {
            kind: kind.into(),
            start: Some(timestamp_from_ns(start_unix_ns)),
            end: Some(timestamp_from_ns(self.unix_ns(end_ns))),
            label: span.label.clone(),
        };
        self.markers.write(&mut self.writer, start_unix_ns, start_unix_ns, &message)
    }

    /// A line for people at `time_ns` since the start (`foxglove.Log`); `source` says who says so.
    pub fn log(
        &mut self,
        time_ns: u64,
        level: LogLevel,
        source: &str,
        text: &str,
    ) -> Result<(), RecordingError> {
        let unix_ns = self.unix_ns(time_ns);
        let level = match level {
            LogLevel::Info => Level::Info,
            LogLevel::Warning => Level::Warning,
            LogLevel::Error => Level::Error,
        };
        let message = Log {
            timestamp: Some(timestamp_from_ns(unix_ns)),
            level: level.into(),
            message: text.to_owned(),
            name: source.to_owned(),
            ..Log::default()
        };
        let topic = match &mut self.log {
            Some(topic) => topic,
            None => self.log.insert(Topic::add(&mut self.writer, LOG_TOPIC, LOG_SCHEMA, &BTreeMap::new())?),
        };
        topic.write(&mut self.writer, unix_ns, unix_ns, &message)
    }

    /// Makes everything so far readable even if the process dies now.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.writer.flush().map_err(write_error("chunk"))
    }

    /// Completes the file.
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.writer.finish().map_err(write_error("summary"))?;
        Ok(self.writer.into_inner())
    }

    fn unix_ns(&self, time_ns: u64) -> u64 {
        self.start_unix_ns.saturating_add(time_ns)
    }
}

impl Topic {
    fn add<W: Write + Seek>(
        writer: &mut mcap::Writer<W>,
        name: &str,
        schema: &str,
        about: &BTreeMap<String, String>,
    ) -> Result<Self, RecordingError> {
        let descriptors = descriptor_set(schema)
            .ok_or_else(|| refused(name, format!("the software lacks the description of {schema}")))?;
        let schema_id = writer.add_schema(schema, PROTOBUF, &descriptors).map_err(write_error(name))?;
        let channel_id = writer.add_channel(schema_id, name, PROTOBUF, about).map_err(write_error(name))?;
        Ok(Self { name: name.to_owned(), channel_id, sequence: 0, last_time_ns: None })
    }

    /// Takes note of a sample at `time_ns`, which must be later than the one before.
    fn advance(&mut self, time_ns: u64) -> Result<(), RecordingError> {
        if let Some(last_ns) = self.last_time_ns.filter(|&last_ns| time_ns <= last_ns) {
            let problem =
                format!("a sample at {time_ns} ns follows one at {last_ns} ns; times must increase");
            return Err(refused(&self.name, problem));
        }
        self.last_time_ns = Some(time_ns);
        Ok(())
    }

    fn write<W: Write + Seek>(
        &mut self,
        writer: &mut mcap::Writer<W>,
        log_time: u64,
        publish_time: u64,
        message: &impl prost::Message,
    ) -> Result<(), RecordingError> {
        let header =
            MessageHeader { channel_id: self.channel_id, sequence: self.sequence, log_time, publish_time };
        self.sequence = self.sequence.wrapping_add(1);
        writer.write_to_known_channel(&header, &message.encode_to_vec()).map_err(write_error(&self.name))
    }
}

fn joint_states(
    topic: &str,
    names: &[String],
    unix_ns: u64,
    positions: &[f64],
) -> Result<JointStates, RecordingError> {
    if positions.len() != names.len() {
        return Err(refused(topic, format!("{} positions, expected {}", positions.len(), names.len())));
    }
    if let Some(dof) = positions.iter().position(|position| !position.is_finite()) {
        return Err(refused(topic, format!("joint {:?} is at {}", names[dof], positions[dof])));
    }
    let joints = names
        .iter()
        .zip(positions)
        .map(|(name, &position)| JointState {
            name: name.clone(),
            position: Some(position),
            ..JointState::default()
        })
        .collect();
    Ok(JointStates { timestamp: Some(timestamp_from_ns(unix_ns)), joints })
}

fn metadata_of(station: &Station, meta: &TakeMeta, start_unix_ns: u64) -> BTreeMap<String, String> {
    let (position_m, quaternion_wxyz) = pose_numbers(&meta.base_from_object);
    // Takes without have the bytes of versions that knew none.
    let surroundings =
        (!meta.surroundings.is_empty()).then(|| ("surroundings", join_boxes(&meta.surroundings)));
    [
        ("format", FORMAT.to_string()),
        ("station", station.id.clone()),
        ("start_unix_ns", start_unix_ns.to_string()),
        ("object", meta.object.clone()),
        ("object_position_m", join_numbers(&position_m)),
        ("object_quaternion_wxyz", join_numbers(&quaternion_wxyz)),
        ("primitive", meta.primitive.clone()),
        ("fixture_trusted", meta.fixture_trusted.to_string()),
        ("operator", meta.operator.clone()),
        ("software", meta.software.clone()),
    ]
    .into_iter()
    .chain(surroundings)
    .map(|(key, value)| (key.to_owned(), value))
    .collect()
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, extension)| extension.to_ascii_lowercase()).as_deref() {
        Some("toml") => "application/toml",
        Some("urdf" | "xml") => "application/xml",
        Some("obj") => "model/obj",
        Some("stl") => "model/stl",
        _ => "application/octet-stream",
    }
}

/// What the writer calls the file, whose name it does not know.
const TARGET: &str = "take being written";

fn refused(place: &str, problem: impl Into<String>) -> RecordingError {
    RecordingError::content(TARGET, place, problem)
}

fn write_error(place: &str) -> impl FnOnce(mcap::McapError) -> RecordingError {
    let place = place.to_owned();
    move |error| match error {
        mcap::McapError::Io(source) => RecordingError::Io { action: "write", path: TARGET.into(), source },
        error => RecordingError::content(TARGET, place, error.to_string()),
    }
}
