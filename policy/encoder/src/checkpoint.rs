//! A pretraining, or the encoder that came out of it, as bytes of a safetensors file.
//!
//! Parameters have their names, the optimiser's memory `adam.first.NAME` and `adam.second.NAME`, the scaling of inputs
//! `scaling.mean` and `scaling.factor` in 64 bits. An encoder's file is the same without decoder and optimiser; its
//! parameters have 16 bits.

use std::{collections::BTreeMap, path::Path};

use palpate_training::{Adam, Array, Encoded, TensorFile, encode};
use serde::{Deserialize, Serialize};

use crate::network::Networks;
use crate::sample::Dims;
use crate::statistics::Scaling;
use crate::{Dataset, Encoder, EncoderConfig, EncoderError, Trainer};

/// Version of the file; another one is refused.
const FORMAT: u32 = 1;

#[derive(Serialize, Deserialize)]
struct State {
    format: u32,
    channels: usize,
    joints: usize,
    /// The configuration's file.
    config: String,
    updates: u64,
    /// What the samples were made from, by name.
    sources: BTreeMap<String, String>,
    /// CRC-32 of the bytes of each tensor.
    checksums: BTreeMap<String, u32>,
    /// Nothing in an encoder's file.
    #[serde(flatten)]
    training: Option<TrainingState>,
}

/// What it takes to go on.
#[derive(Serialize, Deserialize)]
struct TrainingState {
    samples: usize,
    adam_steps: u64,
}

type File<'a> = TensorFile<'a, State>;

impl Trainer {
    /// This training as the bytes of a checkpoint.
    pub fn to_checkpoint(&self) -> Vec<u8> {
        let mut tensors = Vec::new();
        for (idx, Array { name, shape, values }) in self.networks.arrays.iter().enumerate() {
            tensors.push(Encoded::floats(name.clone(), *shape, values));
            tensors.push(Encoded::floats(format!("adam.first.{name}"), *shape, &self.adam.first[idx]));
            tensors.push(Encoded::floats(format!("adam.second.{name}"), *shape, &self.adam.second[idx]));
        }
        encode_scaling(&mut tensors, &self.scaling);
        encode(tensors, |checksums| State {
            format: FORMAT,
            channels: self.dims.channels,
            joints: self.dims.joints,
            config: self.config.to_toml(),
            updates: self.updates,
            sources: self.sources.clone(),
            checksums,
            training: Some(TrainingState { samples: self.num_samples, adam_steps: self.adam.steps }),
        })
    }

    /// The training that `bytes` hold, to go on with `config` on `data`, which was made from `sources`. `path` names the
    /// file in errors.
    ///
    /// # Errors
    /// Files that are cut off, altered, of another format, configuration or samples, naming what differs.
    pub fn from_checkpoint<D: Dataset + ?Sized>(
        config: EncoderConfig,
        data: &D,
        sources: BTreeMap<String, String>,
        path: &Path,
        bytes: &[u8],
    ) -> Result<Self, EncoderError> {
        let file = File::open(path, bytes, FORMAT)?;
        config.validate()?;
        let Some(training) = &file.state.training else {
            let problem = "it holds an encoder alone, without the training to go on with";
            return Err(file.error(problem.to_owned()).into());
        };
        if let Some((field, found, expected)) = palpate_training::difference(&read_config(&file)?, &config) {
            let problem = format!("{field} is {found}, that of the configuration is {expected}");
            return Err(file.error(problem).into());
        }
        let differs = |(name, digest): &(&String, &String)| sources.get(*name) != Some(*digest);
        if let Some((name, _)) = file.state.sources.iter().find(differs) {
            let problem = format!("its samples were made from another {name:?} than this call's");
            return Err(file.error(problem).into());
        }
        if let Some(name) = sources.keys().find(|name| !file.state.sources.contains_key(*name)) {
            return Err(file.error(format!("its samples were not made from this call's {name:?}")).into());
        }
        let sizes = [
            ("channels", file.state.channels, data.num_channels()),
            ("joints", file.state.joints, data.num_joints()),
            ("samples", training.samples, data.len()),
        ];
        if let Some((name, found, expected)) = sizes.iter().find(|(_, found, expected)| found != expected) {
            return Err(file.error(format!("{name} is {found}, that of this call is {expected}")).into());
        }
        let mut trainer = Self::new(config, data, sources)?;
        let Adam { steps, first, second } = &mut trainer.adam;
        for (array, (first, second)) in trainer.networks.arrays.iter_mut().zip(first.iter_mut().zip(second)) {
            let Array { name, shape, values } = array;
            *values = file.floats(name, *shape)?;
            *first = file.floats(&format!("adam.first.{name}"), *shape)?;
            *second = file.floats(&format!("adam.second.{name}"), *shape)?;
        }
        *steps = training.adam_steps;
        trainer.scaling = scaling(&file)?;
        trainer.updates = file.state.updates;
        Ok(trainer)
    }
}

impl Encoder {
    /// The encoder of the checkpoint, or of the encoder's file, that `bytes` hold. `path` names the file in errors.
    ///
    /// # Errors
    /// Files that are cut off, altered or of another format, naming the field.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, EncoderError> {
        let file = File::open(path, bytes, FORMAT)?;
        let config = read_config(&file)?;
        let dims = Dims::new(&config, file.state.channels, file.state.joints);
        let mut networks = Networks::of_encoder(&config.network, dims);
        for Array { name, shape, values } in &mut networks.arrays {
            *values = match file.state.training {
                Some(_) => file.floats(name, *shape)?,
                None => file.halves(name, *shape)?,
            };
        }
        let scaling = scaling(&file)?;
        Ok(Self::new(networks, scaling, config, file.state.updates, file.state.sources))
    }

    /// This encoder as the bytes of a file of its own, a small part of a checkpoint: parameters are rounded to 16 bits, and
    /// nothing goes on from it. The encoder that is read from it has the same file again.
    ///
    /// # Errors
    /// Parameters too large for 16 bits, by name.
    pub fn to_bytes(&self) -> Result<Vec<u8>, EncoderError> {
        let mut tensors = Vec::new();
        for array in &self.networks.arrays {
            tensors.push(Encoded::halves(array).map_err(EncoderError::Shape)?);
        }
        encode_scaling(&mut tensors, &self.scaling);
        Ok(encode(tensors, |checksums| State {
            format: FORMAT,
            channels: self.networks.dims.channels,
            joints: self.networks.dims.joints,
            config: self.config.to_toml(),
            updates: self.updates,
            sources: self.sources.clone(),
            checksums,
            training: None,
        }))
    }
}

fn encode_scaling(tensors: &mut Vec<Encoded>, scaling: &Scaling) {
    tensors.push(Encoded::doubles("scaling.mean".to_owned(), &scaling.mean));
    tensors.push(Encoded::doubles("scaling.factor".to_owned(), &scaling.factor));
}

fn scaling(file: &File) -> Result<Scaling, EncoderError> {
    let len = 3 * file.state.channels;
    Ok(Scaling { mean: file.doubles("scaling.mean", len)?, factor: file.doubles("scaling.factor", len)? })
}

fn read_config(file: &File) -> Result<EncoderConfig, EncoderError> {
    let config = EncoderConfig::from_toml("config", &file.state.config);
    config.map_err(|err| file.error(err.to_string()).into())
}
