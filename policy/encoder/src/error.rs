//! What can go wrong.

use palpate_training::TrainingError;

/// An error of a pretraining.
#[derive(Debug, thiserror::Error)]
pub enum EncoderError {
    /// Something is wrong with a file of the training, its configuration among them.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// Samples and configuration do not fit.
    #[error("the samples do not fit: {0}")]
    Shape(String),
    /// A sample has a number that is none.
    #[error("sample {sample} has {value} as {what}, expected finite numbers")]
    NonFiniteSample {
        /// Index of the sample.
        sample: usize,
        /// Which numbers.
        what: &'static str,
        /// The value.
        value: f32,
    },
    /// Learning ran away.
    #[error("{what} is not finite at update {update}: lower learning_rate or max_gradient_norm")]
    Diverged {
        /// Which quantity.
        what: String,
        /// Updates done before this one.
        update: u64,
    },
}
