//! Records of the trials of a rollout, JSON lines (`docs/rollouts.md`).

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::Deserialize;

use super::{
    Episode, LeftOut, Log, Origin, Outcome, RawKind, Setup, StreamSetup, Touch, file_name, folder_name,
    sha256, words,
};
use crate::{ExportError, clock::ns_from_secs};

/// No record is larger, B: an hour of frames is 100 MB.
const MAX_RECORD_BYTES: u64 = 1 << 30;

/// The first line of a record.
#[derive(Deserialize)]
struct Head {
    object: String,
    station: String,
    control_rate_hz: f64,
    joints: Vec<String>,
    channels: Vec<String>,
    begins_at: Vec<f64>,
}

/// What the stream of the studio said.
#[derive(Deserialize)]
struct Frame {
    at_s: f64,
    positions: Vec<f64>,
    active: Vec<usize>,
    raw: Vec<f32>,
    /// Empty without torque.
    let_through: Vec<f64>,
}

/// What a trial came to.
#[derive(Deserialize)]
struct Ended {
    suggested: String,
    truth: Option<Seen>,
}

/// What the operator of an emulated station saw.
#[derive(Deserialize)]
struct Seen {
    verdict: Option<String>,
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Line {
    Trial { trial: Box<Head> },
    Step {},
    Answer {},
    Frame(Frame),
    Outcome { outcome: Ended },
}

/// The records in the folder of a rollout, by name.
pub(super) fn records(dir: &Path) -> Result<Vec<PathBuf>, ExportError> {
    let entries = fs::read_dir(dir).map_err(ExportError::io("read", dir))?;
    let paths: Vec<PathBuf> = entries
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<io::Result<_>>()
        .map_err(ExportError::io("read", dir))?;
    let is_record = |path: &PathBuf| {
        let name = file_name(path);
        name.starts_with("trial-") && name.ends_with(".jsonl")
    };
    let mut records: Vec<PathBuf> = paths.into_iter().filter(is_record).collect();
    records.sort();
    Ok(records)
}

/// Reads a record; trials without an outcome, or that were void, are no episodes.
pub(super) fn read(path: &Path) -> Result<Result<Episode, LeftOut>, ExportError> {
    let len = fs::metadata(path).map_err(ExportError::io("read", path))?.len();
    if len > MAX_RECORD_BYTES {
        return Err(ExportError::content(
            path,
            format!("{len} bytes are more than a record has, {MAX_RECORD_BYTES}"),
        ));
    }
    let text = fs::read_to_string(path).map_err(ExportError::io("read", path))?;
    parse(path, &text)
}

fn parse(path: &Path, text: &str) -> Result<Result<Episode, LeftOut>, ExportError> {
    let left_out = |reason: &str| Ok(Err(LeftOut { file: path.to_owned(), reason: reason.to_owned() }));
    let wrong =
        |line: usize, problem: String| ExportError::content(path, format!("line {}: {problem}", line + 1));
    let mut head: Option<Head> = None;
    let mut ended: Option<Ended> = None;
    let (mut joints, mut commands, mut touch) = (Log::default(), Log::default(), Touch::default());
    for (idx, line) in text.split_inclusive('\n').enumerate() {
        let parsed: Line = match serde_json::from_str(line) {
            Ok(parsed) => parsed,
            // Whoever wrote it was killed in the middle of the last line.
            Err(_) if !line.ends_with('\n') && idx > 0 => break,
            Err(error) => {
                return Err(wrong(idx, format!("{error}; expected a line of the record of a trial")));
            }
        };
        match (parsed, &head) {
            (Line::Trial { trial }, None) => {
                check(&trial).map_err(|problem| wrong(idx, problem))?;
                commands.times_ns.push(0);
                commands.values.clone_from(&trial.begins_at);
                head = Some(*trial);
            }
            (Line::Trial { .. }, Some(_)) => return Err(wrong(idx, "begins another trial".to_owned())),
            (_, None) => {
                return Err(wrong(
                    idx,
                    "is none of the kind \"trial\", with which a record begins".to_owned(),
                ));
            }
            (Line::Frame(frame), Some(head)) => {
                // The stream may repeat what was there when the trial began.
                let before = joints.times_ns.last().copied();
                let time_ns = frame_time_ns(&frame, head).map_err(|problem| wrong(idx, problem))?;
                if before.is_some_and(|before| time_ns < before) {
                    return Err(wrong(idx, format!("at_s is {}, before the frame above", frame.at_s)));
                }
                if before == Some(time_ns) {
                    continue;
                }
                joints.times_ns.push(time_ns);
                joints.values.extend_from_slice(&frame.positions);
                touch.active.times_ns.push(time_ns);
                let first = touch.active.values.len();
                touch.active.values.resize(first + head.channels.len(), false);
                for channel in frame.active {
                    touch.active.values[first + channel] = true;
                }
                touch.raw.extend_from_slice(&frame.raw);
                if !frame.let_through.is_empty() && time_ns > 0 {
                    commands.times_ns.push(time_ns);
                    commands.values.extend_from_slice(&frame.let_through);
                }
            }
            (Line::Outcome { outcome }, Some(_)) => ended = Some(outcome),
            (Line::Step {} | Line::Answer {}, Some(_)) => {}
        }
    }
    let Some(head) = head else {
        return Err(ExportError::content(path, "is empty; expected the record of a trial"));
    };
    let Some(ended) = ended else { return left_out("the trial has no outcome: it was cut off") };
    let (verdict, judged_by) = match ended.truth.and_then(|seen| seen.verdict) {
        Some(verdict) => (verdict, "operator of the emulated station"),
        None => (ended.suggested, "the robot's own senses"),
    };
    let failure_mode = match verdict.as_str() {
        "success" => None,
        "EG" => Some("empty_grasp"),
        "SL" => Some("slip"),
        "ES" => Some("emergency_stop"),
        "void" => return left_out("the trial is void"),
        other => {
            let problem = format!("the outcome is {other:?}, expected success, EG, SL, ES or void");
            return Err(ExportError::content(path, problem));
        }
    };
    if joints.times_ns.is_empty() {
        return left_out("the trial has no frame");
    }
    let setup = Setup {
        station: head.station,
        rate_hz: head.control_rate_hz,
        joints: head.joints,
        streams: vec![StreamSetup {
            id: "stream".to_owned(),
            raw_unit: "unit of the channel's stream".to_owned(),
            rate_hz: head.control_rate_hz,
            channels: head.channels,
        }],
        raw: RawKind::LessReference,
    };
    Ok(Ok(Episode {
        task: format!("grasp and lift: {}", words(&head.object)),
        joints,
        commands,
        streams: vec![touch],
        object_poses: Log::default(),
        outcome: Some(Outcome {
            success: failure_mode.is_none(),
            failure_mode: failure_mode.map(str::to_owned),
            judged_by,
        }),
        origin: Origin {
            folder: folder_name(path),
            file: file_name(path),
            sha256: sha256(text.as_bytes()),
            format: "rollout_record",
            object: head.object,
            primitive: "grasp".to_owned(),
        },
        setup,
    }))
}

fn check(head: &Head) -> Result<(), String> {
    if !(head.control_rate_hz.is_finite() && head.control_rate_hz > 0.0) {
        return Err(format!("control_rate_hz is {}, expected a positive number", head.control_rate_hz));
    }
    let (found, expected) = (head.begins_at.len(), head.joints.len());
    if found != expected {
        return Err(format!("begins_at has {found} numbers, expected one per joint, {expected}"));
    }
    Ok(())
}

/// Time of a frame that fits to `head`.
fn frame_time_ns(frame: &Frame, head: &Head) -> Result<u64, String> {
    let (num_joints, num_channels) = (head.joints.len(), head.channels.len());
    let wrong = |key: &str, found: usize, of: &str, expected: usize| {
        Err(format!("{key} has {found} numbers, expected one per {of}, {expected}"))
    };
    if frame.positions.len() != num_joints {
        return wrong("positions", frame.positions.len(), "joint", num_joints);
    }
    if !frame.let_through.is_empty() && frame.let_through.len() != num_joints {
        return wrong("let_through", frame.let_through.len(), "joint", num_joints);
    }
    if frame.raw.len() != num_channels {
        return wrong("raw", frame.raw.len(), "channel", num_channels);
    }
    if let Some(channel) = frame.active.iter().find(|&&channel| channel >= num_channels) {
        return Err(format!("active names channel {channel}, expected less than {num_channels}"));
    }
    if !(frame.at_s.is_finite() && frame.at_s >= 0.0) {
        return Err(format!("at_s is {}, expected seconds since the trial began", frame.at_s));
    }
    Ok(ns_from_secs(frame.at_s))
}
