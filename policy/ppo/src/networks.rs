//! Actor and critic: their parameters as plain arrays, and the same as tensors that compute.

use burn_tensor::{Device, Tensor, TensorData, activation};
use palpate_training::{Array, fill_normal};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::{
    Activation, NetworksConfig,
    seed::{Purpose, generator},
};

/// Rows that one thread computes at a time. Fixed, because the order of a sum is part of its bits.
pub(crate) const CHUNK_ROWS: usize = 256;

/// Every parameter that is learned: layers `actor.N.weight`, `[inputs, outputs]`, and `actor.N.bias`, `[1, outputs]`, then
/// `actor.log_std`, `[1, action_dim]`, then the layers of `critic`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Networks {
    pub(crate) arrays: Vec<Array>,
    num_actor_arrays: usize,
    activation: Activation,
}

/// Widths of what goes in and out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Dims {
    pub(crate) actor: usize,
    pub(crate) critic: usize,
    pub(crate) action: usize,
}

impl Networks {
    /// First parameters: weights normal with variance `1 / inputs`, the actor's last layer a hundredth of that so that the
    /// first actions are the noise alone, biases zero.
    pub(crate) fn new(config: &NetworksConfig, dims: Dims, initial_std: f64, seed: u64) -> Self {
        let mut arrays = Vec::new();
        let mut generators = (0..).map(|layer| generator(seed, Purpose::Weights, layer, 0));
        add_layers(
            &mut arrays,
            "actor",
            &widths(dims.actor, &config.actor, dims.action),
            0.01,
            &mut generators,
        );
        let log_std = vec![initial_std.ln() as f32; dims.action];
        arrays.push(Array { name: "actor.log_std".to_owned(), shape: [1, dims.action], values: log_std });
        let num_actor_arrays = arrays.len();
        add_layers(&mut arrays, "critic", &widths(dims.critic, &config.critic, 1), 1.0, &mut generators);
        Self { arrays, num_actor_arrays, activation: config.activation }
    }

    /// An actor alone, every parameter of which is yet to be filled in.
    pub(crate) fn of_actor(config: &NetworksConfig, actor_dim: usize, action_dim: usize) -> Self {
        let layers = widths(actor_dim, &config.actor, action_dim);
        let array = |name: String, shape| Array { name, shape, values: Vec::new() };
        let mut arrays: Vec<Array> = layers
            .windows(2)
            .enumerate()
            .flat_map(|(idx, pair)| {
                [
                    array(format!("actor.{idx}.weight"), [pair[0], pair[1]]),
                    array(format!("actor.{idx}.bias"), [1, pair[1]]),
                ]
            })
            .collect();
        arrays.push(array("actor.log_std".to_owned(), [1, action_dim]));
        Self { num_actor_arrays: arrays.len(), arrays, activation: config.activation }
    }

    /// The actor alone.
    pub(crate) fn without_critic(&self) -> Self {
        Self { arrays: self.arrays[..self.num_actor_arrays].to_vec(), ..*self }
    }

    /// Logarithm of the spread of each component of an action.
    pub(crate) fn log_std(&self) -> &[f32] {
        &self.arrays[self.num_actor_arrays - 1].values
    }

    /// Every parameter as a tensor on `device`, in the order of `arrays`; with gradients where the device has them.
    pub(crate) fn tensors(&self, device: &Device) -> Vec<Tensor<2>> {
        let tensor = |array: &Array| {
            let tensor = Tensor::from_data(TensorData::new(array.values.clone(), array.shape), device);
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        };
        self.arrays.iter().map(tensor).collect()
    }

    /// The actor's mean, the logarithm of its spread and the critic among [`Networks::tensors`].
    pub(crate) fn split<'a>(&self, tensors: &'a [Tensor<2>]) -> (Mlp<'a>, &'a Tensor<2>, Mlp<'a>) {
        let (actor, critic) = tensors.split_at(self.num_actor_arrays);
        let (log_std, actor) = actor.split_last().expect("an actor has a spread");
        (
            Mlp { layers: actor, activation: self.activation },
            log_std,
            Mlp { layers: critic, activation: self.activation },
        )
    }
}

/// Layers that compute.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mlp<'a> {
    /// Weight, bias, weight, bias, ...
    layers: &'a [Tensor<2>],
    activation: Activation,
}

impl Mlp<'_> {
    /// `[rows, inputs]` to `[rows, outputs]`.
    pub(crate) fn forward(&self, rows: Tensor<2>) -> Tensor<2> {
        let num_layers = self.layers.len() / 2;
        self.layers.chunks_exact(2).enumerate().fold(rows, |rows, (idx, layer)| {
            let sums = rows.matmul(layer[0].clone()) + layer[1].clone();
            if idx + 1 == num_layers { sums } else { activate(sums, self.activation) }
        })
    }

    /// Outputs for `rows`, `[any, inputs]`, one chunk a thread.
    pub(crate) fn outputs(&self, rows: &[f32]) -> Vec<f32> {
        let [inputs, _] = self.layers[0].dims();
        let chunks: Vec<Vec<f32>> = rows
            .par_chunks(CHUNK_ROWS * inputs)
            .map(|chunk| {
                let data = TensorData::new(chunk.to_vec(), [chunk.len() / inputs, inputs]);
                values(self.forward(Tensor::from_data(data, &self.layers[0].device())))
            })
            .collect();
        chunks.concat()
    }
}

/// The numbers of a tensor, row by row.
pub(crate) fn values(tensor: Tensor<2>) -> Vec<f32> {
    tensor.into_data().try_into_vec().expect("networks are made of 32-bit floats")
}

fn activate(sums: Tensor<2>, activation: Activation) -> Tensor<2> {
    match activation {
        // No branch ever computes the exponential of a large number: its infinity times a gradient of zero would be NaN.
        Activation::Elu => activation::relu(sums.clone()) + sums.clamp_max(0.0).exp() - 1.0,
        Activation::Relu => activation::relu(sums),
        Activation::Tanh => sums.tanh(),
    }
}

fn widths(inputs: usize, hidden: &[usize], outputs: usize) -> Vec<usize> {
    [&[inputs], hidden, &[outputs]].concat()
}

fn add_layers(
    arrays: &mut Vec<Array>,
    network: &str,
    widths: &[usize],
    last_scale: f32,
    generators: &mut impl Iterator<Item = ChaCha8Rng>,
) {
    let num_layers = widths.len() - 1;
    for ((idx, shape), mut generator) in widths.windows(2).enumerate().zip(generators) {
        let (inputs, outputs) = (shape[0], shape[1]);
        let mut weights = vec![0.0; inputs * outputs];
        fill_normal(&mut generator, &mut weights);
        let scale = if idx + 1 == num_layers { last_scale } else { 1.0 } / (inputs as f32).sqrt();
        weights.iter_mut().for_each(|weight| *weight *= scale);
        let name = |part| format!("{network}.{idx}.{part}");
        arrays.push(Array { name: name("weight"), shape: [inputs, outputs], values: weights });
        arrays.push(Array { name: name("bias"), shape: [1, outputs], values: vec![0.0; outputs] });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn networks(activation: Activation) -> Networks {
        let config = NetworksConfig { actor: vec![7, 5], critic: vec![6], activation };
        Networks::new(&config, Dims { actor: 3, critic: 4, action: 2 }, 0.3, 1)
    }

    #[test]
    fn layers_have_the_shapes_of_the_file() {
        let networks = networks(Activation::Elu);
        let shapes: Vec<_> = networks.arrays.iter().map(|array| (array.name.as_str(), array.shape)).collect();
        assert_eq!(
            shapes,
            [
                ("actor.0.weight", [3, 7]),
                ("actor.0.bias", [1, 7]),
                ("actor.1.weight", [7, 5]),
                ("actor.1.bias", [1, 5]),
                ("actor.2.weight", [5, 2]),
                ("actor.2.bias", [1, 2]),
                ("actor.log_std", [1, 2]),
                ("critic.0.weight", [4, 6]),
                ("critic.0.bias", [1, 6]),
                ("critic.1.weight", [6, 1]),
                ("critic.1.bias", [1, 1]),
            ]
        );
    }

    #[test]
    fn outputs_are_what_loops_compute() {
        let mut networks = networks(Activation::Elu);
        for (idx, array) in networks.arrays.iter_mut().enumerate() {
            array
                .values
                .iter_mut()
                .enumerate()
                .for_each(|(at, value)| *value += (idx + at) as f32 % 3.0 - 1.0);
        }
        let rows: Vec<f32> = (0..3 * (CHUNK_ROWS + 5)).map(|i| (i % 11) as f32 / 5.0 - 1.0).collect();
        let tensors = networks.tensors(&Device::flex());
        let (actor, _, _) = networks.split(&tensors);
        let outputs = actor.outputs(&rows);
        for (row, output) in rows.chunks(3).zip(outputs.chunks(2)) {
            let mut layer: Vec<f64> = row.iter().map(|&value| f64::from(value)).collect();
            for (idx, pair) in networks.arrays[..6].chunks(2).enumerate() {
                let [_, width] = pair[0].shape;
                layer = (0..width)
                    .map(|out| {
                        let weight =
                            |input: usize| f64::from(pair[0].values[input * width + out]) * layer[input];
                        (0..layer.len()).map(weight).sum::<f64>() + f64::from(pair[1].values[out])
                    })
                    .map(|sum| if idx < 2 && sum < 0.0 { sum.exp_m1() } else { sum })
                    .collect();
            }
            for (value, expected) in output.iter().zip(&layer) {
                assert!((f64::from(*value) - expected).abs() < 1e-4, "{value} {expected}");
            }
        }
    }

    #[test]
    fn elu_has_its_values_and_slopes_and_stays_finite_far_out() {
        let device = Device::flex().autodiff();
        let sums = Tensor::<2>::from_floats([[-200.0, -1.0, 2.0, 200.0]], &device).require_grad();
        let outputs = activate(sums.clone(), Activation::Elu);
        let gradients = outputs.clone().sum().backward();
        let slopes = values(sums.grad(&gradients).expect("a gradient"));
        let e = (-1.0_f32).exp();
        for (value, expected) in values(outputs).iter().zip([-1.0, e - 1.0, 2.0, 200.0]) {
            assert!((value - expected).abs() < 1e-6, "{value} {expected}");
        }
        for (slope, expected) in slopes.iter().zip([0.0, e, 1.0, 1.0]) {
            assert!((slope - expected).abs() < 1e-6, "{slope} {expected}");
        }
    }
}
