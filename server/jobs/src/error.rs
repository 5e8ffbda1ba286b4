//! What can go wrong with jobs.

use std::{io, path::PathBuf};

/// Why something could not be done with a job.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JobsError {
    /// The database cannot be used as it is.
    #[error("{problem} (database {path:?})")]
    Database {
        /// The database's file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The database answered with an error.
    #[error("failed to {action} in the database of jobs")]
    Sql {
        /// What was tried.
        action: &'static str,
        /// Why not.
        #[source]
        source: rusqlite::Error,
    },
    /// There is no such job.
    #[error("no job {0:?}; GET /api/v1/jobs lists them")]
    NotFound(String),
    /// The job is in a state that does not allow it.
    #[error("{0}")]
    Conflict(String),
    /// The idempotency key came before with another request.
    #[error("{0}")]
    KeyReused(String),
    /// The request makes no sense.
    #[error("{0}")]
    Argument(String),
    /// What a file of a job holds cannot be used.
    #[error("{path:?}: {problem}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
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
    /// A runner could not do what it was asked.
    #[error("{0}")]
    Runner(String),
}

impl JobsError {
    /// `failed to {action} {path}`.
    pub(crate) fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { action, path, source }
    }

    pub(crate) fn sql(action: &'static str) -> impl FnOnce(rusqlite::Error) -> Self {
        move |source| Self::Sql { action, source }
    }
}
