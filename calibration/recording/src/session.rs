//! A session: a folder of takes with a `session.toml`.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{RecordingError, Take};

/// `session.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionFile {
    /// Version of the format; 1.
    pub format: u32,
    /// Station id.
    pub station: String,
    /// When it was recorded, RFC 3339; empty if unknown.
    #[serde(default)]
    pub recorded: String,
    /// Takes, in order.
    #[serde(rename = "take", default)]
    pub takes: Vec<SessionTake>,
}

/// One take in `session.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionTake {
    /// File name in the session's folder, e.g. `take-01.mcap`.
    pub file: String,
    /// Object id.
    pub object: String,
    /// Whether the operator accepted it.
    pub accepted: bool,
}

/// An opened session.
#[derive(Clone, Debug)]
pub struct Session {
    /// Its folder.
    pub dir: PathBuf,
    /// Id: the folder's name.
    pub id: String,
    /// `session.toml`.
    pub file: SessionFile,
}

impl Session {
    /// Reads `session.toml` in `dir`. A session without takes is refused.
    pub fn open(dir: &Path) -> Result<Self, RecordingError> {
        let _ = dir;
        todo!()
    }

    /// Reads one take by index; checks that its station and streams are the session's.
    pub fn take(&self, take_idx: usize) -> Result<Take, RecordingError> {
        let _ = take_idx;
        todo!()
    }

    /// Writes `session.toml` of a new session (atomically: temporary file, then rename).
    pub fn create(dir: &Path, file: SessionFile) -> Result<Self, RecordingError> {
        let _ = (dir, file);
        todo!()
    }
}
