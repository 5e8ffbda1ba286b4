//! Recordings from elsewhere become a session: CSV and other delimited text, each file with its own time base.
//!
//! Without a mapping file every sub-folder is a take with `take.toml`, `joints.csv` and one `<stream>.csv` for each
//! stream of the station, or one CSV file that holds all of them. Columns go by the names of joints and channels, in
//! any order, or by number in the station's order. A Parquet file is read as the CSV file that it would be. A
//! [`Mapping`] says what is what where recordings look different. `docs/recordings.md` describes every field. All times
//! of a take are seconds on one clock; the take's time zero is the last whole second at or before its earliest sample,
//! so that files which count from zero keep their times, and files with wall-clock times keep their precision.

mod assemble;
mod axes;
mod columns;
mod config;
#[cfg(test)]
mod documented;
mod files;
mod firmware;
mod name_pattern;
mod parquet;
mod poses;
mod read;
mod repetitions;
mod report;
mod rows;
mod sheet;
mod spans;
mod table;
mod targets;
mod units;
mod write;

use std::path::{Path, PathBuf};

use palpate_robot_model::Station;

pub use self::{
    config::{MAPPING_FILE, Mapping},
    report::{ColumnReport, FileReport, IgnoredColumn, ImportReport, RepetitionReport, TakeReport},
};
use self::{read::CheckedTake, write::write_take};
use crate::{RecordingError, SessionDraft, SessionFile, SessionTake, session::refuse_existing};

/// How recordings are to be understood.
#[derive(Clone, Copy, Debug, Default)]
pub struct ImportOptions<'a> {
    /// What columns and files mean, where they are not called as the station calls them.
    pub mapping: Option<&'a Mapping>,
    /// Whether repetitions are looked for in the joint path of takes that mark none.
    pub find_repetitions: bool,
}

/// Imports every take under `csv_dir` into a new session at `session_dir`, which must not exist, without a mapping file
/// and with the repetitions that are marked.
///
/// Everything is read and checked before anything is written; on an error nothing is left on disk.
/// Gives the path of the session.
pub fn import_csv(station: &Station, csv_dir: &Path, session_dir: &Path) -> Result<PathBuf, RecordingError> {
    import(station, csv_dir, ImportOptions::default(), session_dir).map(|(dir, _)| dir)
}

/// As [`import_csv`], understanding recordings as `options` say. Gives what was understood too.
pub fn import(
    station: &Station,
    csv_dir: &Path,
    options: ImportOptions<'_>,
    session_dir: &Path,
) -> Result<(PathBuf, ImportReport), RecordingError> {
    refuse_existing(session_dir)?;
    let (mut takes, mut report): (Vec<CheckedTake>, _) = (Vec::new(), empty_report(station, options));
    for source in files::sources(csv_dir, options.mapping)? {
        let mut understood = TakeReport::default();
        let take = read::take(station, &source, options, &mut understood)?;
        refuse_same_id(&takes, &take, &source)?;
        takes.push(take);
        report.takes.push(understood);
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
    Ok((session.dir, report))
}

/// What [`import`] would understand of the recordings, problems of every take included; writes nothing.
pub fn explain(
    station: &Station,
    csv_dir: &Path,
    options: ImportOptions<'_>,
) -> Result<ImportReport, RecordingError> {
    let (mut takes, mut report): (Vec<CheckedTake>, _) = (Vec::new(), empty_report(station, options));
    for source in files::sources(csv_dir, options.mapping)? {
        let mut understood = TakeReport::default();
        let take = read::take(station, &source, options, &mut understood)
            .and_then(|take| refuse_same_id(&takes, &take, &source).map(|()| take));
        match take {
            Ok(take) => takes.push(take),
            Err(error) => {
                report.ok = false;
                understood.problem = Some(match std::error::Error::source(&error) {
                    Some(source) => format!("{error}: {source}"),
                    None => error.to_string(),
                });
            }
        }
        report.takes.push(understood);
    }
    Ok(report)
}

/// Whether the recordings may be of `station`: it knows the objects of every take, and the files of the first take hold
/// each of its joints and channels. The error says what does not fit.
pub fn fits(station: &Station, csv_dir: &Path, mapping: Option<&Mapping>) -> Result<(), RecordingError> {
    let sources = files::sources(csv_dir, mapping)?;
    for source in &sources {
        read::check_object(station, source, mapping)?;
    }
    match sources.first() {
        Some(first) => read::check_columns(station, first, mapping),
        None => Ok(()),
    }
}

fn empty_report(station: &Station, options: ImportOptions<'_>) -> ImportReport {
    ImportReport {
        ok: true,
        station: station.id.clone(),
        station_because: String::new(),
        mapping: options.mapping.map(|mapping| mapping.path().display().to_string()),
        takes: Vec::new(),
    }
}

fn refuse_same_id(
    takes: &[CheckedTake],
    take: &CheckedTake,
    source: &files::TakeSource,
) -> Result<(), RecordingError> {
    if takes.iter().any(|other| other.id == take.id) {
        let problem =
            format!("would be called {:?} like another take; rename the {}", take.id, source.kind());
        return Err(RecordingError::content(&source.path, source.kind(), problem));
    }
    Ok(())
}
