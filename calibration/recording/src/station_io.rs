//! Reads a station from disk.

use std::{error::Error as _, path::Path};

use palpate_robot_model::Station;

use crate::{
    RecordingError,
    files::{MAX_STATION_FILE_BYTES, open_file, read_file},
};

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
    open_file(path)?;
    Station::read(&file_name, |name| {
        let named = dir.join(name);
        read_file(&named, MAX_STATION_FILE_BYTES).map_err(|error| match error.source() {
            Some(cause) => format!("{error}: {cause}"),
            None => error.to_string(),
        })
    })
    .map_err(|source| RecordingError::Station { path: path.to_owned(), source })
}
