//! What goes in, and what is to come out.

use std::ops::Range;

use crate::{EncoderConfig, EncoderError};

/// Numbers of a channel in a frame: the place of its taxel and its activation.
pub(crate) const FEATURES: usize = 4;
/// Numbers of a pose: translation and quaternion.
pub(crate) const POSE: usize = 7;

/// One moment of a demonstration. Lengths in m, in the hand's frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// `[history, channels, 4]`, oldest frame first: x, y, z of the taxel, then its activation, 0 or 1.
    pub input: Vec<f32>,
    /// Points on the hand, `[hand_points, 3]`.
    pub hand_points: Vec<f32>,
    /// Points on the object, `[object_points, 3]`.
    pub object_points: Vec<f32>,
    /// hand_from_object: x, y, z, then the unit quaternion, w first.
    pub pose: [f32; POSE],
    /// Joint positions, rad or m, `[joints]`.
    pub joints: Vec<f32>,
    /// Which channels are active, 0 or 1, `[channels]`.
    pub contacts: Vec<f32>,
}

impl Sample {
    /// m: whether anything is felt.
    pub fn in_contact(&self) -> bool {
        self.contacts.iter().any(|&contact| contact > 0.0)
    }

    /// Whether this has `dims` and numbers only; `idx` names it in errors.
    pub(crate) fn check(&self, idx: usize, dims: &Dims) -> Result<(), EncoderError> {
        let parts: [(&'static str, &[f32], usize); 6] = [
            ("input", &self.input, dims.input_len()),
            ("hand points", &self.hand_points, 3 * dims.hand_points),
            ("object points", &self.object_points, 3 * dims.object_points),
            ("pose", &self.pose, POSE),
            ("joints", &self.joints, dims.joints),
            ("contacts", &self.contacts, dims.channels),
        ];
        for (what, values, expected) in parts {
            if values.len() != expected {
                let found = values.len();
                return Err(EncoderError::Shape(format!(
                    "sample {idx} has {found} numbers as {what}, expected {expected}"
                )));
            }
            if let Some(&value) = values.iter().find(|value| !value.is_finite()) {
                return Err(EncoderError::NonFiniteSample { sample: idx, what, value });
            }
        }
        Ok(())
    }
}

/// Samples by number.
pub trait Dataset: Sync {
    /// Number of samples.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of tactile channels.
    fn num_channels(&self) -> usize;

    /// Number of joints.
    fn num_joints(&self) -> usize;

    /// The sample numbered `idx`, always the same.
    fn sample(&self, idx: usize) -> Sample;
}

/// The frames of an input that ends at `step`, oldest first: before the first frame, that one again.
pub fn history_steps(step: usize, history: usize) -> impl ExactSizeIterator<Item = usize> {
    (0..history).map(move |frame| (step + frame + 1).saturating_sub(history))
}

/// Sizes of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dims {
    /// H: frames of an input.
    pub history: usize,
    /// Tactile channels.
    pub channels: usize,
    /// Joints.
    pub joints: usize,
    /// Points of the hand.
    pub hand_points: usize,
    /// Points of the object.
    pub object_points: usize,
}

impl Dims {
    pub(crate) fn new(config: &EncoderConfig, channels: usize, joints: usize) -> Self {
        Self {
            history: config.history,
            channels,
            joints,
            hand_points: config.hand_points,
            object_points: config.object_points,
        }
    }

    pub(crate) fn input_len(&self) -> usize {
        self.history * self.channels * FEATURES
    }

    /// Where each prediction is among the decoder's outputs.
    pub(crate) fn outputs(&self) -> Outputs {
        let mut end = 0;
        let mut next = |len: usize| {
            end += len;
            end - len..end
        };
        Outputs {
            hand: next(3 * self.hand_points),
            object: next(3 * self.object_points),
            pose: next(POSE),
            joints: next(self.joints),
            contacts: next(self.channels),
        }
    }
}

/// Ranges of a row of outputs.
#[derive(Clone, Debug)]
pub(crate) struct Outputs {
    pub(crate) hand: Range<usize>,
    pub(crate) object: Range<usize>,
    pub(crate) pose: Range<usize>,
    pub(crate) joints: Range<usize>,
    pub(crate) contacts: Range<usize>,
}

impl Outputs {
    pub(crate) fn len(&self) -> usize {
        self.contacts.end
    }
}

/// What is believed of a moment: the same numbers as in a [`Sample`], contacts as logits, the quaternion of any length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prediction {
    /// `[hand_points, 3]`.
    pub hand_points: Vec<f32>,
    /// `[object_points, 3]`.
    pub object_points: Vec<f32>,
    /// x, y, z, then the quaternion, w first.
    pub pose: [f32; POSE],
    /// `[joints]`.
    pub joints: Vec<f32>,
    /// `[channels]`.
    pub contact_logits: Vec<f32>,
}

impl Prediction {
    pub(crate) fn of_row(row: &[f32], outputs: &Outputs) -> Self {
        let mut pose = [0.0; POSE];
        pose.copy_from_slice(&row[outputs.pose.clone()]);
        Self {
            hand_points: row[outputs.hand.clone()].to_vec(),
            object_points: row[outputs.object.clone()].to_vec(),
            pose,
            joints: row[outputs.joints.clone()].to_vec(),
            contact_logits: row[outputs.contacts.clone()].to_vec(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn before_the_first_frame_comes_the_first_frame_again() {
        let steps = |step, history| history_steps(step, history).collect::<Vec<_>>();
        assert_eq!(steps(0, 4), [0, 0, 0, 0]);
        assert_eq!(steps(2, 4), [0, 0, 1, 2]);
        assert_eq!(steps(3, 4), [0, 1, 2, 3]);
        assert_eq!(steps(9, 4), [6, 7, 8, 9]);
        assert_eq!(steps(5, 1), [5]);
    }
}
