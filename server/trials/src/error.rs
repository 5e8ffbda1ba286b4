//! What can go wrong with campaigns.

use std::{io, path::PathBuf};

use palpate_recording::RecordingError;

/// Why something could not be done with a campaign.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrialsError {
    /// There is no such campaign.
    #[error("no campaign {0:?}; GET /api/v1/campaigns lists them")]
    UnknownCampaign(String),
    /// The campaign has no such trial.
    #[error("campaign {campaign:?} has no trial {trial}; expected 1 to {planned}")]
    UnknownTrial {
        /// The campaign.
        campaign: String,
        /// The number that was asked for.
        trial: u32,
        /// How many it has.
        planned: u32,
    },
    /// The request makes no sense.
    #[error("{0}")]
    Argument(String),
    /// The campaign or the trial is in a state that does not allow it.
    #[error("{0}")]
    Conflict(String),
    /// A file of the campaign cannot be used.
    #[error("{path:?}: {problem}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// A file could not be read or written.
    #[error(transparent)]
    File(#[from] RecordingError),
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
}

impl TrialsError {
    /// `failed to {action} {path}`.
    pub(crate) fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { action, path, source }
    }
}
