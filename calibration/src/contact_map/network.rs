//! The network of one stream.

/// A linear layer beside a hidden one of tanh units: `l . x + o . tanh(W x + b) + c`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Network {
    num_inputs: usize,
    num_hidden: usize,
    /// `W` (`[unit * num_inputs + input]`), `b`, `o`, `l`, `c`, in this order.
    pub(crate) weights: Vec<f64>,
}

/// The parts of a network's weights, or of their gradient.
struct Parts<'a> {
    inner: &'a [f64],
    inner_offsets: &'a [f64],
    outer: &'a [f64],
    linear: &'a [f64],
    offset: f64,
}

impl Network {
    /// A network of these weights; none where there are more or fewer than its shape has.
    pub(crate) fn new(num_inputs: usize, num_hidden: usize, weights: Vec<f64>) -> Option<Self> {
        (weights.len() == Self::num_weights(num_inputs, num_hidden)).then_some(Self {
            num_inputs,
            num_hidden,
            weights,
        })
    }

    /// Weights of a network of this shape.
    pub(crate) fn num_weights(num_inputs: usize, num_hidden: usize) -> usize {
        num_hidden * (num_inputs + 2) + num_inputs + 1
    }

    /// Units of the hidden layer.
    pub(crate) fn num_hidden(&self) -> usize {
        self.num_hidden
    }

    /// Numbers of an input.
    pub(crate) fn num_inputs(&self) -> usize {
        self.num_inputs
    }

    fn parts(&self) -> Parts<'_> {
        let (inner, rest) = self.weights.split_at(self.num_hidden * self.num_inputs);
        let (inner_offsets, rest) = rest.split_at(self.num_hidden);
        let (outer, rest) = rest.split_at(self.num_hidden);
        let (linear, offset) = rest.split_at(self.num_inputs);
        Parts { inner, inner_offsets, outer, linear, offset: offset[0] }
    }

    /// Logarithm of the odds that `input` is contact.
    pub(crate) fn logit(&self, input: &[f64]) -> f64 {
        let parts = self.parts();
        let units = parts.inner.chunks_exact(self.num_inputs).zip(parts.inner_offsets).zip(parts.outer);
        let hidden: f64 = units.map(|((row, offset), outer)| outer * (dot(row, input) + offset).tanh()).sum();
        hidden + dot(parts.linear, input) + parts.offset
    }

    /// Adds the gradient of a loss to `gradient`, of which `slope` is the derivative with respect to the logit of `input`.
    pub(crate) fn add_gradient(&self, input: &[f64], slope: f64, gradient: &mut [f64]) {
        let parts = self.parts();
        let (inner, rest) = gradient.split_at_mut(self.num_hidden * self.num_inputs);
        let (inner_offsets, rest) = rest.split_at_mut(self.num_hidden);
        let (outer, rest) = rest.split_at_mut(self.num_hidden);
        let (linear, offset) = rest.split_at_mut(self.num_inputs);
        for unit in 0..self.num_hidden {
            let row = unit * self.num_inputs..(unit + 1) * self.num_inputs;
            let value = (dot(&parts.inner[row.clone()], input) + parts.inner_offsets[unit]).tanh();
            outer[unit] += slope * value;
            let slope = slope * parts.outer[unit] * (1.0 - value * value);
            inner_offsets[unit] += slope;
            add_scaled(&mut inner[row], slope, input);
        }
        add_scaled(linear, slope, input);
        offset[0] += slope;
    }
}

fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

fn add_scaled(sum: &mut [f64], factor: f64, values: &[f64]) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += factor * value;
    }
}

/// Logistic loss of a logit, `ln(1 + exp(-z))` of contact and `ln(1 + exp(z))` of none, and its derivative.
pub(crate) fn logistic_loss(logit: f64, is_contact: bool) -> (f64, f64) {
    let wrong = if is_contact { -logit } else { logit };
    // Neither exponential overflows.
    let loss = wrong.max(0.0) + (-wrong.abs()).exp().ln_1p();
    let share = 1.0 / (1.0 + (-wrong).exp());
    (loss, if is_contact { -share } else { share })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradient_is_that_of_finite_differences() {
        let (num_inputs, num_hidden) = (3, 4);
        let num_weights = Network::num_weights(num_inputs, num_hidden);
        let weights = (0..num_weights).map(|idx| (1.7 * idx as f64).sin()).collect();
        let network = Network::new(num_inputs, num_hidden, weights).expect("as many as the shape has");
        let input = [0.4, -1.3, 2.1];
        for is_contact in [true, false] {
            let slope = logistic_loss(network.logit(&input), is_contact).1;
            let mut gradient = vec![0.0; num_weights];
            network.add_gradient(&input, slope, &mut gradient);
            for (idx, slope) in gradient.iter().enumerate() {
                let loss_at = |step: f64| {
                    let mut moved = network.clone();
                    moved.weights[idx] += step;
                    logistic_loss(moved.logit(&input), is_contact).0
                };
                let expected = (loss_at(1e-5) - loss_at(-1e-5)) / 2e-5;
                assert!((slope - expected).abs() < 1e-8, "{idx}: {slope} {expected}");
            }
        }
    }

    #[test]
    fn loss_of_certain_answers_is_finite() {
        assert_eq!(logistic_loss(800.0, true), (0.0, 0.0));
        assert_eq!(logistic_loss(800.0, false), (800.0, 1.0));
        assert_eq!(logistic_loss(-800.0, true), (800.0, -1.0));
    }

    #[test]
    fn weights_of_another_shape_are_refused() {
        assert_eq!(Network::new(3, 4, vec![0.0; 7]), None);
    }
}
