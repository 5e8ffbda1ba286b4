//! What is known of samples before anything is learned.

use rayon::prelude::*;

use crate::sample::{FEATURES, POSE};
use crate::{Dataset, Dims, EncoderError, InputsConfig, Prediction, Sample};

/// Samples that statistics are made of at most, evenly spread over all.
const MOST_SAMPLES: usize = 2048;
/// Taxels that move less than this in the hand's frame, m, are shifted only: dividing by their spread would amplify rounding.
const MIN_STD_M: f64 = 1e-4;
/// Shares of time that a channel is active at least and at most believed to be, so that logits are finite.
const MIN_SHARE: f64 = 1e-4;

/// Means over samples.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Statistics {
    pub(crate) scaling: Scaling,
    /// Means; those of points one by one.
    pub(crate) mean: Prediction,
    /// Points of the objects of many samples.
    cloud: Vec<f32>,
}

/// Brings places of taxels to mean zero and variance one.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scaling {
    /// `[channels, 3]`, m.
    pub(crate) mean: Vec<f64>,
    /// What differences are multiplied with, `[channels, 3]`, per m.
    pub(crate) factor: Vec<f64>,
}

impl Scaling {
    /// `input`, `[any, channels, 4]`, as the network wants it; what `seen` leaves out is zero.
    pub(crate) fn apply(&self, input: &[f32], seen: &InputsConfig) -> Vec<f32> {
        let channels = self.mean.len() / 3;
        let mut scaled = Vec::with_capacity(input.len());
        for frame in input.chunks_exact(channels * FEATURES) {
            for (channel, numbers) in frame.as_chunks::<FEATURES>().0.iter().enumerate() {
                let [place @ .., active] = numbers;
                for (axis, &value) in place.iter().enumerate() {
                    let at = 3 * channel + axis;
                    let value = (f64::from(value) - self.mean[at]) * self.factor[at];
                    scaled.push(if seen.positions { value as f32 } else { 0.0 });
                }
                scaled.push(if seen.touch { *active } else { 0.0 });
            }
        }
        scaled
    }
}

/// Sums of rows of the same length.
#[derive(Default)]
struct Sums {
    count: f64,
    values: Vec<f64>,
    squares: Vec<f64>,
}

impl Sums {
    fn add(&mut self, row: &[f32]) {
        self.values.resize(row.len(), 0.0);
        self.squares.resize(row.len(), 0.0);
        self.count += 1.0;
        for ((sum, squares), &value) in self.values.iter_mut().zip(&mut self.squares).zip(row) {
            *sum += f64::from(value);
            *squares += f64::from(value).powi(2);
        }
    }

    fn mean(&self, len: usize) -> Vec<f64> {
        if self.count == 0.0 {
            vec![0.0; len]
        } else {
            self.values.iter().map(|sum| sum / self.count).collect()
        }
    }
}

impl Statistics {
    /// Of samples evenly spread over `data`, in their order.
    ///
    /// # Errors
    /// No samples, or some that do not have `dims`.
    pub(crate) fn of<D: Dataset + ?Sized>(data: &D, dims: Dims) -> Result<Self, EncoderError> {
        if data.is_empty() {
            return Err(EncoderError::Shape("there are none to learn from".to_owned()));
        }
        let stride = data.len().div_ceil(MOST_SAMPLES);
        let numbers: Vec<usize> = (0..data.len()).step_by(stride).collect();
        let check = |&idx: &usize| -> Result<Sample, EncoderError> {
            let sample = data.sample(idx);
            sample.check(idx, &dims)?;
            Ok(sample)
        };
        let samples: Vec<Sample> = numbers.par_iter().map(check).collect::<Result<_, _>>()?;

        let [mut places, mut hand, mut object, mut translation, mut joints, mut contacts] =
            std::array::from_fn(|_| Sums::default());
        let mut quaternions = [[0.0; 4]; 4];
        for sample in &samples {
            let newest = &sample.input[sample.input.len() - dims.channels * FEATURES..];
            let of_taxel = |numbers: &[f32; FEATURES]| [numbers[0], numbers[1], numbers[2]];
            places.add(&newest.as_chunks().0.iter().flat_map(of_taxel).collect::<Vec<_>>());
            hand.add(&sample.hand_points);
            joints.add(&sample.joints);
            contacts.add(&sample.contacts);
            if sample.in_contact() {
                object.add(&sample.object_points);
                translation.add(&sample.pose[..3]);
                let quaternion = &sample.pose[3..];
                for (row, left) in quaternions.iter_mut().zip(quaternion) {
                    row.iter_mut().zip(quaternion).for_each(|(sum, right)| *sum += f64::from(left * right));
                }
            }
        }
        let mean = places.mean(3 * dims.channels);
        let std = |(squares, mean): (&f64, &f64)| (squares / places.count - mean * mean).max(0.0).sqrt();
        let factor = places.squares.iter().zip(&mean).map(std);
        let factor = factor.map(|std| if std > MIN_STD_M { 1.0 / std } else { 1.0 }).collect();

        let floats = |values: Vec<f64>| -> Vec<f32> { values.iter().map(|&value| value as f32).collect() };
        let mut pose = [0.0; POSE];
        pose[..3].copy_from_slice(&floats(translation.mean(3)));
        pose[3..].copy_from_slice(&principal(&quaternions).map(|value| value as f32));
        let logit = |share: f64| {
            let share = share.clamp(MIN_SHARE, 1.0 - MIN_SHARE);
            (share / (1.0 - share)).ln() as f32
        };
        let mean_prediction = Prediction {
            hand_points: floats(hand.mean(3 * dims.hand_points)),
            object_points: floats(object.mean(3 * dims.object_points)),
            pose,
            joints: floats(joints.mean(dims.joints)),
            contact_logits: contacts.mean(dims.channels).into_iter().map(logit).collect(),
        };
        let cloud = spread_points(&samples, dims.object_points);
        Ok(Self { scaling: Scaling { mean, factor }, mean: mean_prediction, cloud })
    }
}

/// As many points as `count`, of the objects of samples in contact, evenly spread over these; the origin without any.
fn spread_points(samples: &[Sample], count: usize) -> Vec<f32> {
    let felt: Vec<&Sample> = samples.iter().filter(|sample| sample.in_contact()).collect();
    (0..count)
        .flat_map(|idx| match felt.len() {
            0 => [0.0; 3],
            len => {
                let points = felt[idx * len / count].object_points.as_chunks::<3>().0;
                points[idx % points.len()]
            }
        })
        .collect()
}

/// The direction in which `matrix`, symmetric and positive, is largest (power iteration): of the sum of q q^T the mean of
/// quaternions, whatever their signs (Markley et al. 2007).
fn principal(matrix: &[[f64; 4]; 4]) -> [f64; 4] {
    let mut vector = [1.0, 0.1, 0.01, 0.001];
    for _ in 0..1000 {
        let product =
            matrix.map(|row| row.iter().zip(&vector).map(|(left, right)| left * right).sum::<f64>());
        let norm = product.iter().map(|value| value * value).sum::<f64>().sqrt();
        if norm == 0.0 {
            return [1.0, 0.0, 0.0, 0.0];
        }
        vector = product.map(|value| value / norm);
    }
    vector
}

/// What is said by somebody who feels nothing and knows the training samples: the mean pose of objects in contact, points
/// of many objects at once, the hand's mean points, mean joints, and how often each channel is active.
#[derive(Clone, Debug, PartialEq)]
pub struct MeanPrediction(Prediction);

impl MeanPrediction {
    /// Of the samples of `data`.
    ///
    /// # Errors
    /// No samples, or samples that do not fit `config`.
    pub fn of<D: Dataset + ?Sized>(data: &D, config: &crate::EncoderConfig) -> Result<Self, EncoderError> {
        let dims = Dims::new(config, data.num_channels(), data.num_joints());
        let Statistics { mean, cloud, .. } = Statistics::of(data, dims)?;
        Ok(Self(Prediction { object_points: cloud, ..mean }))
    }

    /// The same for every sample.
    pub fn prediction(&self) -> &Prediction {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_quaternions_does_not_know_their_signs() {
        let mut sum = [[0.0; 4]; 4];
        for (angle, sign) in [(0.3_f64, 1.0), (0.5, -1.0), (0.4, 1.0), (0.4, -1.0)] {
            let quaternion = [(0.5 * angle).cos(), 0.0, (0.5 * angle).sin(), 0.0].map(|value| sign * value);
            for (row, left) in sum.iter_mut().zip(quaternion) {
                row.iter_mut().zip(quaternion).for_each(|(sum, right)| *sum += left * right);
            }
        }
        let mean = principal(&sum);
        assert!((mean[0].abs() - 0.2_f64.cos()).abs() < 1e-9 && mean[1] == 0.0, "{mean:?}");
        assert_eq!(principal(&[[0.0; 4]; 4]), [1.0, 0.0, 0.0, 0.0]);
    }
}
