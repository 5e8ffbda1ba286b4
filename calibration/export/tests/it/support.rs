//! Small sessions and rollouts, and a reader of tables.

use std::{
    fs,
    fs::File,
    io::Cursor,
    path::{Path, PathBuf},
};

use nalgebra::Isometry3;
use palpate_export::{
    ExportError,
    lerobot::{LerobotConfig, LerobotReport, export},
};
use palpate_recording::{
    Session, SessionFile, SessionTake, TactileSampleRef, TakeMeta, TakeWriter, load_station,
};
use palpate_sim::job::{Cancel, NoProgress};
use parquet::{
    file::reader::{FileReader as _, SerializedFileReader},
    record::{Field, Row},
};
use serde_json::{Value, json};

/// What a small take is like.
pub(crate) struct TakeSpec {
    pub(crate) object: &'static str,
    pub(crate) primitive: &'static str,
    /// Of the joint log and the streams, ms.
    pub(crate) duration_ms: u64,
    /// Commands begin here, ms.
    pub(crate) commands_from_ms: Option<u64>,
    /// Readings are recorded beside the activations.
    pub(crate) with_raw: bool,
    /// The object moves: every 20 ms from 100 ms on, 1e-5 m per ms along x.
    pub(crate) moves: bool,
}

pub(crate) const TAP: TakeSpec = TakeSpec {
    object: "ball",
    primitive: "tap",
    duration_ms: 2000,
    commands_from_ms: Some(450),
    with_raw: true,
    moves: false,
};

/// Joints at 10 Hz: `slide` is at 1e-4 per ms, `curl` at -0.5. The `gel` (3 channels) at 100 Hz from 30 ms on: channel `c` reads
/// `1000 * c` + ms and is touched while ms / 500 is `c`. The `film` (2 channels) at 40 Hz.
pub(crate) fn take(spec: &TakeSpec) -> Vec<u8> {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures");
    let station = load_station(&fixtures.join("finger-station/station.toml")).unwrap();
    let meta = TakeMeta {
        object: spec.object.to_owned(),
        base_from_object: Isometry3::identity(),
        primitive: spec.primitive.to_owned(),
        fixture_trusted: true,
        operator: String::new(),
        software: "tests".to_owned(),
        surroundings: Vec::new(),
    };
    let mut writer =
        TakeWriter::new(Cursor::new(Vec::new()), &station, &meta, 1_700_000_000_000_000_000).unwrap();
    for ms in (0..=spec.duration_ms).step_by(5) {
        let time_ns = ms * 1_000_000;
        if ms % 100 == 0 {
            writer.joints(time_ns, &[ms as f64 * 1e-4, -0.5]).unwrap();
        }
        if ms % 50 == 0 && spec.commands_from_ms.is_some_and(|from_ms| ms >= from_ms) {
            writer.commands(time_ns, &[ms as f64, 7.0]).unwrap();
        }
        if spec.moves && ms >= 100 && ms % 20 == 0 {
            writer.object_pose(time_ns, &Isometry3::translation(ms as f64 * 1e-5, 0.25, -0.5)).unwrap();
        }
        for (stream_idx, stream) in station.layout.streams.iter().enumerate() {
            let period_ms = (1e3 / stream.rate_hz) as u64;
            if ms % period_ms != 0 || (stream.id == "gel" && ms < 30) {
                continue;
            }
            let channels = 0..stream.channels.len() as u64;
            let active: Vec<bool> = channels.clone().map(|channel| ms / 500 == channel).collect();
            let raw: Vec<f32> = channels.map(|channel| (1000 * channel + ms) as f32).collect();
            let raw = if spec.with_raw { raw.as_slice() } else { &[] };
            let sample = TactileSampleRef { raw, active: &active, device_time_ns: 0 };
            writer.tactile(stream_idx, time_ns, sample).unwrap();
        }
    }
    writer.finish().unwrap().into_inner()
}

/// A session of these takes; the second says whether it is accepted.
pub(crate) fn session(dir: &Path, takes: &[(&TakeSpec, bool)]) {
    let entries = takes.iter().enumerate().map(|(idx, (spec, accepted))| SessionTake {
        file: format!("take-{:02}.mcap", idx + 1),
        object: spec.object.to_owned(),
        accepted: *accepted,
    });
    let entries: Vec<SessionTake> = entries.collect();
    fs::create_dir_all(dir).unwrap();
    for ((spec, _), entry) in takes.iter().zip(&entries) {
        fs::write(dir.join(&entry.file), take(spec)).unwrap();
    }
    let file =
        SessionFile { format: 1, station: "finger".to_owned(), recorded: String::new(), takes: entries };
    Session::create(dir, file).unwrap();
}

/// The record of a trial of half a second: frames every 50 ms, and its outcome.
pub(crate) fn record(outcome: Option<Value>) -> Vec<Value> {
    let head = json!({
        "trial": 3, "object": "cube", "station": "finger", "control_rate_hz": 20.0, "joints": ["slide", "curl"],
        "channels": ["a", "b", "c"], "begins_at": [0.5, 0.25], "policy": "p", "files": [],
    });
    let mut lines = vec![json!({ "kind": "trial", "trial": head })];
    for frame in 0..11 {
        let torque = frame >= 4;
        lines.push(json!({
            "kind": "frame", "at_s": 0.01 + 0.05 * f64::from(frame), "station_s": 1.0, "positions": [f64::from(frame), 1.0],
            "active": if frame == 5 { vec![2] } else { vec![] }, "raw": [0.0, 1.0, f64::from(frame)],
            "let_through": if torque { vec![100.0 + f64::from(frame), 2.0] } else { vec![] },
        }));
        lines.push(json!({ "kind": "answer", "number": frame, "accepted": true }));
    }
    lines.extend(outcome.map(|outcome| json!({ "kind": "outcome", "outcome": outcome })));
    lines
}

pub(crate) fn text(lines: &[Value]) -> String {
    lines.iter().map(|line| format!("{line}\n")).collect()
}

pub(crate) fn write(
    sources: &[PathBuf],
    out: &Path,
    config: LerobotConfig,
) -> Result<LerobotReport, ExportError> {
    export(sources, out, config, &NoProgress, &Cancel::default())
}

/// All rows of a table.
pub(crate) fn rows(path: &Path) -> Vec<Row> {
    let reader = SerializedFileReader::new(File::open(path).unwrap()).unwrap();
    reader.get_row_iter(None).unwrap().map(Result::unwrap).collect()
}

pub(crate) fn field<'a>(row: &'a Row, name: &str) -> &'a Field {
    row.get_column_iter().find(|(found, _)| *found == name).map(|(_, field)| field).unwrap()
}

pub(crate) fn numbers(row: &Row, name: &str) -> Vec<f64> {
    let number = |field: &Field| match field {
        Field::Float(value) => f64::from(*value),
        Field::Double(value) => *value,
        Field::Long(value) => *value as f64,
        Field::Bool(value) => f64::from(u8::from(*value)),
        other => panic!("{name} is {other:?}"),
    };
    match field(row, name) {
        Field::ListInternal(list) => list.elements().iter().map(number).collect(),
        single => vec![number(single)],
    }
}

pub(crate) fn json_of(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}
