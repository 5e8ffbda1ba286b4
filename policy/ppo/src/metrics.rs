//! What an update tells.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// What an update tells; one line of the metrics file. Means are over the update's steps, samples or episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Updates done, this one included.
    pub update: u64,
    /// Steps learned from so far, of all environments.
    pub steps: u64,
    /// Episodes that ended so far. Those that a checkpoint cut off do not count.
    pub episodes: u64,
    /// Mean sum of rewards of the episodes that ended in this update; nothing if none did.
    pub return_mean: Option<f64>,
    /// Mean steps of these episodes.
    pub length_mean: Option<f64>,
    /// Share of these episodes that succeeded.
    pub success_rate: Option<f64>,
    /// Share of the newest episodes that succeeded, once there are as many as the configuration's `stop` counts.
    pub recent_success_rate: Option<f64>,
    /// Mean of each term of the reward, a step.
    pub reward_terms: BTreeMap<String, f64>,
    /// What the environments say of themselves after the update's steps ([`crate::VectorEnv::metrics`]).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub environment: BTreeMap<String, f64>,
    /// Mean of the negative clipped surrogate.
    pub policy_loss: f64,
    /// Mean of half the squared error of the critic.
    pub value_loss: f64,
    /// Share of the returns' variance that the critic knew before the update; below 0 it is worse than a constant.
    pub explained_variance: f64,
    /// Divergence from the policy that acted, in nats.
    pub kl: f64,
    /// Share of samples whose probability left the clip range.
    pub clip_fraction: f64,
    /// Entropy of the policy after the update, in nats.
    pub entropy: f64,
    /// Mean spread of the components of an action after the update.
    pub action_std: f64,
    /// Mean norm of the gradient before it was clipped.
    pub gradient_norm: f64,
}
