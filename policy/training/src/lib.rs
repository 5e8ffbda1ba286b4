//! What every training shares, whatever it learns: noise by key, the optimiser, configurations that are refused by line and
//! field, tensors in a file with checksums, and the folder of a run.
//!
//! Parameters are [`Array`]s, plain numbers with a name: optimiser and files work on these. Nothing here computes a network.

mod adam;
mod array;
mod config;
mod error;
mod file;
mod folder;
mod run;
mod seed;

pub use adam::{Adam, AdamRates, add_gradients, clip_norm};
pub use array::{Array, ArrayBuilder};
pub use config::{Expectation, check, difference, parse};
pub use error::TrainingError;
pub use file::{Encoded, TensorFile, encode};
pub use folder::{CHECKPOINT_FILE, METRICS_FILE, MetricsLog, Start, file_error, write_in_one_move};
pub use run::{Finish, Judgement, Learner, Progress, run};
pub use seed::{below, fill_normal, generator, permutation};
