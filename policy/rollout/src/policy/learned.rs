//! Policies that were learned.

use std::collections::VecDeque;

use anyhow::bail;
use palpate_grasp::learn::{ActorState, ActorTask};
use palpate_ppo::Actor;

use super::{Horizon, Policy, Seen, Step, newest, sensed};

/// A policy that was learned, without its noise.
pub struct LearnedPolicy {
    task: ActorTask,
    actor: Actor,
    state: ActorState,
    observation: Vec<f32>,
}

impl LearnedPolicy {
    /// `actor` in `task`.
    ///
    /// # Errors
    /// An actor with observations or actions of another size.
    pub fn new(task: ActorTask, actor: Actor) -> anyhow::Result<Self> {
        let layout = task.layout();
        let dims = [
            ("observations", actor.actor_dim(), layout.actor_dim()),
            ("actions", actor.action_dim(), layout.action_dim()),
        ];
        if let Some((what, found, expected)) = dims.iter().find(|(_, found, expected)| found != expected) {
            bail!("the policy's {what} have {found} numbers, those of the station {expected}");
        }
        let start = task.world().start_positions(&task.station().robot);
        let state = ActorState::begin(&task, &start);
        Ok(Self { observation: vec![0.0; layout.actor_dim()], state, task, actor })
    }

    /// What the actor saw at the last step.
    pub fn observation(&self) -> &[f32] {
        &self.observation
    }
}

impl Policy for LearnedPolicy {
    fn horizon(&self) -> Horizon {
        Horizon::STEP
    }

    fn begin(&mut self, positions: &[f64]) {
        self.state = ActorState::begin(&self.task, positions);
    }

    fn plan(&mut self, seen: &VecDeque<Seen>) -> anyhow::Result<Vec<Step>> {
        let now = newest(seen)?;
        self.state.observe(&self.task, &now.positions, &now.active, now.time_s, &mut self.observation);
        let action = self.actor.actions(&self.observation)?;
        if let Some(idx) = action.iter().position(|value| !value.is_finite()) {
            bail!(
                "the policy's action {:?} is {}, expected a finite number",
                self.task.layout().action[idx],
                action[idx]
            );
        }
        let targets = self.state.act(&self.task, &action, sensed(now)).to_vec();
        Ok(vec![Step { action, targets }])
    }
}
