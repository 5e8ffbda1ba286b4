//! A training, or the policy that came out of it, as bytes of a safetensors file.
//!
//! Parameters have their names; in a checkpoint the optimiser's memory is `adam.first.NAME` and `adam.second.NAME`, the
//! moving average `average.NAME`. The scalings are `inputs.mean`, `inputs.factor`, `chunks.mean`, `chunks.factor` in 64
//! bits. A policy's file has the averaged parameters alone, in 16 bits. Where an encoder makes features, its own file is the
//! tensor `encoder`, byte by byte.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};

use palpate_training::{Adam, Array, CHECKPOINT_FILE, Encoded, TensorFile, encode, file_error};
use serde::{Deserialize, Serialize};

use crate::cloned::{Cloned, Robot};
use crate::episodes::{EncoderFile, Episodes};
use crate::network::Network;
use crate::scaling::Scaling;
use crate::trainer::Trainer;
use crate::{CloneConfig, CloneError, Head, Predicts};

/// The policy that came out of a training, in its folder.
pub const POLICY_FILE: &str = "policy.safetensors";

/// The tensor that holds the file of an encoder.
const ENCODER: &str = "encoder";

/// Version of the file; another one is refused.
const FORMAT: u32 = 1;

#[derive(Serialize, Deserialize)]
struct State {
    format: u32,
    joints: Vec<String>,
    channels: Vec<String>,
    control_rate_hz: f64,
    /// The configuration's file.
    config: String,
    updates: u64,
    /// What the episodes were made from, by name.
    sources: BTreeMap<String, String>,
    /// CRC-32 of the bytes of each tensor.
    checksums: BTreeMap<String, u32>,
    /// Nothing where no encoder makes features.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    encoder: Option<EncoderState>,
    /// Nothing in a policy's file.
    #[serde(flatten)]
    training: Option<TrainingState>,
}

/// The encoder whose file is the tensor [`ENCODER`].
#[derive(Clone, Serialize, Deserialize)]
struct EncoderState {
    /// Of that file.
    sha256: String,
    /// Numbers that it makes of a moment.
    features: usize,
}

/// What it takes to go on.
#[derive(Serialize, Deserialize)]
struct TrainingState {
    samples: usize,
    adam_steps: u64,
}

type File<'a> = TensorFile<'a, State>;

impl State {
    /// That of a policy's file, whose tensors have no checksums yet.
    fn new(
        robot: &Robot,
        config: &CloneConfig,
        updates: u64,
        sources: &BTreeMap<String, String>,
        encoder: Option<EncoderState>,
    ) -> Self {
        Self {
            format: FORMAT,
            joints: robot.joints.clone(),
            channels: robot.channels.clone(),
            control_rate_hz: robot.control_rate_hz,
            config: config.to_toml(),
            updates,
            sources: sources.clone(),
            checksums: BTreeMap::new(),
            encoder,
            training: None,
        }
    }

    fn robot(&self) -> Robot {
        Robot {
            joints: self.joints.clone(),
            channels: self.channels.clone(),
            control_rate_hz: self.control_rate_hz,
        }
    }
}

impl Trainer {
    /// This training as the bytes of a checkpoint.
    pub fn to_checkpoint(&self) -> Vec<u8> {
        let mut tensors = Vec::new();
        for (idx, Array { name, shape, values }) in self.network.arrays.iter().enumerate() {
            tensors.push(Encoded::floats(name.clone(), *shape, values));
            tensors.push(Encoded::floats(format!("average.{name}"), *shape, &self.average[idx]));
            tensors.push(Encoded::floats(format!("adam.first.{name}"), *shape, &self.adam.first[idx]));
            tensors.push(Encoded::floats(format!("adam.second.{name}"), *shape, &self.adam.second[idx]));
        }
        encode_scaling(&mut tensors, "inputs", &self.inputs);
        encode_scaling(&mut tensors, "chunks", &self.chunks);
        let encoder = encode_encoder(&mut tensors, self.encoder.as_deref());
        let state = State::new(&self.robot, &self.config, self.updates, &self.sources, encoder);
        let training = Some(TrainingState { samples: self.num_samples, adam_steps: self.adam.steps });
        encode(tensors, |checksums| State { checksums, training, ..state })
    }

    /// The training that `bytes` hold, to go on with `config` on `episodes` of `robot`, which were made from `sources`.
    /// `path` names the file in errors.
    ///
    /// # Errors
    /// Files that are cut off, altered, of another format, configuration, robot or episodes, naming what differs.
    pub fn from_checkpoint(
        config: CloneConfig,
        robot: Robot,
        episodes: &Episodes,
        sources: BTreeMap<String, String>,
        path: &Path,
        bytes: &[u8],
    ) -> Result<Self, CloneError> {
        let file = File::open(path, bytes, FORMAT)?;
        let Some(training) = &file.state.training else {
            let problem = "it holds a policy alone, without the training to go on with";
            return Err(file.error(problem.to_owned()).into());
        };
        if let Some((field, found, expected)) =
            palpate_training::difference(&read_config(&file)?.spelled_out(), &config.spelled_out())
        {
            let problem = format!("{field} is {found}, that of the configuration is {expected}");
            return Err(file.error(problem).into());
        }
        file.state.robot().check(&robot).map_err(|err| file.error(err.to_string()))?;
        let named = |sha256: Option<&String>| {
            sha256.map_or_else(
                || "no encoder".to_owned(),
                |sha256| format!("the encoder with SHA-256 {sha256}"),
            )
        };
        let found = file.state.encoder.as_ref().map(|encoder| &encoder.sha256);
        let given = episodes.encoder().map(|encoder| &encoder.sha256);
        if found != given {
            let (found, given) = (named(found), named(given));
            return Err(file
                .error(format!("its features were made by {found}, those of this call by {given}"))
                .into());
        }
        if file.state.sources != sources {
            return Err(file.error("its episodes are others than this call's".to_owned()).into());
        }
        let mut trainer = Self::new(config, robot, episodes, sources)?;
        if training.samples != trainer.num_samples {
            let (found, expected) = (training.samples, trainer.num_samples);
            return Err(file
                .error(format!("it learned from {found} steps, this call has {expected}"))
                .into());
        }
        let Adam { steps, first, second } = &mut trainer.adam;
        let memory = first.iter_mut().zip(second).zip(&mut trainer.average);
        for (array, ((first, second), average)) in trainer.network.arrays.iter_mut().zip(memory) {
            let Array { name, shape, values } = array;
            *values = file.floats(name, *shape)?;
            *average = file.floats(&format!("average.{name}"), *shape)?;
            *first = file.floats(&format!("adam.first.{name}"), *shape)?;
            *second = file.floats(&format!("adam.second.{name}"), *shape)?;
        }
        *steps = training.adam_steps;
        trainer.inputs = scaling(&file, "inputs", trainer.inputs.mean.len())?;
        trainer.chunks = scaling(&file, "chunks", trainer.chunks.mean.len())?;
        trainer.updates = file.state.updates;
        Ok(trainer)
    }
}

impl Cloned {
    /// The policy of a training's folder or of a file, and the file and bytes that it was read from.
    ///
    /// # Errors
    /// A file that cannot be read; see [`Self::from_bytes`].
    pub fn read(path: &Path) -> Result<(PathBuf, Vec<u8>, Self), CloneError> {
        let file = match path.is_dir() {
            true if path.join(POLICY_FILE).is_file() => path.join(POLICY_FILE),
            true => path.join(CHECKPOINT_FILE),
            false => path.to_owned(),
        };
        let bytes = std::fs::read(&file).map_err(file_error("read", &file))?;
        let policy = Self::from_bytes(&file, &bytes)?;
        Ok((file, bytes, policy))
    }

    /// The policy of the checkpoint, or of the policy's file, that `bytes` hold. `path` names the file in errors.
    ///
    /// # Errors
    /// Files that are cut off, altered or of another format, naming the field.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, CloneError> {
        let file = File::open(path, bytes, FORMAT)?;
        let (config, robot) = (read_config(&file)?, file.state.robot());
        let encoder = encoder(&file)?;
        if config.observation.features != encoder.is_some() {
            let features = config.observation.features;
            let holds = if encoder.is_some() { "it holds an encoder" } else { "it holds no encoder" };
            return Err(file.error(format!("observation.features is {features}, but {holds}")).into());
        }
        let encoded = encoder.as_ref().map_or(0, |encoder| encoder.num_features);
        let shape = robot.shape().seen(&config.observation, encoded);
        let mut network = Network::new(&config, shape);
        for Array { name, shape, values } in &mut network.arrays {
            *values = match file.state.training {
                Some(_) => file.floats(&format!("average.{name}"), *shape)?,
                None => file.halves(name, *shape)?,
            };
        }
        let inputs = scaling(&file, "inputs", shape.input_len(&config.observation))?;
        let chunks = scaling(&file, "chunks", network.chunk_len())?;
        let State { updates, sources, .. } = file.state;
        Ok(Self::new(config, robot, [inputs, chunks], network, updates, sources, encoder))
    }

    /// This policy as the bytes of a file of its own: parameters are rounded to 16 bits, and nothing goes on from it.
    /// The policy that is read from it has the same file again.
    ///
    /// # Errors
    /// Parameters too large for 16 bits, by name.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CloneError> {
        let mut tensors = Vec::new();
        for array in &self.network.arrays {
            tensors.push(Encoded::halves(array).map_err(CloneError::Shape)?);
        }
        encode_scaling(&mut tensors, "inputs", &self.inputs);
        encode_scaling(&mut tensors, "chunks", &self.chunks);
        let encoder = encode_encoder(&mut tensors, self.encoder.as_deref());
        let state = State::new(&self.robot, &self.config, self.updates, &self.sources, encoder);
        Ok(encode(tensors, |checksums| State { checksums, ..state }))
    }
}

fn encode_scaling(tensors: &mut Vec<Encoded>, name: &str, scaling: &Scaling) {
    tensors.push(Encoded::doubles(format!("{name}.mean"), &scaling.mean));
    tensors.push(Encoded::doubles(format!("{name}.factor"), &scaling.factor));
}

fn encode_encoder(tensors: &mut Vec<Encoded>, encoder: Option<&EncoderFile>) -> Option<EncoderState> {
    let encoder = encoder?;
    tensors.push(Encoded::file(ENCODER.to_owned(), &encoder.bytes));
    Some(EncoderState { sha256: encoder.sha256.clone(), features: encoder.num_features })
}

fn encoder(file: &File<'_>) -> Result<Option<Arc<EncoderFile>>, CloneError> {
    let Some(EncoderState { sha256, features }) = file.state.encoder.clone() else { return Ok(None) };
    if features == 0 {
        return Err(file.error("its encoder makes 0 features, expected 1 or more".to_owned()).into());
    }
    Ok(Some(Arc::new(EncoderFile { bytes: file.file(ENCODER)?, sha256, num_features: features })))
}

fn scaling(file: &File<'_>, name: &str, len: usize) -> Result<Scaling, CloneError> {
    Ok(Scaling {
        mean: file.doubles(&format!("{name}.mean"), len)?,
        factor: file.doubles(&format!("{name}.factor"), len)?,
    })
}

fn read_config(file: &File<'_>) -> Result<CloneConfig, CloneError> {
    let config = CloneConfig::from_toml("config", &file.state.config);
    let mut config = config.map_err(|err| file.error(err.to_string()))?;
    if config.head == Head::Diffusion {
        // Diffusions predicted nothing else before files said what they predict.
        config.diffusion.predicts.get_or_insert(Predicts::Noise);
    }
    Ok(config)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_diffusion_of_before_it_was_said_predicts_the_noise() {
        let robot = Robot { joints: Vec::new(), channels: Vec::new(), control_rate_hz: 20.0 };
        let chunk = CloneConfig { head: Head::Diffusion, ..CloneConfig::default() };
        let state = State::new(&robot, &chunk, 1, &BTreeMap::new(), None);
        let old = State { config: state.config.replace("predicts = \"chunk\"\n", ""), ..state };
        assert!(!old.config.contains("predicts"), "{}", old.config);
        let bytes = encode(Vec::new(), |_| old);
        let path = Path::new("policy.safetensors");
        let read = read_config(&File::open(path, &bytes, FORMAT).expect("a file")).expect("it makes sense");
        assert_eq!(read.diffusion.predicts, Some(Predicts::Noise));
        let differs = palpate_training::difference(&read.spelled_out(), &chunk.spelled_out());
        let (field, found, expected) = differs.expect("a training does not go on as another");
        assert_eq!((&*field, &*found, &*expected), ("diffusion.predicts", "\"noise\"", "\"chunk\""));
    }
}
