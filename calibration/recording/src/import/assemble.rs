//! From the files of a take to its joint log and streams: one time base each, every joint and channel once.

use std::path::PathBuf;

use palpate_robot_model::{Mimic, Station};

use super::{
    columns::{Cell, listed},
    name_pattern::nearest,
    table::Table,
    targets::{NUM_POSITIONS, Names, POSE_NAMES, Target, plural},
};
use crate::RecordingError;

/// One file of a take, read.
pub(super) struct Part {
    pub(super) path: PathBuf,
    pub(super) cells: Vec<Cell>,
    /// A column per cell.
    pub(super) table: Table,
    /// Headers that were not recognised, for errors about what is missing.
    pub(super) ignored: Vec<String>,
    /// Whether it has the oldest form, whose times are seconds.
    pub(super) is_numbered: bool,
}

/// A joint log or a stream: the file whose times it has, and a column per joint or channel.
#[derive(Clone, Debug, Default)]
pub(super) struct Assembled {
    pub(super) path: PathBuf,
    pub(super) table: Table,
    /// How several files became one, if they did.
    pub(super) note: Option<String>,
}

/// How values of other files are brought to the times of the one with the most rows.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Between {
    /// Positions change steadily.
    Interpolate,
    /// A reading holds until the next.
    Hold,
}

/// The joint log. `fixed` are positions of joints that no file holds, `following` those that no file holds because they
/// follow others (see [`following`]).
pub(super) fn joints(
    station: &Station,
    parts: &[Part],
    fixed: &[(usize, f64)],
    following: &[(usize, usize, Mimic)],
) -> Result<Assembled, RecordingError> {
    let wanted: Vec<Target> = (0..station.robot.num_dofs()).map(Target::Joint).collect();
    // A place is kept for them; what it holds comes from the joint that is followed.
    let placed: Vec<(usize, f64)> =
        fixed.iter().copied().chain(following.iter().map(|&(dof, ..)| (dof, 0.0))).collect();
    let mut joints = assembled(station, parts, &wanted, &placed, Between::Interpolate)?;
    for row in joints.table.values.chunks_exact_mut(wanted.len().max(1)) {
        for &(dof, followed, mimic) in following {
            row[dof] = mimic.multiplier * row[followed] + mimic.offset;
        }
    }
    Ok(joints)
}

/// The joints that follow others (URDF's `mimic`) and that no file holds and nothing fixes, those that others follow first.
pub(super) fn following<'a>(
    station: &Station,
    cells: impl Iterator<Item = &'a Cell> + Clone,
    fixed: &[(usize, f64)],
) -> Vec<(usize, usize, Mimic)> {
    let is_held = |dof: usize| {
        cells.clone().any(|cell| cell.target == Target::Joint(dof))
            || fixed.iter().any(|&(held, _)| held == dof)
    };
    station.robot.mimics().into_iter().filter(|&(dof, ..)| !is_held(dof)).collect()
}

/// The stream `stream_idx`: a column for each channel, or for each axis of each.
pub(super) fn stream(
    names: Names<'_>,
    parts: &[Part],
    stream_idx: usize,
) -> Result<Assembled, RecordingError> {
    let channels = names.station.layout.streams[stream_idx].channels.clone();
    let wanted: Vec<Target> = channels.flat_map(|channel| names.of_channel(channel)).collect();
    assembled(names.station, parts, &wanted, &[], Between::Hold)
}

/// Where the object is over time, if a file says so: columns of the first three or of all of [`POSE_NAMES`].
pub(super) fn object(station: &Station, parts: &[Part]) -> Result<Option<Assembled>, RecordingError> {
    let held = |wanted: Target| parts.iter().any(|part| part.cells.iter().any(|cell| cell.target == wanted));
    let targets: Vec<Target> = (0..POSE_NAMES.len()).map(Target::Object).collect();
    if !targets.iter().any(|&target| held(target)) {
        return Ok(None);
    }
    // A quaternion is there as a whole or not at all.
    let has_turn = targets[NUM_POSITIONS..].iter().any(|&target| held(target));
    let wanted = if has_turn { &targets[..] } else { &targets[..NUM_POSITIONS] };
    assembled(station, parts, wanted, &[], Between::Interpolate).map(Some)
}

/// Columns of one part that are wanted: `(column of the result, column of the part)`.
type Columns = Vec<(usize, usize)>;

/// Refuses joints and channels that no file or several hold.
pub(super) fn check_complete<'a>(
    station: &Station,
    files: &[(&'a PathBuf, &'a [Cell], &'a [String])],
    wanted: &[Target],
    fixed: &[(usize, f64)],
) -> Result<(), RecordingError> {
    let names = Names { station, binary: false };
    let mut missing = Vec::new();
    for &target in wanted {
        let holders: Vec<_> =
            files.iter().filter(|(_, cells, _)| cells.iter().any(|cell| cell.target == target)).collect();
        let is_fixed = matches!(target, Target::Joint(dof) if fixed.iter().any(|&(fixed, _)| fixed == dof));
        match holders[..] {
            [_] if is_fixed => {
                let problem = format!(
                    "holds joint {:?}, which fixed_joints fixes; remove one of them",
                    names.id(target)
                );
                return Err(RecordingError::content(holders[0].0, "columns", problem));
            }
            [_] => {}
            [] if is_fixed => {}
            [] => missing.push(target),
            [first, second, ..] => {
                let problem = format!(
                    "holds {:?}, and so does {}; map it to something else in one of them, or leave the column out",
                    names.id(target),
                    first.0.display()
                );
                return Err(RecordingError::content(second.0, "columns", problem));
            }
        }
    }
    if missing.is_empty() {
        return Ok(());
    }
    // The file that holds most of the rest is where people will look.
    let num_held = |cells: &[Cell]| cells.iter().filter(|cell| wanted.contains(&cell.target)).count();
    let likely = files.iter().max_by_key(|(_, cells, ignored)| (num_held(cells), ignored.len()));
    let Some((path, ..)) = likely else {
        return Err(RecordingError::content("recording", "files", "there is no file in it"));
    };
    let what = missing[0].what();
    let ids: Vec<_> = missing.iter().map(|&target| names.id(target)).collect();
    let mut problem = format!(
        "no column for {} {}",
        if ids.len() == 1 { what.to_owned() } else { plural(what) },
        listed(&ids)
    );
    let ignored: Vec<&str> =
        files.iter().flat_map(|(_, _, ignored)| ignored.iter().map(String::as_str)).collect();
    let near: Vec<String> = ids
        .iter()
        .filter_map(|id| Some(format!("{:?} looks like {id:?}", nearest(id, ignored.iter().copied())?)))
        .take(3)
        .collect();
    if !near.is_empty() {
        problem += &format!("; {}: rename it, or map it in a mapping file", near.join(", "));
    } else if matches!(missing[0], Target::Object(_)) {
        problem += &format!(
            "; a pose has {}, and, if it turns, {}",
            POSE_NAMES[..NUM_POSITIONS].join(", "),
            POSE_NAMES[NUM_POSITIONS..].join(", ")
        );
    } else if !ignored.is_empty() {
        problem += &format!(
            "; columns must be called as the station calls its {}; not recognised here: {}",
            plural(what),
            listed(ignored.iter().copied())
        );
    } else {
        problem += &format!(
            "; station {:?} needs one for each of its {} {}",
            station.id,
            wanted.len(),
            plural(what)
        );
    }
    if what == "joint" {
        problem +=
            ". A joint that was not recorded because it stood still goes into fixed_joints of a mapping file";
    }
    Err(RecordingError::content(path, "columns", problem))
}

fn assembled(
    station: &Station,
    parts: &[Part],
    wanted: &[Target],
    fixed: &[(usize, f64)],
    between: Between,
) -> Result<Assembled, RecordingError> {
    let files: Vec<_> =
        parts.iter().map(|part| (&part.path, part.cells.as_slice(), part.ignored.as_slice())).collect();
    check_complete(station, &files, wanted, fixed)?;
    let mut held: Vec<(&Part, Columns, Vec<usize>)> = Vec::new();
    for part in parts {
        let columns: Columns = part
            .cells
            .iter()
            .enumerate()
            .filter_map(|(column, cell)| {
                Some((wanted.iter().position(|&target| target == cell.target)?, column))
            })
            .collect();
        if !columns.is_empty() {
            let rows = rows(part, &columns)?;
            held.push((part, columns, rows));
        }
    }
    // The first of those with the most rows.
    let base = held.iter().rev().max_by_key(|(_, _, rows)| rows.len());
    let Some((base, base_columns, base_rows)) = base else {
        let problem = "every joint is in fixed_joints, expected at least one that was recorded";
        return Err(RecordingError::content("recording", "fixed_joints", problem));
    };
    let width = wanted.len();
    let is_whole = held.len() == 1
        && fixed.is_empty()
        && base_columns.len() == base.cells.len()
        && base_columns.iter().enumerate().all(|(idx, &pair)| pair == (idx, idx))
        && base_rows.len() == base.table.times_s.len();
    if is_whole {
        return Ok(Assembled { path: base.path.clone(), table: base.table.clone(), note: None });
    }
    let mut table = Table::default();
    let others: Vec<_> = held.iter().filter(|(part, ..)| !std::ptr::eq(*part, *base)).collect();
    let mut row_values = vec![0.0; width];
    for &row in base_rows {
        let time_s = base.table.times_s[row];
        for &(dof, position) in fixed {
            if let Some(column) = wanted.iter().position(|&target| target == Target::Joint(dof)) {
                row_values[column] = position;
            }
        }
        copy(base, base_columns, row, &mut row_values);
        let mut is_complete = true;
        for (part, columns, rows) in &others {
            is_complete &= at(part, columns, rows, time_s, between, &mut row_values);
        }
        if is_complete {
            table.times_s.push(time_s);
            table.lines.push(base.table.lines[row]);
            table.values.extend_from_slice(&row_values);
        }
    }
    if table.times_s.is_empty() {
        let other = others.first().map_or(&base.path, |(part, ..)| &part.path);
        let problem = format!(
            "shares no time with {}; are they of the same recording, on one clock? time = {{ offset_s = ... }} in a mapping \
             file moves one",
            other.display()
        );
        return Err(RecordingError::content(&base.path, "times", problem));
    }
    let note = (!others.is_empty()).then(|| {
        let names: Vec<String> = others.iter().map(|(part, ..)| file_name(part)).collect();
        let how = match between {
            Between::Interpolate => "interpolated to",
            Between::Hold => "held until the next reading at",
        };
        let left_out = base_rows.len() - table.times_s.len();
        let left_out = if left_out == 0 {
            String::new()
        } else {
            format!("; {left_out} rows without all files left out")
        };
        format!("{} {how} the times of {}{left_out}", names.join(", "), file_name(base))
    });
    Ok(Assembled { path: base.path.clone(), table, note })
}

fn file_name(part: &Part) -> String {
    part.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

fn copy(part: &Part, columns: &Columns, row: usize, values: &mut [f64]) {
    let cells = part.table.row(row, part.cells.len());
    for &(to, from) in columns {
        values[to] = cells[from];
    }
}

/// Rows of `part` that have values in `columns`. A row may lack all of them, where a file of several rates leaves cells
/// empty, but not some.
fn rows(part: &Part, columns: &Columns) -> Result<Vec<usize>, RecordingError> {
    let mut rows = Vec::with_capacity(part.table.times_s.len());
    for row in 0..part.table.times_s.len() {
        let cells = part.table.row(row, part.cells.len());
        let empty = columns.iter().find(|(_, column)| cells[*column].is_nan());
        let num_empty = columns.iter().filter(|(_, column)| cells[*column].is_nan()).count();
        match empty {
            None => rows.push(row),
            Some(_) if num_empty == columns.len() => {}
            Some(&(_, column)) => {
                let problem = "is empty, while others of the same sample are not; leave the row out or mend the recording";
                return Err(RecordingError::content(
                    &part.path,
                    part.cells[column].place(part.table.lines[row]),
                    problem,
                ));
            }
        }
    }
    if rows.is_empty() {
        let ids = listed(columns.iter().map(|&(_, column)| part.cells[column].id.as_str()));
        let problem = format!("every cell of {ids} is empty");
        return Err(RecordingError::content(&part.path, "columns", problem));
    }
    Ok(rows)
}

/// Writes the values of `part` at `time_s` into `values`; false where it has none.
fn at(
    part: &Part,
    columns: &Columns,
    rows: &[usize],
    time_s: f64,
    between: Between,
    values: &mut [f64],
) -> bool {
    let next = rows.partition_point(|&row| part.table.times_s[row] <= time_s);
    let Some(before) = next.checked_sub(1).map(|before| rows[before]) else { return false };
    copy(part, columns, before, values);
    let Some(&after) = rows.get(next) else {
        // A reading holds for one step past the last.
        let (first_s, last_s) = (part.table.times_s[rows[0]], part.table.times_s[before]);
        let step_s = (last_s - first_s) / (rows.len() as f64 - 1.0).max(1.0);
        return time_s <= last_s + if between == Between::Hold { step_s } else { 0.0 };
    };
    if between == Between::Interpolate {
        let (before_s, after_s) = (part.table.times_s[before], part.table.times_s[after]);
        let share = (time_s - before_s) / (after_s - before_s);
        let later = part.table.row(after, part.cells.len());
        for &(to, from) in columns {
            values[to] += share * (later[from] - values[to]);
        }
    }
    true
}
