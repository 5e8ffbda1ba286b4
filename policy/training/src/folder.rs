//! The folder of a run.

use std::{
    fs::{File, OpenOptions, TryLockError},
    io::Write,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use crate::TrainingError;

/// The newest checkpoint.
pub const CHECKPOINT_FILE: &str = "checkpoint.safetensors";
/// One line of JSON for each update.
pub const METRICS_FILE: &str = "metrics.jsonl";

/// Whether to begin or to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Begin; a folder that holds a checkpoint is refused.
    Fresh,
    /// Go on from the folder's checkpoint, or begin if the run was ended before the first one.
    Resume,
}

/// Replaces `path` by a file with `bytes`: whoever looks, also after a crash, sees the old file or the new one.
///
/// # Errors
/// Whatever the file system refuses.
pub fn write_in_one_move(path: &Path, bytes: &[u8]) -> Result<(), TrainingError> {
    let partial = path.with_extension("partial");
    let write = || {
        let mut file = File::create(&partial)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&partial, path)
    };
    write().map_err(file_error("write", path))
}

/// What `doing` something with `path` failed with.
pub fn file_error(doing: &'static str, path: &Path) -> impl Fn(std::io::Error) -> TrainingError {
    let path = path.to_owned();
    move |source| TrainingError::File { doing, path: path.clone(), source }
}

/// The metrics file, which this process alone writes while it is open.
#[derive(Debug)]
pub struct MetricsLog {
    path: PathBuf,
    file: File,
}

/// What a line of metrics must have to be kept.
#[derive(Deserialize)]
struct LineNumber {
    update: u64,
}

impl MetricsLog {
    /// The metrics file of `folder`.
    ///
    /// # Errors
    /// A folder that cannot be written, or that another run uses.
    pub fn open(folder: &Path) -> Result<Self, TrainingError> {
        let path = folder.join(METRICS_FILE);
        let open = OpenOptions::new().read(true).append(true).create(true).open(&path);
        let file = open.map_err(file_error("open", &path))?;
        file.try_lock().map_err(|err| match err {
            TryLockError::WouldBlock => TrainingError::RunInUse(folder.to_owned()),
            TryLockError::Error(source) => file_error("lock", &path)(source),
        })?;
        Ok(Self { path, file })
    }

    /// Drops what was written after the update numbered `last`, also a line that a crash cut off.
    ///
    /// # Errors
    /// A file that cannot be read or written; so for all below.
    pub fn keep_up_to(&self, last: u64) -> Result<(), TrainingError> {
        let bytes = std::fs::read(&self.path).map_err(file_error("read", &self.path))?;
        let is_kept = |line: &&[u8]| {
            let number: Option<LineNumber> = serde_json::from_slice(line).ok();
            line.ends_with(b"\n") && number.is_some_and(|line| line.update <= last)
        };
        let kept: usize =
            bytes.split_inclusive(|&byte| byte == b'\n').take_while(is_kept).map(<[u8]>::len).sum();
        self.file.set_len(kept as u64).map_err(file_error("write", &self.path))
    }

    /// Writes a line, which has the number of its `update`.
    ///
    /// # Errors
    /// See [`MetricsLog::keep_up_to`].
    pub fn append(&mut self, line: &impl Serialize) -> Result<(), TrainingError> {
        let mut text = serde_json::to_string(line).expect("numbers and names are JSON");
        text.push('\n');
        self.file.write_all(text.as_bytes()).map_err(file_error("write", &self.path))
    }

    /// Returns when all lines are on the disk.
    ///
    /// # Errors
    /// See [`MetricsLog::keep_up_to`].
    pub fn sync(&self) -> Result<(), TrainingError> {
        self.file.sync_data().map_err(file_error("write", &self.path))
    }
}
