//! One error for everything a take, session or import can have wrong.

use std::path::{Path, PathBuf};

use palpate_robot_model::ModelError;

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
        source: ModelError,
    },
}

impl RecordingError {
    /// Wrong content at `place` in `path`.
    pub fn content(path: impl AsRef<Path>, place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Content { path: path.as_ref().to_owned(), place: place.into(), problem: problem.into() }
    }

    /// The same about the file at `path`, where what noticed it did not know the file's name.
    pub(crate) fn about(mut self, path: &Path) -> Self {
        match &mut self {
            Self::Io { path: named, .. }
            | Self::Content { path: named, .. }
            | Self::Station { path: named, .. } => {
                path.clone_into(named);
            }
        }
        self
    }

    /// Whether the disk is full: nothing can be written until something else goes.
    pub fn is_disk_full(&self) -> bool {
        use std::io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
        matches!(self, Self::Io { source, .. } if matches!(source.kind(), StorageFull | QuotaExceeded | FileTooLarge))
    }

    /// For `map_err`: the operating system refused to `action` `path`.
    pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |source| Self::Io { action, path: path.to_owned(), source }
    }

    /// For `map_err`: TOML text that does not parse, with its line.
    pub(crate) fn toml(path: &Path, text: &str) -> impl FnOnce(toml::de::Error) -> Self {
        move |error| {
            let place = match error.span() {
                Some(span) => {
                    let before = &text.as_bytes()[..span.start.min(text.len())];
                    format!("line {}", before.iter().filter(|&&byte| byte == b'\n').count() + 1)
                }
                None => "file".to_owned(),
            };
            Self::content(path, place, error.message().trim())
        }
    }

    /// The problem without the file's name, for lists that name it already.
    pub(crate) fn place_and_problem(&self) -> (String, String) {
        match self {
            Self::Content { place, problem, .. } => (place.clone(), problem.clone()),
            Self::Io { source, .. } => ("file".to_owned(), format!("{self}: {source}")),
            Self::Station { source, .. } => ("station".to_owned(), source.to_string()),
        }
    }
}
