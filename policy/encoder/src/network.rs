//! Encoder and decoder: their parameters as plain arrays, and the same as tensors that compute.
//!
//! Both are Transformers that normalise before each part (pre-norm): x + attention(norm(x)), x + feed-forward(norm(x)).

use burn_tensor::{Device, Tensor, TensorData, activation, module};
use palpate_training::{Array, ArrayBuilder};

use crate::sample::{FEATURES, POSE};
use crate::statistics::Statistics;
use crate::{Dims, NetworkConfig};

/// Samples that one thread computes at a time. Fixed, because the order of a sum is part of its bits.
pub(crate) const CHUNK_SAMPLES: usize = 16;

/// Networks say lengths in this many m, so that their numbers are about one.
const LENGTH_UNIT_M: f64 = 0.1;
const NORM_EPSILON: f64 = 1e-5;
/// What noise is for: first weights.
const WEIGHTS: u64 = 1;
/// First spread of what tells frames, and queries, apart.
const POSITION_STD: f32 = 0.1;
const QUERY_STD: f32 = 1.0;
/// First weights of heads, against those of other layers: the first predictions are the means.
const HEAD_SCALE: f32 = 0.1;

/// Every parameter that is learned, in the order in which a pass needs them; those of the encoder come first.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Networks {
    pub(crate) arrays: Vec<Array>,
    pub(crate) num_encoder_arrays: usize,
    pub(crate) config: NetworkConfig,
    pub(crate) dims: Dims,
}

/// Adds arrays one after the other.
struct Builder(ArrayBuilder);

impl Builder {
    fn new(seed: u64) -> Self {
        Self(ArrayBuilder::new(seed, WEIGHTS))
    }

    /// A head whose first outputs are about `bias`; several tokens share the weights of one, but not the biases.
    fn head(&mut self, name: &str, width: usize, outputs: usize, bias: Vec<f32>) {
        self.0.normal(format!("{name}.weight"), [width, outputs], HEAD_SCALE / (width as f32).sqrt());
        self.0.row(format!("{name}.bias"), bias);
    }

    fn attention(&mut self, name: &str, width: usize) {
        for part in ["query", "key", "value", "output"] {
            self.0.linear(&format!("{name}.{part}"), width, width);
        }
    }

    fn feed_forward(&mut self, name: &str, config: &NetworkConfig) {
        self.0.norm(&format!("{name}.norm"), config.width);
        self.0.linear(&format!("{name}.0"), config.width, config.feed_forward);
        self.0.linear(&format!("{name}.1"), config.feed_forward, config.width);
    }

    fn encoder(&mut self, config: &NetworkConfig, dims: Dims) {
        self.0.linear("encoder.input", dims.channels * FEATURES, config.width);
        self.0.normal("encoder.positions".to_owned(), [dims.history, config.width], POSITION_STD);
        for layer in 0..config.layers {
            self.0.norm(&format!("encoder.{layer}.norm"), config.width);
            self.attention(&format!("encoder.{layer}.attention"), config.width);
            self.feed_forward(&format!("encoder.{layer}.feed_forward"), config);
        }
        self.0.norm("encoder.norm", config.width);
    }

    fn decoder(&mut self, config: &NetworkConfig, dims: Dims, means: &Statistics) {
        let width = config.width;
        self.0.normal("decoder.queries".to_owned(), [Queries::new(config, dims).all(), width], QUERY_STD);
        for layer in 0..config.decoder_layers {
            self.0.norm(&format!("decoder.{layer}.self_norm"), width);
            self.attention(&format!("decoder.{layer}.self_attention"), width);
            self.0.norm(&format!("decoder.{layer}.cross_norm"), width);
            self.attention(&format!("decoder.{layer}.cross_attention"), width);
            self.feed_forward(&format!("decoder.{layer}.feed_forward"), config);
        }
        self.0.norm("decoder.norm", width);
        let lengths = |values: &[f32]| values.iter().map(|value| value / LENGTH_UNIT_M as f32).collect();
        let point_numbers = 3 * config.points_per_query;
        self.head("decoder.hand", width, point_numbers, lengths(&means.mean.hand_points));
        self.head("decoder.object", width, point_numbers, lengths(&means.mean.object_points));
        self.head("decoder.translation", width, 3, lengths(&means.mean.pose[..3]));
        self.head("decoder.rotation", width, POSE - 3, means.mean.pose[3..].to_vec());
        self.head("decoder.joints", width, dims.joints, means.mean.joints.clone());
        self.head("decoder.contacts", width, dims.channels, means.mean.contact_logits.clone());
    }
}

/// Tokens of the decoder: points of the hand, of the object, then one each for pose, joints and contacts.
struct Queries {
    hand: usize,
    object: usize,
}

impl Queries {
    fn new(config: &NetworkConfig, dims: Dims) -> Self {
        Self {
            hand: dims.hand_points / config.points_per_query,
            object: dims.object_points / config.points_per_query,
        }
    }

    fn all(&self) -> usize {
        self.hand + self.object + 3
    }
}

impl Networks {
    /// First parameters: weights normal with variance `1 / inputs`, biases zero but for those of the heads, which are the
    /// means of what is to be predicted.
    pub(crate) fn new(config: &NetworkConfig, dims: Dims, means: &Statistics, seed: u64) -> Self {
        let mut builder = Builder::new(seed);
        builder.encoder(config, dims);
        let num_encoder_arrays = builder.0.len();
        builder.decoder(config, dims, means);
        Self { arrays: builder.0.into_arrays(), num_encoder_arrays, config: config.clone(), dims }
    }

    /// An encoder alone, whose parameters are yet to be filled in.
    pub(crate) fn of_encoder(config: &NetworkConfig, dims: Dims) -> Self {
        let mut builder = Builder::new(0);
        builder.encoder(config, dims);
        let num_encoder_arrays = builder.0.len();
        Self { arrays: builder.0.into_arrays(), num_encoder_arrays, config: config.clone(), dims }
    }

    /// The encoder alone.
    pub(crate) fn without_decoder(&self) -> Self {
        let arrays = self.arrays[..self.num_encoder_arrays].to_vec();
        Self { arrays, config: self.config.clone(), ..*self }
    }

    /// Every parameter as a tensor on `device`, in the order of `arrays`; with gradients where the device has them.
    pub(crate) fn tensors(&self, device: &Device) -> Vec<Tensor<2>> {
        let tensor = |array: &Array| {
            let tensor = Tensor::from_data(TensorData::new(array.values.clone(), array.shape), device);
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        };
        self.arrays.iter().map(tensor).collect()
    }

    /// Z: inputs `[samples, history * channels * 4]`, normalised, to tokens `[samples * history, width]`.
    pub(crate) fn encode(&self, tensors: &[Tensor<2>], inputs: Tensor<2>) -> Tensor<2> {
        let mut pass = Pass { tensors: tensors.iter(), heads: self.config.heads };
        let [samples, _] = inputs.dims();
        let (history, width) = (self.dims.history, self.config.width);
        let frames = inputs.reshape([samples * history, self.dims.channels * FEATURES]);
        let embedded = pass.linear(frames).reshape([samples, history, width]);
        let tokens = embedded + pass.next().reshape([1, history, width]);
        let mut tokens = tokens.reshape([samples * history, width]);
        for _ in 0..self.config.layers {
            let normal = pass.norm(tokens.clone());
            tokens = tokens + pass.attention(samples, normal.clone(), normal);
            tokens = pass.feed_forward(tokens);
        }
        pass.norm(tokens)
    }

    /// Outputs `[samples, outputs]` ([`Dims::outputs`]) of Z.
    pub(crate) fn decode(&self, tensors: &[Tensor<2>], samples: usize, memory: Tensor<2>) -> Tensor<2> {
        let mut pass = Pass { tensors: tensors[self.num_encoder_arrays..].iter(), heads: self.config.heads };
        let queries = Queries::new(&self.config, self.dims);
        let (all, width) = (queries.all(), self.config.width);
        let tokens = pass.next().reshape([1, all, width]).expand([samples, all, width]);
        let mut tokens = tokens.reshape([samples * all, width]);
        for _ in 0..self.config.decoder_layers {
            let normal = pass.norm(tokens.clone());
            tokens = tokens + pass.attention(samples, normal.clone(), normal);
            let normal = pass.norm(tokens.clone());
            tokens = tokens + pass.attention(samples, normal, memory.clone());
            tokens = pass.feed_forward(tokens);
        }
        let tokens = pass.norm(tokens).reshape([samples, all, width]);
        let mut first = 0;
        let mut head = |count: usize| {
            let of_head = tokens.clone().narrow(1, first, count).reshape([samples * count, width]);
            first += count;
            of_head
        };
        let (hand, object, pose, joints, contacts) =
            (head(queries.hand), head(queries.object), head(1), head(1), head(1));
        let outputs = vec![
            pass.head(samples, hand) * LENGTH_UNIT_M,
            pass.head(samples, object) * LENGTH_UNIT_M,
            pass.head(samples, pose.clone()) * LENGTH_UNIT_M,
            pass.head(samples, pose),
            pass.head(samples, joints),
            pass.head(samples, contacts),
        ];
        Tensor::cat(outputs, 1)
    }
}

/// One way through the parameters.
struct Pass<'a> {
    tensors: std::slice::Iter<'a, Tensor<2>>,
    heads: usize,
}

impl Pass<'_> {
    fn next(&mut self) -> Tensor<2> {
        self.tensors.next().expect("a pass takes what was built").clone()
    }

    fn linear(&mut self, rows: Tensor<2>) -> Tensor<2> {
        rows.matmul(self.next()) + self.next()
    }

    /// Tokens `[samples * tokens, width]` of a head to `[samples, tokens * outputs]`.
    fn head(&mut self, samples: usize, tokens: Tensor<2>) -> Tensor<2> {
        let outputs = tokens.matmul(self.next());
        let bias = self.next();
        let [_, len] = bias.dims();
        outputs.reshape([samples, len]) + bias
    }

    fn norm(&mut self, rows: Tensor<2>) -> Tensor<2> {
        let (gain, bias) = (self.next(), self.next());
        let [_, width] = gain.dims();
        module::layer_norm(rows, gain.reshape([width]), Some(bias.reshape([width])), NORM_EPSILON)
    }

    fn feed_forward(&mut self, rows: Tensor<2>) -> Tensor<2> {
        let normal = self.norm(rows.clone());
        let hidden = activation::relu(self.linear(normal));
        rows + self.linear(hidden)
    }

    /// What `tokens` read in `memory`, both `[samples * any, width]`.
    fn attention(&mut self, samples: usize, tokens: Tensor<2>, memory: Tensor<2>) -> Tensor<2> {
        let [rows, width] = tokens.dims();
        let (heads, per_head) = (self.heads, width / self.heads);
        let split = |rows: Tensor<2>| {
            let [count, _] = rows.dims();
            rows.reshape([samples, count / samples, heads, per_head]).swap_dims(1, 2)
        };
        let queries = split(self.linear(tokens));
        let keys = split(self.linear(memory.clone()));
        let values = split(self.linear(memory));
        let scores = queries.matmul(keys.swap_dims(2, 3)) / (per_head as f64).sqrt();
        let read = activation::softmax(scores, 3).matmul(values);
        self.linear(read.swap_dims(1, 2).reshape([rows, width]))
    }
}

/// The numbers of a tensor, row by row.
pub(crate) fn values(tensor: Tensor<2>) -> Vec<f32> {
    tensor.into_data().try_into_vec().expect("networks are made of 32-bit floats")
}
