//! Which takes there are, and which files each of them has.

use std::{
    fs,
    path::{Path, PathBuf},
};

use palpate_robot_model::Station;

use super::{
    columns::{Assignment, assign},
    config::{FileConfig, Mapping, TakeConfig, Takes},
    name_pattern::matched,
    parquet, rows,
    targets::{Names, Scope, Target},
};
use crate::{
    RecordingError,
    decode::stream_list,
    files::{MAX_TAKE_BYTES, MAX_TEXT_BYTES, read_file, read_text},
};

const TAKE_FILE: &str = "take.toml";
const JOINTS_FILE: &str = "joints.csv";
/// What the joint log is called, whatever its ending.
const JOINTS_STEM: &str = "joints";
/// What the poses of a moving object are called.
const OBJECT_STEM: &str = "object";
const CSV_ENDING: &str = ".csv";

/// Where a take comes from.
#[derive(Clone, Debug)]
pub(super) struct TakeSource {
    /// Its folder, or the file that it is.
    pub(super) path: PathBuf,
    /// Where its files lie.
    dir: PathBuf,
    pub(super) name: String,
    /// Its `take.toml`, whether there is one or not.
    pub(super) config_path: PathBuf,
    /// Whether the take is a file.
    is_file: bool,
}

impl TakeSource {
    pub(super) fn kind(&self) -> &'static str {
        if self.is_file { "file" } else { "folder" }
    }

    /// The fields of `take.toml`, those of the mapping file where it is silent.
    pub(super) fn config(&self, mapping: Option<&Mapping>) -> Result<TakeConfig, RecordingError> {
        let defaults = mapping.map(|mapping| mapping.take(&self.name)).unwrap_or_default();
        if mapping.is_some() && !self.config_path.exists() {
            return Ok(defaults);
        }
        let text = read_text(&self.config_path, MAX_TEXT_BYTES)?;
        let own: TakeConfig =
            toml::from_str(&text).map_err(RecordingError::toml(&self.config_path, &text))?;
        Ok(defaults.overridden_by(own))
    }
}

/// The takes under `csv_dir`, by name.
pub(super) fn sources(csv_dir: &Path, mapping: Option<&Mapping>) -> Result<Vec<TakeSource>, RecordingError> {
    let pattern = match mapping {
        Some(mapping) if mapping.config.takes == Takes::Files => {
            Some(mapping.config.pattern.as_ref().map_or("*.csv", |pattern| pattern.get_ref().as_str()))
        }
        _ => None,
    };
    let mut sources = Vec::new();
    for path in entries(csv_dir)? {
        let file_name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let excepted = mapping.map_or(&[][..], |mapping| &mapping.config.except);
        if excepted.iter().any(|pattern| matched(pattern, &file_name).is_some()) {
            continue;
        }
        let source = match pattern {
            None if path.is_dir() => TakeSource {
                dir: path.clone(),
                config_path: path.join(TAKE_FILE),
                name: file_name,
                path,
                is_file: false,
            },
            Some(pattern) if !path.is_dir() => {
                let Some(name) = matched(pattern, &file_name) else { continue };
                TakeSource {
                    dir: csv_dir.to_owned(),
                    config_path: csv_dir.join(format!("{name}.toml")),
                    name: name.to_owned(),
                    path,
                    is_file: true,
                }
            }
            _ => continue,
        };
        sources.push(source);
    }
    if sources.is_empty() {
        let problem = match pattern {
            Some(pattern) => {
                format!("no file {pattern:?}, each of which would be a take; change takes and pattern")
            }
            None => format!(
                "no take; put each take's {TAKE_FILE}, {JOINTS_FILE} and streams in a sub-folder of its own"
            ),
        };
        return Err(RecordingError::content(csv_dir, "folder", problem));
    }
    Ok(sources)
}

/// What lies in `dir`, hidden entries aside, by name.
fn entries(dir: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let mut paths = Vec::new();
    for entry in fs::read_dir(dir).map_err(RecordingError::io("read", dir))? {
        let path = entry.map_err(RecordingError::io("read", dir))?.path();
        if path.file_name().is_some_and(|name| !name.as_encoded_bytes().starts_with(b".")) {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// A file of a take, its columns known but its rows not yet read.
pub(super) struct Opened {
    pub(super) path: PathBuf,
    pub(super) bytes: Vec<u8>,
    pub(super) config: FileConfig,
    pub(super) columns: OpenedColumns,
}

/// How the columns of a file go.
pub(super) enum OpenedColumns {
    /// `t_s`, then all of the scope in the station's order.
    Numbered(Scope),
    Assigned(Assignment),
}

impl Opened {
    /// Whether it says where the object is.
    pub(super) fn has_poses(&self) -> bool {
        let OpenedColumns::Assigned(assignment) = &self.columns else { return false };
        assignment.cells.iter().any(|cell| matches!(cell.target, Target::Object(_)))
    }
}

/// Opens the files of a take.
pub(super) fn open(
    station: &Station,
    source: &TakeSource,
    mapping: Option<&Mapping>,
) -> Result<Vec<Opened>, RecordingError> {
    let binary = source.config(mapping)?.binary.unwrap_or(false);
    let names = Names { station, binary };
    match mapping {
        Some(mapping) if !mapping.config.file.is_empty() => {
            let files = mapping.config.file.iter().map(|file| {
                let config = file.get_ref();
                let path = match &config.file {
                    Some(name) => source.dir.join(name.replace("{take}", &source.name)),
                    None => source.path.clone(),
                };
                open_mapped(names, path, config, mapping)
            });
            files.collect()
        }
        _ if source.is_file => Ok(vec![open_plain(names, source.path.clone(), Scope::All)?]),
        _ => open_folder(names, &source.dir),
    }
}

fn open_folder(names: Names<'_>, dir: &Path) -> Result<Vec<Opened>, RecordingError> {
    let station = names.station;
    let tables: Vec<(PathBuf, String)> = entries(dir)?
        .into_iter()
        .filter_map(|path| {
            let name = path.file_name()?.to_string_lossy();
            let stem =
                name.strip_suffix(CSV_ENDING).or_else(|| name.strip_suffix(parquet::ENDING))?.to_owned();
            Some((path, stem))
        })
        .collect();
    for (idx, (path, stem)) in tables.iter().enumerate() {
        if let Some((other, _)) = tables[..idx].iter().find(|(_, other)| other == stem) {
            let problem = format!("holds the same as {}; remove one of them", other.display());
            return Err(RecordingError::content(path, "file", problem));
        }
    }
    // A stream may be called so too.
    let is_object = |stem: &str| stem == OBJECT_STEM && station.layout.stream_index(stem).is_none();
    let (poses, tables): (Vec<_>, Vec<_>) = tables.into_iter().partition(|(_, stem)| is_object(stem));
    let poses = poses.into_iter().map(|(path, _)| open_plain(names, path, Scope::Object));
    let poses = poses.collect::<Result<Vec<_>, _>>()?;
    let is_known = |stem: &str| station.layout.stream_index(stem).is_some() || stem == JOINTS_STEM;
    if let [(path, stem)] = &tables[..]
        && !is_known(stem)
    {
        return Ok(std::iter::once(open_plain(names, path.clone(), Scope::All)?).chain(poses).collect());
    }
    // Most likely it is the wrong station, or a misspelt name.
    if let Some((path, stem)) = tables.iter().find(|(_, stem)| !is_known(stem)) {
        let problem = format!(
            "station {:?} has no stream {stem:?}, only {}; import with the station that recorded it, or say in a mapping file \
             what it holds",
            station.id,
            stream_list(station)
        );
        return Err(RecordingError::content(path, "file", problem));
    }
    // What is missing is missed as CSV.
    let table = |stem: &str| {
        let there = tables.iter().find(|(_, other)| other == stem).map(|(path, _)| path.clone());
        there.unwrap_or_else(|| dir.join(format!("{stem}{CSV_ENDING}")))
    };
    let mut opened = vec![open_plain(names, table(JOINTS_STEM), Scope::Joints)?];
    for (stream_idx, stream) in station.layout.streams.iter().enumerate() {
        opened.push(open_plain(names, table(&stream.id), Scope::Stream(stream_idx))?);
    }
    opened.extend(poses);
    Ok(opened)
}

/// The text of the file at `path`, of a Parquet file that of the CSV file that it would be.
fn read_table(path: &Path, config: &FileConfig) -> Result<Vec<u8>, RecordingError> {
    let bytes = read_file(path, MAX_TAKE_BYTES)?;
    if parquet::is_parquet(path, &bytes) {
        parquet::as_csv(path, bytes, config, MAX_TAKE_BYTES)
    } else {
        Ok(bytes)
    }
}

/// Opens a file without a mapping: comma-separated, with a header.
fn open_plain(names: Names<'_>, path: PathBuf, scope: Scope) -> Result<Opened, RecordingError> {
    let config = FileConfig::plain();
    let bytes = read_table(&path, &config)?;
    let header = rows::first_row(&path, &bytes, &config)?;
    let prefix = match scope {
        Scope::Joints => Some('q'),
        Scope::Stream(_) => Some('v'),
        Scope::Object | Scope::All => None,
    };
    let is_number = |header: &String| {
        prefix.is_some_and(|prefix| {
            header
                .strip_prefix(prefix)
                .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit()))
        })
    };
    // A single column under another name is a file with another delimiter.
    let is_numbered = |cells: &[String]| {
        cells.iter().skip(1).all(is_number) && (cells.len() > 1 || cells.iter().all(|only| only == "t_s"))
    };
    let columns =
        match &header {
            Some((line, cells)) if !(prefix.is_some() && is_numbered(cells)) => OpenedColumns::Assigned(
                assign(&names, &path, Some((*line, cells)), cells.len(), scope, &config, None)?,
            ),
            None if prefix.is_none() => {
                let known =
                    if scope == Scope::Object { "x, y and z" } else { "the names of joints and channels" };
                let problem = format!("the file is empty, expected a header with {known}");
                return Err(RecordingError::content(&path, "line 1", problem));
            }
            // An empty file is refused as the oldest form.
            _ => OpenedColumns::Numbered(scope),
        };
    Ok(Opened { path, bytes, config, columns })
}

fn open_mapped(
    names: Names<'_>,
    path: PathBuf,
    config: &FileConfig,
    mapping: &Mapping,
) -> Result<Opened, RecordingError> {
    let station = names.station;
    let bytes = read_table(&path, config)?;
    let Some((line, cells)) = rows::first_row(&path, &bytes, config)? else {
        let place = format!("line {}", config.skip_lines + 1);
        return Err(RecordingError::content(&path, place, "the file is empty, expected a row of values"));
    };
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let scope = match station.layout.stream_index(&stem) {
        Some(stream_idx) if is_about_stream(station, config, stream_idx) => Scope::Stream(stream_idx),
        _ if stem == JOINTS_STEM => Scope::Joints,
        _ if is_about_object(config) => Scope::Object,
        _ => Scope::All,
    };
    let header = config.header.then_some((line, cells.as_slice()));
    let assignment = assign(&names, &path, header, cells.len(), scope, config, Some(mapping))?;
    Ok(Opened { path, bytes, config: config.clone(), columns: OpenedColumns::Assigned(assignment) })
}

/// Whether a file is mapped to nothing but poses of the object.
fn is_about_object(config: &FileConfig) -> bool {
    !config.map.is_empty() && config.map.iter().all(|map| map.get_ref().object.is_some())
}

/// Whether a file that is called like a stream is mapped to nothing but channels of that stream.
fn is_about_stream(station: &Station, config: &FileConfig, stream_idx: usize) -> bool {
    let layout = &station.layout;
    config.map.iter().all(|map| {
        let map = map.get_ref();
        let in_stream = |id: &String| {
            layout.channels.iter().any(|channel| channel.id == *id && channel.stream == stream_idx)
        };
        map.stream.as_ref().is_some_and(|id| layout.stream_index(id) == Some(stream_idx))
            || map.channels.as_ref().is_some_and(|channels| channels.as_slice().iter().all(in_stream))
            || map.patch.as_ref().is_some_and(|id| {
                layout.patches.iter().any(|patch| patch.id == *id && patch.stream == stream_idx)
            })
    })
}
