//! What a training computes on: the CPU's threads, or one device that keeps everything.

use burn_tensor::{Device, Tensor, TensorData};
use palpate_training::AdamRates;

use crate::episodes::{Episodes, Sample};
use crate::pass::values;
use crate::trainer::{NOISE, Predicted, Trainer};
use crate::{CloneConfig, CloneError};

/// What a training computes on.
#[derive(Clone, Debug)]
pub struct TrainingDevice {
    name: String,
    /// Nothing: the CPU, all threads of the pool.
    pub(crate) card: Option<Device>,
}

impl TrainingDevice {
    /// The CPU, with the same bits for any number of threads.
    pub fn cpu() -> Self {
        Self { name: "CPU".to_owned(), card: None }
    }

    /// The graphics card that the system thinks the fastest, by Vulkan, Metal or DirectX. Sums have another order there
    /// than on the CPU, so a training gets other bits.
    ///
    /// # Errors
    /// There is none, or this was built without the feature `gpu`.
    pub fn gpu() -> Result<Self, CloneError> {
        #[cfg(feature = "gpu")]
        {
            let (device, setup) = Device::wgpu_options()
                .init_with_setup()
                .map_err(|err| CloneError::Device(format!("no graphics card can be used: {err}")))?;
            let info = setup.adapter.get_info();
            Ok(Self {
                name: format!("{} ({:?}, {:?})", info.name, info.device_type, info.backend),
                card: Some(device),
            })
        }
        #[cfg(not(feature = "gpu"))]
        Err(CloneError::Device(
            "this program was built without support for graphics cards; build it with `--features gpu`, or take the CPU"
                .to_owned(),
        ))
    }

    /// One device that keeps everything, whatever it is.
    #[cfg(test)]
    pub(crate) fn one(device: Device) -> Self {
        Self { name: "one device".to_owned(), card: Some(device) }
    }

    /// What it is, for people.
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// A training's numbers on a card, where they stay: what goes there are samples, and what comes back are loss and norm.
pub(crate) struct OnCard {
    device: Device,
    /// Parameters, without gradients; in the order of the network's arrays, as all of these.
    parameters: Vec<Tensor<2>>,
    average: Vec<Tensor<2>>,
    first: Vec<Tensor<2>>,
    second: Vec<Tensor<2>>,
}

impl OnCard {
    /// `trainer`'s numbers, brought to `device`.
    pub(crate) fn new(trainer: &Trainer, device: Device) -> Self {
        let arrays = &trainer.network.arrays;
        let bring = |lists: &[Vec<f32>]| {
            let tensor = |(list, shape): (&Vec<f32>, [usize; 2])| {
                Tensor::from_data(TensorData::new(list.clone(), shape), &device)
            };
            lists.iter().zip(arrays.iter().map(|array| array.shape)).map(tensor).collect()
        };
        Self {
            parameters: trainer.network.tensors(&device),
            average: bring(&trainer.average),
            first: bring(&trainer.adam.first),
            second: bring(&trainer.adam.second),
            device,
        }
    }

    /// Learns from the next batch of `episodes`; gives its loss and the norm of the gradient. `trainer` counts, and its
    /// arrays stay as they are until [`Self::store`].
    ///
    /// # Errors
    /// Predictions or gradients that are no numbers; what is on the card is then of no use any more.
    pub(crate) fn update(
        &mut self,
        trainer: &mut Trainer,
        episodes: &Episodes,
    ) -> Result<(f64, f64), CloneError> {
        let samples = trainer.next_batch(episodes);
        let CloneConfig { max_gradient_norm, weight_decay, .. } = *trainer.config();
        let (gradients, loss) = self.gradients(trainer, &samples);
        let norm = gradients
            .iter()
            .map(|gradient| gradient.clone().square().sum())
            .reduce(|sum, square| sum + square)
            .expect("a network has parameters")
            .sqrt();
        let scale = norm.clone().recip().mul_scalar(max_gradient_norm).clamp_max(1.0).reshape([1, 1]);
        trainer.adam.steps += 1;
        let AdamRates { rate, epsilon, kept, beta_1, beta_2 } =
            AdamRates::new(trainer.adam.steps, trainer.learning_rate(), weight_decay);
        let update = trainer.updates();
        trainer.updates += 1;
        let renewed = trainer.average_renewed();
        for (idx, gradient) in gradients.into_iter().enumerate() {
            let slope = gradient * scale.clone();
            let first = self.first[idx].clone() * beta_1 + slope.clone() * (1.0 - beta_1);
            let second = self.second[idx].clone() * beta_2 + slope.square() * (1.0 - beta_2);
            let step = first.clone() * rate / (second.clone().sqrt() + epsilon);
            let value = self.parameters[idx].clone() * kept - step;
            let average = self.average[idx].clone();
            self.average[idx] = average.clone() + (value.clone() - average) * renewed;
            (self.parameters[idx], self.first[idx], self.second[idx]) = (value, first, second);
        }
        // Only now, so that the card had everything to do before anybody waits for it.
        let [loss, norm] = [number(loss)?, number(norm)?];
        let diverged = |what| Err(CloneError::Diverged { what, update });
        match (loss.is_finite(), norm.is_finite()) {
            (false, _) => diverged("a prediction"),
            (_, false) => diverged("a gradient"),
            _ => Ok((loss, norm)),
        }
    }

    /// Gradients of the loss of `samples`, one for each of the network's arrays, and that loss.
    fn gradients(&self, trainer: &Trainer, samples: &[Sample]) -> (Vec<Tensor<2>>, Tensor<1>) {
        let device = self.device.clone().autodiff();
        let leaves: Vec<Tensor<2>> =
            self.parameters.iter().map(|tensor| tensor.clone().autodiff().require_grad()).collect();
        let numbers = [trainer.updates(), 0];
        let Predicted { rows, wanted, divergence } =
            trainer.predictions(&trainer.network, &leaves, samples, NOISE, numbers, &device);
        let wanted = Tensor::from_data(TensorData::new(wanted, rows.dims()), &device);
        let off = rows - wanted;
        let is_absolute = trainer.config().is_loss_absolute();
        let mut loss = if is_absolute { off.abs().mean() } else { off.square().mean() };
        if let Some(divergence) = divergence {
            let weight = trainer.config().act().divergence_weight;
            loss = loss + divergence * (weight / samples.len() as f64);
        }
        let mut gradients = loss.backward();
        let of_leaf = |leaf: &Tensor<2>| {
            leaf.grad_remove(&mut gradients).expect("every parameter is part of the predictions")
        };
        (leaves.iter().map(of_leaf).collect(), loss.inner())
    }

    /// As [`Trainer::judge`], with what is on the card.
    ///
    /// # Errors
    /// Predictions that are no numbers.
    pub(crate) fn judge(&self, trainer: &Trainer, episodes: &Episodes) -> Result<f64, CloneError> {
        trainer.judge_with(episodes, |parts| {
            parts
                .iter()
                .map(|part| trainer.loss_of(episodes, part, &trainer.network, &self.average, &self.device))
                .collect()
        })
    }

    /// Brings everything back into `trainer`'s arrays.
    pub(crate) fn store(&self, trainer: &mut Trainer) {
        let fetch = |tensors: &[Tensor<2>]| tensors.iter().map(|tensor| values(tensor.clone())).collect();
        let parameters: Vec<Vec<f32>> = fetch(&self.parameters);
        trainer.network.arrays.iter_mut().zip(parameters).for_each(|(array, values)| array.values = values);
        trainer.average = fetch(&self.average);
        trainer.adam.first = fetch(&self.first);
        trainer.adam.second = fetch(&self.second);
    }
}

/// The one number of `tensor`, once the card has it.
fn number(tensor: Tensor<1>) -> Result<f64, CloneError> {
    let failed = |err: &dyn std::fmt::Display| {
        CloneError::Device(format!(
            "the graphics card failed: {err}; go on from the last checkpoint with `--resume`"
        ))
    };
    let data = tensor.try_into_data().map_err(|err| failed(&err))?;
    let numbers: Vec<f32> = data.try_into_vec().map_err(|err| failed(&format!("{err:?}")))?;
    numbers.first().map(|&number| f64::from(number)).ok_or_else(|| failed(&"it gave no number"))
}
