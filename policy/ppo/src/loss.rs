//! What an update descends: the clipped surrogate (Schulman et al. 2017), the critic's error, and entropy.

use std::f64::consts::{PI, TAU};

use burn_tensor::{Device, Tensor, TensorData};

use crate::networks::{Dims, Networks, values};

/// Rows of a batch, `[rows, dim]` or `[rows]` each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Samples {
    /// Normalised.
    pub(crate) actor: Vec<f32>,
    /// Normalised.
    pub(crate) critic: Vec<f32>,
    pub(crate) actions: Vec<f32>,
    /// Of `actions`, under the policy that took them.
    pub(crate) log_probs: Vec<f32>,
    pub(crate) advantages: Vec<f32>,
    /// What the critic should have said.
    pub(crate) returns: Vec<f32>,
}

impl Samples {
    /// Rows at `indices`, in that order.
    pub(crate) fn gather(&self, indices: &[usize], dims: Dims) -> Self {
        let rows = |from: &[f32], dim: usize| -> Vec<f32> {
            indices.iter().flat_map(|&row| &from[row * dim..(row + 1) * dim]).copied().collect()
        };
        Self {
            actor: rows(&self.actor, dims.actor),
            critic: rows(&self.critic, dims.critic),
            actions: rows(&self.actions, dims.action),
            log_probs: rows(&self.log_probs, 1),
            advantages: rows(&self.advantages, 1),
            returns: rows(&self.returns, 1),
        }
    }
}

/// Weights of the loss.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LossParams {
    pub(crate) clip: f64,
    pub(crate) value_coefficient: f64,
    pub(crate) entropy_coefficient: f64,
}

/// Sums over samples, for reports.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LossSums {
    pub(crate) samples: usize,
    pub(crate) policy_loss: f64,
    pub(crate) value_loss: f64,
    /// `ratio - 1 - ln ratio`: never negative, and in the mean the divergence from the policy that acted.
    pub(crate) kl: f64,
    /// Samples whose ratio left the clip range.
    pub(crate) clipped: usize,
}

impl LossSums {
    pub(crate) fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.policy_loss += other.policy_loss;
        self.value_loss += other.value_loss;
        self.kl += other.kl;
        self.clipped += other.clipped;
    }
}

/// Ratios beyond `exp` of this are as good as infinite: within, nothing overflows.
const MAX_LOG_RATIO: f64 = 20.0;

/// Entropy of a Gaussian with independent components.
pub(crate) fn entropy(log_std: &[f32]) -> f64 {
    log_std.iter().map(|&log_std| f64::from(log_std) + 0.5 * (1.0 + TAU.ln())).sum()
}

/// Logarithm of the density of `actions` under Gaussians around `means`, all `[rows, action_dim]`, spread `[1, action_dim]`;
/// gives `[rows, 1]`.
fn log_prob(actions: Tensor<2>, means: Tensor<2>, log_std: &Tensor<2>) -> Tensor<2> {
    let [_, action_dim] = actions.dims();
    let distances = (actions - means) * (-log_std.clone()).exp();
    let constant = 0.5 * action_dim as f64 * (2.0 * PI).ln();
    (distances.square().sum_dim(1) * -0.5) - log_std.clone().sum_dim(1) - constant
}

/// `min(ratio A, clip(ratio) A)`, all `[rows, 1]`: what moving the policy gains, and no more beyond `1 ± clip`.
fn clipped_surrogate(ratios: Tensor<2>, advantages: Tensor<2>, clip: f64) -> Tensor<2> {
    let clipped = ratios.clone().clamp(1.0 - clip, 1.0 + clip) * advantages.clone();
    (ratios * advantages).min_pair(clipped)
}

/// Gradients of the loss of `samples`, a part of a minibatch of `minibatch_rows`, so that those of all parts add up to
/// the gradient of the minibatch's mean. One array for each of [`Networks::arrays`].
pub(crate) fn gradients(
    networks: &Networks,
    samples: &Samples,
    dims: Dims,
    minibatch_rows: usize,
    params: LossParams,
) -> (Vec<Vec<f32>>, LossSums) {
    let rows = samples.returns.len();
    let device = Device::flex().autodiff();
    let matrix = |numbers: &[f32], columns: usize| {
        Tensor::<2>::from_data(TensorData::new(numbers.to_vec(), [rows, columns]), &device)
    };
    let tensors = networks.tensors(&device);
    let (actor, log_std, critic) = networks.split(&tensors);

    let means = actor.forward(matrix(&samples.actor, dims.actor));
    let log_probs = log_prob(matrix(&samples.actions, dims.action), means, log_std);
    let log_ratios = (log_probs - matrix(&samples.log_probs, 1)).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO);
    let surrogate = clipped_surrogate(log_ratios.clone().exp(), matrix(&samples.advantages, 1), params.clip);
    let errors = critic.forward(matrix(&samples.critic, dims.critic)) - matrix(&samples.returns, 1);

    let sums = LossSums::of(
        &values(log_ratios.inner()),
        &values(surrogate.clone().inner()),
        &values(errors.clone().inner()),
        params.clip,
    );
    // The entropy does not depend on the observation: each part of the minibatch adds its share.
    let entropy = log_std.clone().sum() * (rows as f64 * params.entropy_coefficient);
    let loss = errors.square().sum() * (0.5 * params.value_coefficient) - surrogate.sum() - entropy;
    let mut slopes = (loss / minibatch_rows as f64).backward();
    let gradients = tensors
        .iter()
        .map(|tensor| values(tensor.grad_remove(&mut slopes).expect("every parameter is part of the loss")))
        .collect();
    (gradients, sums)
}

impl LossSums {
    fn of(log_ratios: &[f32], surrogate: &[f32], errors: &[f32], clip: f64) -> Self {
        let mut sums = Self { samples: log_ratios.len(), ..Self::default() };
        for ((&log_ratio, &gain), &error) in log_ratios.iter().zip(surrogate).zip(errors) {
            let (log_ratio, error) = (f64::from(log_ratio), f64::from(error));
            sums.policy_loss -= f64::from(gain);
            sums.value_loss += 0.5 * error * error;
            sums.kl += log_ratio.exp_m1() - log_ratio;
            sums.clipped += usize::from(log_ratio.exp_m1().abs() > clip);
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Activation, NetworksConfig};

    #[test]
    fn the_surrogate_has_no_slope_beyond_the_clip_where_going_on_would_gain() {
        // Ratio, advantage, slope: within the clip the advantage; beyond it nothing where the ratio has already gone the way
        // that the advantage wants; where it went the wrong way, the advantage pulls it back.
        let cases = [
            (1.0, 2.0, 2.0),
            (1.1, -2.0, -2.0),
            (0.9, 3.0, 3.0),
            (1.5, 2.0, 0.0),
            (0.5, -2.0, 0.0),
            (1.5, -2.0, -2.0),
            (0.5, 2.0, 2.0),
        ];
        let device = Device::flex().autodiff();
        for (ratio, advantage, slope) in cases {
            let ratios = Tensor::<2>::from_floats([[ratio]], &device).require_grad();
            let gain = clipped_surrogate(ratios.clone(), Tensor::from_floats([[advantage]], &device), 0.2);
            let gradients = gain.sum().backward();
            let found = values(ratios.grad(&gradients).expect("a gradient"))[0];
            assert_eq!(found, slope, "ratio {ratio}, advantage {advantage}");
        }
    }

    #[test]
    fn densities_and_entropy_are_the_gaussian_ones() {
        let device = Device::flex();
        let log_std = [0.5_f32.ln(), 2.0_f32.ln()];
        let found = log_prob(
            Tensor::from_floats([[1.0, -1.0]], &device),
            Tensor::from_floats([[0.5, 3.0]], &device),
            &Tensor::from_floats([log_std], &device),
        );
        // One spread from the mean in the first component, two in the second; the spreads' product is one.
        let expected = -0.5 * (1.0 + 4.0) - TAU.ln();
        assert!((f64::from(values(found)[0]) - expected).abs() < 1e-6);
        assert!((entropy(&log_std) - (1.0 + TAU.ln())).abs() < 1e-6);
    }

    fn samples(rows: usize, dims: Dims) -> Samples {
        let wave = |count: usize, pace: f32| (0..count).map(|i| (i as f32 * pace).sin()).collect();
        Samples {
            actor: wave(rows * dims.actor, 0.7),
            critic: wave(rows * dims.critic, 1.1),
            actions: wave(rows * dims.action, 1.9),
            log_probs: vec![-2.5; rows],
            advantages: wave(rows, 2.3),
            returns: wave(rows, 0.3),
        }
    }

    const DIMS: Dims = Dims { actor: 3, critic: 4, action: 2 };
    const PARAMS: LossParams = LossParams { clip: 0.2, value_coefficient: 0.5, entropy_coefficient: 0.01 };

    fn networks() -> Networks {
        let config = NetworksConfig { actor: vec![7], critic: vec![5], activation: Activation::Elu };
        Networks::new(&config, DIMS, 0.7, 3)
    }

    fn loss(networks: &Networks, samples: &Samples) -> f64 {
        let (_, sums) = gradients(networks, samples, DIMS, samples.returns.len(), PARAMS);
        let rows = sums.samples as f64;
        sums.policy_loss / rows + PARAMS.value_coefficient * sums.value_loss / rows
            - PARAMS.entropy_coefficient * entropy(networks.log_std())
    }

    #[test]
    fn gradients_are_differences_of_the_loss() {
        let (networks, samples) = (networks(), samples(13, DIMS));
        let (slopes, sums) = gradients(&networks, &samples, DIMS, 13, PARAMS);
        assert!(sums.clipped > 0 && sums.clipped < 13, "both sides of the clip are among them: {sums:?}");
        for (array, slopes) in slopes.iter().enumerate() {
            for at in [0, slopes.len() - 1] {
                let moved = |by: f32| {
                    let mut moved = networks.clone();
                    moved.arrays[array].values[at] += by;
                    loss(&moved, &samples)
                };
                let slope = (moved(1e-2) - moved(-1e-2)) / 2e-2;
                let name = &networks.arrays[array].name;
                assert!((f64::from(slopes[at]) - slope).abs() < 2e-3, "{name}[{at}]: {} {slope}", slopes[at]);
            }
        }
    }

    #[test]
    fn parts_of_a_minibatch_add_up_to_it() {
        let (networks, samples) = (networks(), samples(13, DIMS));
        let (whole, _) = gradients(&networks, &samples, DIMS, 13, PARAMS);
        let part = |rows: std::ops::Range<usize>| {
            gradients(&networks, &samples.gather(&rows.collect::<Vec<_>>(), DIMS), DIMS, 13, PARAMS).0
        };
        let (first, second) = (part(0..5), part(5..13));
        for ((whole, first), second) in whole.iter().zip(&first).zip(&second) {
            for ((whole, first), second) in whole.iter().zip(first).zip(second) {
                assert!((whole - (first + second)).abs() < 1e-5, "{whole} {first} {second}");
            }
        }
    }
}
