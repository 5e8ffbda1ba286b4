//! CSV import: one sub-folder a take, each stream with its own time base.
//!
//! Each sub-folder holds `take.toml`, `joints.csv` and one `<stream>.csv` for each stream of the station. All times of
//! a take are seconds on one clock; the take's time zero is the last whole second at or before its earliest sample, so
//! that files which count from zero keep their times, and files with wall-clock times keep their precision.

mod table;

use std::{
    fs,
    path::{Path, PathBuf},
};

use palpate_robot_model::{PoseConfig, Robot, Station, Stream, StreamConfig};
use serde::Deserialize;

use self::table::{Columns, Table};
use crate::{
    RecordingError, SessionDraft, SessionFile, SessionTake, Span, SpanKind, TactileSampleRef, TakeMeta,
    TakeWriter,
    decode::stream_list,
    files::{MAX_TEXT_BYTES, read_text},
    format::ns_from_secs,
    plausible,
    session::refuse_existing,
    take::reference_readings,
};

const TAKE_FILE: &str = "take.toml";
const JOINTS_FILE: &str = "joints.csv";

/// `take.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TakeConfig {
    object: String,
    object_pose: PoseConfig,
    primitive: String,
    #[serde(default)]
    repetitions_s: Vec<[f64; 2]>,
    /// What each repetition does, one for each; absent: all do what the primitive says.
    repetition_labels: Option<Vec<String>>,
    /// Needed unless the take is binary.
    baseline_s: Option<[f64; 2]>,
    #[serde(default)]
    binary: bool,
    #[serde(default = "trusted")]
    fixture_trusted: bool,
    #[serde(default)]
    operator: String,
}

fn trusted() -> bool {
    true
}

/// A take that passed every check and waits to be written.
struct CheckedTake {
    id: String,
    meta: TakeMeta,
    start_unix_ns: u64,
    joints: Table,
    /// Host time of each row, ns since the take's start.
    joint_times_ns: Vec<u64>,
    streams: Vec<CheckedStream>,
    spans: Vec<Span>,
}

struct CheckedStream {
    times_ns: Vec<u64>,
    /// `num_samples x num_channels`, row-major; empty for binary takes.
    raw: Vec<f32>,
    active: Vec<bool>,
}

/// Imports every take under `csv_dir` into a new session at `session_dir`, which must not exist.
///
/// Everything is read and checked before anything is written; on an error nothing is left on disk.
/// Gives the path of the session.
pub fn import_csv(station: &Station, csv_dir: &Path, session_dir: &Path) -> Result<PathBuf, RecordingError> {
    refuse_existing(session_dir)?;
    let mut takes = Vec::new();
    for take_dir in take_dirs(csv_dir)? {
        let take = read_take(station, &take_dir)?;
        if let Some(other) = takes.iter().find(|other: &&CheckedTake| other.id == take.id) {
            let problem = format!("would be called {:?} like another take; rename the folder", other.id);
            return Err(RecordingError::content(&take_dir, "folder", problem));
        }
        takes.push(take);
    }

    let draft = SessionDraft::new(session_dir)?;
    let mut entries = Vec::with_capacity(takes.len());
    for take in &takes {
        let file = format!("{}.mcap", take.id);
        write_take(station, take, &draft.partial_dir().join(&file))?;
        entries.push(SessionTake { file, object: take.meta.object.clone(), accepted: true });
    }
    let session = draft.commit(SessionFile {
        format: 1,
        station: station.id.clone(),
        recorded: String::new(),
        takes: entries,
    })?;
    Ok(session.dir)
}

/// Sub-folders with a take, by name.
fn take_dirs(csv_dir: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let mut dirs = Vec::new();
    for entry in fs::read_dir(csv_dir).map_err(RecordingError::io("read", csv_dir))? {
        let path = entry.map_err(RecordingError::io("read", csv_dir))?.path();
        let hidden = path.file_name().is_none_or(|name| name.as_encoded_bytes().starts_with(b"."));
        if path.is_dir() && !hidden {
            dirs.push(path);
        }
    }
    dirs.sort();
    if dirs.is_empty() {
        let problem = format!(
            "no take; put each take's {TAKE_FILE}, {JOINTS_FILE} and streams in a sub-folder of its own"
        );
        return Err(RecordingError::content(csv_dir, "folder", problem));
    }
    Ok(dirs)
}

fn read_take(station: &Station, dir: &Path) -> Result<CheckedTake, RecordingError> {
    let config_path = dir.join(TAKE_FILE);
    let config_error = |key: &str, problem: String| RecordingError::content(&config_path, key, problem);
    let text = read_text(&config_path, MAX_TEXT_BYTES)?;
    let config: TakeConfig = toml::from_str(&text).map_err(RecordingError::toml(&config_path, &text))?;
    if !station.objects.contains_key(&config.object) {
        let known: Vec<String> = station.objects.keys().map(|id| format!("{id:?}")).collect();
        let problem = format!(
            "unknown object {:?}; station {:?} knows {}",
            config.object,
            station.id,
            known.join(", ")
        );
        return Err(config_error("object", problem));
    }
    let base_from_object =
        config.object_pose.to_isometry().map_err(|problem| config_error("object_pose", problem))?;
    if let Some(problem) = plausible::out_of_reach(&station.robot, &base_from_object) {
        return Err(config_error("object_pose", problem));
    }
    refuse_foreign_files(station, dir)?;

    let joint_ids: Vec<String> = station.robot.dofs().map(|joint| joint.name.clone()).collect();
    let joint_columns = Columns { prefix: 'q', ids: &joint_ids, what: "joint", binary: false };
    let joints_path = dir.join(JOINTS_FILE);
    let joints = Table::read(&joints_path, &joint_columns)?;
    check_joints(&station.robot, &joints_path, &joint_columns, &joints)?;
    let mut tables = Vec::with_capacity(station.layout.streams.len());
    for stream in &station.layout.streams {
        let path = dir.join(format!("{}.csv", stream.id));
        let channel_ids: Vec<String> = station.layout.channels[stream.channels.clone()]
            .iter()
            .map(|channel| channel.id.clone())
            .collect();
        let columns = Columns { prefix: 'v', ids: &channel_ids, what: "channel", binary: config.binary };
        let table = Table::read(&path, &columns)?;
        if !config.binary {
            check_readings(stream, &station.streams[tables.len()], &path, &columns, &table)?;
        }
        tables.push((path, table));
    }

    let all =
        || std::iter::once((&joints_path, &joints)).chain(tables.iter().map(|(path, table)| (path, table)));
    let first_s = all().map(|(_, table)| table.times_s[0]).fold(f64::INFINITY, f64::min);
    let last_s = all().filter_map(|(_, table)| table.times_s.last().copied()).fold(first_s, f64::max);
    let zero_s = first_s.floor();

    let mut spans = Vec::new();
    let labelled = |kind, label: &str, [start_s, end_s]: [f64; 2]| Span {
        kind,
        start_s: start_s - zero_s,
        end_s: end_s - zero_s,
        label: label.to_owned(),
    };
    if let Some(labels) = &config.repetition_labels
        && labels.len() != config.repetitions_s.len()
    {
        let problem = format!(
            "{} labels for {} spans of repetitions_s; give one for each, alike for repetitions of the same motion, or leave \
             them out",
            labels.len(),
            config.repetitions_s.len()
        );
        return Err(config_error("repetition_labels", problem));
    }
    for (span_idx, &span) in config.repetitions_s.iter().enumerate() {
        check_span(span, first_s, last_s)
            .map_err(|problem| config_error(&format!("repetitions_s, span {}", span_idx + 1), problem))?;
        let label = config.repetition_labels.as_ref().map_or(&config.primitive, |labels| &labels[span_idx]);
        spans.push(labelled(SpanKind::Repetition, label, span));
    }
    match config.baseline_s {
        Some(span) => {
            check_span(span, first_s, last_s).map_err(|problem| config_error("baseline_s", problem))?;
            spans.push(labelled(SpanKind::Baseline, "", span));
        }
        None if config.binary => {}
        None => {
            let problem = "missing; raw readings need a span without touch, from which reference values come: \
                           baseline_s = [t0, t1]";
            return Err(config_error("baseline_s", problem.to_owned()));
        }
    }
    spans.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));

    let joint_times_ns = times_ns(&joints_path, &joints, zero_s)?;
    let mut streams = Vec::with_capacity(tables.len());
    for (stream_idx, (path, table)) in tables.iter().enumerate() {
        if let Some([start_s, end_s]) = config.baseline_s.filter(|_| !config.binary)
            && !table.times_s.iter().any(|&time_s| start_s <= time_s && time_s <= end_s)
        {
            let stream = &station.layout.streams[stream_idx].id;
            let problem =
                format!("no sample of stream {stream:?} lies within {start_s}..{end_s} s; move the span");
            return Err(config_error("baseline_s", problem));
        }
        streams.push(check_stream(station, stream_idx, path, table, zero_s, config.binary, &spans)?);
    }

    let meta = TakeMeta {
        object: config.object,
        base_from_object,
        primitive: config.primitive,
        fixture_trusted: config.fixture_trusted,
        operator: config.operator,
        software: concat!("palpate ", env!("CARGO_PKG_VERSION"), " (CSV import)").to_owned(),
    };
    // Wall-clock times stay what they were; times that count from some start have none.
    let start_unix_ns = ns_from_secs(zero_s).unwrap_or(0);
    Ok(CheckedTake { id: take_id(dir)?, meta, start_unix_ns, joints, joint_times_ns, streams, spans })
}

/// The folder's name as a file stem that is safe in addresses too.
fn take_id(dir: &Path) -> Result<String, RecordingError> {
    let name = dir.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let id: String = name
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '-' })
        .collect();
    if id.chars().any(|c| c.is_ascii_alphanumeric()) {
        Ok(id)
    } else {
        let problem = "has no letter or digit in its name, from which the take's id comes; rename it";
        Err(RecordingError::content(dir, "folder", problem))
    }
}

/// Refuses CSV files that are no stream of the station: most likely it is the wrong station, or a misspelt name.
fn refuse_foreign_files(station: &Station, dir: &Path) -> Result<(), RecordingError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(dir).map_err(RecordingError::io("read", dir))? {
        let entry = entry.map_err(RecordingError::io("read", dir))?;
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    for name in names.iter().filter(|name| *name != JOINTS_FILE && !name.starts_with('.')) {
        if let Some(stream) = name.strip_suffix(".csv")
            && station.layout.stream_index(stream).is_none()
        {
            let problem = format!(
                "station {:?} has no stream {stream:?}, only {}; import with the station that recorded it",
                station.id,
                stream_list(station)
            );
            return Err(RecordingError::content(dir.join(name), "file", problem));
        }
    }
    Ok(())
}

fn check_span([start_s, end_s]: [f64; 2], first_s: f64, last_s: f64) -> Result<(), String> {
    if !(start_s.is_finite() && end_s.is_finite()) {
        return Err(format!("[{start_s}, {end_s}] must be finite"));
    }
    if end_s <= start_s {
        return Err(format!("[{start_s}, {end_s}] ends before it starts"));
    }
    if end_s < first_s || start_s > last_s || start_s < first_s.floor() {
        return Err(format!("[{start_s}, {end_s}] lies outside the recording, {first_s}..{last_s} s"));
    }
    Ok(())
}

/// Refuses positions that the joints cannot have.
fn check_joints(
    robot: &Robot,
    path: &Path,
    columns: &Columns<'_>,
    table: &Table,
) -> Result<(), RecordingError> {
    let num_dofs = robot.num_dofs();
    for (row, &line) in table.lines.iter().enumerate() {
        for (dof, (joint, &position)) in robot.dofs().zip(table.row(row, num_dofs)).enumerate() {
            let Some(limits) = plausible::exceeded_limits(joint, position) else { continue };
            let mut problem = plausible::outside_limits(joint, position, &limits);
            if plausible::are_degrees(robot, &table.values) {
                problem = format!("{}: {}", plausible::short(position), plausible::DEGREES);
            }
            return Err(RecordingError::content(path, columns.place(line, dof), problem));
        }
    }
    Ok(())
}

/// Refuses readings that the device cannot give.
fn check_readings(
    stream: &Stream,
    config: &StreamConfig,
    path: &Path,
    columns: &Columns<'_>,
    table: &Table,
) -> Result<(), RecordingError> {
    let num_channels = stream.channels.len();
    for (cell, &reading) in table.values.iter().enumerate() {
        if let Some(problem) = plausible::below_range(config, reading, &stream.raw_unit) {
            let place = columns.place(table.lines[cell / num_channels], cell % num_channels);
            return Err(RecordingError::content(path, place, problem));
        }
    }
    Ok(())
}

fn times_ns(path: &Path, table: &Table, zero_s: f64) -> Result<Vec<u64>, RecordingError> {
    let mut times_ns = Vec::with_capacity(table.times_s.len());
    for (&time_s, line) in table.times_s.iter().zip(&table.lines) {
        let error = |problem: &str| {
            Err(RecordingError::content(
                path,
                format!("line {line}, column 1 (t_s)"),
                format!("{time_s} s {problem}"),
            ))
        };
        let Some(time_ns) = ns_from_secs(time_s - zero_s) else {
            return error("is too far from the other times of the take; all files must share one clock");
        };
        if times_ns.last().is_some_and(|&last_ns| time_ns <= last_ns) {
            return error("is less than 1 ns after the row before; times must increase");
        }
        times_ns.push(time_ns);
    }
    Ok(times_ns)
}

fn check_stream(
    station: &Station,
    stream_idx: usize,
    path: &Path,
    table: &Table,
    zero_s: f64,
    binary: bool,
    spans: &[Span],
) -> Result<CheckedStream, RecordingError> {
    let num_channels = station.layout.streams[stream_idx].channels.len();
    let times_ns = times_ns(path, table, zero_s)?;
    if binary {
        let active = table.values.iter().map(|&value| value == 1.0).collect();
        return Ok(CheckedStream { times_ns, raw: Vec::new(), active });
    }
    let raw: Vec<f32> = table.values.iter().map(|&value| value as f32).collect();
    if let Some(cell) = raw.iter().position(|reading| !reading.is_finite()) {
        let place = format!("line {}, column {}", table.lines[cell / num_channels], cell % num_channels + 2);
        return Err(RecordingError::content(path, place, format!("{} is too large", table.values[cell])));
    }
    // The times as the reader will see them, so that both find the same reference.
    let times_s: Vec<f64> = times_ns.iter().map(|&time_ns| crate::format::secs_from_ns(time_ns)).collect();
    let reference = reference_readings(&times_s, &raw, num_channels, spans);
    let active = activations(&station.streams[stream_idx], &raw, &reference);
    Ok(CheckedStream { times_ns, raw, active })
}

/// Firmware's rule: on above `on_threshold` over the reference, off again below `off_threshold`, else as before.
///
/// `raw` is `num_samples x num_channels`, row-major; `reference` has one reading per channel.
fn activations(config: &StreamConfig, raw: &[f32], reference: &[f32]) -> Vec<bool> {
    let num_channels = reference.len().max(1);
    let mut state = vec![false; num_channels];
    let mut active = Vec::with_capacity(raw.len());
    for (cell, &reading) in raw.iter().enumerate() {
        let channel = cell % num_channels;
        let excess = f64::from(reading) - f64::from(reference[channel]);
        if excess > config.on_threshold {
            state[channel] = true;
        } else if excess < config.off_threshold || config.off_threshold >= config.on_threshold {
            state[channel] = false;
        }
        active.push(state[channel]);
    }
    active
}

/// What comes next in a take: a joint frame, or a sample of a stream.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Source {
    Joints,
    Stream(usize),
}

fn write_take(station: &Station, take: &CheckedTake, path: &Path) -> Result<(), RecordingError> {
    let num_dofs = station.robot.num_dofs();
    let file = fs::File::create_new(path).map_err(RecordingError::io("write", path))?;
    let mut writer = TakeWriter::new(std::io::BufWriter::new(file), station, &take.meta, take.start_unix_ns)?;
    for span in &take.spans {
        writer.span(span)?;
    }

    // In the order of arrival, as a live recording would have it.
    let mut order: Vec<(u64, Source, usize)> = Vec::new();
    order
        .extend(take.joint_times_ns.iter().enumerate().map(|(row, &time_ns)| (time_ns, Source::Joints, row)));
    for (stream_idx, stream) in take.streams.iter().enumerate() {
        let source = Source::Stream(stream_idx);
        order.extend(stream.times_ns.iter().enumerate().map(|(row, &time_ns)| (time_ns, source, row)));
    }
    order.sort_unstable();
    for (time_ns, source, row) in order {
        match source {
            Source::Joints => writer.joints(time_ns, take.joints.row(row, num_dofs))?,
            Source::Stream(stream_idx) => {
                let stream = &take.streams[stream_idx];
                let num_channels = station.layout.streams[stream_idx].channels.len();
                let row_cells = row * num_channels..(row + 1) * num_channels;
                let sample = TactileSampleRef {
                    raw: stream.raw.get(row_cells.clone()).unwrap_or_default(),
                    active: &stream.active[row_cells],
                    device_time_ns: 0,
                };
                writer.tactile(stream_idx, time_ns, sample)?;
            }
        }
    }
    let file = writer.finish()?.into_inner().map_err(|error| error.into_error());
    let synced = file.and_then(|file| file.sync_all());
    synced.map_err(RecordingError::io("write", path))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(on_threshold: f64, off_threshold: f64) -> StreamConfig {
        StreamConfig { stream: "pad".to_owned(), on_threshold, off_threshold, raw_min: 0.0, raw_max: 4095.0 }
    }

    #[test]
    fn a_channel_stays_on_between_the_two_thresholds() {
        // Two channels, the second rests at 100.
        let raw = [0.0, 100.0, 21.0, 115.0, 15.0, 121.0, 9.0, 115.0, 15.0, 109.0_f32];
        let active = activations(&config(20.0, 10.0), &raw, &[0.0, 100.0]);
        assert_eq!(active, [false, false, true, false, true, true, false, true, false, false]);
    }

    #[test]
    fn without_hysteresis_only_the_reading_counts() {
        let raw = [20.0, 20.5, 20.0, 19.0, 30.0_f32];
        assert_eq!(activations(&config(20.0, 20.0), &raw, &[0.0]), [false, true, false, false, true]);
    }
}
