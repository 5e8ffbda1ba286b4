//! A ball that touches a row of taxels, so that where it is can be felt.

use std::collections::BTreeMap;

use palpate_encoder::{Dataset, EncoderConfig, NetworkConfig, Sample};

pub(crate) const CHANNELS: usize = 6;
pub(crate) const JOINTS: usize = 2;
const PITCH_M: f32 = 0.02;
const RADIUS_M: f32 = 0.015;

/// Samples `first..first + len` of a sequence without end. The ball is anywhere along the row, in every fifth sample beyond it;
/// two joints move the row.
#[derive(Clone)]
pub(crate) struct Row {
    pub(crate) first: usize,
    pub(crate) len: usize,
    pub(crate) broken: Option<usize>,
}

impl Row {
    pub(crate) fn new(first: usize, len: usize) -> Self {
        Self { first, len, broken: None }
    }
}

/// A number in 0..1 that `idx` and `what` say.
fn chance(idx: usize, what: usize) -> f32 {
    let mixed = ((idx as u64) << 8 | what as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    ((mixed ^ mixed >> 31).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f32 / (1_u64 << 24) as f32
}

impl Dataset for Row {
    fn len(&self) -> usize {
        self.len
    }

    fn num_channels(&self) -> usize {
        CHANNELS
    }

    fn num_joints(&self) -> usize {
        JOINTS
    }

    fn sample(&self, idx: usize) -> Sample {
        let config = config();
        let seen = self.first + idx;
        let joints = [0.02 * chance(seen, 0), 0.02 * chance(seen, 1)];
        let ball = if seen.is_multiple_of(5) { -1.0 } else { PITCH_M * CHANNELS as f32 * chance(seen, 2) };
        let taxel = |channel: usize| [joints[0] + PITCH_M * channel as f32, joints[1], 0.0];
        let touches = |channel: usize| f32::from(u8::from((taxel(channel)[0] - ball).abs() < 0.8 * PITCH_M));
        let contacts: Vec<f32> = (0..CHANNELS).map(touches).collect();
        let frame = (0..CHANNELS).flat_map(|channel| {
            let [x, y, z] = taxel(channel);
            [x, y, z, contacts[channel]]
        });
        let around = |count: usize, point: &dyn Fn(f32) -> [f32; 3]| -> Vec<f32> {
            (0..count).flat_map(|i| point(i as f32 / count as f32)).collect()
        };
        let turn = 0.5 * joints[0] * 20.0;
        let mut sample = Sample {
            input: frame.collect::<Vec<f32>>().repeat(config.history),
            hand_points: around(config.hand_points, &|share| {
                [joints[0] + share * PITCH_M * CHANNELS as f32, joints[1], 0.0]
            }),
            object_points: around(config.object_points, &|share| {
                let angle = std::f32::consts::TAU * share;
                [ball + RADIUS_M * angle.cos(), RADIUS_M * angle.sin(), RADIUS_M]
            }),
            pose: [ball, 0.0, RADIUS_M, turn.cos(), 0.0, 0.0, turn.sin()],
            joints: joints.to_vec(),
            contacts,
        };
        if self.broken == Some(idx) {
            sample.pose[1] = f32::NAN;
        }
        sample
    }
}

pub(crate) fn config() -> EncoderConfig {
    EncoderConfig {
        epochs: 4,
        batch_size: 48,
        learning_rate: 3e-3,
        final_learning_rate: 3e-4,
        checkpoint_updates: 5,
        history: 3,
        hand_points: 8,
        object_points: 16,
        network: NetworkConfig {
            width: 24,
            layers: 1,
            decoder_layers: 1,
            heads: 2,
            feed_forward: 48,
            points_per_query: 8,
        },
        ..EncoderConfig::default()
    }
}

pub(crate) fn sources(digest: &str) -> BTreeMap<String, String> {
    BTreeMap::from([("demonstrations of the ball".to_owned(), digest.to_owned())])
}
