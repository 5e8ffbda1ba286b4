//! What is learned in: many environments that step together.

use std::collections::BTreeMap;

/// An error of an environment; [`crate::PpoError`] says at which step it came up.
pub type EnvError = Box<dyn std::error::Error + Send + Sync>;

/// What actor and critic see of every environment, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observations {
    /// What hardware would see too, `[num_envs, actor_dim]`.
    pub actor: Vec<f32>,
    /// What only a simulator sees, usually with the actor's observation among it, `[num_envs, critic_dim]`.
    pub critic: Vec<f32>,
}

/// How an episode ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Ending {
    /// The task is over: nothing can be earned after this step.
    Terminated {
        /// Whether the task was achieved.
        success: bool,
    },
    /// The clock ran out: what could still have been earned is the critic's guess at `final_critic`.
    Truncated {
        /// Whether the task was achieved.
        success: bool,
        /// The critic's observation after the last step, before the new episode began, `[critic_dim]`.
        final_critic: Vec<f32>,
    },
}

impl Ending {
    /// Whether the task was achieved.
    pub fn success(&self) -> bool {
        match self {
            Self::Terminated { success } | Self::Truncated { success, .. } => *success,
        }
    }
}

/// What one step of all environments gave.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepResult {
    /// Observations after the step; of a new episode where one ended.
    pub observations: Observations,
    /// What each term of the reward gave, `[num_envs, num_terms]`; the reward is their sum.
    pub reward_terms: Vec<f32>,
    /// How the episode ended where it did, `[num_envs]`.
    pub endings: Vec<Option<Ending>>,
}

/// Many environments that step together. Where an episode ends, the next one begins within the same step.
pub trait VectorEnv {
    /// Number of environments.
    fn num_envs(&self) -> usize;
    /// Width of the actor's observation.
    fn actor_dim(&self) -> usize;
    /// Width of the critic's observation.
    fn critic_dim(&self) -> usize;
    /// Width of an action.
    fn action_dim(&self) -> usize;
    /// Names of the terms of the reward, in the order of [`StepResult::reward_terms`].
    fn reward_terms(&self) -> Vec<String>;

    /// Begins a new episode everywhere.
    ///
    /// `round` counts the calls of a training, also over interruptions. Everything that happens until the next call
    /// must follow from how `self` was made, from [`VectorEnv::memory`], from `round` and from the actions: a training
    /// that resumes makes the environments anew, restores their memory and calls this with the next round.
    ///
    /// # Errors
    /// Whatever keeps the environments from starting.
    fn reset(&mut self, round: u64) -> Result<Observations, EnvError>;

    /// One step with `actions`, `[num_envs, action_dim]`. Actions are samples of a Gaussian: the environment limits them.
    ///
    /// # Errors
    /// Whatever keeps the environments from going on.
    fn step(&mut self, actions: &[f32]) -> Result<StepResult, EnvError>;

    /// Numbers for [`crate::Metrics::environment`], such as how hard a curriculum has become, by name; none unless overridden.
    fn metrics(&self) -> BTreeMap<String, f64> {
        BTreeMap::new()
    }

    /// What outlives episodes, such as how far a curriculum is, as text for a checkpoint; nothing unless overridden.
    fn memory(&self) -> String {
        String::new()
    }

    /// Takes over what [`VectorEnv::memory`] gave when a checkpoint was written.
    ///
    /// # Errors
    /// Text that is no such memory.
    fn restore(&mut self, memory: &str) -> Result<(), EnvError> {
        if memory.is_empty() {
            return Ok(());
        }
        Err(format!("these environments have no memory, the checkpoint's is {memory:?}").into())
    }
}
