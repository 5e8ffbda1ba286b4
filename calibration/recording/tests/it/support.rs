//! A small station, a small take, and ways to break them.

use std::{
    collections::BTreeMap,
    fs,
    io::Cursor,
    path::{Path, PathBuf},
};

use mcap::{Summary, WriteOptions, records::MessageHeader};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use palpate_recording::{Span, SpanKind, TactileSampleRef, TakeMeta, TakeWriter, load_station};
use palpate_robot_model::Station;

pub(crate) const START_UNIX_NS: u64 = 1_700_000_000_000_000_123;

pub(crate) fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures")
}

/// Two joints at 10 Hz; stream `gel` of three channels at 100 Hz, `film` of two at 40 Hz.
pub(crate) fn station() -> Station {
    load_station(&fixtures().join("finger-station/station.toml")).unwrap()
}

pub(crate) fn meta() -> TakeMeta {
    TakeMeta {
        object: "ball".to_owned(),
        base_from_object: Isometry3::from_parts(
            Vector3::new(0.1, -0.2, 0.3).into(),
            UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3),
        ),
        primitive: "tap".to_owned(),
        fixture_trusted: true,
        operator: "somebody".to_owned(),
        software: "tests".to_owned(),
        surroundings: Vec::new(),
    }
}

/// A take of `duration_ms`, as bytes. Channel `c` is touched during the `c`-th half second after the first.
pub(crate) fn take_bytes(duration_ms: u64, meta: &TakeMeta) -> Vec<u8> {
    let station = station();
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station, meta, START_UNIX_NS).unwrap();
    let baseline = Span { kind: SpanKind::Baseline, start_s: 0.0, end_s: 0.5, label: String::new() };
    writer.span(&baseline).unwrap();
    for tick_ms in (0..duration_ms).step_by(5) {
        let time_ns = tick_ms * 1_000_000;
        if tick_ms % 100 == 0 {
            writer.joints(time_ns, &[tick_ms as f64 * 5e-5, -0.5]).unwrap();
        }
        for (stream_idx, stream) in station.layout.streams.iter().enumerate() {
            let period_ms = (1e3 / stream.rate_hz) as u64;
            if tick_ms % period_ms == 0 {
                let active: Vec<bool> =
                    stream.channels.clone().map(|channel| tick_ms / 500 == channel as u64 + 1).collect();
                let raw: Vec<f32> = active.iter().map(|&on| if on { 600.0 } else { 300.0 }).collect();
                let device_time_ns = if stream.id == "gel" { time_ns + 5_000 } else { 0 };
                writer
                    .tactile(
                        stream_idx,
                        time_ns,
                        TactileSampleRef { raw: &raw, active: &active, device_time_ns },
                    )
                    .unwrap();
            }
        }
        if tick_ms % 1000 == 0 {
            writer.flush().unwrap();
        }
    }
    writer.finish().unwrap().into_inner()
}

/// One message on its way into a broken copy of a take.
pub(crate) struct Edit<'a> {
    pub(crate) topic: &'a mut String,
    pub(crate) schema: &'a mut String,
    pub(crate) log_time: &'a mut u64,
    pub(crate) data: &'a mut Vec<u8>,
    /// Number of the message on its topic, from 0.
    pub(crate) number: usize,
    pub(crate) dropped: &'a mut bool,
}

/// Writes the take again as another tool would, attachments and metadata last, each message changed by `edit`.
pub(crate) fn rewrite(bytes: &[u8], edit: impl FnMut(Edit<'_>)) -> Vec<u8> {
    rewrite_all(bytes, edit, |_| true, |_| {})
}

/// As [`rewrite`]; keeps the attachments that `keep` wants and changes the metadata.
pub(crate) fn rewrite_all(
    bytes: &[u8],
    mut edit: impl FnMut(Edit<'_>),
    keep: impl Fn(&str) -> bool,
    change_metadata: impl Fn(&mut BTreeMap<String, String>),
) -> Vec<u8> {
    let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let mut numbers: BTreeMap<String, usize> = BTreeMap::new();
    for message in mcap::MessageStream::new(bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.clone().unwrap();
        let mut topic = message.channel.topic.clone();
        let number = numbers.entry(topic.clone()).or_default();
        let (mut schema_name, mut log_time) = (schema.name.clone(), message.log_time);
        let (mut data, mut dropped) = (message.data.to_vec(), false);
        edit(Edit {
            topic: &mut topic,
            schema: &mut schema_name,
            log_time: &mut log_time,
            data: &mut data,
            number: *number,
            dropped: &mut dropped,
        });
        *number += 1;
        if dropped {
            continue;
        }
        let schema_id = writer.add_schema(&schema_name, &schema.encoding, &schema.data).unwrap();
        let channel_id = writer.add_channel(schema_id, &topic, "protobuf", &BTreeMap::new()).unwrap();
        let header = MessageHeader {
            channel_id,
            sequence: message.sequence,
            log_time,
            publish_time: message.publish_time,
        };
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    let summary = Summary::read(bytes).unwrap().unwrap();
    for index in &summary.attachment_indexes {
        if keep(&index.name) {
            writer.attach(&mcap::read::attachment(bytes, index).unwrap()).unwrap();
        }
    }
    for index in &summary.metadata_indexes {
        if keep(&index.name) {
            let mut metadata = mcap::read::metadata(bytes, index).unwrap();
            change_metadata(&mut metadata.metadata);
            writer.write_metadata(&metadata).unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// Every file under `dir` with its bytes, to see whether anything changed.
pub(crate) fn tree(dir: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut found = BTreeMap::new();
    let mut pending = vec![dir.to_owned()];
    while let Some(dir) = pending.pop() {
        for entry in fs::read_dir(&dir).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                found.insert(path.clone(), None);
                pending.push(path);
            } else {
                found.insert(path.clone(), Some(fs::read(&path).unwrap()));
            }
        }
    }
    found
}
