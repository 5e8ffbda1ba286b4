//! Reads a station from disk.

use std::path::Path;

use palpate_robot_model::Station;

use crate::RecordingError;

/// Reads the station file at `path` and everything it names, relative to it.
pub fn load_station(path: &Path) -> Result<Station, RecordingError> {
    let _ = path;
    todo!()
}
