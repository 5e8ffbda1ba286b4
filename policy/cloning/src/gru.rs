//! A gated recurrent unit (Cho et al. 2014) over the frames of a window, with the reset gate on the product with the
//! state, as in PyTorch.

use burn_tensor::{Tensor, activation};
use palpate_training::ArrayBuilder;

use crate::pass::Pass;

/// First bias of the gate that keeps the state: at first a state lasts some frames, and gradients reach the oldest ones
/// (Jozefowicz et al. 2015).
const KEEP_BIAS: f32 = 1.0;

/// Sizes of a unit and of what it reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gru {
    /// Frames of a window.
    pub(crate) frames: usize,
    /// Numbers of a frame.
    pub(crate) frame_len: usize,
    /// Numbers of the state.
    pub(crate) width: usize,
}

impl Gru {
    /// Columns of the arrays are those of the reset gate, of the gate that keeps the state, and of the candidate.
    pub(crate) fn build(self, builder: &mut ArrayBuilder) {
        let Self { frame_len, width, .. } = self;
        builder.normal(
            "gru.frame.weight".to_owned(),
            [frame_len, 3 * width],
            (frame_len as f32).sqrt().recip(),
        );
        let bias = |column: usize| if column / width == 1 { KEEP_BIAS } else { 0.0 };
        builder.row("gru.frame.bias".to_owned(), (0..3 * width).map(bias).collect());
        builder.linear("gru.state", width, 3 * width);
    }

    /// The last state, and what is not part of a frame, `[samples, width + rest]`, of observations
    /// `[samples, frames * frame_len + rest]`, which have the newest frame first.
    pub(crate) fn read(self, pass: &mut Pass<'_>, observations: Tensor<2>) -> Tensor<2> {
        let Self { frames, frame_len, width } = self;
        let [samples, len] = observations.dims();
        let window_len = frames * frame_len;
        let rest = observations.clone().narrow(1, window_len, len - window_len);
        let window = observations.narrow(1, 0, window_len).reshape([samples * frames, frame_len]);
        let of_frames = pass.linear(window).reshape([samples, frames * 3 * width]);
        let (weight, bias) = (pass.next(), pass.next());
        let mut state = Tensor::<2>::zeros([samples, width], &rest.device());
        for frame in (0..frames).rev() {
            let of_frame = of_frames.clone().narrow(1, frame * 3 * width, 3 * width);
            let of_state = state.clone().matmul(weight.clone()) + bias.clone();
            let part = |rows: &Tensor<2>, idx: usize| rows.clone().narrow(1, idx * width, width);
            let gate = |idx| activation::sigmoid(part(&of_frame, idx) + part(&of_state, idx));
            let candidate = (part(&of_frame, 2) + gate(0) * part(&of_state, 2)).tanh();
            state = candidate.clone() + gate(1) * (state - candidate);
        }
        Tensor::cat(vec![state, rest], 1)
    }
}

#[cfg(test)]
mod tests {
    use burn_tensor::{Device, TensorData};

    use super::*;
    use crate::pass::values;

    /// The last state by the formulas of PyTorch's documentation, one number after the other.
    fn by_hand(gru: Gru, arrays: &[Vec<f64>], observation: &[f64]) -> Vec<f64> {
        let (width, columns) = (gru.width, 3 * gru.width);
        let product = |row: &[f64], weight: &[f64], bias: &[f64], column: usize| {
            let terms = row.iter().enumerate().map(|(idx, value)| value * weight[idx * columns + column]);
            bias[column] + terms.sum::<f64>()
        };
        let sigmoid = |value: f64| 1.0 / (1.0 + (-value).exp());
        let mut state = vec![0.0; width];
        for frame in (0..gru.frames).rev() {
            let frame = &observation[frame * gru.frame_len..][..gru.frame_len];
            let of_frame = |column| product(frame, &arrays[0], &arrays[1], column);
            let of_state = |column| product(&state, &arrays[2], &arrays[3], column);
            state = (0..width)
                .map(|idx| {
                    let reset = sigmoid(of_frame(idx) + of_state(idx));
                    let keep = sigmoid(of_frame(width + idx) + of_state(width + idx));
                    let candidate = (of_frame(2 * width + idx) + reset * of_state(2 * width + idx)).tanh();
                    (1.0 - keep) * candidate + keep * state[idx]
                })
                .collect();
        }
        state
    }

    #[test]
    fn the_last_state_is_that_of_the_formulas_and_the_rest_stays() {
        let gru = Gru { frames: 4, frame_len: 3, width: 5 };
        let mut builder = ArrayBuilder::new(3, 1);
        gru.build(&mut builder);
        let mut arrays = builder.into_arrays();
        // Biases that are not zero, so that each one counts.
        for array in arrays.iter_mut().filter(|array| array.name.ends_with("bias")) {
            array.values.iter_mut().enumerate().for_each(|(idx, value)| *value += 0.1 * (idx as f32).sin());
        }
        let device = Device::flex();
        let tensors: Vec<Tensor<2>> = arrays
            .iter()
            .map(|array| Tensor::from_data(TensorData::new(array.values.clone(), array.shape), &device))
            .collect();
        let rows: [Vec<f32>; 2] =
            [1.0, 2.0].map(|scale| (0..14).map(|idx| (scale * idx as f32).cos()).collect());
        let observations = Tensor::from_data(TensorData::new(rows.concat(), [2, 14]), &device);
        let found = values(gru.read(&mut Pass::new(&tensors), observations));
        let arrays: Vec<Vec<f64>> =
            arrays.iter().map(|array| array.values.iter().copied().map(f64::from).collect()).collect();
        for (row, found) in rows.iter().zip(found.chunks_exact(7)) {
            let observation: Vec<f64> = row.iter().copied().map(f64::from).collect();
            for (expected, &found) in by_hand(gru, &arrays, &observation).iter().zip(found) {
                assert!((expected - f64::from(found)).abs() < 1e-5, "{found}, by hand {expected}");
            }
            assert_eq!(found[5..], row[12..]);
        }
    }
}
