//! CSV import: one sub-folder a take, each stream with its own time base.

use std::path::{Path, PathBuf};

use palpate_robot_model::Station;

use crate::RecordingError;

/// Imports every take under `csv_dir` into a new session at `session_dir`, which must not exist.
///
/// Everything is read and checked before anything is written; on an error nothing is left on disk.
/// Gives the path of the session.
pub fn import_csv(station: &Station, csv_dir: &Path, session_dir: &Path) -> Result<PathBuf, RecordingError> {
    let _ = (station, csv_dir, session_dir);
    todo!()
}
