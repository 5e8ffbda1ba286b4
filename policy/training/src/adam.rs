//! Adam (Kingma and Ba 2015) on plain arrays, with decay of weights beside it (AdamW, Loshchilov and Hutter 2019).

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// The optimiser's memory of a list of arrays.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// Steps taken.
    pub steps: u64,
    /// Running means of gradients, one array for each of the parameters.
    pub first: Vec<Vec<f32>>,
    /// Running means of squared gradients.
    pub second: Vec<Vec<f32>>,
}

/// The numbers of one step of Adam, the same for every parameter: with `m` and `v` the running means, the step is
/// `value * kept - rate * m / (v.sqrt() + epsilon)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamRates {
    /// Step size, the bias corrections of both means in it.
    pub rate: f32,
    /// What keeps the quotient finite, with the bias correction of the second mean in it.
    pub epsilon: f32,
    /// What decay leaves of a parameter.
    pub kept: f32,
    /// What a step leaves of the running mean of gradients.
    pub beta_1: f32,
    /// The same of squared gradients.
    pub beta_2: f32,
}

impl AdamRates {
    /// Those of step number `step`, from 1.
    pub fn new(step: u64, learning_rate: f64, weight_decay: f64) -> Self {
        let steps = step as f64;
        let second_correction = (1.0 - BETA_2.powf(steps)).sqrt();
        Self {
            rate: (learning_rate * second_correction / (1.0 - BETA_1.powf(steps))) as f32,
            epsilon: (EPSILON * second_correction) as f32,
            kept: (1.0 - learning_rate * weight_decay) as f32,
            beta_1: BETA_1 as f32,
            beta_2: BETA_2 as f32,
        }
    }
}

impl Adam {
    /// An optimiser for arrays of these lengths.
    pub fn new(lengths: impl Iterator<Item = usize>) -> Self {
        let zeros: Vec<Vec<f32>> = lengths.map(|len| vec![0.0; len]).collect();
        Self { steps: 0, first: zeros.clone(), second: zeros }
    }

    /// Moves `parameters` against `gradients`, both as long as the arrays this was made for, after shrinking each of them by
    /// `learning_rate * weight_decay` of itself.
    pub fn step<'a>(
        &mut self,
        parameters: impl Iterator<Item = &'a mut Vec<f32>>,
        gradients: &[Vec<f32>],
        learning_rate: f64,
        weight_decay: f64,
    ) {
        self.steps += 1;
        let AdamRates { rate, epsilon, kept, beta_1, beta_2 } =
            AdamRates::new(self.steps, learning_rate, weight_decay);
        let memory = self.first.iter_mut().zip(&mut self.second);
        for ((values, gradient), (first, second)) in parameters.zip(gradients).zip(memory) {
            for (((value, &slope), first), second) in values.iter_mut().zip(gradient).zip(first).zip(second) {
                *first = beta_1 * *first + (1.0 - beta_1) * slope;
                *second = beta_2 * *second + (1.0 - beta_2) * slope * slope;
                *value = *value * kept - rate * *first / (second.sqrt() + epsilon);
            }
        }
    }
}

/// Adds the gradients of one `part` of a batch to `total`; both have arrays of the same lengths.
pub fn add_gradients(total: &mut [Vec<f32>], part: &[Vec<f32>]) {
    // Array by array, because the compiler makes no vector instructions of a loop over all of them in one.
    for (total, part) in total.iter_mut().zip(part) {
        total.iter_mut().zip(part).for_each(|(total, part)| *total += part);
    }
}

/// Scales `gradients` down to a norm of at most `max_norm`, over all arrays; gives the norm before.
pub fn clip_norm(gradients: &mut [Vec<f32>], max_norm: f64) -> f64 {
    let norm = gradients.iter().flatten().map(|&slope| f64::from(slope).powi(2)).sum::<f64>().sqrt();
    if norm > max_norm {
        let scale = (max_norm / norm) as f32;
        for array in gradients {
            array.iter_mut().for_each(|slope| *slope *= scale);
        }
    }
    norm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_steps_worked_by_hand() {
        let mut adam = Adam::new([1].into_iter());
        let mut parameters = [vec![1.0_f32]];
        // The first step has the size of the rate, whatever the slope.
        adam.step(parameters.iter_mut(), &[vec![40.0]], 0.1, 0.0);
        assert!((parameters[0][0] - 0.9).abs() < 1e-6);
        // m = 0.1 * (0.9 * 40 - 20) = 1.6, corrected 1.6 / 0.19; v = 1e-3 * (0.999 * 1600 + 400), corrected / 1.999e-3.
        adam.step(parameters.iter_mut(), &[vec![-20.0]], 0.1, 0.0);
        let expected = 0.9 - 0.1 * (1.6 / 0.19) / (1.9984_f64 / 1.999e-3).sqrt();
        assert!((f64::from(parameters[0][0]) - expected).abs() < 1e-6, "{parameters:?}");
    }

    #[test]
    fn decay_shrinks_values_whatever_the_slope() {
        let mut adam = Adam::new([2].into_iter());
        let mut parameters = [vec![1.0_f32, -3.0]];
        adam.step(parameters.iter_mut(), &[vec![0.0, 0.0]], 0.1, 0.5);
        assert_eq!(parameters, [vec![0.95, -2.85]]);
    }

    #[test]
    fn gradients_of_parts_are_added_array_by_array() {
        let mut total = [vec![1.0], vec![2.0, 3.0]];
        add_gradients(&mut total, &[vec![0.5], vec![-2.0, 1.0]]);
        assert_eq!(total, [vec![1.5], vec![0.0, 4.0]]);
    }

    #[test]
    fn gradients_longer_than_allowed_keep_their_direction() {
        let mut gradients = [vec![3.0], vec![0.0, 4.0]];
        assert_eq!(clip_norm(&mut gradients, 10.0), 5.0);
        assert_eq!(gradients, [vec![3.0], vec![0.0, 4.0]]);
        assert_eq!(clip_norm(&mut gradients, 1.0), 5.0);
        assert_eq!(gradients, [vec![0.6], vec![0.0, 0.8]]);
    }
}
