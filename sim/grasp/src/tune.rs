//! Scripts made better by trial: the cross-entropy method over a few numbers that change a script.
//!
//! [`TuningConfig`] is data and says which numbers those are ([`TuningConfig::apply`]) and what a trial is worth; with the
//! `mujoco` feature, [`tune`] searches. Candidates of a generation are drawn from a normal distribution, each is tried in the
//! same worlds, and the distribution moves to the best of them (Rubinstein, "The cross-entropy method for combinatorial
//! and continuous optimization", 1999).

mod config;
#[cfg(feature = "mujoco")]
mod search;

pub use config::{ActsOn, ParameterConfig, ScoreConfig, TuningConfig};
#[cfg(feature = "mujoco")]
pub use search::{Generation, TuneParams, TuneReport, tune};
