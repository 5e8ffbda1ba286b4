//! Trials of the grasp world that keep what was felt at every step.

use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_grasp::learn::{Conditions, LearnEnv, LearnTask};
use palpate_grasp::trial::{Judge, Outcome};
use palpate_grasp::{GraspEnv, GraspError, GraspScene, Randomisation, Script, ScriptRun, Start};

use crate::policy::{Policy, Watch};

/// How a trial begins.
#[derive(Clone, Debug)]
pub(super) enum Begin {
    /// As the grasp world draws it.
    Trial { seed: u64, trial: u64 },
    /// With the object here, in the nominal world.
    Pose { positions: Vec<f64>, base_from_object: Isometry3<f64> },
}

impl Begin {
    /// The start in `scene`.
    pub(super) fn start(&self, scene: &GraspScene) -> Start {
        match self {
            Self::Trial { seed, trial } => {
                Start::of_trial(scene, scene.config().task.half_width_m, *seed, *trial)
            }
            Self::Pose { positions, base_from_object } => Start {
                randomisation: Randomisation::none(),
                positions: positions.clone(),
                base_from_object: *base_from_object,
            },
        }
    }
}

/// A trial in simulation.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Simulated {
    pub(super) outcome: Outcome,
    /// Touch before each step, `[step * num_channels + channel]`.
    pub(super) active: Vec<bool>,
    /// Joint positions before each step, rad or m.
    pub(super) positions: Vec<Vec<f64>>,
}

impl Simulated {
    fn empty() -> Self {
        Self { outcome: Outcome::EmergencyStop, active: Vec::new(), positions: Vec::new() }
    }

    fn see(&mut self, env: &GraspEnv) {
        self.active.extend_from_slice(&env.readings().active);
        self.positions.push(env.positions().to_vec());
    }
}

impl Watch for Simulated {
    fn before(&mut self, env: &LearnEnv, _: &[f32], _: &[f32]) {
        self.see(env.grasp());
    }

    fn after(&mut self, _: &LearnEnv) {}
}

/// What moved the hand.
pub(super) enum Mover {
    Script(Arc<Script>),
    Learned { policy: Box<Policy>, task: Arc<LearnTask> },
}

impl Mover {
    /// The trial that begins like this.
    pub(super) fn run(
        &self,
        scene: &Arc<GraspScene>,
        begin: &Begin,
        start: &Start,
    ) -> anyhow::Result<Simulated> {
        match self {
            Self::Script(script) => {
                let mut run = ScriptRun::new(script);
                let longest_s = scene.config().task.episode_s;
                Ok(drive(scene, start, longest_s, |env, _| {
                    run.targets(script, scene.station(), scene.config(), env.sensed())
                })?)
            }
            Self::Learned { policy, task } => {
                let mut env = LearnEnv::for_trials(Arc::clone(task))?;
                match begin {
                    // As `evaluate` does it, its noise of readings included.
                    Begin::Trial { seed, trial } => {
                        env.begin_trial(*seed, *trial, Conditions::Evaluation)?;
                    }
                    Begin::Pose { .. } => {
                        env.begin_trial(0, 0, Conditions::Evaluation)?;
                        env.begin(start)?;
                    }
                }
                let mut seen = Simulated::empty();
                seen.outcome = policy.run(&mut env, &mut seen)?;
                Ok(seen)
            }
        }
    }
}

/// Carries out `commands`, one a step, from `start`, until they end.
pub(super) fn commands(
    scene: &Arc<GraspScene>,
    start: &Start,
    commands: &[Vec<f64>],
) -> Result<Simulated, GraspError> {
    let longest_s = commands.len() as f64 / scene.config().control_rate_hz;
    // One step more than there are commands is never made: time is up before.
    drive(scene, start, longest_s, |env, idx| {
        commands.get(idx).map_or_else(|| env.targets().to_vec(), Vec::clone)
    })
}

/// Control steps towards what `next` says, until there is a verdict.
fn drive(
    scene: &Arc<GraspScene>,
    start: &Start,
    longest_s: f64,
    mut next: impl FnMut(&GraspEnv, usize) -> Vec<f64>,
) -> Result<Simulated, GraspError> {
    let mut env = GraspEnv::new(Arc::clone(scene), 0, 0)?;
    env.begin(start)?;
    let mut judge = Judge::new(env.world(), longest_s);
    let mut seen = Simulated::empty();
    for idx in 0.. {
        seen.see(&env);
        let targets = next(&env, idx);
        match env.step(&targets) {
            Err(GraspError::Diverged { .. }) => break,
            other => other?,
        }
        let contacts = env.world().contacts();
        if let Some(outcome) = judge.look(scene.config(), env.world(), &contacts) {
            seen.outcome = outcome;
            break;
        }
    }
    Ok(seen)
}
