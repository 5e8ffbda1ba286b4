//! Learning: rollouts in, better policies out.

use std::collections::{BTreeMap, VecDeque};

use palpate_training::{Adam, add_gradients, clip_norm, permutation};
use rayon::prelude::*;

use crate::{
    Actor, Metrics, PpoConfig, PpoError, VectorEnv,
    loss::{LossParams, LossSums, Samples, entropy, gradients},
    networks::{CHUNK_ROWS, Dims, Networks},
    normaliser::Normaliser,
    rollout::{Behaviour, Episode, Live, Normalisers, Rollout},
    seed::{Purpose, generator},
};

/// A training under way.
#[derive(Clone, Debug)]
pub struct Trainer {
    pub(crate) config: PpoConfig,
    pub(crate) dims: Dims,
    pub(crate) reward_terms: Vec<String>,
    pub(crate) networks: Networks,
    pub(crate) adam: Adam,
    pub(crate) normalisers: Normalisers,
    pub(crate) counters: Counters,
    /// Verdicts of the newest episodes, oldest first; as many as `stop` counts.
    pub(crate) recent: VecDeque<bool>,
    /// What the environments remember beyond episodes, as of the last update.
    pub(crate) memory: String,
    /// Nothing where new episodes are to begin.
    live: Option<Live>,
}

/// What has happened so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Counters {
    pub(crate) updates: u64,
    /// Steps of each environment.
    pub(crate) env_steps: u64,
    /// Calls of [`VectorEnv::reset`].
    pub(crate) rounds: u64,
    pub(crate) episodes: u64,
}

impl Trainer {
    /// A training that begins.
    ///
    /// # Errors
    /// A configuration that makes no sense, or that does not fit `env`.
    pub fn new<E: VectorEnv + ?Sized>(config: PpoConfig, env: &E) -> Result<Self, PpoError> {
        config.validate()?;
        let dims = Dims { actor: env.actor_dim(), critic: env.critic_dim(), action: env.action_dim() };
        if env.num_envs() != config.num_envs {
            let (found, expected) = (env.num_envs(), config.num_envs);
            return Err(PpoError::Shape(format!(
                "there are {found}, the configuration's num_envs is {expected}"
            )));
        }
        let reward_terms = env.reward_terms();
        let widths = [
            ("actor_dim", dims.actor),
            ("critic_dim", dims.critic),
            ("action_dim", dims.action),
            ("the number of reward terms", reward_terms.len()),
        ];
        if let Some((name, _)) = widths.iter().find(|(_, width)| *width == 0) {
            return Err(PpoError::Shape(format!("{name} is 0, expected 1 or more")));
        }
        let networks = Networks::new(&config.networks, dims, config.initial_std, config.seed);
        Ok(Self {
            adam: Adam::new(networks.arrays.iter().map(|array| array.values.len())),
            normalisers: Normalisers {
                actor: Normaliser::new(dims.actor),
                critic: Normaliser::new(dims.critic),
            },
            networks,
            dims,
            memory: env.memory(),
            reward_terms,
            config,
            counters: Counters::default(),
            recent: VecDeque::new(),
            live: None,
        })
    }

    /// Acts for a horizon of steps and learns from them. Where the configuration wants a checkpoint afterwards, the next
    /// update begins new episodes.
    ///
    /// # Errors
    /// Environments that fail or give numbers that are none; gradients that are none. Parameters are then those before
    /// the step that failed.
    pub fn update<E: VectorEnv + ?Sized>(&mut self, env: &mut E) -> Result<Metrics, PpoError> {
        let live = self.live.take();
        let behaviour = Behaviour {
            config: &self.config,
            dims: self.dims,
            networks: &self.networks,
            normalisers: &self.normalisers,
            env_steps: self.counters.env_steps,
        };
        let mut live = match live {
            Some(live) => live,
            None => {
                let step = self.counters.env_steps;
                let failed = |source| PpoError::Env { step, source };
                let observations = env.reset(self.counters.rounds).map_err(failed)?;
                self.counters.rounds += 1;
                behaviour.begin(observations)?
            }
        };
        let rollout = behaviour.rollout(env, &mut live)?;
        let (sums, gradient_norm) = self.learn(&rollout.samples)?;

        self.normalisers = rollout.normalisers.clone();
        self.memory = env.memory();
        self.counters.updates += 1;
        self.counters.env_steps += self.config.horizon() as u64;
        self.counters.episodes += rollout.episodes.len() as u64;
        self.recent.extend(rollout.episodes.iter().map(|episode| episode.success));
        self.forget_old_verdicts();
        if !self.counters.updates.is_multiple_of(self.config.checkpoint_updates) {
            self.live = Some(live);
        }
        Ok(Metrics { environment: env.metrics(), ..self.metrics(&rollout, &sums, gradient_norm) })
    }

    /// Whether new episodes are to begin, which is when the training can be written down.
    pub fn is_between_episodes(&self) -> bool {
        self.live.is_none()
    }

    /// Gives up the episodes that are under way.
    pub fn begin_new_episodes(&mut self) {
        self.live = None;
    }

    /// Updates done.
    pub fn updates(&self) -> u64 {
        self.counters.updates
    }

    /// Steps learned from, of all environments.
    pub fn steps(&self) -> u64 {
        self.counters.env_steps * self.config.num_envs as u64
    }

    /// How to learn.
    pub fn config(&self) -> &PpoConfig {
        &self.config
    }

    /// Share of the newest episodes that succeeded, once there are as many as the configuration's `stop` counts.
    pub fn recent_success_rate(&self) -> Option<f64> {
        let stop = self.config.stop.as_ref()?;
        let successes = self.recent.iter().filter(|&&success| success).count();
        (self.recent.len() >= stop.episodes).then(|| successes as f64 / self.recent.len() as f64)
    }

    /// The policy so far.
    pub fn actor(&self) -> Actor {
        Actor {
            networks: self.networks.without_critic(),
            normaliser: self.normalisers.actor.clone(),
            action_dim: self.dims.action,
            config: self.config.clone(),
            counters: self.counters,
            memory: self.memory.clone(),
        }
    }

    pub(crate) fn forget_old_verdicts(&mut self) {
        let kept = self.config.stop.as_ref().map_or(0, |stop| stop.episodes);
        self.recent.drain(..self.recent.len().saturating_sub(kept));
    }

    /// All epochs over `samples`; gives the sums and the mean norm of the gradient.
    fn learn(&mut self, samples: &Samples) -> Result<(LossSums, f64), PpoError> {
        let config = &self.config;
        let params = LossParams {
            clip: config.clip,
            value_coefficient: config.value_coefficient,
            entropy_coefficient: config.entropy_coefficient,
        };
        let rows = samples.returns.len();
        let minibatch_rows = rows / config.num_minibatches;
        let mut sums = LossSums::default();
        let mut norms = 0.0;
        let kept_actor =
            (self.counters.updates < config.critic_warmup_updates).then(|| self.networks.without_critic());
        for epoch in 0..config.num_epochs as u64 {
            let mut order = generator(config.seed, Purpose::Shuffle, self.counters.updates, epoch);
            for minibatch in permutation(&mut order, rows).chunks_exact(minibatch_rows) {
                let parts: Vec<_> = minibatch
                    .par_chunks(CHUNK_ROWS)
                    .map(|indices| {
                        let part = samples.gather(indices, self.dims);
                        gradients(&self.networks, &part, self.dims, minibatch_rows, params)
                    })
                    .collect();
                let mut parts = parts.into_iter();
                let (mut total, part_sums) = parts.next().expect("a minibatch has samples");
                sums.add(&part_sums);
                for (part, part_sums) in parts {
                    sums.add(&part_sums);
                    add_gradients(&mut total, &part);
                }
                let norm = clip_norm(&mut total, config.max_gradient_norm);
                if !norm.is_finite() {
                    return Err(self.diverged(&total));
                }
                norms += norm;
                let parameters = self.networks.arrays.iter_mut().map(|array| &mut array.values);
                self.adam.step(parameters, &total, config.learning_rate, 0.0);
                if let Some(actor) = &kept_actor {
                    self.networks.arrays[..actor.arrays.len()].clone_from_slice(&actor.arrays);
                }
            }
        }
        Ok((sums, norms / (config.num_epochs * config.num_minibatches) as f64))
    }

    fn diverged(&self, gradients: &[Vec<f32>]) -> PpoError {
        let broken = |gradient: &Vec<f32>| gradient.iter().any(|slope| !slope.is_finite());
        let name =
            gradients.iter().position(broken).map_or("their norm", |at| &self.networks.arrays[at].name);
        PpoError::Diverged { what: format!("the gradient of {name}"), update: self.counters.updates }
    }

    fn metrics(&self, rollout: &Rollout, sums: &LossSums, gradient_norm: f64) -> Metrics {
        let episodes = &rollout.episodes;
        let mean = |number: &dyn Fn(&Episode) -> f64| {
            (!episodes.is_empty()).then(|| episodes.iter().map(number).sum::<f64>() / episodes.len() as f64)
        };
        let samples = sums.samples as f64;
        let log_std = self.networks.log_std();
        Metrics {
            update: self.counters.updates,
            steps: self.steps(),
            episodes: self.counters.episodes,
            return_mean: mean(&|episode| episode.total),
            length_mean: mean(&|episode| episode.length as f64),
            success_rate: mean(&|episode| f64::from(u8::from(episode.success))),
            recent_success_rate: self.recent_success_rate(),
            reward_terms: self.reward_terms.iter().cloned().zip(rollout.term_means.iter().copied()).collect(),
            environment: BTreeMap::new(),
            policy_loss: sums.policy_loss / samples,
            value_loss: sums.value_loss / samples,
            explained_variance: rollout.explained_variance,
            kl: sums.kl / samples,
            clip_fraction: sums.clipped as f64 / samples,
            entropy: entropy(log_std),
            action_std: log_std.iter().map(|&log_std| f64::from(log_std).exp()).sum::<f64>()
                / log_std.len() as f64,
            gradient_norm,
        }
    }
}
