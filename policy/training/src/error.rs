//! What can go wrong with the files of a training.

use std::path::PathBuf;

/// An error with a file of a training.
#[derive(Debug, thiserror::Error)]
pub enum TrainingError {
    /// A configuration cannot be read or does not make sense.
    #[error("{file}{}: {problem}", line.map(|line| format!(":{line}")).unwrap_or_default())]
    Config {
        /// The file or preset.
        file: String,
        /// Line of the field, from 1, if the file has it.
        line: Option<usize>,
        /// Field, value, what was expected.
        problem: String,
    },
    /// There is no such preset.
    #[error("there is no preset {0:?}, expected one of \"quick\", \"paper\"")]
    UnknownPreset(String),
    /// A checkpoint cannot be used.
    #[error("checkpoint {}: {problem}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// Which field, what it is, what was expected.
        problem: String,
    },
    /// A file cannot be read or written.
    #[error("failed to {doing} {}", path.display())]
    File {
        /// "read", "write", ...
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// A run would overwrite another.
    #[error("{} holds a checkpoint already: resume it, or choose another folder", .0.display())]
    RunExists(PathBuf),
    /// Two runs in one folder.
    #[error("{} is in use by another run", .0.display())]
    RunInUse(PathBuf),
}
