//! A training, or the policy that came out of it, as bytes: a safetensors file that other programs read as well.
//!
//! Parameters have their names ([`Networks`]), the optimiser's memory `adam.first.NAME` and `adam.second.NAME`, normalisers
//! `normaliser.actor.mean` and so on in 64 bits. Everything else is JSON under the key `state` of the file's metadata.
//! Each tensor has its checksum there, and the JSON its own in the tensor `state.crc32`, because a bit that flips in a
//! weight would otherwise go unnoticed.
//!
//! A policy's file is the same without critic, optimiser and what only a training needs; its parameters have 16 bits.

use std::{collections::BTreeMap, path::Path};

use palpate_training::{Array, Encoded, TensorFile, encode};
use serde::{Deserialize, Serialize};

use crate::{
    Actor, PpoConfig, PpoError, Trainer, VectorEnv, networks::Networks, normaliser::Normaliser,
    trainer::Counters,
};

/// Version of the file; another one is refused.
const FORMAT: u32 = 1;

type File<'a> = TensorFile<'a, State>;

#[derive(Serialize, Deserialize)]
struct State {
    format: u32,
    actor_dim: usize,
    action_dim: usize,
    /// The configuration's file.
    config: String,
    counters: Counters,
    /// Rows that the normalisers have seen.
    observations: u64,
    /// Of the environments ([`VectorEnv::memory`]).
    memory: String,
    /// CRC-32 of the bytes of each tensor.
    checksums: BTreeMap<String, u32>,
    /// Nothing in a policy's file.
    #[serde(flatten)]
    training: Option<TrainingState>,
}

/// What it takes to go on.
#[derive(Serialize, Deserialize)]
struct TrainingState {
    critic_dim: usize,
    reward_terms: Vec<String>,
    adam_steps: u64,
    /// Verdicts of the newest episodes, oldest first.
    recent: Vec<bool>,
}

impl Trainer {
    /// This training as the bytes of a checkpoint. Episodes under way are not in it ([`Trainer::is_between_episodes`]).
    pub fn to_checkpoint(&self) -> Vec<u8> {
        let mut tensors = Vec::new();
        for (idx, array) in self.networks.arrays.iter().enumerate() {
            let Array { name, shape, values } = array;
            tensors.push(Encoded::floats(name.clone(), *shape, values));
            tensors.push(Encoded::floats(format!("adam.first.{name}"), *shape, &self.adam.first[idx]));
            tensors.push(Encoded::floats(format!("adam.second.{name}"), *shape, &self.adam.second[idx]));
        }
        encode_normaliser(&mut tensors, "actor", &self.normalisers.actor);
        encode_normaliser(&mut tensors, "critic", &self.normalisers.critic);
        encode(tensors, |checksums| State {
            format: FORMAT,
            actor_dim: self.dims.actor,
            action_dim: self.dims.action,
            config: self.config.to_toml(),
            counters: self.counters,
            observations: self.normalisers.actor.count,
            memory: self.memory.clone(),
            checksums,
            training: Some(TrainingState {
                critic_dim: self.dims.critic,
                reward_terms: self.reward_terms.clone(),
                adam_steps: self.adam.steps,
                recent: self.recent.iter().copied().collect(),
            }),
        })
    }

    /// The training that `bytes` hold, to go on with `config` in `env`, which gets its memory back. `path` names the file
    /// in errors.
    ///
    /// `config` may want more steps or stop elsewhere than the one that the training began with; all else must be equal.
    ///
    /// # Errors
    /// Files that are cut off, altered, of another format, configuration or environment, naming the field.
    pub fn from_checkpoint<E: VectorEnv + ?Sized>(
        config: PpoConfig,
        env: &mut E,
        path: &Path,
        bytes: &[u8],
    ) -> Result<Self, PpoError> {
        let file = File::open(path, bytes, FORMAT)?;
        let mut trainer = Self::new(config, env)?;
        let Some(training) = &file.state.training else {
            return Err(file
                .error("it holds a policy alone, without the training to go on with".to_owned())
                .into());
        };
        let widths = [
            ("actor_dim", file.state.actor_dim, trainer.dims.actor),
            ("critic_dim", training.critic_dim, trainer.dims.critic),
            ("action_dim", file.state.action_dim, trainer.dims.action),
        ];
        if let Some((name, found, expected)) = widths.iter().find(|(_, found, expected)| found != expected) {
            return Err(file
                .error(format!("{name} is {found}, that of the environments is {expected}"))
                .into());
        }
        if training.reward_terms != trainer.reward_terms {
            return Err(file
                .error(format!(
                    "reward_terms is {:?}, those of the environments are {:?}",
                    training.reward_terms, trainer.reward_terms
                ))
                .into());
        }
        let began_with = self::config(&file)?;
        if let Some((field, found, expected)) = difference(&began_with, &trainer.config) {
            return Err(file
                .error(format!("{field} is {found}, that of the configuration is {expected}"))
                .into());
        }

        let memory = trainer.adam.first.iter_mut().zip(&mut trainer.adam.second);
        for (array, (first, second)) in trainer.networks.arrays.iter_mut().zip(memory) {
            let Array { name, shape, values } = array;
            *values = file.floats(name, *shape)?;
            *first = file.floats(&format!("adam.first.{name}"), *shape)?;
            *second = file.floats(&format!("adam.second.{name}"), *shape)?;
        }
        trainer.adam.steps = training.adam_steps;
        trainer.normalisers.actor = normaliser(&file, "actor", trainer.dims.actor)?;
        trainer.normalisers.critic = normaliser(&file, "critic", trainer.dims.critic)?;
        trainer.counters = file.state.counters;
        trainer.recent = training.recent.iter().copied().collect();
        trainer.forget_old_verdicts();
        env.restore(&file.state.memory).map_err(|err| file.error(format!("memory: {err}")))?;
        trainer.memory = file.state.memory;
        Ok(trainer)
    }
}

impl Actor {
    /// The policy of the checkpoint, or of the policy's file, that `bytes` hold. `path` names the file in errors.
    ///
    /// # Errors
    /// Files that are cut off, altered or of another format, naming the field.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, PpoError> {
        let file = File::open(path, bytes, FORMAT)?;
        let config = config(&file)?;
        let State { actor_dim, action_dim, counters, .. } = file.state;
        let mut networks = Networks::of_actor(&config.networks, actor_dim, action_dim);
        for Array { name, shape, values } in &mut networks.arrays {
            *values = match file.state.training {
                Some(_) => file.floats(name, *shape)?,
                None => file.halves(name, *shape)?,
            };
        }
        let normaliser = normaliser(&file, "actor", actor_dim)?;
        Ok(Self { networks, normaliser, action_dim, config, counters, memory: file.state.memory })
    }

    /// This policy as the bytes of a file of its own, a small part of a checkpoint: parameters are rounded to 16 bits, and
    /// nothing goes on from it. The policy that is read from it has the same file again.
    ///
    /// # Errors
    /// Parameters too large for 16 bits, by name.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PpoError> {
        let mut tensors = Vec::new();
        for array in &self.networks.arrays {
            tensors.push(Encoded::halves(array).map_err(PpoError::Shape)?);
        }
        encode_normaliser(&mut tensors, "actor", &self.normaliser);
        Ok(encode(tensors, |checksums| State {
            format: FORMAT,
            actor_dim: self.actor_dim(),
            action_dim: self.action_dim,
            config: self.config.to_toml(),
            counters: self.counters,
            observations: self.normaliser.count,
            memory: self.memory.clone(),
            checksums,
            training: None,
        }))
    }
}

fn encode_normaliser(tensors: &mut Vec<Encoded>, name: &str, normaliser: &Normaliser) {
    tensors.push(Encoded::doubles(format!("normaliser.{name}.mean"), &normaliser.mean));
    tensors.push(Encoded::doubles(format!("normaliser.{name}.squares"), &normaliser.squares));
}

fn config(file: &File) -> Result<PpoConfig, PpoError> {
    let config = PpoConfig::from_toml("config", &file.state.config);
    config.map_err(|err| file.error(err.to_string()).into())
}

fn normaliser(file: &File, name: &str, dim: usize) -> Result<Normaliser, PpoError> {
    Ok(Normaliser {
        count: file.state.observations,
        mean: file.doubles(&format!("normaliser.{name}.mean"), dim)?,
        squares: file.doubles(&format!("normaliser.{name}.squares"), dim)?,
    })
}

/// The first field in which two configurations learn differently: name, value in `left`, value in `right`.
fn difference(left: &PpoConfig, right: &PpoConfig) -> Option<(String, String, String)> {
    // How long to learn does not change what is learned until then.
    let PpoConfig { total_steps, stop, .. } = PpoConfig::default();
    let comparable = |config: &PpoConfig| PpoConfig { total_steps, stop: stop.clone(), ..config.clone() };
    palpate_training::difference(&comparable(left), &comparable(right))
}
