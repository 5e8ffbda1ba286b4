//! A training, or the policy that came out of it, as bytes: a safetensors file that other programs read as well.
//!
//! Parameters have their names ([`Networks`]), the optimiser's memory `adam.first.NAME` and `adam.second.NAME`, normalisers
//! `normaliser.actor.mean` and so on in 64 bits. Everything else is JSON under the key `state` of the file's metadata.
//! Each tensor has its checksum there, and the JSON its own in the tensor `state.crc32`, because a bit that flips in a
//! weight would otherwise go unnoticed.
//!
//! A policy's file is the same without critic, optimiser and what only a training needs; its parameters have 16 bits.

use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
};

use half::f16;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};

use crate::{
    Actor, PpoConfig, PpoError, Trainer, VectorEnv,
    networks::{Array, Networks},
    normaliser::Normaliser,
    trainer::Counters,
};

/// Version of the file; another one is refused.
const FORMAT: u32 = 1;
const STATE_KEY: &str = "state";
const STATE_CHECKSUM: &str = "state.crc32";

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

/// What every version of a state says first.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

/// Bytes of a tensor on their way into a file.
struct Encoded {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Encoded {
    fn floats(name: String, shape: [usize; 2], values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { name, dtype: Dtype::F32, shape: shape.to_vec(), bytes }
    }

    /// Each number as the nearest of 16 bits.
    fn halves(name: String, shape: [usize; 2], values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|&value| f16::from_f32(value).to_le_bytes()).collect();
        Self { name, dtype: Dtype::F16, shape: shape.to_vec(), bytes }
    }

    fn doubles(name: String, values: &[f64]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { name, dtype: Dtype::F64, shape: vec![values.len()], bytes }
    }
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
        let state = State {
            format: FORMAT,
            actor_dim: self.dims.actor,
            action_dim: self.dims.action,
            config: self.config.to_toml(),
            counters: self.counters,
            observations: self.normalisers.actor.count,
            memory: self.memory.clone(),
            checksums: BTreeMap::new(),
            training: Some(TrainingState {
                critic_dim: self.dims.critic,
                reward_terms: self.reward_terms.clone(),
                adam_steps: self.adam.steps,
                recent: self.recent.iter().copied().collect(),
            }),
        };
        file_bytes(tensors, state)
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
        let file = File::open(path, bytes)?;
        let mut trainer = Self::new(config, env)?;
        let Some(training) = &file.state.training else {
            return Err(file.error("it holds a policy alone, without the training to go on with".to_owned()));
        };
        let widths = [
            ("actor_dim", file.state.actor_dim, trainer.dims.actor),
            ("critic_dim", training.critic_dim, trainer.dims.critic),
            ("action_dim", file.state.action_dim, trainer.dims.action),
        ];
        if let Some((name, found, expected)) = widths.iter().find(|(_, found, expected)| found != expected) {
            return Err(file.error(format!("{name} is {found}, that of the environments is {expected}")));
        }
        if training.reward_terms != trainer.reward_terms {
            return Err(file.error(format!(
                "reward_terms is {:?}, those of the environments are {:?}",
                training.reward_terms, trainer.reward_terms
            )));
        }
        let began_with = file.config()?;
        if let Some((field, found, expected)) = difference(&began_with, &trainer.config) {
            return Err(file.error(format!("{field} is {found}, that of the configuration is {expected}")));
        }

        let memory = trainer.adam.first.iter_mut().zip(&mut trainer.adam.second);
        for (array, (first, second)) in trainer.networks.arrays.iter_mut().zip(memory) {
            let Array { name, shape, values } = array;
            *values = file.floats(name, *shape)?;
            *first = file.floats(&format!("adam.first.{name}"), *shape)?;
            *second = file.floats(&format!("adam.second.{name}"), *shape)?;
        }
        trainer.adam.steps = training.adam_steps;
        trainer.normalisers.actor = file.normaliser("actor", trainer.dims.actor)?;
        trainer.normalisers.critic = file.normaliser("critic", trainer.dims.critic)?;
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
        let file = File::open(path, bytes)?;
        let config = file.config()?;
        let State { actor_dim, action_dim, counters, .. } = file.state;
        let mut networks = Networks::of_actor(&config.networks, actor_dim, action_dim);
        for Array { name, shape, values } in &mut networks.arrays {
            *values = match file.state.training {
                Some(_) => file.floats(name, *shape)?,
                None => file.halves(name, *shape)?,
            };
        }
        let normaliser = file.normaliser("actor", actor_dim)?;
        Ok(Self { networks, normaliser, action_dim, config, counters, memory: file.state.memory })
    }

    /// This policy as the bytes of a file of its own, a small part of a checkpoint: parameters are rounded to 16 bits, and
    /// nothing goes on from it. The policy that is read from it has the same file again.
    ///
    /// # Errors
    /// Parameters too large for 16 bits, by name.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PpoError> {
        let mut tensors = Vec::new();
        for Array { name, shape, values } in &self.networks.arrays {
            if let Some(value) = values.iter().find(|&&value| !f16::from_f32(value).is_finite()) {
                let problem =
                    format!("{name} holds {value}, expected at most {} for a policy's file", f16::MAX);
                return Err(PpoError::Shape(problem));
            }
            tensors.push(Encoded::halves(name.clone(), *shape, values));
        }
        encode_normaliser(&mut tensors, "actor", &self.normaliser);
        let state = State {
            format: FORMAT,
            actor_dim: self.actor_dim(),
            action_dim: self.action_dim,
            config: self.config.to_toml(),
            counters: self.counters,
            observations: self.normaliser.count,
            memory: self.memory.clone(),
            checksums: BTreeMap::new(),
            training: None,
        };
        Ok(file_bytes(tensors, state))
    }
}

fn encode_normaliser(tensors: &mut Vec<Encoded>, name: &str, normaliser: &Normaliser) {
    tensors.push(Encoded::doubles(format!("normaliser.{name}.mean"), &normaliser.mean));
    tensors.push(Encoded::doubles(format!("normaliser.{name}.squares"), &normaliser.squares));
}

/// The file of `tensors` and `state`, which gets their checksums.
fn file_bytes(mut tensors: Vec<Encoded>, mut state: State) -> Vec<u8> {
    let checksum = |tensor: &Encoded| (tensor.name.clone(), crc32fast::hash(&tensor.bytes));
    state.checksums = tensors.iter().map(checksum).collect();
    let state = serde_json::to_string(&state).expect("numbers and names are JSON");
    tensors.push(Encoded {
        name: STATE_CHECKSUM.to_owned(),
        dtype: Dtype::U32,
        shape: vec![1],
        bytes: crc32fast::hash(state.as_bytes()).to_le_bytes().to_vec(),
    });
    let views = tensors.iter().map(|tensor| {
        let view = TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes);
        (tensor.name.as_str(), view.expect("as many bytes as the shape says"))
    });
    let metadata = HashMap::from([(STATE_KEY.to_owned(), state)]);
    safetensors::serialize(views, Some(metadata)).expect("every name is given once")
}

/// A file whose state has been read.
struct File<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
    state: State,
}

impl<'a> File<'a> {
    fn open(path: &'a Path, bytes: &'a [u8]) -> Result<Self, PpoError> {
        let error = |problem: String| PpoError::Checkpoint { path: path.to_owned(), problem };
        let no_tensors = |err| error(format!("not a whole safetensors file: {err}"));
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(no_tensors)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(no_tensors)?;
        let state = header
            .metadata()
            .as_ref()
            .and_then(|metadata| metadata.get(STATE_KEY))
            .ok_or_else(|| error(format!("its metadata has no {STATE_KEY:?}: it holds no training")))?;
        let checksum = tensors.tensor(STATE_CHECKSUM).ok().map(|view| view.data().to_vec());
        if checksum.as_deref() != Some(&crc32fast::hash(state.as_bytes()).to_le_bytes()) {
            return Err(error(format!("{STATE_KEY} does not match {STATE_CHECKSUM}: the file was altered")));
        }
        let unreadable = |err| error(format!("{STATE_KEY}: {err}"));
        let Format { format } = serde_json::from_str(state).map_err(unreadable)?;
        if format != FORMAT {
            return Err(error(format!("format is {format}, expected {FORMAT}")));
        }
        let state = serde_json::from_str(state).map_err(unreadable)?;
        Ok(Self { path, tensors, state })
    }

    fn error(&self, problem: String) -> PpoError {
        PpoError::Checkpoint { path: self.path.to_owned(), problem }
    }

    fn config(&self) -> Result<PpoConfig, PpoError> {
        PpoConfig::from_toml("config", &self.state.config).map_err(|err| self.error(err.to_string()))
    }

    fn bytes(&self, name: &str, dtype: Dtype, shape: &[usize]) -> Result<&[u8], PpoError> {
        let view = self.tensors.tensor(name).map_err(|_| self.error(format!("it has no tensor {name}")))?;
        if view.dtype() != dtype || view.shape() != shape {
            return Err(self.error(format!(
                "tensor {name} is {:?} {:?}, expected {dtype:?} {shape:?}",
                view.dtype(),
                view.shape()
            )));
        }
        if self.state.checksums.get(name) != Some(&crc32fast::hash(view.data())) {
            return Err(
                self.error(format!("tensor {name} does not match its checksum: the file was altered"))
            );
        }
        Ok(view.data())
    }

    fn floats(&self, name: &str, shape: [usize; 2]) -> Result<Vec<f32>, PpoError> {
        let numbers = self.bytes(name, Dtype::F32, &shape)?.as_chunks().0.iter();
        let values: Vec<f32> = numbers.map(|bytes| f32::from_le_bytes(*bytes)).collect();
        self.finite(name, values.iter().all(|value| value.is_finite()))?;
        Ok(values)
    }

    fn halves(&self, name: &str, shape: [usize; 2]) -> Result<Vec<f32>, PpoError> {
        let numbers = self.bytes(name, Dtype::F16, &shape)?.as_chunks().0.iter();
        let values: Vec<f32> = numbers.map(|bytes| f16::from_le_bytes(*bytes).to_f32()).collect();
        self.finite(name, values.iter().all(|value| value.is_finite()))?;
        Ok(values)
    }

    fn doubles(&self, name: &str, len: usize) -> Result<Vec<f64>, PpoError> {
        let numbers = self.bytes(name, Dtype::F64, &[len])?.as_chunks().0.iter();
        let values: Vec<f64> = numbers.map(|bytes| f64::from_le_bytes(*bytes)).collect();
        self.finite(name, values.iter().all(|value| value.is_finite()))?;
        Ok(values)
    }

    fn finite(&self, name: &str, holds: bool) -> Result<(), PpoError> {
        if holds { Ok(()) } else { Err(self.error(format!("tensor {name} holds numbers that are none"))) }
    }

    fn normaliser(&self, name: &str, dim: usize) -> Result<Normaliser, PpoError> {
        Ok(Normaliser {
            count: self.state.observations,
            mean: self.doubles(&format!("normaliser.{name}.mean"), dim)?,
            squares: self.doubles(&format!("normaliser.{name}.squares"), dim)?,
        })
    }
}

/// The first field in which two configurations learn differently: name, value in `left`, value in `right`.
fn difference(left: &PpoConfig, right: &PpoConfig) -> Option<(String, String, String)> {
    let table = |config: &PpoConfig| {
        // How long to learn does not change what is learned until then.
        let PpoConfig { total_steps, stop, .. } = PpoConfig::default();
        let comparable = PpoConfig { total_steps, stop, ..config.clone() };
        toml::Table::try_from(comparable).expect("numbers, lists and names are TOML")
    };
    let (left, right) = (table(left), table(right));
    left.iter()
        .map(|(field, value)| (field, value.to_string(), right[field].to_string()))
        .find(|(_, left, right)| left != right)
        .map(|(field, left, right)| (field.clone(), left, right))
}
