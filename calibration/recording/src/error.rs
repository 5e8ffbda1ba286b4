//! One error for everything a take, session or import can have wrong.

use std::path::PathBuf;

/// A take, session or import that cannot be used: which file, where in it, what was expected.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The operating system refused.
    #[error("failed to {action} {path:?}")]
    Io {
        /// What was tried, e.g. `read`.
        action: &'static str,
        /// On which path.
        path: PathBuf,
        /// Why not.
        #[source]
        source: std::io::Error,
    },
    /// The content is wrong.
    #[error("{path}: {place}: {problem}", path = path.display())]
    Content {
        /// Which file.
        path: PathBuf,
        /// Where in it: line, topic, channel, message.
        place: String,
        /// What is wrong, what was expected, what to do.
        problem: String,
    },
    /// The station's own texts are wrong.
    #[error("{path}: in the station's files", path = path.display())]
    Station {
        /// Which take or station file.
        path: PathBuf,
        /// What is wrong.
        #[source]
        source: palpate_robot_model::ModelError,
    },
}
