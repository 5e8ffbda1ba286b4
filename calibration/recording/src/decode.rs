//! Bytes of an MCAP file to a take.
//!
//! Two passes: the first finds what the file is (metadata, attachments), which tools that rewrite MCAP files may put at
//! either end; the second decodes the messages against the station that was found. Both go through the library's
//! sans-IO reader with a cap on every length, so that damaged lengths cost an error, not memory.

use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
};

use mcap::{
    McapError, parse_record,
    records::{self, MessageHeader, Record, op},
    sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
};
use nalgebra::Isometry3;
use palpate_messages::{
    foxglove::{JointStates, PoseInFrame},
    proto::{Marker, TactileAxes, TactileSample, marker::Kind},
};
use palpate_robot_model::{Station, StationFiles};
use prost::Message as _;

use crate::{
    JointLog, PoseLog, RecordingError, Span, SpanKind, StreamLog, Take, TakeMeta,
    format::{
        self, AXES_SCHEMA, AXES_TOPIC_PREFIX, FORMAT, JOINT_COMMANDS_TOPIC, JOINT_STATES_SCHEMA,
        JOINT_STATES_TOPIC, MARKER_SCHEMA, MARKERS_TOPIC, OBJECT_POSE_TOPIC, POSE_SCHEMA, PROTOBUF,
        STATION_ATTACHMENT, TACTILE_SCHEMA, TACTILE_TOPIC_PREFIX, TAKE_METADATA, UNIT_TOLERANCE,
        secs_from_ns,
    },
};

/// No record or chunk of a take is larger, unpacked, B. Chunks are about 1 MiB; the rest is for attached meshes.
const RECORD_LENGTH_LIMIT: usize = 256 << 20;

/// A take as far as it can be read. Order of times is not checked yet.
pub(crate) struct Decoded {
    pub(crate) take: Take,
    pub(crate) damage: Option<Damage>,
}

/// Where a file stops being readable.
pub(crate) struct Damage {
    /// Bytes taken in when it showed.
    offset: usize,
    len: usize,
    error: McapError,
    /// Newest intact message, s since the take's start.
    last_time_s: Option<f64>,
}

impl Damage {
    pub(crate) fn into_error(self, path: &Path) -> RecordingError {
        let Self { offset, len, error, last_time_s } = self;
        if matches!(error, McapError::BadMagic) && offset <= mcap::MAGIC.len() {
            return RecordingError::content(
                path,
                "byte 0",
                "not an MCAP file; give a take that palpate wrote",
            );
        }
        if let McapError::UnsupportedCompression(name) = &error {
            let problem = format!(
                "chunks are compressed with {name:?}, expected zstd or none; write the file again with the `mcap` tool: \
                 `mcap compress --compression zstd`"
            );
            return RecordingError::content(path, format!("byte {offset} of {len}"), problem);
        }
        let intact = match last_time_s {
            Some(time_s) => format!("the last intact message is at {time_s:.3} s"),
            None => "no message is intact".to_owned(),
        };
        let problem = match error {
            McapError::UnexpectedEof | McapError::UnexpectedEoc if offset >= len => {
                "the recording is cut off".to_owned()
            }
            error => format!("the recording is damaged ({error})"),
        };
        RecordingError::content(
            path,
            format!("byte {offset} of {len}"),
            format!(
                "{problem}; {intact}; copy the file again from where it was recorded, or take it out of session.toml \
                 and look at the rest with `palpate session check`"
            ),
        )
    }
}

/// Reads `bytes`; `path` gives the take's id and names it in errors.
pub(crate) fn decode(path: &Path, bytes: &[u8]) -> Result<Decoded, RecordingError> {
    let mut about = About::default();
    let damage = for_each_record(bytes, true, |record| {
        about.record(record);
        Ok(())
    })?;
    let (meta, start_unix_ns, station_files) = match about.take(path) {
        Ok(found) => found,
        // Cut off before it said what it is.
        Err(error) => return Err(damage.map_or(error, |damage| damage.into_error(path))),
    };
    let station = match Station::from_files(station_files) {
        Ok(station) => station,
        Err(source) => {
            let error = RecordingError::Station { path: path.to_owned(), source };
            // A file cut off among its attachments has an incomplete station.
            return Err(damage.map_or(error, |damage| damage.into_error(path)));
        }
    };

    let mut messages = Messages::new(path, &station, start_unix_ns);
    let mut damage = for_each_record(bytes, false, |record| messages.record(record))?;
    if let Some(damage) = &mut damage {
        damage.last_time_s = messages.newest_ns.map(secs_from_ns);
    }
    let logs = match messages.finish() {
        Ok(logs) => logs,
        Err(error) => return Err(damage.map_or(error, |damage| damage.into_error(path))),
    };
    let id = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let Logs { joints, commands, object_poses, streams, spans } = logs;
    let take = Take { id, meta, start_unix_ns, station, joints, commands, object_poses, streams, spans };
    Ok(Decoded { take, damage })
}

/// Visits every record in order, until the end or the first damage. An error of the visitor ends it at once.
fn for_each_record(
    bytes: &[u8],
    emit_chunks: bool,
    mut visit: impl FnMut(Record<'_>) -> Result<(), RecordingError>,
) -> Result<Option<Damage>, RecordingError> {
    let mut reader = LinearReader::new_with_options(
        LinearReaderOptions::default()
            .with_emit_chunks(emit_chunks)
            .with_prevalidate_chunk_crcs(!emit_chunks)
            .with_validate_data_section_crc(true)
            .with_check_finishes_after_end_magic(true)
            .with_record_length_limit(RECORD_LENGTH_LIMIT),
    );
    let mut offset = 0;
    let damage = |offset, error| Ok(Some(Damage { offset, len: bytes.len(), error, last_time_s: None }));
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let granted = wanted.min(bytes.len() - offset);
                reader.insert(granted).copy_from_slice(&bytes[offset..offset + granted]);
                reader.notify_read(granted);
                offset += granted;
            }
            Ok(LinearReadEvent::Record { opcode, data }) => match parse(opcode, data) {
                Ok(record) => visit(record)?,
                Err(error) => return damage(offset, error),
            },
            Err(error) => return damage(offset, error),
        }
    }
    Ok(None)
}

fn parse(opcode: u8, data: &[u8]) -> Result<Record<'_>, McapError> {
    // The library slices off an attachment's CRC without looking whether there is one.
    const SHORTEST_ATTACHMENT: usize = 8 + 8 + 4 + 4 + 8 + 4;
    if opcode == op::ATTACHMENT {
        let fits = attachment_header_len(data).is_some_and(|header_len| header_len + 4 <= data.len());
        if data.len() < SHORTEST_ATTACHMENT || !fits {
            return Err(McapError::BadAttachmentLength { header: 0, available: data.len() as u64 });
        }
    }
    parse_record(opcode, data)
}

/// Bytes before an attachment's content: two times, two strings with lengths, the content's length.
fn attachment_header_len(data: &[u8]) -> Option<usize> {
    let mut position = 16_usize;
    for _ in 0..2 {
        let length = data.get(position..position.checked_add(4)?)?;
        let length = u32::from_le_bytes(length.try_into().ok()?);
        position = position.checked_add(4)?.checked_add(usize::try_from(length).ok()?)?;
    }
    position.checked_add(8)
}

/// What the file says about itself.
#[derive(Default)]
struct About {
    metadata: Option<BTreeMap<String, String>>,
    station_toml: Option<Vec<u8>>,
    files: BTreeMap<String, Vec<u8>>,
}

impl About {
    fn record(&mut self, record: Record<'_>) {
        match record {
            Record::Metadata(metadata) if metadata.name == TAKE_METADATA => {
                self.metadata = Some(metadata.metadata);
            }
            Record::Attachment { header, data, .. } if header.name == STATION_ATTACHMENT => {
                self.station_toml = Some(data.into_owned());
            }
            Record::Attachment { header, data, .. } => {
                self.files.insert(header.name, data.into_owned());
            }
            _ => {}
        }
    }

    fn take(self, path: &Path) -> Result<(TakeMeta, u64, StationFiles), RecordingError> {
        let missing = |what: &str| {
            RecordingError::content(
                path,
                what,
                "missing; this MCAP file is no take that palpate wrote, or a tool dropped it",
            )
        };
        let metadata = self.metadata.ok_or_else(|| missing("metadata \"palpate.take\""))?;
        let place = |key: &str| format!("metadata \"{TAKE_METADATA}\", {key}");
        let get = |key: &str| metadata.get(key).map(String::as_str).ok_or_else(|| missing(&place(key)));
        let wrong = |key: &str, expected: &str| {
            let found = metadata.get(key).map(String::as_str).unwrap_or_default();
            RecordingError::content(path, place(key), format!("{found:?}, expected {expected}"))
        };

        let format: u32 = get("format")?.parse().map_err(|_| wrong("format", "a number"))?;
        if format == 0 || format > FORMAT {
            return Err(wrong(
                "format",
                &format!("at most {FORMAT}; a newer palpate wrote this take, so read it with that one"),
            ));
        }
        let start_unix_ns =
            get("start_unix_ns")?.parse().map_err(|_| wrong("start_unix_ns", "ns since 1970"))?;
        let position_m = format::split_numbers::<3>(get("object_position_m")?)
            .ok_or_else(|| wrong("object_position_m", "three finite numbers"))?;
        let base_from_object = format::split_numbers::<4>(get("object_quaternion_wxyz")?)
            .and_then(|quaternion_wxyz| format::pose_from_numbers(position_m, quaternion_wxyz))
            .ok_or_else(|| wrong("object_quaternion_wxyz", "four finite numbers that make a rotation"))?;
        let fixture_trusted =
            get("fixture_trusted")?.parse().map_err(|_| wrong("fixture_trusted", "true or false"))?;
        let meta = TakeMeta {
            object: get("object")?.to_owned(),
            base_from_object,
            primitive: get("primitive")?.to_owned(),
            fixture_trusted,
            operator: metadata.get("operator").cloned().unwrap_or_default(),
            software: metadata.get("software").cloned().unwrap_or_default(),
            surroundings: match metadata.get("surroundings") {
                None => Vec::new(),
                Some(text) => format::split_boxes(text).ok_or_else(|| {
                    let expected = "for each box ten numbers: position, quaternion (w x y z), edges above 0; boxes with \
                                    semicolons between them";
                    wrong("surroundings", expected)
                })?,
            },
        };
        let station_toml =
            self.station_toml.ok_or_else(|| missing(&format!("attachment {STATION_ATTACHMENT:?}")))?;
        let station_toml = String::from_utf8(station_toml).map_err(|error| {
            let problem = format!("byte {} is not UTF-8", error.utf8_error().valid_up_to());
            RecordingError::content(path, format!("attachment {STATION_ATTACHMENT:?}"), problem)
        })?;
        Ok((meta, start_unix_ns, StationFiles { station_toml, files: self.files }))
    }
}

/// What a channel of the file carries.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Joints,
    Commands,
    ObjectPose,
    Stream(usize),
    /// What the axes of a stream's taxels measured.
    Axes(usize),
    Markers,
    /// For people or for others.
    Other,
}

/// Messages, decoded so far.
struct Messages<'a> {
    path: &'a Path,
    station: &'a Station,
    joint_names: Vec<&'a str>,
    start_unix_ns: u64,
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, (Role, String)>,
    logs: Logs,
    /// Messages of each stream so far.
    num_messages: HashMap<u16, u64>,
    newest_ns: Option<u64>,
}

#[derive(Default)]
struct Logs {
    joints: JointLog,
    commands: JointLog,
    object_poses: PoseLog,
    streams: Vec<StreamLog>,
    spans: Vec<Span>,
}

impl<'a> Messages<'a> {
    fn new(path: &'a Path, station: &'a Station, start_unix_ns: u64) -> Self {
        Self {
            path,
            station,
            joint_names: station.robot.dofs().map(|joint| joint.name.as_str()).collect(),
            start_unix_ns,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            logs: Logs {
                streams: vec![StreamLog::default(); station.layout.streams.len()],
                ..Logs::default()
            },
            num_messages: HashMap::new(),
            newest_ns: None,
        }
    }

    fn error(&self, place: impl Into<String>, problem: impl Into<String>) -> RecordingError {
        RecordingError::content(self.path, place, problem)
    }

    fn record(&mut self, record: Record<'_>) -> Result<(), RecordingError> {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => self.channel(channel)?,
            Record::Message { header, data } => self.message(&header, &data)?,
            _ => {}
        }
        Ok(())
    }

    fn channel(&mut self, channel: records::Channel) -> Result<(), RecordingError> {
        let records::Channel { id, schema_id, topic, message_encoding, .. } = channel;
        let (role, expected) = match topic.as_str() {
            JOINT_STATES_TOPIC => (Role::Joints, JOINT_STATES_SCHEMA),
            JOINT_COMMANDS_TOPIC => (Role::Commands, JOINT_STATES_SCHEMA),
            OBJECT_POSE_TOPIC => (Role::ObjectPose, POSE_SCHEMA),
            MARKERS_TOPIC => (Role::Markers, MARKER_SCHEMA),
            _ => match stream_topic(&topic) {
                Some((stream, role, schema)) => match self.station.layout.stream_index(stream) {
                    Some(stream_idx) => (role(stream_idx), schema),
                    None => {
                        let problem = format!(
                            "the attached station {:?} has no stream {stream:?}, only {}; the take and its station do \
                             not belong together",
                            self.station.id,
                            stream_list(self.station)
                        );
                        return Err(self.error(topic, problem));
                    }
                },
                None => (Role::Other, ""),
            },
        };
        if role != Role::Other {
            let schema = self.schemas.get(&schema_id).map(String::as_str).unwrap_or("no schema");
            if schema != expected || message_encoding != PROTOBUF {
                let problem = format!(
                    "messages are {schema} in {message_encoding:?}, expected {expected} in {PROTOBUF:?}"
                );
                return Err(self.error(topic, problem));
            }
            if self.channels.iter().any(|(&other_id, (other, _))| *other == role && other_id != id) {
                return Err(self.error(topic, "two channels carry this topic, expected one"));
            }
        }
        self.channels.insert(id, (role, topic));
        Ok(())
    }

    fn message(&mut self, header: &MessageHeader, data: &[u8]) -> Result<(), RecordingError> {
        let Some((role, topic)) = self.channels.get(&header.channel_id).cloned() else {
            return Err(
                self.error(format!("channel {}", header.channel_id), "a message comes before its channel")
            );
        };
        if role == Role::Other {
            return Ok(());
        }
        let number = self.num_messages.entry(header.channel_id).or_default();
        *number += 1;
        let number = *number;
        let Some(time_ns) = header.log_time.checked_sub(self.start_unix_ns) else {
            let problem = format!("its time {} ns lies before the take's start", header.log_time);
            return Err(self.error(format!("{topic}: message {number}"), problem));
        };
        self.newest_ns = self.newest_ns.max(Some(time_ns));
        let time_s = secs_from_ns(time_ns);
        let outcome = match role {
            Role::Joints => joint_positions(&self.joint_names, data)
                .map(|positions| self.logs.joints.push(time_s, &positions)),
            Role::Commands => joint_positions(&self.joint_names, data)
                .map(|positions| self.logs.commands.push(time_s, &positions)),
            Role::ObjectPose => object_pose(self.station, data).map(|base_from_object| {
                self.logs.object_poses.times_s.push(time_s);
                self.logs.object_poses.poses.push(base_from_object);
            }),
            Role::Stream(stream_idx) => {
                let log = &mut self.logs.streams[stream_idx];
                tactile_sample(
                    self.station,
                    stream_idx,
                    log.times_s.first().map(|_| !log.raw.is_empty()),
                    data,
                )
                .map(|sample| {
                    log.times_s.push(time_s);
                    log.device_times_s.push(secs_from_ns(sample.device_time_ns));
                    log.raw.extend_from_slice(&sample.raw);
                    log.active.extend_from_slice(&sample.active);
                })
            }
            Role::Axes(stream_idx) => tactile_axes(self.station, stream_idx, data).map(|values| {
                let log = &mut self.logs.streams[stream_idx].axes;
                log.times_s.push(time_s);
                log.values.extend_from_slice(&values);
            }),
            Role::Markers => marker_span(self.start_unix_ns, data).map(|span| self.logs.spans.push(span)),
            Role::Other => Ok(()),
        };
        outcome.map_err(|problem| self.error(format!("{topic}: message {number} at {time_s:.3} s"), problem))
    }

    fn finish(mut self) -> Result<Logs, RecordingError> {
        if self.logs.joints.times_s.is_empty() {
            return Err(self.error(JOINT_STATES_TOPIC, "no messages; a take needs joint states"));
        }
        for (stream, log) in self.station.layout.streams.iter().zip(&self.logs.streams) {
            if log.times_s.is_empty() {
                let problem = format!(
                    "no messages, but the attached station {:?} has the stream {:?}; the device was not connected, or \
                     the take and its station do not belong together",
                    self.station.id, stream.id
                );
                return Err(self.error(format::tactile_topic(&stream.id), problem));
            }
        }
        self.logs.spans.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
        for (stream, log) in self.station.layout.streams.iter().zip(&mut self.logs.streams) {
            if log.device_times_s.iter().all(|&time_s| time_s == 0.0) {
                log.device_times_s.clear();
            }
            log.find_references(stream.channels.len(), &self.logs.spans);
        }
        Ok(self.logs)
    }
}

impl JointLog {
    fn push(&mut self, time_s: f64, positions: &[f64]) {
        self.times_s.push(time_s);
        self.positions.extend_from_slice(positions);
    }
}

/// Makes a role of the index of a stream.
type RoleOfStream = fn(usize) -> Role;

/// The stream that a topic is about, what the topic carries of it, and in which schema.
fn stream_topic(topic: &str) -> Option<(&str, RoleOfStream, &'static str)> {
    let of_samples = topic.strip_prefix(TACTILE_TOPIC_PREFIX);
    let of_axes = || topic.strip_prefix(AXES_TOPIC_PREFIX);
    match of_samples {
        Some(stream) => Some((stream, Role::Stream, TACTILE_SCHEMA)),
        None => Some((of_axes()?, Role::Axes, AXES_SCHEMA)),
    }
}

/// The ids of a station's streams, for people.
pub(crate) fn stream_list(station: &Station) -> String {
    let ids: Vec<String> = station.layout.streams.iter().map(|stream| format!("{:?}", stream.id)).collect();
    ids.join(", ")
}

fn joint_positions(names: &[&str], data: &[u8]) -> Result<Vec<f64>, String> {
    let message = JointStates::decode(data).map_err(|error| error.to_string())?;
    if message.joints.len() != names.len() {
        return Err(format!("{} joints, the attached station has {}", message.joints.len(), names.len()));
    }
    let positions = message.joints.iter().zip(names).enumerate().map(|(dof, (joint, &name))| {
        if joint.name != name {
            return Err(format!("joint {dof} is {:?}, the attached station has {name:?} there", joint.name));
        }
        match joint.position {
            Some(position) if position.is_finite() => Ok(position),
            Some(position) => Err(format!("joint {name:?} is at {position}, expected a finite number")),
            None => Err(format!("joint {name:?} has no position")),
        }
    });
    positions.collect()
}

/// base_from_object.
fn object_pose(station: &Station, data: &[u8]) -> Result<Isometry3<f64>, String> {
    let message = PoseInFrame::decode(data).map_err(|error| error.to_string())?;
    let base = station.robot.links.first().map_or("", |link| link.name.as_str());
    // Many programs leave the frame out.
    if !message.frame_id.is_empty() && message.frame_id != base {
        return Err(format!(
            "the pose is given in frame {:?}, expected the base of the attached station's robot, {base:?}",
            message.frame_id
        ));
    }
    let pose = message.pose.ok_or("there is no pose in it")?;
    // What protobuf leaves out is zero.
    let position = pose.position.unwrap_or_default();
    let Some(turn) = pose.orientation else { return Err("the pose has no orientation".to_owned()) };
    let position_m = [position.x, position.y, position.z];
    let quaternion_wxyz = [turn.w, turn.x, turn.y, turn.z];
    if !position_m.iter().all(|number| number.is_finite()) {
        return Err(format!("the object is at {position_m:?} m, expected finite numbers"));
    }
    let norm = quaternion_wxyz.iter().map(|number| number * number).sum::<f64>().sqrt();
    format::pose_from_numbers(position_m, quaternion_wxyz)
        .filter(|_| (norm - 1.0).abs() <= UNIT_TOLERANCE)
        .ok_or_else(|| {
            format!(
                "the object's quaternion is {quaternion_wxyz:?} (w x y z), whose norm is {norm}; expected a unit quaternion"
            )
        })
}

fn tactile_sample(
    station: &Station,
    stream_idx: usize,
    has_raw: Option<bool>,
    data: &[u8],
) -> Result<TactileSample, String> {
    let message = TactileSample::decode(data).map_err(|error| error.to_string())?;
    let channels = station.layout.streams[stream_idx].channels.clone();
    let num_channels = channels.len();
    if message.active.len() != num_channels {
        let num_active = message.active.len();
        return Err(format!("{num_active} channels, the attached station has {num_channels} in this stream"));
    }
    let num_raw = message.raw.len();
    if num_raw != 0 && num_raw != num_channels {
        return Err(format!(
            "{num_raw} raw readings, the attached station has {num_channels} in this stream"
        ));
    }
    if has_raw.is_some_and(|has_raw| has_raw != (num_raw != 0)) {
        return Err("some samples of this stream have raw readings and some have none".to_owned());
    }
    if let Some(channel) = message.raw.iter().position(|reading| !reading.is_finite()) {
        let id = &station.layout.channels[channels.start + channel].id;
        return Err(format!("channel {id:?} reads {}, expected a finite number", message.raw[channel]));
    }
    Ok(message)
}

fn tactile_axes(station: &Station, stream_idx: usize, data: &[u8]) -> Result<Vec<f32>, String> {
    let TactileAxes { axes, values, .. } = TactileAxes::decode(data).map_err(|error| error.to_string())?;
    let layout = &station.layout;
    let stream = &layout.streams[stream_idx];
    let (num_channels, num_axes) = (stream.channels.len(), stream.axes.count());
    if num_axes == 1 || axes as usize != num_axes || values.len() != num_channels * num_axes {
        return Err(format!(
            "{} numbers of {axes} axes each, the attached station has {num_channels} channels with {} in this stream",
            values.len(),
            counted_axes(num_axes)
        ));
    }
    if let Some(cell) = values.iter().position(|value| !value.is_finite()) {
        let id = layout.axis_id(stream.channels.start + cell / num_axes, cell % num_axes);
        return Err(format!("axis {id:?} reads {}, expected a finite number", values[cell]));
    }
    Ok(values)
}

fn counted_axes(num_axes: usize) -> String {
    if num_axes == 1 { "1 axis".to_owned() } else { format!("{num_axes} axes") }
}

fn marker_span(start_unix_ns: u64, data: &[u8]) -> Result<Span, String> {
    let message = Marker::decode(data).map_err(|error| error.to_string())?;
    let since_start = |time: Option<&prost_types::Timestamp>| {
        time.and_then(format::ns_from_timestamp).and_then(|unix_ns| unix_ns.checked_sub(start_unix_ns))
    };
    let (Some(start_ns), Some(end_ns)) =
        (since_start(message.start.as_ref()), since_start(message.end.as_ref()))
    else {
        return Err("start or end is missing or lies before the take's start".to_owned());
    };
    if end_ns <= start_ns {
        return Err(format!("ends at {} s, before it starts", secs_from_ns(end_ns)));
    }
    let kind = match message.kind() {
        Kind::Baseline => SpanKind::Baseline,
        Kind::Repetition => SpanKind::Repetition,
        Kind::Note | Kind::Unspecified => SpanKind::Note,
    };
    Ok(Span { kind, start_s: secs_from_ns(start_ns), end_s: secs_from_ns(end_ns), label: message.label })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_compression_is_not_called_damage() {
        let error = McapError::UnsupportedCompression("lz4".to_owned());
        let damage = Damage { offset: 40, len: 90, error, last_time_s: None };
        let message = damage.into_error(Path::new("a.mcap")).to_string();
        assert!(
            message.starts_with("a.mcap: byte 40 of 90: chunks are compressed with \"lz4\""),
            "{message}"
        );
    }

    #[test]
    fn an_attachment_without_room_for_its_checksum_is_an_error() {
        // Times, two empty strings, no content; then fewer bytes than a checksum has.
        let mut data = vec![0; 16 + 4 + 4 + 8];
        for missing in [4, 1] {
            data.resize(36 - missing, 0);
            assert!(parse(op::ATTACHMENT, &data).is_err(), "{missing} bytes short");
        }
        data.resize(36, 0);
        assert!(parse(op::ATTACHMENT, &data).is_ok());
        // A name longer than the record.
        data[16] = 200;
        assert!(parse(op::ATTACHMENT, &data).is_err());
    }
}
