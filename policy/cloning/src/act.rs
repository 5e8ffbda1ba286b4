//! Action chunking with Transformers (Zhao et al. 2023): a conditional variational autoencoder whose decoder predicts all
//! steps of a chunk at once.
//!
//! The decoder has a learned query for each step, which reads one token of the style, one of the trunk and one of each frame
//! of the window. The style is what tells one right answer from another: while it learns, an encoder reads it off the chunk
//! that the expert chose; at work it is zero, the mean of its prior. Transformers normalise before each part (pre-norm).

use burn_tensor::{Tensor, activation};
use palpate_training::ArrayBuilder;

use crate::pass::{Pass, output};
use crate::{CloneConfig, Shape};

/// First spread of what tells frames, and steps of a chunk, apart.
const POSITION_STD: f32 = 0.1;
const QUERY_STD: f32 = 1.0;

/// Sizes of both Transformers and of what they read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Act {
    width: usize,
    heads: usize,
    feed_forward: usize,
    layers: usize,
    style_layers: usize,
    /// Numbers of the style.
    pub(crate) style: usize,
    /// Numbers of the trunk's features.
    features: usize,
    frames: usize,
    frame_len: usize,
    predicted: usize,
    action_len: usize,
}

impl Act {
    /// As `config` says, on a trunk that makes `features` numbers.
    pub(crate) fn new(config: &CloneConfig, shape: Shape, features: usize) -> Self {
        let act = config.act();
        Self {
            width: act.width,
            heads: act.heads,
            feed_forward: act.feed_forward,
            layers: act.layers,
            style_layers: act.style_layers,
            style: act.style,
            features,
            frames: config.observation.frames,
            frame_len: shape.frame_len(),
            predicted: config.predicted,
            action_len: shape.action_len(),
        }
    }

    /// What predicts chunks: all that is needed at work.
    pub(crate) fn build_decoder(&self, builder: &mut ArrayBuilder) {
        let Self { width, .. } = *self;
        builder.linear("decoder.style", self.style, width);
        builder.linear("decoder.trunk", self.features, width);
        builder.linear("decoder.frame", self.frame_len, width);
        builder.normal("decoder.positions".to_owned(), [self.frames, width], POSITION_STD);
        builder.normal("decoder.queries".to_owned(), [self.predicted, width], QUERY_STD);
        for layer in 0..self.layers {
            let name = |part: &str| format!("decoder.{layer}.{part}");
            builder.norm(&name("self_norm"), width);
            self.build_attention(builder, &name("self_attention"));
            builder.norm(&name("cross_norm"), width);
            self.build_attention(builder, &name("cross_attention"));
            self.build_feed_forward(builder, &name("feed_forward"));
        }
        builder.norm("decoder.norm", width);
        output(builder, "decoder.action", width, self.action_len);
    }

    /// What reads the style off a chunk.
    pub(crate) fn build_encoder(&self, builder: &mut ArrayBuilder) {
        let Self { width, .. } = *self;
        builder.normal("style.summary".to_owned(), [1, width], QUERY_STD);
        builder.linear("style.trunk", self.features, width);
        builder.linear("style.action", self.action_len, width);
        builder.normal("style.positions".to_owned(), [self.predicted, width], POSITION_STD);
        for layer in 0..self.style_layers {
            builder.norm(&format!("style.{layer}.norm"), width);
            self.build_attention(builder, &format!("style.{layer}.attention"));
            self.build_feed_forward(builder, &format!("style.{layer}.feed_forward"));
        }
        builder.norm("style.norm", width);
        output(builder, "style.mean", width, self.style);
        output(builder, "style.log_variance", width, self.style);
    }

    fn build_attention(&self, builder: &mut ArrayBuilder, name: &str) {
        for part in ["query", "key", "value", "output"] {
            builder.linear(&format!("{name}.{part}"), self.width, self.width);
        }
    }

    fn build_feed_forward(&self, builder: &mut ArrayBuilder, name: &str) {
        builder.norm(&format!("{name}.norm"), self.width);
        builder.linear(&format!("{name}.0"), self.width, self.feed_forward);
        builder.linear(&format!("{name}.1"), self.feed_forward, self.width);
    }

    /// Chunks `[samples, predicted * action_len]` of features `[samples, features]`, of the observations that these were made
    /// of, `[samples, frames * frame_len + rest]`, and of a style each, `[samples, style]`.
    pub(crate) fn decode(
        &self,
        pass: &mut Pass<'_>,
        features: Tensor<2>,
        observations: Tensor<2>,
        style: Tensor<2>,
    ) -> Tensor<2> {
        let Self { width, frames, frame_len, predicted, .. } = *self;
        let [samples, _] = features.dims();
        let token = |row: Tensor<2>| row.reshape([samples, 1, width]);
        let (style, trunk) = (token(pass.linear(style)), token(pass.linear(features)));
        let window = observations.narrow(1, 0, frames * frame_len).reshape([samples * frames, frame_len]);
        let window = pass.linear(window).reshape([samples, frames, width]);
        let window = window + pass.next().reshape([1, frames, width]);
        let memory = Tensor::cat(vec![style, trunk, window], 1).reshape([samples * (frames + 2), width]);
        let queries = pass.next().reshape([1, predicted, width]).expand([samples, predicted, width]);
        let mut tokens = queries.reshape([samples * predicted, width]);
        for _ in 0..self.layers {
            let normal = pass.norm(tokens.clone());
            tokens = tokens + self.attention(pass, samples, normal.clone(), normal);
            let normal = pass.norm(tokens.clone());
            tokens = tokens + self.attention(pass, samples, normal, memory.clone());
            tokens = feed_forward(pass, tokens);
        }
        let tokens = pass.norm(tokens);
        pass.linear(tokens).reshape([samples, predicted * self.action_len])
    }

    /// Mean and logarithm of the variance of the style, `[samples, style]` each, of chunks `[samples, predicted * action_len]`
    /// that the expert chose where features were `[samples, features]`.
    pub(crate) fn encode(
        &self,
        pass: &mut Pass<'_>,
        features: Tensor<2>,
        chunks: Tensor<2>,
    ) -> [Tensor<2>; 2] {
        let Self { width, predicted, .. } = *self;
        let [samples, _] = features.dims();
        let summary = pass.next().reshape([1, 1, width]).expand([samples, 1, width]);
        let trunk = pass.linear(features).reshape([samples, 1, width]);
        let steps = pass.linear(chunks.reshape([samples * predicted, self.action_len]));
        let steps = steps.reshape([samples, predicted, width]) + pass.next().reshape([1, predicted, width]);
        let count = predicted + 2;
        let mut tokens = Tensor::cat(vec![summary, trunk, steps], 1).reshape([samples * count, width]);
        for _ in 0..self.style_layers {
            let normal = pass.norm(tokens.clone());
            tokens = tokens + self.attention(pass, samples, normal.clone(), normal);
            tokens = feed_forward(pass, tokens);
        }
        let summary = tokens.reshape([samples, count, width]).narrow(1, 0, 1).reshape([samples, width]);
        let summary = pass.norm(summary);
        [pass.linear(summary.clone()), pass.linear(summary)]
    }

    /// What `tokens` read in `memory`, both `[samples * any, width]`.
    fn attention(
        &self,
        pass: &mut Pass<'_>,
        samples: usize,
        tokens: Tensor<2>,
        memory: Tensor<2>,
    ) -> Tensor<2> {
        let [rows, width] = tokens.dims();
        let (heads, per_head) = (self.heads, width / self.heads);
        let split = |rows: Tensor<2>| {
            let [count, _] = rows.dims();
            rows.reshape([samples, count / samples, heads, per_head]).swap_dims(1, 2)
        };
        let queries = split(pass.linear(tokens));
        let keys = split(pass.linear(memory.clone()));
        let values = split(pass.linear(memory));
        let scores = queries.matmul(keys.swap_dims(2, 3)) / (per_head as f64).sqrt();
        let read = activation::softmax(scores, 3).matmul(values);
        pass.linear(read.swap_dims(1, 2).reshape([rows, width]))
    }
}

fn feed_forward(pass: &mut Pass<'_>, rows: Tensor<2>) -> Tensor<2> {
    let normal = pass.norm(rows.clone());
    let hidden = activation::relu(pass.linear(normal));
    rows + pass.linear(hidden)
}

/// Kullback-Leibler divergence of styles with these means and logarithms of variances from the prior, the standard normal
/// distribution; summed over all samples (Kingma and Welling 2014, appendix B).
pub(crate) fn divergence(mean: Tensor<2>, log_variance: Tensor<2>) -> Tensor<1> {
    (mean.square() + log_variance.clone().exp() - log_variance - 1.0).sum() * 0.5
}
