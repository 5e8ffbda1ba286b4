//! The networks: their parameters as plain arrays, and the same as tensors that compute.

use burn_tensor::{Device, Tensor, TensorData, activation};
use palpate_training::{Array, ArrayBuilder};

use crate::act::Act;
use crate::gru::Gru;
use crate::pass::{Pass, output};
use crate::{CloneConfig, Head, Memory, Shape};

/// Samples that one thread computes at a time. Fixed, because the order of a sum is part of its bits.
pub(crate) const CHUNK_SAMPLES: usize = 32;

/// What noise is for: first weights.
const WEIGHTS: u64 = 1;
/// Numbers that say which step of the diffusion it is.
const STEP_DIM: usize = 64;
/// Longest period of these, steps.
const MAX_PERIOD: f64 = 10_000.0;

/// Every parameter, in the order in which a pass needs them; those of the trunk come first.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Network {
    pub(crate) arrays: Vec<Array>,
    num_trunk_arrays: usize,
    head: Head,
    /// What reads the window before the trunk's layers; nothing where frames stand side by side.
    gru: Option<Gru>,
    trunk_layers: usize,
    predicted: usize,
    action_len: usize,
    channels: [usize; 2],
    kernel: usize,
    act: Act,
    /// Of the trunk and of what is needed at work; those of the encoder of styles come after.
    num_arrays_at_work: usize,
}

impl Network {
    /// First parameters for `config` and a robot of this `shape`.
    pub(crate) fn new(config: &CloneConfig, shape: Shape) -> Self {
        let mut builder = ArrayBuilder::new(config.seed, WEIGHTS);
        let mut width = shape.input_len(&config.observation);
        let gru = match config.memory {
            Memory::Window => None,
            Memory::Recurrent => {
                let frames = config.observation.frames;
                Some(Gru { frames, frame_len: shape.frame_len(), width: config.recurrent.width })
            }
        };
        if let Some(gru) = gru {
            gru.build(&mut builder);
            width = width - gru.frames * gru.frame_len + gru.width;
        }
        for (layer, &next) in config.trunk.iter().enumerate() {
            builder.linear(&format!("trunk.{layer}"), width, next);
            width = next;
        }
        let num_trunk_arrays = builder.len();
        let (action_len, predicted) = (shape.action_len(), config.predicted);
        let act = Act::new(config, shape, width);
        match config.head {
            Head::Regression => output(&mut builder, "head", width, predicted * action_len),
            Head::Diffusion => {
                builder.linear("step.0", STEP_DIM, 4 * STEP_DIM);
                builder.linear("step.1", 4 * STEP_DIM, STEP_DIM);
                let unet = UNet { condition: width + STEP_DIM, kernel: config.diffusion.kernel };
                unet.build(&mut builder, action_len, config.diffusion.channels);
            }
            Head::Act => act.build_decoder(&mut builder),
        }
        let num_arrays_at_work = builder.len();
        if config.head == Head::Act {
            act.build_encoder(&mut builder);
        }
        Self {
            arrays: builder.into_arrays(),
            act,
            num_arrays_at_work,
            num_trunk_arrays,
            head: config.head,
            gru,
            trunk_layers: config.trunk.len(),
            predicted,
            action_len,
            channels: config.diffusion.channels,
            kernel: config.diffusion.kernel,
        }
    }

    /// Every parameter as a tensor on `device`, in the order of `arrays`; with gradients where the device has them.
    pub(crate) fn tensors(&self, device: &Device) -> Vec<Tensor<2>> {
        let tensor = |array: &Array| {
            let tensor = Tensor::from_data(TensorData::new(array.values.clone(), array.shape), device);
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        };
        self.arrays.iter().map(tensor).collect()
    }

    /// Features `[samples, width]` of observations `[samples, input_len]`, normalised.
    pub(crate) fn trunk(&self, tensors: &[Tensor<2>], inputs: Tensor<2>) -> Tensor<2> {
        let mut pass = Pass::new(&tensors[..self.num_trunk_arrays]);
        let rows = match self.gru {
            None => inputs,
            Some(gru) => gru.read(&mut pass, inputs),
        };
        (0..self.trunk_layers).fold(rows, |rows, _| activation::silu(pass.linear(rows)))
    }

    /// Chunks `[samples, predicted * action_len]`, normalised, of features.
    pub(crate) fn regress(&self, tensors: &[Tensor<2>], features: Tensor<2>) -> Tensor<2> {
        Pass::new(&tensors[self.num_trunk_arrays..]).linear(features)
    }

    /// What the U-Net predicts ([`crate::Predicts`]) of `noisy` chunks `[samples, predicted * action_len]`, which are after
    /// these `steps`, one for each sample.
    pub(crate) fn of_noisy(
        &self,
        tensors: &[Tensor<2>],
        features: Tensor<2>,
        noisy: Tensor<2>,
        steps: &[usize],
    ) -> Tensor<2> {
        let mut pass = Pass::new(&tensors[self.num_trunk_arrays..]);
        let (samples, device) = (steps.len(), features.device());
        let embedded = TensorData::new(embedding(steps), [samples, STEP_DIM]);
        let embedded = activation::silu(pass.linear(Tensor::from_data(embedded, &device)));
        // Every block is told the same.
        let condition = activation::silu(Tensor::cat(vec![features, pass.linear(embedded)], 1));
        let signal = Signal { rows: noisy.reshape([samples * self.predicted, self.action_len]), samples };
        let [outer, inner] = self.channels;
        let unet = UNet { condition: 0, kernel: self.kernel };
        let mut block = |signal: Signal, out: usize| unet.block(&mut pass, signal, out, condition.clone());
        let fine = block(signal, outer);
        let fine = block(fine, outer);
        let coarse = unet.halve(&mut pass, fine);
        let mut block = |signal: Signal, out: usize| unet.block(&mut pass, signal, out, condition.clone());
        let coarse = block(coarse, inner);
        let skipped = block(coarse, inner);
        let middle = block(skipped.clone(), inner);
        let middle = block(middle, inner);
        let joined = Signal { rows: Tensor::cat(vec![middle.rows, skipped.rows], 1), samples };
        let joined = block(joined, outer);
        let joined = block(joined, outer);
        let fine = unet.double(&mut pass, joined);
        let last = unet.convolve(&mut pass, &fine);
        let last = activation::silu(pass.norm(last));
        pass.linear(last).reshape([samples, self.predicted * self.action_len])
    }

    /// Chunks `[samples, predicted * action_len]`, normalised, of features, of the inputs that these were made of, and of a
    /// style each.
    pub(crate) fn chunks_in_style(
        &self,
        tensors: &[Tensor<2>],
        features: Tensor<2>,
        inputs: Tensor<2>,
        style: Tensor<2>,
    ) -> Tensor<2> {
        let mut pass = Pass::new(&tensors[self.num_trunk_arrays..self.num_arrays_at_work]);
        self.act.decode(&mut pass, features, inputs, style)
    }

    /// Mean and logarithm of the variance of the style, `[samples, style]` each, of normalised chunks.
    pub(crate) fn styles(
        &self,
        tensors: &[Tensor<2>],
        features: Tensor<2>,
        chunks: Tensor<2>,
    ) -> [Tensor<2>; 2] {
        self.act.encode(&mut Pass::new(&tensors[self.num_arrays_at_work..]), features, chunks)
    }

    /// The style of `samples` at work: the mean of its prior.
    pub(crate) fn usual_style(&self, samples: usize, device: &Device) -> Tensor<2> {
        Tensor::zeros([samples, self.act.style], device)
    }

    /// Numbers of a style.
    pub(crate) fn style_len(&self) -> usize {
        self.act.style
    }

    /// What this network predicts with.
    pub(crate) fn head(&self) -> Head {
        self.head
    }

    /// Numbers of a chunk.
    pub(crate) fn chunk_len(&self) -> usize {
        self.predicted * self.action_len
    }
}

/// Sines and cosines of each step, `[steps, STEP_DIM]` (Vaswani et al. 2017, section 3.5).
fn embedding(steps: &[usize]) -> Vec<f32> {
    let half = STEP_DIM / 2;
    let angle = |step: usize, idx: usize| step as f64 * MAX_PERIOD.powf(-(idx as f64) / (half - 1) as f64);
    let of = |&step: &usize| (0..half).flat_map(move |idx| [angle(step, idx).sin(), angle(step, idx).cos()]);
    steps.iter().flat_map(of).map(|value| value as f32).collect()
}

/// A signal over the steps of a chunk: rows `[samples * steps, channels]`.
#[derive(Clone)]
struct Signal {
    rows: Tensor<2>,
    samples: usize,
}

impl Signal {
    fn steps(&self) -> usize {
        self.rows.dims()[0] / self.samples
    }
}

/// A one-dimensional U-Net of two levels whose blocks are told the condition by FiLM (Perez et al. 2018), as in
/// Diffusion Policy; but each step is normalised by itself, where that normalises groups of channels over all steps.
struct UNet {
    /// Numbers of the condition.
    condition: usize,
    kernel: usize,
}

impl UNet {
    fn build(&self, builder: &mut ArrayBuilder, action_len: usize, [outer, inner]: [usize; 2]) {
        self.build_block(builder, "fine.0", action_len, outer);
        self.build_block(builder, "fine.1", outer, outer);
        builder.linear("halve", 2 * outer, outer);
        self.build_block(builder, "coarse.0", outer, inner);
        self.build_block(builder, "coarse.1", inner, inner);
        self.build_block(builder, "middle.0", inner, inner);
        self.build_block(builder, "middle.1", inner, inner);
        self.build_block(builder, "joined.0", 2 * inner, outer);
        self.build_block(builder, "joined.1", outer, outer);
        builder.linear("double", outer, 2 * outer);
        builder.linear("last", self.kernel * outer, outer);
        builder.norm("last.norm", outer);
        output(builder, "output", outer, action_len);
    }

    fn build_block(&self, builder: &mut ArrayBuilder, name: &str, inputs: usize, outputs: usize) {
        builder.linear(&format!("{name}.0"), self.kernel * inputs, outputs);
        builder.norm(&format!("{name}.0.norm"), outputs);
        builder.linear(&format!("{name}.film"), self.condition, 2 * outputs);
        builder.linear(&format!("{name}.1"), self.kernel * outputs, outputs);
        builder.norm(&format!("{name}.1.norm"), outputs);
        if inputs != outputs {
            builder.linear(&format!("{name}.residual"), inputs, outputs);
        }
    }

    fn block(&self, pass: &mut Pass<'_>, signal: Signal, outputs: usize, condition: Tensor<2>) -> Signal {
        let (samples, steps) = (signal.samples, signal.steps());
        let [_, inputs] = signal.rows.dims();
        let rows = self.convolve(pass, &signal);
        let rows = activation::silu(pass.norm(rows));
        let film = pass.linear(condition);
        let part = |first| film.clone().narrow(1, first, outputs).reshape([samples, 1, outputs]);
        let rows = rows.reshape([samples, steps, outputs]);
        let rows = rows.clone() + rows * part(0) + part(outputs);
        let told = Signal { rows: rows.reshape([samples * steps, outputs]), samples };
        let rows = self.convolve(pass, &told);
        let rows = activation::silu(pass.norm(rows));
        let residual = if inputs == outputs { signal.rows } else { pass.linear(signal.rows) };
        Signal { rows: rows + residual, samples }
    }

    /// A convolution with zeros around: the steps that each output sees, side by side, times one matrix.
    fn convolve(&self, pass: &mut Pass<'_>, signal: &Signal) -> Tensor<2> {
        let (samples, steps) = (signal.samples, signal.steps());
        let [_, channels] = signal.rows.dims();
        let around = self.kernel / 2;
        let zeros = || Tensor::<3>::zeros([samples, around, channels], &signal.rows.device());
        let inside = signal.rows.clone().reshape([samples, steps, channels]);
        let padded = if around == 0 { inside } else { Tensor::cat(vec![zeros(), inside, zeros()], 1) };
        let taps = (0..self.kernel).map(|tap| padded.clone().narrow(1, tap, steps)).collect();
        pass.linear(Tensor::cat(taps, 2).reshape([samples * steps, self.kernel * channels]))
    }

    /// Every two steps become one.
    fn halve(&self, pass: &mut Pass<'_>, signal: Signal) -> Signal {
        let [rows, channels] = signal.rows.dims();
        Signal { rows: pass.linear(signal.rows.reshape([rows / 2, 2 * channels])), samples: signal.samples }
    }

    /// Every step becomes two.
    fn double(&self, pass: &mut Pass<'_>, signal: Signal) -> Signal {
        let doubled = pass.linear(signal.rows);
        let [rows, channels] = doubled.dims();
        Signal { rows: doubled.reshape([2 * rows, channels / 2]), samples: signal.samples }
    }
}
