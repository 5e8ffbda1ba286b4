//! What all networks are made of: layers in the order in which their parameters are stored.

use burn_tensor::{Tensor, module};
use palpate_training::ArrayBuilder;

const NORM_EPSILON: f64 = 1e-5;
/// First weights of what comes out, against those of other layers: the first predictions are about zero.
const OUTPUT_SCALE: f32 = 0.1;

/// A layer that predicts.
pub(crate) fn output(builder: &mut ArrayBuilder, name: &str, inputs: usize, outputs: usize) {
    builder.normal(format!("{name}.weight"), [inputs, outputs], OUTPUT_SCALE / (inputs as f32).sqrt());
    builder.constant(format!("{name}.bias"), outputs, 0.0);
}

/// One way through the parameters.
pub(crate) struct Pass<'a>(std::slice::Iter<'a, Tensor<2>>);

impl<'a> Pass<'a> {
    pub(crate) fn new(tensors: &'a [Tensor<2>]) -> Self {
        Self(tensors.iter())
    }

    pub(crate) fn next(&mut self) -> Tensor<2> {
        self.0.next().expect("a pass takes what was built").clone()
    }

    pub(crate) fn linear(&mut self, rows: Tensor<2>) -> Tensor<2> {
        rows.matmul(self.next()) + self.next()
    }

    pub(crate) fn norm(&mut self, rows: Tensor<2>) -> Tensor<2> {
        let (gain, bias) = (self.next(), self.next());
        let [_, width] = gain.dims();
        module::layer_norm(rows, gain.reshape([width]), Some(bias.reshape([width])), NORM_EPSILON)
    }
}

/// The numbers of a tensor, row by row.
pub(crate) fn values(tensor: Tensor<2>) -> Vec<f32> {
    tensor.into_data().try_into_vec().expect("networks are made of 32-bit floats")
}
