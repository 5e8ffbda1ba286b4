//! What can go wrong.

use palpate_sim::replay::ReplayError;

/// Why touch could not be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TouchError {
    /// An argument that no caller of the interface should give: a null pointer, text that is not UTF-8, an unknown handle.
    #[error("{0}")]
    Argument(String),
    /// A file that cannot be read, or that says something that cannot be.
    #[error("{0}")]
    File(String),
    /// Numbers that cannot be felt.
    #[error("{0}")]
    Input(String),
}

impl TouchError {
    /// Of frame `idx` of the frames, or environments, called `what`.
    pub(crate) fn of(what: &str, idx: usize, error: &ReplayError) -> Self {
        let problem = match error {
            ReplayError::NonFinitePosition { joint, value, .. } => {
                format!("position of joint {joint:?} is {value}, expected a finite number of rad or m")
            }
            ReplayError::NonFiniteObjectPose { position_m, .. } => {
                format!("the object's pose must be finite, found position {position_m:?} m")
            }
            ReplayError::TimeNotIncreasing { time_s, before_s } => {
                format!(
                    "time is {time_s} s after {before_s} s, expected finite times that increase until a restart"
                )
            }
            other => other.to_string(),
        };
        Self::Input(format!("{what} {idx}: {problem}"))
    }
}
