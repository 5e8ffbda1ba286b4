//! What pretraining descends: the paper's losses of one sample, each with its gradient in the prediction.
//!
//! What the paper leaves open: distances of the Chamfer distance are Euclidean, not squared, so that it is in m as the
//! translation's loss is, and both directions' means are added. A point of the object is repelled by its nearest
//! neighbour below a distance, and is inside the hand below a distance from a point of the hand; the hand does not give way.

use crate::points::{Cloud, mean_nearest_m};
use crate::sample::{Outputs, Sample};
use crate::{EncoderError, LossConfig};

/// Keeps quaternions of length zero from being divided by it.
const EPSILON: f64 = 1e-8;

/// Names of [`LossTerms`], in the order of [`LossTerms::means`].
pub const TERMS: [&str; 10] = [
    "hand",
    "object",
    "translation",
    "rotation",
    "joints",
    "contact",
    "repulsion",
    "penetration",
    "empty_object",
    "empty_pose",
];

/// Which samples a term is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum When {
    Always,
    InContact,
    Empty,
}

const WHEN: [When; TERMS.len()] = [
    When::Always,
    When::InContact,
    When::InContact,
    When::InContact,
    When::Always,
    When::Always,
    When::InContact,
    When::InContact,
    When::Empty,
    When::Empty,
];

/// Sums over samples of every term, before its weight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossTerms {
    samples: usize,
    in_contact: usize,
    /// In the order of [`TERMS`].
    sums: [f64; TERMS.len()],
    total: f64,
}

impl LossTerms {
    pub(crate) fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.in_contact += other.in_contact;
        self.total += other.total;
        self.sums.iter_mut().zip(other.sums).for_each(|(sum, other)| *sum += other);
    }

    /// The mean of each term over the samples that it is for; nothing where there were none. In the order of [`TERMS`].
    pub fn means(&self) -> [Option<f64>; TERMS.len()] {
        let mut means = [None; TERMS.len()];
        for ((mean, sum), when) in means.iter_mut().zip(self.sums).zip(WHEN) {
            let count = match when {
                When::Always => self.samples,
                When::InContact => self.in_contact,
                When::Empty => self.samples - self.in_contact,
            };
            *mean = (count > 0).then(|| sum / count as f64);
        }
        means
    }

    /// The mean of the objective.
    pub fn total(&self) -> f64 {
        self.total / self.samples as f64
    }
}

/// The weights in the order of [`TERMS`].
fn weights(config: &LossConfig) -> [f64; TERMS.len()] {
    [
        config.hand,
        config.object,
        1.0,
        config.rotation,
        config.joints,
        config.contact,
        config.repulsion,
        config.penetration,
        config.empty_object,
        config.empty_pose,
    ]
}

/// The losses of a row of outputs; adds `scale` times the objective's gradient to `gradient`, as long as `row`.
pub(crate) fn sample_loss(
    sample: &Sample,
    row: &[f32],
    outputs: &Outputs,
    config: &LossConfig,
    scale: f64,
    gradient: &mut [f32],
) -> LossTerms {
    let weights = weights(config);
    let in_contact = sample.in_contact();
    let mut sums = [0.0; TERMS.len()];
    for (idx, (sum, when)) in sums.iter_mut().zip(WHEN).enumerate() {
        if when == if in_contact { When::Empty } else { When::InContact } {
            continue;
        }
        *sum = term(idx, sample, row, outputs, config, scale * weights[idx], gradient);
    }
    let total = sums.iter().zip(weights).map(|(sum, weight)| sum * weight).sum();
    LossTerms { samples: 1, in_contact: usize::from(in_contact), sums, total }
}

/// The term numbered `idx` in [`TERMS`]; adds `scale` times its gradient.
fn term(
    idx: usize,
    sample: &Sample,
    row: &[f32],
    outputs: &Outputs,
    config: &LossConfig,
    scale: f64,
    gradient: &mut [f32],
) -> f64 {
    let (hand, object) = (&row[outputs.hand.clone()], &row[outputs.object.clone()]);
    let (position, quaternion) =
        (outputs.pose.start..outputs.pose.start + 3, outputs.pose.start + 3..outputs.pose.end);
    match TERMS[idx] {
        "hand" => chamfer(hand, &sample.hand_points, scale, &mut gradient[outputs.hand.clone()]),
        "object" => chamfer(object, &sample.object_points, scale, &mut gradient[outputs.object.clone()]),
        "translation" => absolute(&row[position.clone()], &sample.pose[..3], scale, &mut gradient[position]),
        "rotation" => rotation(&row[quaternion.clone()], &sample.pose[3..], scale, &mut gradient[quaternion]),
        "joints" => {
            let range = outputs.joints.clone();
            squared(&row[range.clone()], &sample.joints, scale, &mut gradient[range])
        }
        "contact" => {
            let range = outputs.contacts.clone();
            focal(&row[range.clone()], &sample.contacts, config, scale, &mut gradient[range])
        }
        "repulsion" => repulsion(object, config.repulsion_m, scale, &mut gradient[outputs.object.clone()]),
        "penetration" => {
            penetration(object, hand, config.penetration_m, scale, &mut gradient[outputs.object.clone()])
        }
        "empty_object" => norms(object, scale, &mut gradient[outputs.object.clone()]),
        _ => absolute(&row[position.clone()], &[0.0; 3], scale, &mut gradient[position]),
    }
}

/// Adds `scale` times the unit vector from `to` to `from` to `gradient`, the slope of their distance in `from`.
fn add_direction(from: &[f32], to: &[f32], distance: f64, scale: f64, gradient: &mut [f32]) {
    if distance > 0.0 {
        for ((slope, from), to) in gradient.iter_mut().zip(from).zip(to) {
            *slope += (scale * f64::from(from - to) / distance) as f32;
        }
    }
}

/// Mean distance from every predicted point to its nearest target, and from every target to its nearest prediction, m.
fn chamfer(predicted: &[f32], target: &[f32], scale: f64, gradient: &mut [f32]) -> f64 {
    let (predictions, targets) = (predicted.as_chunks::<3>().0, target.as_chunks::<3>().0);
    let (to_target, to_predicted) = (scale / predictions.len() as f64, scale / targets.len() as f64);
    let cloud = Cloud::new(target);
    let mut there = 0.0;
    for (point, slope) in predictions.iter().zip(gradient.as_chunks_mut::<3>().0) {
        let nearest = cloud.nearest(point);
        let distance = f64::from(nearest.distance);
        there += distance;
        add_direction(point, &targets[nearest.idx], distance, to_target, slope);
    }
    let cloud = Cloud::new(predicted);
    let mut back = 0.0;
    for point in targets {
        let nearest = cloud.nearest(point);
        let distance = f64::from(nearest.distance);
        back += distance;
        let slope = &mut gradient[3 * nearest.idx..3 * nearest.idx + 3];
        add_direction(&predictions[nearest.idx], point, distance, to_predicted, slope);
    }
    there / predictions.len() as f64 + back / targets.len() as f64
}

/// Mean distance to the nearest point of the other cloud, both directions together as one mean, m.
pub(crate) fn mean_distance_m(left: &[f32], right: &[f32]) -> f64 {
    0.5 * (mean_nearest_m(left, right) + mean_nearest_m(right, left))
}

/// Sum of absolute differences.
fn absolute(predicted: &[f32], target: &[f32], scale: f64, gradient: &mut [f32]) -> f64 {
    let mut sum = 0.0;
    for ((predicted, target), slope) in predicted.iter().zip(target).zip(gradient) {
        let difference = f64::from(predicted - target);
        sum += difference.abs();
        if difference != 0.0 {
            *slope += (scale * difference.signum()) as f32;
        }
    }
    sum
}

/// Sum of squared differences.
fn squared(predicted: &[f32], target: &[f32], scale: f64, gradient: &mut [f32]) -> f64 {
    let mut sum = 0.0;
    for ((predicted, target), slope) in predicted.iter().zip(target).zip(gradient) {
        let difference = f64::from(predicted - target);
        sum += difference * difference;
        *slope += (scale * 2.0 * difference) as f32;
    }
    sum
}

/// One less the size of the cosine between two quaternions, of whatever length and sign.
fn rotation(predicted: &[f32], target: &[f32], scale: f64, gradient: &mut [f32]) -> f64 {
    let norm = |of: &[f32]| of.iter().map(|&value| f64::from(value).powi(2)).sum::<f64>().sqrt();
    let (length, target_length) = (norm(predicted), norm(target) + EPSILON);
    let dot: f64 =
        predicted.iter().zip(target).map(|(&p, &t)| f64::from(p) * f64::from(t)).sum::<f64>() / target_length;
    let cosine = dot / (length + EPSILON);
    for ((&predicted, &target), slope) in predicted.iter().zip(target).zip(gradient) {
        let along = if length > 0.0 { f64::from(predicted) / length } else { 0.0 };
        let change = (f64::from(target) / target_length - cosine * along) / (length + EPSILON);
        *slope -= (scale * cosine.signum() * change) as f32;
    }
    1.0 - cosine.abs()
}

/// Mean focal loss (Lin et al. 2017) of logits.
fn focal(logits: &[f32], contacts: &[f32], config: &LossConfig, scale: f64, gradient: &mut [f32]) -> f64 {
    let (alpha, gamma) = (config.focal_alpha, config.focal_gamma);
    let count = logits.len() as f64;
    let mut sum = 0.0;
    for ((&logit, &contact), slope) in logits.iter().zip(contacts).zip(gradient) {
        // x is the logit of what is true: p = sigmoid(x), the loss -a (1 - p)^gamma ln p.
        let (sign, a) = if contact > 0.0 { (1.0, alpha) } else { (-1.0, 1.0 - alpha) };
        let x = sign * f64::from(logit);
        let ln_p = if x > 0.0 { -(-x).exp().ln_1p() } else { x - x.exp().ln_1p() };
        let p = ln_p.exp();
        let missing = (1.0 - p).powf(gamma);
        sum -= a * missing * ln_p;
        let slope_x = a * missing * (gamma * p * ln_p - (1.0 - p));
        *slope += (scale * sign * slope_x / count) as f32;
    }
    sum / count
}

/// Mean over points of how much nearer than `reach_m` the nearest other point is, m.
fn repulsion(points: &[f32], reach_m: f64, scale: f64, gradient: &mut [f32]) -> f64 {
    let cloud = Cloud::new(points);
    let points = points.as_chunks::<3>().0;
    let share = scale / points.len() as f64;
    let mut sum = 0.0;
    for (idx, point) in points.iter().enumerate() {
        let nearest = cloud.nearest_other(point, idx);
        let distance = f64::from(nearest.distance);
        if distance < reach_m {
            sum += reach_m - distance;
            let other = &points[nearest.idx];
            add_direction(point, other, distance, -share, &mut gradient[3 * idx..3 * idx + 3]);
            let slope = &mut gradient[3 * nearest.idx..3 * nearest.idx + 3];
            add_direction(other, point, distance, -share, slope);
        }
    }
    sum / points.len() as f64
}

/// Mean over points of the object of how much nearer than `reach_m` the nearest point of the hand is, m. The gradient
/// is in the object's points alone.
fn penetration(object: &[f32], hand: &[f32], reach_m: f64, scale: f64, gradient: &mut [f32]) -> f64 {
    let cloud = Cloud::new(hand);
    let (object, hand) = (object.as_chunks::<3>().0, hand.as_chunks::<3>().0);
    let share = scale / object.len() as f64;
    let mut sum = 0.0;
    for (point, slope) in object.iter().zip(gradient.as_chunks_mut::<3>().0) {
        let nearest = cloud.nearest(point);
        let distance = f64::from(nearest.distance);
        if distance < reach_m {
            sum += reach_m - distance;
            add_direction(point, &hand[nearest.idx], distance, -share, slope);
        }
    }
    sum / object.len() as f64
}

/// Mean distance of points from the origin, m.
fn norms(points: &[f32], scale: f64, gradient: &mut [f32]) -> f64 {
    let points = points.as_chunks::<3>().0;
    let share = scale / points.len() as f64;
    let mut sum = 0.0;
    for (point, slope) in points.iter().zip(gradient.as_chunks_mut::<3>().0) {
        let distance = point.iter().map(|&value| f64::from(value).powi(2)).sum::<f64>().sqrt();
        sum += distance;
        add_direction(point, &[0.0; 3], distance, share, slope);
    }
    sum / points.len() as f64
}

/// Whether `gradients` are numbers; names the first array with one that is none.
pub(crate) fn diverged(gradients: &[Vec<f32>], names: &[String], update: u64) -> EncoderError {
    let broken = |gradient: &Vec<f32>| gradient.iter().any(|slope| !slope.is_finite());
    let name = gradients.iter().position(broken).map_or("their norm", |at| &names[at]);
    EncoderError::Diverged { what: format!("the gradient of {name}"), update }
}

#[cfg(test)]
mod tests;
