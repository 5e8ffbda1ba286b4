//! Acting: what the environments gave for the actions of one policy, made into samples to learn from.

use burn_tensor::Device;

use palpate_training::fill_normal;

use crate::{
    Ending, EnvError, Gae, Observations, PpoConfig, PpoError, StepResult, Transition, VectorEnv,
    loss::Samples,
    networks::{Dims, Networks},
    normaliser::Normaliser,
    seed::{Purpose, generator},
};

/// Episodes that are under way.
#[derive(Clone, Debug)]
pub(crate) struct Live {
    observations: Observations,
    /// Sum of rewards so far, `[num_envs]`.
    returns: Vec<f64>,
    /// Steps so far, `[num_envs]`.
    lengths: Vec<u64>,
}

/// How an episode went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Episode {
    pub(crate) total: f64,
    pub(crate) length: u64,
    pub(crate) success: bool,
}

/// What a rollout gave.
#[derive(Debug)]
pub(crate) struct Rollout {
    /// Rows in order of time, all environments of a step together.
    pub(crate) samples: Samples,
    /// In order of their ends.
    pub(crate) episodes: Vec<Episode>,
    /// Mean of each term of the reward, a step.
    pub(crate) term_means: Vec<f64>,
    pub(crate) explained_variance: f64,
    /// The normalisers with what was seen here.
    pub(crate) normalisers: Normalisers,
}

/// What brings both observations to mean zero and variance one.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Normalisers {
    pub(crate) actor: Normaliser,
    pub(crate) critic: Normaliser,
}

/// Who acts, and how many steps every environment made before.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Behaviour<'a> {
    pub(crate) config: &'a PpoConfig,
    pub(crate) dims: Dims,
    pub(crate) networks: &'a Networks,
    pub(crate) normalisers: &'a Normalisers,
    pub(crate) env_steps: u64,
}

/// What a step led to, as far as its value goes.
enum Next {
    State,
    Nothing,
    /// Index among the last states of truncated episodes.
    Final(usize),
}

impl Live {
    /// Episodes that begin.
    pub(crate) fn new(observations: Observations, num_envs: usize) -> Self {
        Self { observations, returns: vec![0.0; num_envs], lengths: vec![0; num_envs] }
    }
}

impl Behaviour<'_> {
    /// Checks what `env` gave at its reset and starts counting.
    pub(crate) fn begin(&self, observations: Observations) -> Result<Live, PpoError> {
        self.check_observations(&observations)?;
        Ok(Live::new(observations, self.config.num_envs))
    }

    /// Acts for a horizon of steps.
    pub(crate) fn rollout<E: VectorEnv + ?Sized>(
        &self,
        env: &mut E,
        live: &mut Live,
    ) -> Result<Rollout, PpoError> {
        let (num_envs, clip) = (self.config.num_envs, self.config.observation_clip);
        let tensors = self.networks.tensors(&Device::flex());
        let (actor, _, critic) = self.networks.split(&tensors);
        let num_terms = env.reward_terms().len();

        let mut seen = self.normalisers.clone();
        let mut samples = Samples::default();
        let mut rewards = Vec::new();
        let mut nexts = Vec::new();
        let mut finals = Vec::new();
        let mut episodes = Vec::new();
        let mut term_sums = vec![0.0; num_terms];
        for step in 0..self.config.horizon() as u64 {
            let env_step = self.env_steps + step;
            seen.actor.add(&live.observations.actor);
            seen.critic.add(&live.observations.critic);
            let normal = self.normalisers.actor.normalise(&live.observations.actor, clip);
            let (actions, log_probs) = self.sample(&actor.outputs(&normal), env_step);
            samples.actor.extend(normal);
            samples.critic.extend(self.normalisers.critic.normalise(&live.observations.critic, clip));
            samples.log_probs.extend(log_probs);

            let failed = |source: EnvError| PpoError::Env { step: env_step, source };
            let result = env.step(&actions).map_err(failed)?;
            samples.actions.extend(actions);
            self.check_step(&result, num_terms, env_step + 1)?;
            for (idx, terms) in result.reward_terms.chunks_exact(num_terms).enumerate() {
                let reward: f64 = terms.iter().map(|&term| f64::from(term)).sum();
                term_sums.iter_mut().zip(terms).for_each(|(sum, &term)| *sum += f64::from(term));
                rewards.push(reward);
                live.returns[idx] += reward;
                live.lengths[idx] += 1;
                let ending = &result.endings[idx];
                nexts.push(match ending {
                    None => Next::State,
                    Some(Ending::Terminated { .. }) => Next::Nothing,
                    Some(Ending::Truncated { final_critic, .. }) => {
                        finals.extend(self.normalisers.critic.normalise(final_critic, clip));
                        Next::Final(finals.len() / self.dims.critic - 1)
                    }
                });
                if let Some(ending) = ending {
                    let total = std::mem::take(&mut live.returns[idx]);
                    let length = std::mem::take(&mut live.lengths[idx]);
                    episodes.push(Episode { total, length, success: ending.success() });
                }
            }
            live.observations = result.observations;
        }

        let after = self.normalisers.critic.normalise(&live.observations.critic, clip);
        let mut values = critic.outputs(&samples.critic);
        values.extend(critic.outputs(&after));
        let final_values = critic.outputs(&finals);
        let values: Vec<f64> = values.into_iter().map(f64::from).collect();
        let next_value = |row: usize| match nexts[row] {
            Next::State => values[row + num_envs],
            Next::Nothing => 0.0,
            Next::Final(idx) => f64::from(final_values[idx]),
        };

        let gae = Gae { discount: self.config.discount, lambda: self.config.gae_lambda };
        let mut advantages = vec![0.0; rewards.len()];
        for env in 0..num_envs {
            let rows = || (env..rewards.len()).step_by(num_envs);
            let transitions: Vec<Transition> = rows()
                .map(|row| Transition {
                    reward: rewards[row],
                    value: values[row],
                    next_value: next_value(row),
                    ended: !matches!(nexts[row], Next::State),
                })
                .collect();
            rows().zip(gae.advantages(&transitions)).for_each(|(row, advantage)| advantages[row] = advantage);
        }
        let returns: Vec<f64> =
            advantages.iter().zip(&values).map(|(advantage, value)| advantage + value).collect();
        let (mean, variance) = mean_and_variance(&advantages);
        let (_, variance_of_returns) = mean_and_variance(&returns);
        // Returns that are all alike leave nothing to explain.
        let explained_variance =
            if variance_of_returns > 0.0 { 1.0 - variance / variance_of_returns } else { 0.0 };
        let scale = 1.0 / (variance.sqrt() + 1e-8);
        samples.advantages = advantages.iter().map(|advantage| ((advantage - mean) * scale) as f32).collect();
        samples.returns = returns.into_iter().map(|value| value as f32).collect();
        let term_means = term_sums.into_iter().map(|sum| sum / rewards.len() as f64).collect();
        Ok(Rollout { samples, episodes, term_means, explained_variance, normalisers: seen })
    }

    /// Actions around `means`, `[num_envs, action_dim]`, and the logarithm of the density of each.
    fn sample(&self, means: &[f32], env_step: u64) -> (Vec<f32>, Vec<f32>) {
        let log_std = self.networks.log_std();
        let mut actions = Vec::with_capacity(means.len());
        let mut log_probs = Vec::with_capacity(self.config.num_envs);
        let mut noise = vec![0.0; self.dims.action];
        for (env, means) in means.chunks_exact(self.dims.action).enumerate() {
            let mut generator = generator(self.config.seed, Purpose::Actions, env as u64, env_step);
            fill_normal(&mut generator, &mut noise);
            let mut log_prob = -0.5 * self.dims.action as f64 * std::f64::consts::TAU.ln();
            for ((mean, log_std), noise) in means.iter().zip(log_std).zip(&noise) {
                actions.push(mean + log_std.exp() * noise);
                log_prob -= 0.5 * f64::from(*noise).powi(2) + f64::from(*log_std);
            }
            log_probs.push(log_prob as f32);
        }
        (actions, log_probs)
    }

    fn check_observations(&self, observations: &Observations) -> Result<(), PpoError> {
        let num_envs = self.config.num_envs;
        check_len("actor observations", observations.actor.len(), num_envs, self.dims.actor)?;
        check_len("critic observations", observations.critic.len(), num_envs, self.dims.critic)?;
        check_finite("actor observation", &observations.actor, self.dims.actor, self.env_steps)?;
        check_finite("critic observation", &observations.critic, self.dims.critic, self.env_steps)
    }

    fn check_step(&self, result: &StepResult, num_terms: usize, env_step: u64) -> Result<(), PpoError> {
        Behaviour { env_steps: env_step, ..*self }.check_observations(&result.observations)?;
        let num_envs = self.config.num_envs;
        check_len("reward terms", result.reward_terms.len(), num_envs, num_terms)?;
        check_finite("reward term", &result.reward_terms, num_terms, env_step)?;
        check_len("endings", result.endings.len(), num_envs, 1)?;
        for (env, ending) in result.endings.iter().enumerate() {
            if let Some(Ending::Truncated { final_critic, .. }) = ending {
                check_len("final critic observation", final_critic.len(), 1, self.dims.critic)?;
                if let Some(at) = final_critic.iter().position(|value| !value.is_finite()) {
                    return Err(PpoError::NonFiniteObservation {
                        env,
                        what: format!("final critic observation {at}"),
                        value: final_critic[at],
                        step: env_step,
                    });
                }
            }
        }
        Ok(())
    }
}

fn check_len(what: &str, found: usize, rows: usize, columns: usize) -> Result<(), PpoError> {
    if found == rows * columns {
        return Ok(());
    }
    Err(PpoError::Shape(format!("{found} numbers as {what}, expected {rows} x {columns}")))
}

fn check_finite(what: &str, values: &[f32], columns: usize, step: u64) -> Result<(), PpoError> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(at) => Err(PpoError::NonFiniteObservation {
            env: at / columns,
            what: format!("{what} {}", at % columns),
            value: values[at],
            step,
        }),
    }
}

fn mean_and_variance(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    (mean, values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count)
}
