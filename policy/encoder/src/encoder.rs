//! The encoder that comes out.

use std::collections::BTreeMap;

use burn_tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;

use crate::network::{CHUNK_SAMPLES, Networks, values};
use crate::statistics::Scaling;
use crate::{EncoderConfig, EncoderError};

/// g: from a history of touch to a latent feature.
#[derive(Clone, Debug)]
pub struct Encoder {
    pub(crate) networks: Networks,
    pub(crate) scaling: Scaling,
    /// What it was trained with.
    pub(crate) config: EncoderConfig,
    pub(crate) updates: u64,
    pub(crate) sources: BTreeMap<String, String>,
    /// Its parameters as a pass needs them: copying all of them takes as long as a window of history does.
    tensors: Vec<Tensor<2>>,
}

impl PartialEq for Encoder {
    fn eq(&self, other: &Self) -> bool {
        (&self.networks, &self.scaling, &self.config, self.updates, &self.sources)
            == (&other.networks, &other.scaling, &other.config, other.updates, &other.sources)
    }
}

impl Encoder {
    pub(crate) fn new(
        networks: Networks,
        scaling: Scaling,
        config: EncoderConfig,
        updates: u64,
        sources: BTreeMap<String, String>,
    ) -> Self {
        let tensors = networks.tensors(&Device::flex());
        Self { networks, scaling, config, updates, sources, tensors }
    }

    /// Frames of an input.
    pub fn history(&self) -> usize {
        self.networks.dims.history
    }

    /// Channels of a frame.
    pub fn num_channels(&self) -> usize {
        self.networks.dims.channels
    }

    /// Joints of the robot that it was trained on.
    pub fn num_joints(&self) -> usize {
        self.networks.dims.joints
    }

    /// Numbers of a latent feature.
    pub fn width(&self) -> usize {
        self.config.network.width
    }

    /// Updates that it was trained for.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// What its samples were made from, by name.
    pub fn sources(&self) -> &BTreeMap<String, String> {
        &self.sources
    }

    /// z, the feature of the newest frame, `[any, width]`, of inputs `[any, history, channels, 4]` as in
    /// [`crate::Sample::input`].
    ///
    /// # Errors
    /// Inputs that are no whole rows, or hold numbers that are none.
    pub fn encode(&self, inputs: &[f32]) -> Result<Vec<f32>, EncoderError> {
        let (len, history, width) = (self.networks.dims.input_len(), self.history(), self.width());
        if !inputs.len().is_multiple_of(len) {
            let found = inputs.len();
            return Err(EncoderError::Shape(format!("{found} numbers as inputs, expected rows of {len}")));
        }
        if let Some(at) = inputs.iter().position(|value| !value.is_finite()) {
            let (sample, value) = (at / len, inputs[at]);
            return Err(EncoderError::NonFiniteSample { sample, what: "input", value });
        }
        let encode = |inputs: &[f32]| {
            let rows = inputs.len() / len;
            let scaled = self.scaling.apply(inputs, &self.config.inputs);
            let inputs = Tensor::from_data(TensorData::new(scaled, [rows, len]), &Device::flex());
            let tokens = self.networks.encode(&self.tensors, inputs).reshape([rows, history, width]);
            values(tokens.narrow(1, history - 1, 1).reshape([rows, width]))
        };
        if (1..=CHUNK_SAMPLES * len).contains(&inputs.len()) {
            // A policy at work asks for one window at a time, and waits for no other thread.
            return Ok(encode(inputs));
        }
        let features: Vec<Vec<f32>> = inputs.par_chunks(CHUNK_SAMPLES * len).map(encode).collect();
        Ok(features.concat())
    }
}
