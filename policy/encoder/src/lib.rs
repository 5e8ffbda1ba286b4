//! The tactile encoder: a Transformer over a short history of touch, each channel's activation beside the place of its taxel
//! in the hand's frame, and its pretraining with what only a simulator knows.
//!
//! A [`Dataset`] gives [`Sample`]s; [`EncoderConfig`] is the file that says how to learn; [`Trainer`] learns encoder and
//! decoder together; [`train`] does that in a folder with checkpoints and metrics; [`Score`] says how good the decoder's
//! predictions are, beside those of [`MeanPrediction`], which feels nothing; [`Encoder`] is what remains.
//!
//! The losses are formulas with gradients of their own on plain arrays; `burn` computes the network alone. The same seed gives
//! the same bits for any number of threads on one kind of processor: batches are cut into chunks of fixed size whose gradients
//! are added in order.
//!
//! Nothing here knows a robot, a simulator or a file of demonstrations.

mod checkpoint;
mod config;
mod encoder;
mod error;
mod loss;
mod network;
mod points;
mod run;
mod sample;
mod score;
mod statistics;
mod trainer;

pub use config::{EncoderConfig, InputsConfig, LossConfig, NetworkConfig};
pub use encoder::Encoder;
pub use error::EncoderError;
pub use loss::{LossTerms, TERMS};
pub use palpate_training::{CHECKPOINT_FILE, Finish, METRICS_FILE, Progress, Start, TrainingError};
pub use run::{CONFIG_FILE, Data, train};
pub use sample::{Dataset, Dims, Prediction, Sample, history_steps};
pub use score::Score;
pub use statistics::MeanPrediction;
pub use trainer::Trainer;
