//! The task as something to learn: what actor and critic see, what an action is, what is rewarded.
//!
//! [`LearnConfig`] is data. [`ObservationLayout`] says which number of an observation is what. [`ActorState`] makes
//! observations of readings and targets of actions, here and on a robot. With the `mujoco` feature,
//! [`LearnTask`] is what environments share, [`LearnEnv`] is one of them, and [`LearnBatch`] steps many on every core and
//! begins a new episode wherever one ends.
//!
//! The actor sees what the real robot has: joint readings, its own commands, touch. Everything else is the critic's
//! (paper, appendix "Reinforcement Learning Expert Training Details").

mod actor;
mod config;
mod curriculum;
mod observation;
mod reward;

#[cfg(feature = "mujoco")]
mod batch;
#[cfg(feature = "mujoco")]
mod env;
#[cfg(feature = "mujoco")]
mod task;

pub use actor::{ActorState, ActorTask};
pub use config::{
    ActionConfig, Bounds, LearnConfig, ObservationConfig, PushConfig, RewardConfig, StartConfig,
};
pub use curriculum::Curriculum;
pub use observation::{ObservationLayout, Segment};
pub use reward::{Facts, REWARD_TERMS};

#[cfg(feature = "mujoco")]
pub use {
    batch::{Ending, LearnBatch, LearnStep},
    env::{Conditions, LearnEnv},
    task::LearnTask,
};
