//! One error for everything an export can meet.

use std::{
    io,
    path::{Path, PathBuf},
};

use palpate_recording::RecordingError;

/// Why nothing was exported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// An argument of the caller makes no sense, whatever the data.
    #[error("{0}")]
    Argument(String),
    /// A session or take cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The data cannot become one data set.
    #[error("{path}: {problem}", path = path.display())]
    Content {
        /// Which folder or file.
        path: PathBuf,
        /// What is wrong, what was expected, what to do.
        problem: String,
    },
    /// Something is at the place of the data set already.
    #[error("{path} is there already; choose another folder or remove it", path = path.display())]
    Exists {
        /// What is there.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("failed to {action} {path:?}")]
    Io {
        /// What was tried, e.g. `write`.
        action: &'static str,
        /// On which path.
        path: PathBuf,
        /// Why not.
        #[source]
        source: io::Error,
    },
    /// A table could not be written.
    #[error("failed to write {path:?}")]
    Parquet {
        /// Which table.
        path: PathBuf,
        /// Why not.
        #[source]
        source: parquet::errors::ParquetError,
    },
    /// Somebody cancelled.
    #[error("cancelled")]
    Cancelled,
}

impl ExportError {
    pub(crate) fn content(path: &Path, problem: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), problem: problem.into() }
    }

    /// For `map_err`: the operating system refused to `action` `path`.
    pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.to_owned(), source }
    }

    /// For `map_err`: the table at `path` could not be written.
    pub(crate) fn parquet(path: &Path) -> impl FnOnce(parquet::errors::ParquetError) -> Self {
        move |source| Self::Parquet { path: path.to_owned(), source }
    }
}
