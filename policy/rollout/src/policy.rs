//! Policies as a rollout runs them: from what was seen to what joints are told.

use std::collections::VecDeque;
use std::sync::Arc;

use anyhow::bail;
use palpate_grasp::{GraspConfig, Script, ScriptRun, Sensed};
use palpate_robot_model::Station;

#[cfg(feature = "learned")]
mod cloned;
#[cfg(feature = "learned")]
mod learned;

#[cfg(feature = "learned")]
pub use cloned::ClonedPolicy;
#[cfg(feature = "learned")]
pub use learned::LearnedPolicy;

/// What the robot reports at a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Time of the step since the trial began, s.
    pub time_s: f64,
    /// Joint positions, rad or m, in the station's order.
    pub positions: Vec<f64>,
    /// Whether each channel is on, in the layout's order.
    pub active: Vec<bool>,
}

/// How far a policy looks back and ahead, in steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Horizon {
    /// Observations that it is given, at most (T_o).
    pub observations: usize,
    /// Steps of a plan (H).
    pub predicted: usize,
    /// Of these, how many are carried out before the next plan (N_a).
    pub executed: usize,
}

impl Horizon {
    /// One step from one observation.
    pub const STEP: Self = Self { observations: 1, predicted: 1, executed: 1 };
}

/// One step of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// What the policy put out, in its own units; empty for a script.
    pub action: Vec<f32>,
    /// Where joints shall go, rad or m, in the station's order.
    pub targets: Vec<f64>,
}

/// Whatever can move the hand.
pub trait Policy {
    /// How far it looks.
    fn horizon(&self) -> Horizon;

    /// A trial begins, with the robot told to be at `positions`.
    fn begin(&mut self, positions: &[f64]);

    /// The next steps, at least one, from what was seen; the newest is last, and there is at least one.
    ///
    /// # Errors
    /// Whatever keeps it from planning; numbers that are none.
    fn plan(&mut self, seen: &VecDeque<Seen>) -> anyhow::Result<Vec<Step>>;
}

/// A script as a policy: it feels only where it tries again.
pub struct ScriptPolicy {
    station: Arc<Station>,
    world: GraspConfig,
    script: Script,
    run: ScriptRun,
}

impl ScriptPolicy {
    /// `script` for the robot of `station`.
    pub fn new(station: Arc<Station>, world: GraspConfig, script: Script) -> Self {
        Self { run: ScriptRun::new(&script), station, world, script }
    }
}

impl Policy for ScriptPolicy {
    fn horizon(&self) -> Horizon {
        Horizon::STEP
    }

    fn begin(&mut self, _positions: &[f64]) {
        self.run = ScriptRun::new(&self.script);
    }

    fn plan(&mut self, seen: &VecDeque<Seen>) -> anyhow::Result<Vec<Step>> {
        let now = newest(seen)?;
        let targets = self.run.targets(&self.script, &self.station, &self.world, sensed(now));
        Ok(vec![Step { action: Vec::new(), targets }])
    }
}

fn newest(seen: &VecDeque<Seen>) -> anyhow::Result<&Seen> {
    match seen.back() {
        Some(seen) => Ok(seen),
        None => bail!("nothing has been seen yet"),
    }
}

fn sensed(seen: &Seen) -> Sensed<'_> {
    Sensed { time_s: seen.time_s, positions: &seen.positions, active: &seen.active }
}
