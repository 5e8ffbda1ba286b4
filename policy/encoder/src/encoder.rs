//! The encoder that comes out.

use std::collections::BTreeMap;

use burn_tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;

use crate::network::{CHUNK_SAMPLES, Networks, values};
use crate::statistics::Scaling;
use crate::{EncoderConfig, EncoderError};

/// g: from a history of touch to a latent feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Encoder {
    pub(crate) networks: Networks,
    pub(crate) scaling: Scaling,
    /// What it was trained with.
    pub(crate) config: EncoderConfig,
    pub(crate) updates: u64,
    pub(crate) sources: BTreeMap<String, String>,
}

impl Encoder {
    /// Frames of an input.
    pub fn history(&self) -> usize {
        self.networks.dims.history
    }

    /// Channels of a frame.
    pub fn num_channels(&self) -> usize {
        self.networks.dims.channels
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
            let tensors = self.networks.tensors(&Device::flex());
            let inputs = Tensor::from_data(TensorData::new(scaled, [rows, len]), &Device::flex());
            let tokens = self.networks.encode(&tensors, inputs).reshape([rows, history, width]);
            values(tokens.narrow(1, history - 1, 1).reshape([rows, width]))
        };
        let features: Vec<Vec<f32>> = inputs.par_chunks(CHUNK_SAMPLES * len).map(encode).collect();
        Ok(features.concat())
    }
}
