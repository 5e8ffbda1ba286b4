//! What can go wrong.

use palpate_training::TrainingError;

/// An error of a cloning.
#[derive(Debug, thiserror::Error)]
pub enum CloneError {
    /// Something is wrong with a file of the training, its configuration among them.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// Episodes, configuration, or a robot do not fit.
    #[error("{0}")]
    Shape(String),
    /// There is nothing to compute on as was asked.
    #[error("{0}")]
    Device(String),
    /// Learning ran away.
    #[error("{what} is not finite at update {update}: lower learning_rate or max_gradient_norm")]
    Diverged {
        /// Which quantity.
        what: &'static str,
        /// Updates done before this one.
        update: u64,
    },
}
