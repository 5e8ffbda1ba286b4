//! Proximal policy optimisation with an actor that sees what hardware would see and a critic that sees everything.
//!
//! A [`VectorEnv`] is many environments that step together; [`PpoConfig`] is the file that says how to learn;
//! [`Trainer`] turns both into a policy, one [`Trainer::update`] at a time; [`train`] does that in a folder with
//! checkpoints and metrics; [`Actor`] is the policy that comes out.
//!
//! The same seed gives the same bits for any number of threads on one kind of processor: noise is drawn from generators
//! keyed by (seed, purpose, environment, step), and batches are cut into chunks of fixed size whose gradients are added
//! in order. `burn` computes forward and backward passes of one chunk on one thread; parameters live outside it as plain
//! arrays, which is what optimiser and checkpoints work on.
//!
//! Nothing here knows what the environments simulate.

mod actor;
mod checkpoint;
mod config;
mod env;
mod error;
mod gae;
mod loss;
mod metrics;
mod networks;
mod normaliser;
mod rollout;
mod run;
mod seed;
mod trainer;

pub use actor::Actor;
pub use config::{Activation, NetworksConfig, PpoConfig, StopConfig};
pub use env::{Ending, EnvError, Observations, StepResult, VectorEnv};
pub use error::PpoError;
pub use gae::{Gae, Transition};
pub use metrics::Metrics;
pub use palpate_training::{CHECKPOINT_FILE, METRICS_FILE, Start, TrainingError};
pub use run::{CONFIG_FILE, Finish, Progress, train};
pub use trainer::Trainer;
