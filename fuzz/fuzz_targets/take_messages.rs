//! The messages of a take, inside a file whose checksums are right: those would keep a fuzzer from ever getting here.
#![no_main]

use std::{collections::BTreeMap, io::Cursor, path::Path, sync::LazyLock};

use libfuzzer_sys::fuzz_target;
use mcap::{Attachment, WriteOptions, records::MessageHeader, records::Metadata};
use palpate_recording::Take;
use palpate_robot_model::StationFiles;

const START_UNIX_NS: u64 = 1_700_000_000_000_000_000;

static STATION: LazyLock<StationFiles> = LazyLock::new(|| {
    let bytes = include_bytes!("../../tests/fixtures/take-format-1.mcap");
    Take::from_bytes(Path::new("fixture.mcap"), bytes).expect("the fixture opens").station.files
});

const TOPICS: [(&str, &str); 5] = [
    ("/joint_states", "foxglove.JointStates"),
    ("/joint_commands", "foxglove.JointStates"),
    ("/tactile/gel", "palpate.TactileSample"),
    ("/tactile/film", "palpate.TactileSample"),
    ("/markers", "palpate.Marker"),
];

// The input is a list of messages: topic, time step, length, content.
fuzz_target!(|bytes: &[u8]| {
    if let Some(file) = file_of(bytes) {
        let _ = Take::from_bytes(Path::new("take.mcap"), &file);
    }
});

fn file_of(mut bytes: &[u8]) -> Option<Vec<u8>> {
    let options = WriteOptions::new().compression(None).compression_threads(0);
    let mut writer = options.create(Cursor::new(Vec::new())).ok()?;
    let metadata = [
        ("format", "1".to_owned()),
        ("start_unix_ns", START_UNIX_NS.to_string()),
        ("object", "ball".to_owned()),
        ("object_position_m", "0 0 0".to_owned()),
        ("object_quaternion_wxyz", "1 0 0 0".to_owned()),
        ("primitive", "tap".to_owned()),
        ("fixture_trusted", "true".to_owned()),
    ];
    let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
    writer.write_metadata(&Metadata { name: "palpate.take".to_owned(), metadata }).ok()?;
    let station_toml = ("station.toml", STATION.station_toml.as_bytes());
    let named = STATION.files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice()));
    for (name, data) in std::iter::once(station_toml).chain(named) {
        let (name, media_type) = (name.to_owned(), String::new());
        writer
            .attach(&Attachment { log_time: 0, create_time: 0, name, media_type, data: data.into() })
            .ok()?;
    }
    let mut log_time = START_UNIX_NS;
    let mut sequence = 0;
    while let [topic, step, length, rest @ ..] = bytes {
        let (data, after) = rest.split_at(usize::from(*length).min(rest.len()));
        bytes = after;
        let (topic, schema) = TOPICS[usize::from(*topic) % TOPICS.len()];
        let descriptors = palpate_messages::descriptor_set(schema)?;
        let schema_id = writer.add_schema(schema, "protobuf", &descriptors).ok()?;
        let channel_id = writer.add_channel(schema_id, topic, "protobuf", &BTreeMap::new()).ok()?;
        log_time += u64::from(*step) * 1_000_000;
        sequence += 1;
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, data).ok()?;
    }
    writer.finish().ok()?;
    Some(writer.into_inner().into_inner())
}
