//! A policy that has been learned, and what it does in a trial.

use std::path::Path;

use anyhow::{Context as _, bail};
use palpate_grasp::learn::{LearnEnv, ObservationLayout};
use palpate_grasp::trial::Outcome;
use palpate_ppo::{Actor, CHECKPOINT_FILE};

use crate::files::{self, Source};
use crate::task::{Memory, OpenTask};

/// A policy that always does what it thinks best.
pub(crate) struct Policy {
    actor: Actor,
    layout: ObservationLayout,
}

/// Sees every step of a trial.
pub(crate) trait Watch {
    /// What the policy sees, and what it does next. `critic` begins with what it would see of everything.
    fn before(&mut self, env: &LearnEnv, actor: &[f32], critic: &[f32]);
    /// What came of it.
    fn after(&mut self, env: &LearnEnv);
}

impl Watch for () {
    fn before(&mut self, _: &LearnEnv, _: &[f32], _: &[f32]) {}
    fn after(&mut self, _: &LearnEnv) {}
}

/// The policy of a training's folder, of a checkpoint or of an exported file; and its file.
pub(crate) fn read(path: &Path) -> anyhow::Result<(Actor, Source)> {
    let file = if path.is_dir() { path.join(CHECKPOINT_FILE) } else { path.to_owned() };
    let bytes = std::fs::read(&file).with_context(|| {
        format!(
            "failed to read {file:?}; --policy is a training's folder, a checkpoint or an exported policy"
        )
    })?;
    let source =
        Source { role: "policy".to_owned(), path: files::shown(&file), sha256: files::sha256(&bytes) };
    Ok((Actor::from_bytes(&file, &bytes)?, source))
}

impl Policy {
    /// The policy at `path` ([`read`]), if it was trained in `opened`; and its file.
    pub(crate) fn open(path: &Path, opened: &OpenTask) -> anyhow::Result<(Self, Source)> {
        let (actor, source) = read(path)?;
        let error = |problem: String| anyhow::anyhow!("policy {} does not fit: {problem}", source.path);
        let memory = Memory::from_toml(actor.memory()).map_err(error)?;
        memory.task.check(&opened.record).map_err(error)?;
        let layout = opened.task.layout().clone();
        let dims = [
            ("observations", actor.actor_dim(), layout.actor_dim()),
            ("actions", actor.action_dim(), layout.action_dim()),
        ];
        if let Some((what, found, expected)) = dims.iter().find(|(_, found, expected)| found != expected) {
            return Err(error(format!("its {what} have {found} numbers, those of the task {expected}")));
        }
        Ok((Self { actor, layout }, source))
    }

    /// Runs the trial that has just begun in `env` to its verdict.
    pub(crate) fn run(&self, env: &mut LearnEnv, watch: &mut impl Watch) -> anyhow::Result<Outcome> {
        let mut actor = vec![0.0; self.layout.actor_dim()];
        let mut critic = vec![0.0; self.layout.critic_dim()];
        loop {
            env.observe(&mut actor, &mut critic);
            let action = self.actor.actions(&actor)?;
            if let Some(idx) = action.iter().position(|value| !value.is_finite()) {
                bail!(
                    "the policy's action {:?} is {}, expected a finite number",
                    self.layout.action[idx],
                    action[idx]
                );
            }
            watch.before(env, &actor, &critic);
            let outcome = env.step(&action)?;
            watch.after(env);
            if let Some(outcome) = outcome {
                return Ok(outcome);
            }
        }
    }
}
