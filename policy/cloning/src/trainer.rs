//! Learning: episodes in, a better policy out.

use std::collections::BTreeMap;
use std::sync::Arc;

use burn_tensor::{Device, Tensor, TensorData};
use palpate_training::{Adam, add_gradients, clip_norm, fill_normal, generator, permutation};
use rayon::prelude::*;

use crate::act::divergence;
use crate::cloned::{Cloned, Robot};
use crate::episodes::{EncoderFile, Episodes, Sample};
use crate::network::{CHUNK_SAMPLES, Network};
use crate::pass::values;
use crate::scaling::Scaling;
use crate::schedule::Schedule;
use crate::{CloneConfig, CloneError, Head, Memory, Predicts, Shape};

/// What noise is for: the order of samples; what is added to chunks; the same for held-out ones.
const SHUFFLE: u64 = 2;
pub(crate) const NOISE: u64 = 4;
const HELD_OUT_NOISE: u64 = 5;
/// Samples that means and deviations are taken of, at most; and those that held-out episodes are judged by.
const MAX_MEASURED: usize = 20_000;
const MAX_JUDGED: usize = 2_048;
/// Deviations below these count as these: joints that hardly moved, and actions of which there were hardly any.
const MIN_INPUT_STD: f64 = 0.01;
const MIN_ACTION_STD: f64 = 1e-3;

/// What is predicted of samples.
pub(crate) struct Predicted {
    /// `[samples, predicted * action_len]`: chunks, or the noise in them; normalised.
    pub(crate) rows: Tensor<2>,
    /// What they should be.
    pub(crate) wanted: Vec<f32>,
    /// How far the styles of all samples together are from their prior, where the network learns styles.
    pub(crate) divergence: Option<Tensor<1>>,
}

/// Held-out steps that are predicted together, and their number, which their noise follows from.
pub(crate) struct Part {
    number: u64,
    moments: Vec<(usize, usize)>,
}

/// A training under way.
#[derive(Clone, Debug)]
pub struct Trainer {
    pub(crate) config: CloneConfig,
    pub(crate) robot: Robot,
    /// Number of steps to learn from.
    pub(crate) num_samples: usize,
    pub(crate) inputs: Scaling,
    pub(crate) chunks: Scaling,
    pub(crate) network: Network,
    /// The moving average of the parameters.
    pub(crate) average: Vec<Vec<f32>>,
    pub(crate) adam: Adam,
    pub(crate) updates: u64,
    /// What the episodes were made from, by name.
    pub(crate) sources: BTreeMap<String, String>,
    /// What made the features of the episodes.
    pub(crate) encoder: Option<Arc<EncoderFile>>,
    schedule: Schedule,
    moments: Vec<(usize, usize)>,
    /// An epoch, and the order of its samples: drawn once for all of its updates.
    order: Option<(u64, Vec<usize>)>,
}

impl Trainer {
    /// A training that begins, on `episodes` of `robot`, which were made from `sources`: names with something that
    /// changes where the source does, such as a file's SHA-256.
    ///
    /// # Errors
    /// A configuration that makes no sense, or episodes that do not fit it.
    pub fn new(
        config: CloneConfig,
        robot: Robot,
        episodes: &Episodes,
        sources: BTreeMap<String, String>,
    ) -> Result<Self, CloneError> {
        config.validate()?;
        let shape = episodes.shape();
        check_features(&config, episodes)?;
        check_region(&config, episodes)?;
        if robot.shape() != (Shape { features: 0, ..shape }) {
            let Robot { joints, channels, .. } = &robot;
            return Err(CloneError::Shape(format!(
                "the episodes have {} joints and {} channels, the robot {} and {}",
                shape.dofs,
                shape.channels,
                joints.len(),
                channels.len()
            )));
        }
        let moments = episodes.moments();
        if moments.len() < config.batch_size {
            let (found, expected) = (moments.len(), config.batch_size);
            return Err(CloneError::Shape(format!(
                "there are {found} steps to learn from, expected at least the configuration's batch_size of {expected}"
            )));
        }
        let measured: Vec<Sample> =
            spread(&moments, MAX_MEASURED).par_iter().map(|&at| episodes.sample(&config, at)).collect();
        let mut inputs = Scaling::of(measured.iter().map(|sample| &sample.input), MIN_INPUT_STD);
        if config.memory == Memory::Recurrent || config.head == Head::Act {
            inputs = inputs.with_equal_frames(config.observation.frames, shape.frame_len());
        }
        let network = Network::new(&config, shape);
        let average: Vec<Vec<f32>> = network.arrays.iter().map(|array| array.values.clone()).collect();
        Ok(Self {
            inputs,
            chunks: Scaling::of(measured.iter().map(|sample| &sample.chunk), MIN_ACTION_STD),
            adam: Adam::new(average.iter().map(Vec::len)),
            schedule: Schedule::cosine(config.diffusion.steps),
            num_samples: moments.len(),
            updates: 0,
            order: None,
            robot,
            network,
            average,
            moments,
            sources,
            encoder: episodes.encoder().cloned(),
            config,
        })
    }

    /// How to learn.
    pub fn config(&self) -> &CloneConfig {
        &self.config
    }

    /// Updates done.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// Step size of the next update.
    pub fn learning_rate(&self) -> f64 {
        let CloneConfig { updates, warmup_updates, learning_rate, .. } = self.config;
        if self.updates < warmup_updates {
            return learning_rate * (self.updates + 1) as f64 / warmup_updates as f64;
        }
        let left = updates.saturating_sub(warmup_updates).max(1) as f64;
        let share = ((self.updates - warmup_updates) as f64 / left).min(1.0);
        0.5 * learning_rate * (1.0 + (std::f64::consts::PI * share).cos())
    }

    /// Learns from the next batch of `episodes`, those that it was made with; gives its loss (the mean error of what is
    /// predicted, normalised, and with styles their weighted divergence) and the norm of the gradient.
    ///
    /// # Errors
    /// Predictions or gradients that are no numbers. Parameters are then those before.
    pub fn update(&mut self, episodes: &Episodes) -> Result<(f64, f64), CloneError> {
        let samples = self.next_batch(episodes);
        let parts: Vec<_> = samples
            .par_chunks(CHUNK_SAMPLES)
            .enumerate()
            .map(|(part, samples)| {
                self.gradients(samples, NOISE, [self.updates, part as u64], self.config.batch_size)
            })
            .collect::<Result<_, CloneError>>()?;
        let mut parts = parts.into_iter();
        let (mut total, mut loss) = parts.next().expect("a batch has samples");
        for (part, part_loss) in parts {
            loss += part_loss;
            add_gradients(&mut total, &part);
        }
        let norm = clip_norm(&mut total, self.config.max_gradient_norm);
        if !norm.is_finite() {
            return Err(CloneError::Diverged { what: "a gradient", update: self.updates });
        }
        let rate = self.learning_rate();
        let parameters = self.network.arrays.iter_mut().map(|array| &mut array.values);
        self.adam.step(parameters, &total, rate, self.config.weight_decay);
        self.updates += 1;
        let renewed = self.average_renewed();
        let of_arrays = self.average.iter_mut().zip(&self.network.arrays);
        for (average, array) in of_arrays {
            let both = average.iter_mut().zip(&array.values);
            both.for_each(|(average, &value)| *average += renewed * (value - *average));
        }
        Ok((loss, norm))
    }

    /// Samples of the next update.
    pub(crate) fn next_batch(&mut self, episodes: &Episodes) -> Vec<Sample> {
        let size = self.config.batch_size;
        let per_epoch = (self.num_samples / size) as u64;
        let (epoch, batch) = (self.updates / per_epoch, self.updates % per_epoch);
        let order = match self.order.take() {
            Some((drawn, order)) if drawn == epoch => order,
            _ => permutation(&mut generator(self.config.seed, SHUFFLE, epoch, 0), self.num_samples),
        };
        let numbers = order[batch as usize * size..][..size].par_iter();
        let samples = numbers.map(|&idx| episodes.sample(&self.config, self.moments[idx])).collect();
        self.order = Some((epoch, order));
        samples
    }

    /// By what share the newest parameters renew the moving average. Much at first, or it would hold on to the first
    /// weights.
    pub(crate) fn average_renewed(&self) -> f32 {
        let updates = self.updates as f64;
        1.0 - self.config.average_decay.min((1.0 + updates) / (10.0 + updates)) as f32
    }

    /// The loss of the policy so far, with its averaged parameters, on `episodes`.
    ///
    /// # Errors
    /// Predictions that are no numbers.
    pub fn judge(&self, episodes: &Episodes) -> Result<f64, CloneError> {
        let network = self.averaged();
        self.judge_with(episodes, |parts| {
            let loss = |part: &Part| {
                let device = Device::flex();
                self.loss_of(episodes, part, &network, &network.tensors(&device), &device)
            };
            parts.par_iter().map(loss).collect()
        })
    }

    /// The mean of the losses on some of `episodes`' steps, which `losses` finds part by part.
    pub(crate) fn judge_with(
        &self,
        episodes: &Episodes,
        losses: impl FnOnce(&[Part]) -> Result<Vec<f64>, CloneError>,
    ) -> Result<f64, CloneError> {
        let moments = spread(&episodes.moments(), MAX_JUDGED);
        let numbered = moments.chunks(CHUNK_SAMPLES).zip(0..);
        let parts: Vec<Part> =
            numbered.map(|(moments, number)| Part { number, moments: moments.to_vec() }).collect();
        Ok(losses(&parts)?.iter().sum::<f64>() / moments.len().max(1) as f64)
    }

    /// The sum of the losses of `part`, by `network` with these `tensors` on `device`.
    pub(crate) fn loss_of(
        &self,
        episodes: &Episodes,
        part: &Part,
        network: &Network,
        tensors: &[Tensor<2>],
        device: &Device,
    ) -> Result<f64, CloneError> {
        let samples: Vec<Sample> = part.moments.iter().map(|&at| episodes.sample(&self.config, at)).collect();
        let numbers = [0, part.number];
        let Predicted { rows, wanted, .. } =
            self.predictions(network, tensors, &samples, HELD_OUT_NOISE, numbers, device);
        self.errors(&values(rows), &wanted, samples.len()).map(|(_, loss)| loss * samples.len() as f64)
    }

    /// The policy so far.
    pub fn cloned(&self) -> Cloned {
        Cloned::new(
            self.config.clone(),
            self.robot.clone(),
            [self.inputs.clone(), self.chunks.clone()],
            self.averaged(),
            self.updates,
            self.sources.clone(),
            self.encoder.clone(),
        )
    }

    fn averaged(&self) -> Network {
        let mut network = self.network.clone();
        network
            .arrays
            .iter_mut()
            .zip(&self.average)
            .for_each(|(array, average)| array.values.clone_from(average));
        network
    }

    /// What is predicted of `samples`. Of held-out ones nobody reads the style off the chunk: it is the one at work.
    pub(crate) fn predictions(
        &self,
        network: &Network,
        tensors: &[Tensor<2>],
        samples: &[Sample],
        purpose: u64,
        [first, second]: [u64; 2],
        device: &Device,
    ) -> Predicted {
        let rows = |values: Vec<f32>| {
            let len = values.len() / samples.len();
            Tensor::<2>::from_data(TensorData::new(values, [samples.len(), len]), device)
        };
        let inputs = samples.iter().flat_map(|sample| self.inputs.apply(&sample.input)).collect();
        let chunks: Vec<f32> = samples.iter().flat_map(|sample| self.chunks.apply(&sample.chunk)).collect();
        let inputs = rows(inputs);
        let features = network.trunk(tensors, inputs.clone());
        let mut rng = generator(self.config.seed, purpose, first, second);
        match self.config.head {
            Head::Diffusion => {}
            Head::Regression => {
                let rows = network.regress(tensors, features);
                return Predicted { rows, wanted: chunks, divergence: None };
            }
            Head::Act => {
                let mut styles = (network.usual_style(samples.len(), device), None);
                if purpose != HELD_OUT_NOISE {
                    let [mean, log_variance] =
                        network.styles(tensors, features.clone(), rows(chunks.clone()));
                    let mut noise = vec![0.0; samples.len() * network.style_len()];
                    fill_normal(&mut rng, &mut noise);
                    let drawn = mean.clone() + (log_variance.clone() * 0.5).exp() * rows(noise);
                    styles = (drawn, Some(divergence(mean, log_variance)));
                }
                let (style, divergence) = styles;
                let rows = network.chunks_in_style(tensors, features, inputs, style);
                return Predicted { rows, wanted: chunks, divergence };
            }
        }
        let steps: Vec<usize> =
            samples.iter().map(|_| palpate_training::below(&mut rng, self.schedule.len())).collect();
        let mut noise = vec![0.0; chunks.len()];
        fill_normal(&mut rng, &mut noise);
        let len = network.chunk_len();
        let noisy = chunks.iter().zip(&noise).enumerate().map(|(idx, (&chunk, &noise))| {
            let [signal_share, noise_share] = self.schedule.shares(steps[idx / len]);
            (signal_share * f64::from(chunk) + noise_share * f64::from(noise)) as f32
        });
        let noisy = rows(noisy.collect());
        let wanted = match self.config.diffusion.predicts() {
            Predicts::Noise => noise,
            Predicts::Chunk => chunks,
        };
        Predicted { rows: network.of_noisy(tensors, features, noisy, &steps), wanted, divergence: None }
    }

    /// Slopes of the mean error, squared or absolute, of a batch of `batch_size`, and this part's share of it.
    fn errors(
        &self,
        predicted: &[f32],
        wanted: &[f32],
        batch_size: usize,
    ) -> Result<(Vec<f32>, f64), CloneError> {
        if predicted.iter().any(|value| !value.is_finite()) {
            return Err(CloneError::Diverged { what: "a prediction", update: self.updates });
        }
        let count = (batch_size * self.network.chunk_len()) as f64;
        let off = |(&found, &wanted): (&f32, &f32)| f64::from(found) - f64::from(wanted);
        let pairs = predicted.iter().zip(wanted);
        if self.config.is_loss_absolute() {
            let loss = pairs.clone().map(|pair| off(pair).abs()).sum::<f64>() / count;
            let sign = |off: f64| if off == 0.0 { 0.0 } else { off.signum() };
            return Ok((pairs.map(|pair| (sign(off(pair)) / count) as f32).collect(), loss));
        }
        let loss = pairs.clone().map(|pair| off(pair).powi(2)).sum::<f64>() / count;
        Ok((pairs.map(|pair| (2.0 * off(pair) / count) as f32).collect(), loss))
    }

    /// Gradients of the loss of `samples`, a part of a batch of `batch_size`, so that those of all parts add up to the
    /// gradient of the batch's mean. One array for each of the network's arrays.
    fn gradients(
        &self,
        samples: &[Sample],
        purpose: u64,
        numbers: [u64; 2],
        batch_size: usize,
    ) -> Result<(Vec<Vec<f32>>, f64), CloneError> {
        let device = Device::flex().autodiff();
        let tensors = self.network.tensors(&device);
        let Predicted { rows, wanted, divergence } =
            self.predictions(&self.network, &tensors, samples, purpose, numbers, &device);
        let (slopes, mut loss) = self.errors(&values(rows.clone().inner()), &wanted, batch_size)?;
        // The loss' gradient in the predictions is known: what has that gradient is as good as the loss.
        let slopes =
            Tensor::from_data(TensorData::new(slopes, [samples.len(), self.network.chunk_len()]), &device);
        let mut weighted = (rows * slopes).sum();
        if let Some(divergence) = divergence {
            let divergence = divergence * (self.config.act().divergence_weight / batch_size as f64);
            loss += f64::from(values(divergence.clone().inner().reshape([1, 1]))[0]);
            weighted = weighted + divergence;
        }
        let mut gradients = weighted.backward();
        let gradients = tensors
            .iter()
            .map(|tensor| {
                values(
                    tensor.grad_remove(&mut gradients).expect("every parameter is part of the predictions"),
                )
            })
            .collect();
        Ok((gradients, loss))
    }
}

/// Whether `episodes` have features if `config` lets the policy see some, and say who made them.
fn check_features(config: &CloneConfig, episodes: &Episodes) -> Result<(), CloneError> {
    let shape = episodes.shape();
    if config.observation.points {
        let (found, expected) = (shape.features, shape.num_points_numbers());
        return (found == expected).then_some(()).ok_or_else(|| {
            CloneError::Shape(format!(
                "observation.points is true, but the episodes have {found} numbers of points in each step, expected {expected}"
            ))
        });
    }
    let problem = match (config.observation.features, shape.features) {
        (true, 0) => {
            "observation.features is true, but the episodes have no features of an encoder".to_owned()
        }
        (false, found @ 1..) => {
            format!("observation.features is false, but the episodes have {found} features in each step")
        }
        (true, 1..) if episodes.encoder().is_none() => {
            "the episodes have features, but do not say which encoder made them".to_owned()
        }
        _ => return Ok(()),
    };
    Err(CloneError::Shape(problem))
}

/// Whether `episodes` say in which region they began, and not all in the same one, if `config` lets the policy see it.
fn check_region(config: &CloneConfig, episodes: &Episodes) -> Result<(), CloneError> {
    if !config.observation.region {
        return Ok(());
    }
    let half_widths: Option<Vec<f32>> = episodes.half_widths_m().collect();
    let problem = match half_widths {
        None => "the episodes do not all say in which region their object began".to_owned(),
        Some(all) => match all.first() {
            Some(first) if all.iter().all(|one| one == first) => format!(
                "all episodes began within {first} m of the middle, so that the region says nothing; add episodes of \
                 another region"
            ),
            _ => return Ok(()),
        },
    };
    Err(CloneError::Shape(format!("observation.region is true, but {problem}")))
}

/// At most `most` of `moments`, evenly spread.
fn spread(moments: &[(usize, usize)], most: usize) -> Vec<(usize, usize)> {
    let stride = moments.len().div_ceil(most).max(1);
    moments.iter().copied().step_by(stride).collect()
}

#[cfg(test)]
mod tests;
