//! Many environments of a learning task, on every core.

use std::sync::Arc;

use rayon::prelude::*;

use super::{Curriculum, LearnEnv, LearnTask, REWARD_TERMS};
use crate::env::stream;
use crate::trial::Outcome;
use crate::{GraspError, GraspScene, Start};

/// Environments that step together; where an episode ends, the next one begins within the same step.
///
/// What happens follows from the task, the seed, the rounds and the actions, with the same bits for any number of threads.
#[derive(Debug)]
pub struct LearnBatch {
    task: Arc<LearnTask>,
    seed: u64,
    curriculum: Curriculum,
    rows: Vec<Row>,
}

/// What a step of all environments gave; row by row, one row an environment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LearnStep {
    /// `[num_envs, actor_dim]`, of the new episode where one ended.
    pub actor: Vec<f32>,
    /// `[num_envs, critic_dim]`, likewise.
    pub critic: Vec<f32>,
    /// `[num_envs]`: the sum of the terms, in their order.
    pub rewards: Vec<f32>,
    /// `[num_envs, num_terms]`.
    pub terms: Vec<f32>,
    /// `[num_envs]`: how the episode ended where it did.
    pub endings: Vec<Option<Ending>>,
}

/// The end of an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Ending {
    /// Its verdict.
    pub outcome: Outcome,
    /// Whether the time ran out; otherwise nothing more could be earned.
    pub truncated: bool,
    /// Control steps that it had.
    pub num_steps: usize,
    /// Each term summed over the episode.
    pub term_sums: Vec<f64>,
    /// The critic's observation after the last step, before the next episode began.
    pub final_critic: Vec<f32>,
}

/// An environment and what it last gave.
#[derive(Debug)]
struct Row {
    env: LearnEnv,
    actor: Vec<f32>,
    critic: Vec<f32>,
    terms: Vec<f32>,
    num_steps: usize,
    term_sums: Vec<f64>,
    ending: Option<Ending>,
}

impl LearnBatch {
    /// `num_envs` environments that have not begun yet: [`Self::reset`] comes first.
    pub fn new(task: Arc<LearnTask>, num_envs: usize, seed: u64) -> Result<Self, GraspError> {
        let row = |idx: usize| {
            Ok(Row {
                env: LearnEnv::new(Arc::clone(&task), stream(seed, idx as u64))?,
                actor: vec![0.0; task.layout().actor_dim()],
                critic: vec![0.0; task.layout().critic_dim()],
                terms: vec![0.0; REWARD_TERMS.len()],
                num_steps: 0,
                term_sums: vec![0.0; REWARD_TERMS.len()],
                ending: None,
            })
        };
        let rows = (0..num_envs).into_par_iter().map(row).collect::<Result<Vec<_>, GraspError>>()?;
        let curriculum = Curriculum::new(&task.config().start);
        Ok(Self { task, seed, curriculum, rows })
    }

    /// Number of environments.
    pub fn num_envs(&self) -> usize {
        self.rows.len()
    }

    /// Length of an actor's observation.
    pub fn actor_dim(&self) -> usize {
        self.task.layout().actor_dim()
    }

    /// Length of a critic's.
    pub fn critic_dim(&self) -> usize {
        self.task.layout().critic_dim()
    }

    /// Length of an action.
    pub fn action_dim(&self) -> usize {
        self.task.layout().action_dim()
    }

    /// The task.
    pub fn task(&self) -> &Arc<LearnTask> {
        &self.task
    }

    /// The scene of the task.
    pub fn scene(&self) -> &Arc<GraspScene> {
        self.task.scene()
    }

    /// How wide the region is that objects start in, for a training to keep.
    pub fn curriculum(&self) -> &Curriculum {
        &self.curriculum
    }

    /// Goes on from a curriculum that was kept.
    pub fn set_curriculum(&mut self, curriculum: Curriculum) {
        self.curriculum = curriculum;
    }

    /// Begins a new episode everywhere. Random numbers follow from the seed, `round` and the number of the environment,
    /// whatever happened before: who resumes a training calls this with the next round.
    pub fn reset(&mut self, round: u32) -> Result<LearnStep, GraspError> {
        let (seed, half_width_m) = (self.seed, self.curriculum.half_width_m);
        self.rows.par_iter_mut().enumerate().try_for_each(|(idx, row)| {
            row.env.set_rng(stream(seed, u64::from(round) << u32::BITS | idx as u64));
            row.terms.fill(0.0);
            row.begin(half_width_m)
        })?;
        Ok(self.told())
    }

    /// Begins a new episode in each at the start of the same number.
    ///
    /// # Panics
    /// If there are not as many starts as environments: a caller's bug.
    pub fn begin(&mut self, starts: &[Start]) -> Result<LearnStep, GraspError> {
        assert_eq!(starts.len(), self.rows.len(), "one start an environment");
        self.rows.par_iter_mut().zip(starts).try_for_each(|(row, start)| {
            row.env.begin(start)?;
            row.terms.fill(0.0);
            row.forget();
            Ok::<(), GraspError>(())
        })?;
        Ok(self.told())
    }

    /// One control step of each with `actions`, `[num_envs, action_dim]`, each clipped to -1 to 1. Refuses actions that are
    /// not finite.
    ///
    /// # Panics
    /// If `actions` has the wrong length: a caller's bug.
    pub fn step(&mut self, actions: &[f32]) -> Result<LearnStep, GraspError> {
        let action_dim = self.action_dim();
        assert_eq!(actions.len(), self.rows.len() * action_dim, "one action per environment");
        if let Some(idx) = actions.iter().position(|action| !action.is_finite()) {
            let name = self.task.layout().action[idx % action_dim].clone();
            return Err(GraspError::Action { env: idx / action_dim, name, value: actions[idx] });
        }
        let half_width_m = self.curriculum.half_width_m;
        self.rows
            .par_iter_mut()
            .zip(actions.par_chunks(action_dim))
            .try_for_each(|(row, action)| row.step(action, half_width_m))?;
        for ending in self.rows.iter().filter_map(|row| row.ending.as_ref()) {
            self.curriculum.count(&self.task.config().start, ending.outcome == Outcome::Success);
        }
        Ok(self.told())
    }

    fn told(&mut self) -> LearnStep {
        let mut step = LearnStep::default();
        for row in &mut self.rows {
            step.actor.extend(&row.actor);
            step.critic.extend(&row.critic);
            step.rewards.push(row.terms.iter().sum());
            step.terms.extend(&row.terms);
            step.endings.push(row.ending.take());
        }
        step
    }
}

impl Row {
    fn begin(&mut self, half_width_m: f64) -> Result<(), GraspError> {
        self.env.reset(half_width_m)?;
        self.forget();
        Ok(())
    }

    /// An episode begins where the environment is.
    fn forget(&mut self) {
        self.num_steps = 0;
        self.term_sums.fill(0.0);
        self.ending = None;
        self.env.observe(&mut self.actor, &mut self.critic);
    }

    fn step(&mut self, action: &[f32], half_width_m: f64) -> Result<(), GraspError> {
        let outcome = self.env.step(action)?;
        self.num_steps += 1;
        let terms = self.env.terms();
        self.terms.iter_mut().zip(terms).for_each(|(into, term)| *into = *term as f32);
        self.term_sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        self.env.observe(&mut self.actor, &mut self.critic);
        let Some(outcome) = outcome else { return Ok(()) };
        let ending = Ending {
            outcome,
            truncated: matches!(outcome, Outcome::EmptyGrasp | Outcome::Slip),
            num_steps: self.num_steps,
            term_sums: self.term_sums.clone(),
            final_critic: self.critic.clone(),
        };
        self.begin(half_width_m)?;
        self.ending = Some(ending);
        Ok(())
    }
}
