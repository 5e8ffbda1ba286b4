//! What can go wrong.

use std::path::PathBuf;

use crate::EnvError;

/// An error of a training.
#[derive(Debug, thiserror::Error)]
pub enum PpoError {
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
    /// Environments and configuration do not fit.
    #[error("the environments do not fit: {0}")]
    Shape(String),
    /// An environment failed.
    #[error("environments failed at step {step}")]
    Env {
        /// Steps of each environment since the training began.
        step: u64,
        /// Why.
        #[source]
        source: EnvError,
    },
    /// An environment gave a number that is none.
    #[error("environment {env} gave {value} as {what} at step {step}, expected finite numbers")]
    NonFiniteObservation {
        /// Index of the environment.
        env: usize,
        /// Which number.
        what: String,
        /// The value.
        value: f32,
        /// Steps of each environment since the training began.
        step: u64,
    },
    /// Learning ran away.
    #[error(
        "{what} is not finite at update {update}: lower learning_rate or max_gradient_norm, or scale the reward down"
    )]
    Diverged {
        /// Which quantity.
        what: String,
        /// Updates done before this one.
        update: u64,
    },
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
