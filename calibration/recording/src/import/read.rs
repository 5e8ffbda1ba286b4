//! One take, from its files to what is written; everything is checked here.

use std::path::Path;

use nalgebra::Isometry3;
use palpate_robot_model::{PoseConfig, Robot, Station};

use super::{
    ImportOptions,
    assemble::{self, Assembled, Part},
    axes,
    columns::{Cell, TimeSource},
    config::Mapping,
    files::{self, Opened, OpenedColumns, TakeSource},
    firmware::activations,
    name_pattern::nearest,
    poses::{self, POSE_WHAT},
    report::{ColumnReport, FileReport, IgnoredColumn, TakeReport},
    sheet, spans,
    table::{Columns, Table},
    targets::{Names, Scope, Target},
};
use crate::{
    RecordingError, Span, SpanKind, StreamLog, TakeMeta,
    check::{JOINTS, stream_check},
    format::{ns_from_secs, secs_from_ns},
    plausible,
};

/// A take that passed every check and waits to be written.
pub(super) struct CheckedTake {
    pub(super) id: String,
    pub(super) meta: TakeMeta,
    pub(super) start_unix_ns: u64,
    pub(super) joints: Table,
    /// Host time of each row, ns since the take's start.
    pub(super) joint_times_ns: Vec<u64>,
    /// Where a moving object is, ns since the take's start.
    pub(super) object_poses: Vec<(u64, Isometry3<f64>)>,
    pub(super) streams: Vec<CheckedStream>,
    pub(super) spans: Vec<Span>,
    /// What was changed or put together on the way, for the take's log.
    pub(super) notes: Vec<String>,
}

pub(super) struct CheckedStream {
    pub(super) times_ns: Vec<u64>,
    /// `num_samples x num_channels`, row-major; empty for binary takes.
    pub(super) raw: Vec<f32>,
    pub(super) active: Vec<bool>,
    /// `num_samples x num_channels x num_axes`, row-major; empty for streams of one axis.
    pub(super) axes: Vec<f32>,
}

/// Refuses a take whose object `station` does not know, as far as it is said.
pub(super) fn check_object(
    station: &Station,
    source: &TakeSource,
    mapping: Option<&Mapping>,
) -> Result<(), RecordingError> {
    match source.config(mapping)?.object {
        Some(object) if !station.objects.contains_key(&object) => {
            Err(unknown_object(station, source, &object))
        }
        _ => Ok(()),
    }
}

fn unknown_object(station: &Station, source: &TakeSource, object: &str) -> RecordingError {
    let known: Vec<String> = station.objects.keys().map(|id| format!("{id:?}")).collect();
    let near = nearest(object, station.objects.keys().map(String::as_str));
    let near = near.map(|near| format!("; is it {near:?}?")).unwrap_or_default();
    let problem =
        format!("unknown object {object:?}; station {:?} knows {}{near}", station.id, known.join(", "));
    RecordingError::content(&source.config_path, "object", problem)
}

/// Refuses a take whose files lack joints or channels of `station`.
pub(super) fn check_columns(
    station: &Station,
    source: &TakeSource,
    mapping: Option<&Mapping>,
) -> Result<(), RecordingError> {
    let binary = source.config(mapping)?.binary.unwrap_or(false);
    let names = Names { station, binary };
    let opened = files::open(station, source, mapping)?;
    let mut held = Vec::with_capacity(opened.len());
    for file in &opened {
        held.push(match &file.columns {
            OpenedColumns::Assigned(assignment) => {
                let ignored: Vec<String> =
                    assignment.ignored.iter().map(|(_, header, _)| header.clone()).collect();
                (assignment.cells.clone(), ignored)
            }
            OpenedColumns::Numbered(scope) => {
                let (columns, cells) = numbered_columns(names, *scope, false);
                Table::check_header(&file.path, &file.bytes, &columns)?;
                (cells, Vec::new())
            }
        });
    }
    let files: Vec<_> = opened
        .iter()
        .zip(&held)
        .map(|(file, (cells, ignored))| (&file.path, cells.as_slice(), ignored.as_slice()))
        .collect();
    let mut fixed = fixed_joints(station, mapping)?;
    let following = assemble::following(station, held.iter().flat_map(|(cells, _)| cells), &fixed);
    fixed.extend(following.iter().map(|&(dof, ..)| (dof, 0.0)));
    let joints: Vec<Target> = (0..station.robot.num_dofs()).map(Target::Joint).collect();
    assemble::check_complete(station, &files, &joints, &fixed)?;
    let channels: Vec<Target> =
        (0..station.layout.num_channels()).flat_map(|channel| names.of_channel(channel)).collect();
    assemble::check_complete(station, &files, &channels, &[])
}

/// Reads and checks one take. `report` holds what was understood, also where it ends with an error.
pub(super) fn take(
    station: &Station,
    source: &TakeSource,
    options: ImportOptions<'_>,
    report: &mut TakeReport,
) -> Result<CheckedTake, RecordingError> {
    let mapping = options.mapping;
    report.take.clone_from(&source.name);
    report.repetitions_from = "none".to_owned();
    let config_error =
        |key: &str, problem: String| RecordingError::content(&source.config_path, key, problem);
    let config = source.config(mapping)?;
    let missing = |field: &str| {
        let hint = if mapping.is_some() { ", which a [[take]] of the mapping file may give too" } else { "" };
        config_error("file", format!("missing field `{field}`{hint}"))
    };
    let object = config.object.clone().ok_or_else(|| missing("object"))?;
    // A file may say where the object is instead.
    let mut opened = None;
    if config.object_pose.is_none() {
        let files = files::open(station, source, mapping)?;
        if !files.iter().any(Opened::has_poses) {
            return Err(missing("object_pose"));
        }
        opened = Some(files);
    }
    let primitive = config.primitive.clone().ok_or_else(|| missing("primitive"))?;
    let binary = config.binary.unwrap_or(false);
    let fixture_trusted = config.fixture_trusted.unwrap_or(true);
    report.object.clone_from(&object);
    report.primitive.clone_from(&primitive);
    (report.binary, report.fixture_trusted) = (binary, fixture_trusted);
    if !station.objects.contains_key(&object) {
        return Err(unknown_object(station, source, &object));
    }
    let told = config.object_pose.as_ref().map(PoseConfig::to_isometry).transpose();
    let told = told.map_err(|problem| config_error("object_pose", problem))?;
    if let Some(problem) = told.as_ref().and_then(|pose| plausible::out_of_reach(&station.robot, pose)) {
        return Err(config_error("object_pose", problem));
    }

    let names = Names { station, binary };
    let mut parts = Vec::new();
    let opened = match opened {
        Some(opened) => opened,
        None => files::open(station, source, mapping)?,
    };
    for file in opened {
        let (part, understood) = read_part(names, file)?;
        warn_of_columns(&understood, report);
        report.files.push(understood);
        check_clock(station, &part)?;
        parts.push(part);
    }
    let fixed = fixed_joints(station, mapping)?;
    let following = assemble::following(station, parts.iter().flat_map(|part| &part.cells), &fixed);
    let joints = assemble::joints(station, &parts, &fixed, &following)?;
    check_joints(&station.robot, &parts, &joints)?;
    if !fixed.is_empty() {
        let fixed: Vec<_> = fixed.iter().map(|&(dof, _)| names.id(Target::Joint(dof))).collect();
        report.notes.push(format!("fixed, not recorded: {}", fixed.join(", ")));
    }
    for &(dof, followed, mimic) in &following {
        let id = |dof: usize| names.id(Target::Joint(dof));
        report.notes.push(format!(
            "joint {:?} was not recorded; it follows {:?}: times {}, plus {}, as the URDF says",
            id(dof),
            id(followed),
            mimic.multiplier,
            mimic.offset
        ));
    }
    let mut streams = Vec::with_capacity(station.layout.streams.len());
    for stream_idx in 0..station.layout.streams.len() {
        streams.push(assemble::stream(names, &parts, stream_idx)?);
    }
    if !binary {
        for part in &parts {
            check_readings(station, part)?;
        }
    }
    let object_path = assemble::object(station, &parts)?;
    let poses = match &object_path {
        Some(assembled) => poses::read(station, assembled, told.as_ref(), report)?,
        None => Vec::new(),
    };
    report
        .notes
        .extend(std::iter::once(&joints).chain(&streams).filter_map(|assembled| assembled.note.clone()));
    report.notes.extend(parts.iter().flat_map(mirrored_notes));

    let all = || {
        let assembled = std::iter::once(&joints).chain(&streams).chain(&object_path);
        assembled.map(|assembled| &assembled.table.times_s)
    };
    let first_s = all().map(|times_s| times_s[0]).fold(f64::INFINITY, f64::min);
    let last_s = all().filter_map(|times_s| times_s.last().copied()).fold(first_s, f64::max);
    let zero_s = first_s.floor();
    (report.first_s, report.last_s) = (first_s, last_s);
    let rates_hz = station.layout.streams.iter().map(|stream| (stream.id.as_str(), stream.rate_hz));
    report.streams = std::iter::once((JOINTS, station.joint_rate_hz))
        .chain(rates_hz)
        .zip(all())
        .map(|((id, rate_hz), times_s)| stream_check(id, times_s, rate_hz))
        .collect();

    let baselines_s = spans::baselines(&config, binary, [first_s, last_s], &config_error)?;
    report.baseline_s = baselines_s.first().copied();
    report.later_baselines_s = baselines_s.iter().skip(1).copied().collect();
    report.repetitions =
        spans::repetitions(&config, &primitive, options, &joints, [first_s, last_s], &config_error)?;
    if !report.repetitions.is_empty() {
        let marked = config.repetitions_s.is_some();
        report.repetitions_from = if marked { "marks" } else { "joint path" }.to_owned();
    }
    let span = |kind, label: &str, start_s: f64, end_s: f64| Span {
        kind,
        start_s: start_s - zero_s,
        end_s: end_s - zero_s,
        label: label.to_owned(),
    };
    let mut spans: Vec<Span> = report
        .repetitions
        .iter()
        .map(|repetition| span(SpanKind::Repetition, &repetition.label, repetition.start_s, repetition.end_s))
        .collect();
    spans.extend(baselines_s.iter().map(|&[start_s, end_s]| span(SpanKind::Baseline, "", start_s, end_s)));
    spans.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));

    let joint_times_ns = times_ns(&joints.path, &joints.table, zero_s)?;
    let mut checked_streams = Vec::with_capacity(streams.len());
    for (stream_idx, assembled) in streams.iter().enumerate() {
        let has_sample = |&[start_s, end_s]: &[f64; 2]| {
            assembled.table.times_s.iter().any(|&time_s| start_s <= time_s && time_s <= end_s)
        };
        if let Some([start_s, end_s]) = baselines_s.iter().find(|span| !binary && !has_sample(span)) {
            let stream = &station.layout.streams[stream_idx].id;
            let problem =
                format!("no sample of stream {stream:?} lies within {start_s}..{end_s} s; move the span");
            return Err(config_error("baseline_s", problem));
        }
        let of_axes = !binary && station.layout.streams[stream_idx].axes.count() > 1;
        let reduced = of_axes.then(|| axes::readings(station, stream_idx, assembled, &baselines_s, report));
        let (assembled, axes) = match reduced.transpose()? {
            Some((readings, axes)) => (&Assembled { table: readings, ..assembled.clone() }, axes),
            None => (assembled, Vec::new()),
        };
        let checked = check_stream(station, stream_idx, assembled, zero_s, binary, &spans, report)?;
        checked_streams.push(CheckedStream { axes, ..checked });
    }

    let object_poses = match &object_path {
        Some(Assembled { path, table, .. }) => {
            times_ns(path, table, zero_s)?.into_iter().zip(poses).collect()
        }
        None => Vec::new(),
    };
    let first_pose = object_poses.first().map(|(_, pose)| *pose);
    let meta = TakeMeta {
        object,
        base_from_object: first_pose.or(told).ok_or_else(|| missing("object_pose"))?,
        primitive,
        fixture_trusted,
        operator: config.operator.unwrap_or_default(),
        software: concat!("palpate ", env!("CARGO_PKG_VERSION"), " (CSV import)").to_owned(),
        surroundings: Vec::new(),
    };
    let id = take_id(source)?;
    report.take.clone_from(&id);
    Ok(CheckedTake {
        id,
        meta,
        // Wall-clock times stay what they were; times that count from some start have none.
        start_unix_ns: ns_from_secs(zero_s).unwrap_or(0),
        joints: joints.table,
        joint_times_ns,
        object_poses,
        streams: checked_streams,
        spans,
        notes: report.notes.clone(),
    })
}

/// Columns of the oldest form: `t_s`, then everything of the scope in the station's order.
fn numbered_columns(names: Names<'_>, scope: Scope, binary: bool) -> (Columns, Vec<Cell>) {
    let targets = names.of(scope);
    let (prefix, what) = if scope == Scope::Joints { ('q', "joint") } else { ('v', "channel") };
    let ids = targets.iter().map(|(_, id)| id.to_string()).collect();
    let cells = targets
        .iter()
        .enumerate()
        .map(|(idx, &(target, ref id))| Cell {
            target,
            id: id.to_string(),
            column: idx + 1,
            header: format!("{prefix}{idx}"),
            unit: names.unit(target).to_owned(),
            to_unit: names.unit(target).to_owned(),
            scale: 1.0,
            offset: 0.0,
            mirrored_in: None,
        })
        .collect();
    (Columns { prefix, ids, what, binary }, cells)
}

fn read_part(names: Names<'_>, file: Opened) -> Result<(Part, FileReport), RecordingError> {
    let binary = names.binary;
    let Opened { path, bytes, config, columns } = file;
    let is_numbered = matches!(columns, OpenedColumns::Numbered(_));
    let (table, cells, ignored, time, columns_by) = match columns {
        OpenedColumns::Numbered(scope) => {
            let binary = binary && scope != Scope::Joints;
            let (columns, cells) = numbered_columns(names, scope, binary);
            let table = Table::parse(&path, &bytes, &columns)?;
            (table, cells, Vec::new(), "column 1 (t_s), s".to_owned(), "number, in the station's order")
        }
        OpenedColumns::Assigned(assignment) => {
            let table = sheet::values(&path, &bytes, &config, &assignment, binary)?;
            let time = match &assignment.time {
                TimeSource::Column { column, header, unit, .. } if header.is_empty() => {
                    format!("column {}, {unit}", column + 1)
                }
                TimeSource::Column { column, header, unit, .. } => {
                    format!("column {} ({header}), {unit}", column + 1)
                }
                TimeSource::Rate { rate_hz, .. } => format!("{rate_hz} Hz, as the mapping file says"),
            };
            let by = if config.map.iter().any(|map| map.get_ref().columns.is_some()) {
                "the mapping file"
            } else {
                "name"
            };
            (table, assignment.cells, assignment.ignored, time, by)
        }
    };
    let column = |(idx, cell): (usize, &Cell)| {
        let values =
            || table.values.iter().skip(idx).step_by(cells.len()).copied().filter(|value| !value.is_nan());
        let (min, max) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        ColumnReport {
            column: cell.column + 1,
            header: cell.header.clone(),
            what: cell.what(),
            id: cell.id.clone(),
            unit: cell.unit.clone(),
            to_unit: cell.to_unit.clone(),
            scale: cell.scale,
            offset: cell.offset,
            polarity: if cell.mirrored_in.is_some() { -1 } else { 1 },
            // JSON has no infinities, which a column of empty cells would give.
            min: if min.is_finite() { min } else { 0.0 },
            max: if max.is_finite() { max } else { 0.0 },
            constant: min >= max,
        }
    };
    let report = FileReport {
        file: path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        columns_by: columns_by.to_owned(),
        rows: table.times_s.len(),
        time,
        first_s: table.times_s.first().copied().unwrap_or_default(),
        last_s: table.times_s.last().copied().unwrap_or_default(),
        columns: cells.iter().enumerate().map(column).collect(),
        ignored: ignored
            .iter()
            .map(|(column, header, nearest)| IgnoredColumn {
                column: column + 1,
                header: header.clone(),
                nearest: nearest.clone(),
            })
            .collect(),
    };
    let ignored = ignored.into_iter().map(|(_, header, _)| header).collect();
    Ok((Part { path, cells, table, ignored, is_numbered }, report))
}

/// Warns of columns that nobody reads and of those that say nothing.
fn warn_of_columns(file: &FileReport, report: &mut TakeReport) {
    for ignored in &file.ignored {
        let near =
            ignored.nearest.as_ref().map(|near| format!(", although {near:?} is near")).unwrap_or_default();
        let known = if file.columns.iter().all(|column| column.what == POSE_WHAT) {
            "number of a pose"
        } else {
            "joint or channel of the station"
        };
        let FileReport { file, .. } = file;
        report.warnings.push(format!(
            "{file}: column {} {:?} is no {known}{near}; ignored",
            ignored.column, ignored.header
        ));
    }
    if file.rows < 2 || report.binary {
        return;
    }
    for what in ["joint", "channel", "axis"] {
        let constant: Vec<String> = file
            .columns
            .iter()
            .filter(|column| column.constant && column.what == what)
            .map(|column| {
                format!(
                    "{:?} ({} {})",
                    column.id,
                    plausible::short((column.min * 1e6).round() / 1e6),
                    column.to_unit
                )
            })
            .collect();
        if !constant.is_empty() {
            let hint = if what == "joint" { "did it stand still?" } else { "is it connected?" };
            report.warnings.push(format!(
                "{}: {what} {} never changes; {hint}",
                file.file,
                constant.join(", ")
            ));
        }
    }
}

fn fixed_joints(station: &Station, mapping: Option<&Mapping>) -> Result<Vec<(usize, f64)>, RecordingError> {
    let Some(mapping) = mapping else { return Ok(Vec::new()) };
    let fixed = mapping.config.fixed_joints.iter().map(|(name, &position)| {
        let joints = || station.robot.dofs().map(|joint| joint.name.as_str());
        joints().position(|joint| joint == name.get_ref()).map(|dof| (dof, position)).ok_or_else(|| {
            let near = nearest(name.get_ref(), joints())
                .map(|near| format!("; is it {near:?}?"))
                .unwrap_or_default();
            let problem = format!("station {:?} has no joint {:?}{near}", station.id, name.get_ref());
            mapping.error(name.span(), "fixed_joints", problem)
        })
    });
    fixed.collect()
}

/// How many times faster or slower than the station says a file may be sampled before its times are in another unit.
const MAX_RATE_RATIO: f64 = 300.0;

/// Refuses times whose unit cannot be the one that was assumed.
fn check_clock(station: &Station, part: &Part) -> Result<(), RecordingError> {
    let times_s = &part.table.times_s;
    let nominal_hz = part.cells.iter().map(|cell| match cell.target {
        Target::Joint(_) => station.joint_rate_hz,
        Target::Channel(channel) | Target::Axis(channel, _) => {
            station.layout.streams[station.layout.channels[channel].stream].rate_hz
        }
        // Trackers are about as fast.
        Target::Object(_) => station.joint_rate_hz,
    });
    let nominal_hz = nominal_hz.fold(0.0, f64::max);
    let (Some(first_s), Some(last_s)) = (times_s.first(), times_s.last()) else { return Ok(()) };
    if times_s.len() < 3 || nominal_hz <= 0.0 || part.is_numbered {
        return Ok(());
    }
    let rate_hz = (times_s.len() - 1) as f64 / (last_s - first_s);
    let ratio = rate_hz / nominal_hz;
    if ratio * MAX_RATE_RATIO > 1.0 && ratio < MAX_RATE_RATIO {
        return Ok(());
    }
    let guess = match ratio.recip() {
        slower if slower > 3e7 => "ns",
        slower if slower > 3e4 => "us",
        slower if slower > 1.0 => "ms",
        _ => "s",
    };
    let problem = format!(
        "{rate_hz:.3e} rows a second, the station says {nominal_hz} Hz; the unit of the times must be another one, perhaps \
         {guess}: call the column t_{guess}, or give time = {{ unit = {guess:?} }} in a mapping file"
    );
    Err(RecordingError::content(&part.path, "times", problem))
}

/// Refuses positions that the joints cannot have.
fn check_joints(robot: &Robot, parts: &[Part], joints: &Assembled) -> Result<(), RecordingError> {
    for part in parts {
        for (row, &line) in part.table.lines.iter().enumerate() {
            let values = part.table.row(row, part.cells.len());
            for (cell, &position) in part.cells.iter().zip(values).filter(|(_, position)| !position.is_nan())
            {
                let Target::Joint(dof) = cell.target else { continue };
                let Some(joint) = robot.dofs().nth(dof) else { continue };
                let Some(limits) = plausible::exceeded_limits(joint, position) else { continue };
                let mut problem = plausible::outside_limits(joint, position, &limits);
                if plausible::are_degrees(robot, &joints.table.values) {
                    problem = format!("{}: {}", plausible::short(position), plausible::DEGREES);
                }
                return Err(RecordingError::content(&part.path, cell.place(line), problem));
            }
        }
    }
    Ok(())
}

/// Refuses readings that the device cannot give.
fn check_readings(station: &Station, part: &Part) -> Result<(), RecordingError> {
    let layout = &station.layout;
    for (row, &line) in part.table.lines.iter().enumerate() {
        for (cell, &reading) in part.cells.iter().zip(part.table.row(row, part.cells.len())) {
            let Some(channel) = cell.target.channel() else { continue };
            let stream_idx = layout.channels[channel].stream;
            let (config, unit) = (&station.streams[stream_idx], &layout.streams[stream_idx].raw_unit);
            if !(reading as f32).is_finite() && !reading.is_nan() {
                let problem = format!("{} is too large", plausible::short(reading));
                return Err(RecordingError::content(&part.path, cell.place(line), problem));
            }
            // The range is that of the reading, which axes are yet to become.
            let is_reading = matches!(cell.target, Target::Channel(_));
            if let Some(problem) = plausible::below_range(config, reading, unit).filter(|_| is_reading) {
                return Err(RecordingError::content(&part.path, cell.place(line), problem));
            }
        }
    }
    Ok(())
}

fn mirrored_notes(part: &Part) -> Vec<String> {
    let mut notes: Vec<(String, Vec<&str>)> = Vec::new();
    for (cell, sum) in part.cells.iter().filter_map(|cell| Some((cell, cell.mirrored_in?))) {
        let rule = format!("{sum} {} minus the reading", cell.to_unit);
        match notes.iter_mut().find(|(other, _)| *other == rule) {
            Some((_, ids)) => ids.push(&cell.id),
            None => notes.push((rule, vec![&cell.id])),
        }
    }
    let text = |(rule, ids): &(String, Vec<&str>)| {
        format!(
            "readings that fall under load are kept as {rule}: {}",
            super::columns::listed(ids.iter().copied())
        )
    };
    notes.iter().map(text).collect()
}

/// The take's name as a file stem that is safe in addresses too.
fn take_id(source: &TakeSource) -> Result<String, RecordingError> {
    let id: String = source
        .name
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '-' })
        .collect();
    if id.chars().any(|c| c.is_ascii_alphanumeric()) {
        Ok(id)
    } else {
        let problem = "has no letter or digit in its name, from which the take's id comes; rename it";
        Err(RecordingError::content(&source.path, source.kind(), problem))
    }
}

fn times_ns(path: &Path, table: &Table, zero_s: f64) -> Result<Vec<u64>, RecordingError> {
    let mut times_ns = Vec::with_capacity(table.times_s.len());
    for (&time_s, line) in table.times_s.iter().zip(&table.lines) {
        let error = |problem: &str| {
            Err(RecordingError::content(path, format!("line {line}, time"), format!("{time_s} s {problem}")))
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
    assembled: &Assembled,
    zero_s: f64,
    binary: bool,
    spans: &[Span],
    report: &mut TakeReport,
) -> Result<CheckedStream, RecordingError> {
    let Assembled { path, table, .. } = assembled;
    let channels = station.layout.streams[stream_idx].channels.clone();
    let num_channels = channels.len();
    let times_ns = times_ns(path, table, zero_s)?;
    if binary {
        let active = table.values.iter().map(|&value| value == 1.0).collect();
        return Ok(CheckedStream { times_ns, raw: Vec::new(), active, axes: Vec::new() });
    }
    let raw: Vec<f32> = table.values.iter().map(|&value| value as f32).collect();
    // The times as the reader will see them, so that both find the same reference.
    let times_s: Vec<f64> = times_ns.iter().map(|&time_ns| secs_from_ns(time_ns)).collect();
    let mut log = StreamLog { times_s, raw, ..StreamLog::default() };
    log.find_references(num_channels, spans);
    let config = &station.streams[stream_idx];
    for (offset, channel) in channels.enumerate() {
        if let Some(fall) = plausible::fall_under_load(config, log.above_reference(offset, num_channels)) {
            let id = &station.layout.channels[channel].id;
            let stream = &station.layout.streams[stream_idx];
            report.warnings.push(format!("channel {id:?} {}", plausible::falls(fall, stream)));
        }
    }
    let active = activations(config, &log, num_channels);
    Ok(CheckedStream { times_ns, raw: log.raw, active, axes: Vec::new() })
}
