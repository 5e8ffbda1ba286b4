//! Reads a station from disk.

use std::{fs, path::Path};

use palpate_robot_model::Station;

use crate::RecordingError;

/// Reads the station file at `path` and everything it names, relative to it.
pub fn load_station(path: &Path) -> Result<Station, RecordingError> {
    let dir = path.parent().unwrap_or(Path::new(""));
    let file_name = path
        .file_name()
        .ok_or_else(|| {
            RecordingError::content(path, "path", "names no file; give the path of a station file")
        })?
        .to_string_lossy();
    // Distinguishes a station file that is not there from one that names a file that is not there.
    fs::metadata(path).map_err(RecordingError::io("read", path))?;
    Station::read(&file_name, |name| {
        let named = dir.join(name);
        fs::read(&named).map_err(|error| format!("failed to read {named:?}: {error}"))
    })
    .map_err(|source| RecordingError::Station { path: path.to_owned(), source })
}
