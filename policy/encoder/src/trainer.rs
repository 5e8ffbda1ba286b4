//! Learning: samples in, a better encoder out.

use std::collections::BTreeMap;

use burn_tensor::{Device, Tensor, TensorData};
use palpate_training::{Adam, add_gradients, clip_norm, generator, permutation};
use rayon::prelude::*;

use crate::loss::{LossTerms, diverged, sample_loss};
use crate::network::{CHUNK_SAMPLES, Networks, values};
use crate::statistics::{Scaling, Statistics};
use crate::{Dataset, Dims, Encoder, EncoderConfig, EncoderError, Prediction, Sample};

/// What noise is for: the order of samples, one generator for each epoch.
const SHUFFLE: u64 = 2;

/// A pretraining under way.
#[derive(Clone, Debug)]
pub struct Trainer {
    pub(crate) config: EncoderConfig,
    pub(crate) dims: Dims,
    /// Number of samples to learn from.
    pub(crate) num_samples: usize,
    pub(crate) scaling: Scaling,
    pub(crate) networks: Networks,
    pub(crate) adam: Adam,
    pub(crate) updates: u64,
    /// An epoch, and the order of its samples: drawn once for all of its updates.
    pub(crate) order: Option<(u64, Vec<usize>)>,
    /// What the samples were made from, by name.
    pub(crate) sources: BTreeMap<String, String>,
}

impl Trainer {
    /// A training that begins, on `data`, which was made from `sources`: names with something that changes where the
    /// source does, such as a file's SHA-256.
    ///
    /// # Errors
    /// A configuration that makes no sense, or samples that do not fit it.
    pub fn new<D: Dataset + ?Sized>(
        config: EncoderConfig,
        data: &D,
        sources: BTreeMap<String, String>,
    ) -> Result<Self, EncoderError> {
        config.validate()?;
        let dims = Dims::new(&config, data.num_channels(), data.num_joints());
        if data.len() < config.batch_size {
            let (found, expected) = (data.len(), config.batch_size);
            return Err(EncoderError::Shape(format!(
                "there are {found} to learn from, expected at least the configuration's batch_size of {expected}"
            )));
        }
        for (name, number) in [("channels", dims.channels), ("joints", dims.joints)] {
            if number == 0 {
                return Err(EncoderError::Shape(format!("the number of {name} is 0, expected 1 or more")));
            }
        }
        let statistics = Statistics::of(data, dims)?;
        let networks = Networks::new(&config.network, dims, &statistics, config.seed);
        Ok(Self {
            adam: Adam::new(networks.arrays.iter().map(|array| array.values.len())),
            scaling: statistics.scaling,
            networks,
            dims,
            num_samples: data.len(),
            config,
            updates: 0,
            order: None,
            sources,
        })
    }

    /// How to learn.
    pub fn config(&self) -> &EncoderConfig {
        &self.config
    }

    /// Updates done.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// Updates of an epoch; samples that fill no batch are left out of it.
    pub fn updates_per_epoch(&self) -> u64 {
        (self.num_samples / self.config.batch_size) as u64
    }

    /// Updates of all epochs.
    pub fn num_updates(&self) -> u64 {
        self.config.epochs * self.updates_per_epoch()
    }

    /// Step size of the next update.
    pub fn learning_rate(&self) -> f64 {
        let share = self.updates as f64 / self.num_updates() as f64;
        let EncoderConfig { learning_rate, final_learning_rate, .. } = self.config;
        learning_rate + (final_learning_rate - learning_rate) * share.min(1.0)
    }

    /// Learns from the next batch of `data`; gives its losses and the norm of the gradient.
    ///
    /// # Errors
    /// Samples or gradients that are no numbers. Parameters are then those before.
    pub fn update<D: Dataset + ?Sized>(&mut self, data: &D) -> Result<(LossTerms, f64), EncoderError> {
        let (epoch, batch) =
            (self.updates / self.updates_per_epoch(), self.updates % self.updates_per_epoch());
        let size = self.config.batch_size;
        let order = match self.order.take() {
            Some((drawn, order)) if drawn == epoch => order,
            _ => permutation(&mut generator(self.config.seed, SHUFFLE, epoch, 0), self.num_samples),
        };
        let numbers = &order[batch as usize * size..][..size];
        let parts: Vec<_> = numbers
            .par_chunks(CHUNK_SAMPLES)
            .map(|numbers| self.gradients(&self.samples(data, numbers)?, size))
            .collect::<Result<_, EncoderError>>()?;
        let mut parts = parts.into_iter();
        let (mut total, mut terms) = parts.next().expect("a batch has samples");
        for (part, part_terms) in parts {
            terms.add(&part_terms);
            add_gradients(&mut total, &part);
        }
        let norm = clip_norm(&mut total, self.config.max_gradient_norm);
        if !norm.is_finite() {
            let names: Vec<String> = self.networks.arrays.iter().map(|array| array.name.clone()).collect();
            return Err(diverged(&total, &names, self.updates));
        }
        let rate = self.learning_rate();
        let parameters = self.networks.arrays.iter_mut().map(|array| &mut array.values);
        self.adam.step(parameters, &total, rate, self.config.weight_decay);
        self.updates += 1;
        self.order = Some((epoch, order));
        Ok((terms, norm))
    }

    /// What is predicted of every sample of `data`, `watch` sees in their order, each beside the sample; gives the losses.
    ///
    /// # Errors
    /// Samples that do not fit.
    pub fn predict<D: Dataset + ?Sized>(
        &self,
        data: &D,
        watch: &mut dyn FnMut(&Prediction, &Sample),
    ) -> Result<LossTerms, EncoderError> {
        // As many at a time as many threads have something to do with, and no more than fit into memory.
        const AT_A_TIME: usize = 64 * CHUNK_SAMPLES;
        let (mut terms, outputs) = (LossTerms::default(), self.dims.outputs());
        let numbers: Vec<usize> = (0..data.len()).collect();
        for numbers in numbers.chunks(AT_A_TIME) {
            let predict = |numbers: &[usize]| -> Result<_, EncoderError> {
                let samples = self.samples(data, numbers)?;
                let tensors = self.networks.tensors(&Device::flex());
                let rows = values(self.outputs(&tensors, &samples, &Device::flex()));
                Ok((samples, rows))
            };
            let parts: Vec<_> =
                numbers.par_chunks(CHUNK_SAMPLES).map(predict).collect::<Result<_, EncoderError>>()?;
            for (samples, rows) in parts {
                for (sample, row) in samples.iter().zip(rows.chunks_exact(outputs.len())) {
                    let mut ignored = vec![0.0; row.len()];
                    terms.add(&sample_loss(sample, row, &outputs, &self.config.loss, 0.0, &mut ignored));
                    watch(&Prediction::of_row(row, &outputs), sample);
                }
            }
        }
        Ok(terms)
    }

    /// The encoder so far.
    pub fn encoder(&self) -> Encoder {
        Encoder::new(
            self.networks.without_decoder(),
            self.scaling.clone(),
            self.config.clone(),
            self.updates,
            self.sources.clone(),
        )
    }

    fn samples<D: Dataset + ?Sized>(&self, data: &D, numbers: &[usize]) -> Result<Vec<Sample>, EncoderError> {
        let checked = |&idx: &usize| {
            let sample = data.sample(idx);
            sample.check(idx, &self.dims)?;
            Ok(sample)
        };
        numbers.iter().map(checked).collect()
    }

    fn outputs(&self, tensors: &[Tensor<2>], samples: &[Sample], device: &Device) -> Tensor<2> {
        let scaled = samples.iter().flat_map(|sample| self.scaling.apply(&sample.input, &self.config.inputs));
        let data = TensorData::new(scaled.collect::<Vec<f32>>(), [samples.len(), self.dims.input_len()]);
        let memory = self.networks.encode(tensors, Tensor::from_data(data, device));
        self.networks.decode(tensors, samples.len(), memory)
    }

    /// Gradients of the objective of `samples`, a part of a batch of `batch_size`, so that those of all parts add up to
    /// the gradient of the batch's mean. One array for each of the networks' arrays.
    fn gradients(
        &self,
        samples: &[Sample],
        batch_size: usize,
    ) -> Result<(Vec<Vec<f32>>, LossTerms), EncoderError> {
        let device = Device::flex().autodiff();
        let tensors = self.networks.tensors(&device);
        let rows = self.outputs(&tensors, samples, &device);
        let outputs = self.dims.outputs();
        let numbers = values(rows.clone().inner());
        if numbers.iter().any(|value| !value.is_finite()) {
            return Err(EncoderError::Diverged { what: "a prediction".to_owned(), update: self.updates });
        }
        let mut slopes = vec![0.0; numbers.len()];
        let mut terms = LossTerms::default();
        let of_rows = numbers.chunks_exact(outputs.len()).zip(slopes.chunks_exact_mut(outputs.len()));
        for (sample, (row, slopes)) in samples.iter().zip(of_rows) {
            terms.add(&sample_loss(
                sample,
                row,
                &outputs,
                &self.config.loss,
                1.0 / batch_size as f64,
                slopes,
            ));
        }
        // The objective's gradient in the outputs is known: what has that gradient is as good as the objective.
        let slopes = Tensor::from_data(TensorData::new(slopes, [samples.len(), outputs.len()]), &device);
        let mut gradients = (rows * slopes).sum().backward();
        let gradients = tensors
            .iter()
            .map(|tensor| {
                values(tensor.grad_remove(&mut gradients).expect("every parameter is part of the outputs"))
            })
            .collect();
        Ok((gradients, terms))
    }
}

#[cfg(test)]
mod tests;
