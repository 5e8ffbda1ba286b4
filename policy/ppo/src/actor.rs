//! The policy that comes out.

use burn_tensor::Device;

use crate::{PpoConfig, PpoError, networks::Networks, normaliser::Normaliser, trainer::Counters};

/// A policy without noise.
#[derive(Clone, Debug, PartialEq)]
pub struct Actor {
    pub(crate) networks: Networks,
    pub(crate) normaliser: Normaliser,
    pub(crate) action_dim: usize,
    /// What it was trained with.
    pub(crate) config: PpoConfig,
    pub(crate) counters: Counters,
    pub(crate) memory: String,
}

impl Actor {
    /// Width of an observation.
    pub fn actor_dim(&self) -> usize {
        self.normaliser.mean.len()
    }

    /// Width of an action.
    pub fn action_dim(&self) -> usize {
        self.action_dim
    }

    /// Steps that it was trained for, of all environments.
    pub fn steps(&self) -> u64 {
        self.counters.env_steps * self.config.num_envs as u64
    }

    /// What the environments remembered in which it learned ([`crate::VectorEnv::memory`]).
    pub fn memory(&self) -> &str {
        &self.memory
    }

    /// The likeliest actions, `[any, action_dim]`, for `observations` as the environment gives them, `[any, actor_dim]`.
    ///
    /// # Errors
    /// Observations that are no whole rows, or hold numbers that are none.
    pub fn actions(&self, observations: &[f32]) -> Result<Vec<f32>, PpoError> {
        let dim = self.actor_dim();
        if !observations.len().is_multiple_of(dim) {
            let found = observations.len();
            return Err(PpoError::Shape(format!("{found} numbers as observations, expected rows of {dim}")));
        }
        if let Some(at) = observations.iter().position(|value| !value.is_finite()) {
            return Err(PpoError::Shape(format!(
                "component {} of observation {} is {}, expected finite numbers",
                at % dim,
                at / dim,
                observations[at]
            )));
        }
        let tensors = self.networks.tensors(&Device::flex());
        let (actor, _, _) = self.networks.split(&tensors);
        Ok(actor.outputs(&self.normaliser.normalise(observations, self.config.observation_clip)))
    }
}
