//! What can go wrong.

use palpate_training::TrainingError;

use crate::EnvError;

/// An error of a training.
#[derive(Debug, thiserror::Error)]
pub enum PpoError {
    /// Something is wrong with a file of the training, its configuration among them.
    #[error(transparent)]
    Training(#[from] TrainingError),
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
}
