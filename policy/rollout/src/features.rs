//! What a pretrained encoder makes of what a hand feels: the same numbers in training, in evaluation and on the hand.
//!
//! An encoder looks back on the last frames of a trial, of each channel the place of its taxel in the hand's frame and
//! whether it is active ([`Taxels`]). Everything here is computed from the frames of [`palpate_cloning::Shape::frame`], which
//! are what is kept of a trial, and one window at a time, because a batch of windows may have other bits. So a policy sees
//! at work the bits that it learned from.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, bail};
use nalgebra::Point3;
use palpate_cloning::{Cloned, EncoderFile, Moment, ObservationConfig, Shape};
use palpate_encoder::Encoder;
use palpate_grasp::GraspConfig;
use palpate_robot_model::{Robot, Station};

use crate::task::sha256;

/// Numbers of a point: x, y, z, and what its channel feels.
const POINT: usize = 4;

/// Where the taxel of each channel is, as encoders are told it.
#[derive(Clone, Debug)]
pub struct Taxels {
    /// Link and place in it, m, of each channel.
    places: Vec<(usize, Point3<f64>)>,
    /// The link whose frame is the hand's.
    hand_root: usize,
}

impl Taxels {
    /// Those of `station`, seen from the link `hand_root`.
    pub fn new(station: &Station, hand_root: usize) -> Self {
        let layout = &station.layout;
        let places = layout.channels.iter().map(|channel| {
            let patch = &layout.patches[channel.patch];
            (patch.link, patch.taxels_in_link[channel.taxel])
        });
        Self { places: places.collect(), hand_root }
    }

    /// Channels.
    pub fn num_channels(&self) -> usize {
        self.places.len()
    }

    /// Adds to `input` the frame in which joints were read at `positions` (rad or m) and channels felt `touch`: of each
    /// channel x, y, z in the hand's frame, m, and what it felt.
    pub fn push_frame(
        &self,
        robot: &Robot,
        positions: &[f32],
        touch: impl IntoIterator<Item = f32>,
        input: &mut Vec<f32>,
    ) {
        let positions: Vec<f64> = positions.iter().map(|&position| f64::from(position)).collect();
        let mut base_from_link = Vec::new();
        robot.forward_kinematics(&positions, &mut base_from_link);
        let hand_from_base = base_from_link[self.hand_root].inverse();
        for ((link, place), touch) in self.places.iter().zip(touch) {
            let place = hand_from_base * (base_from_link[*link] * place);
            input.extend([place.x as f32, place.y as f32, place.z as f32, touch]);
        }
    }
}

/// What makes features for a robot: an encoder, or nothing but where the taxels are.
#[derive(Debug)]
pub struct Features {
    /// Nothing where a policy sees the points themselves.
    encoder: Option<Encoder>,
    station: Arc<Station>,
    taxels: Taxels,
    /// Of a frame without features.
    shape: Shape,
    /// Whether what the policy may see is told.
    touch: bool,
    tracking: bool,
}

impl Features {
    /// The encoder in `file` for the robot of `station`, whose hand is the one of `world`. It is told what `observation` lets
    /// the policy see: without touch no channel is ever active, without tracking errors joints are where they were sent.
    ///
    /// # Errors
    /// A file that is no encoder, or one for another number of channels or joints, by the name of what differs.
    pub fn new(
        file: &EncoderFile,
        observation: &ObservationConfig,
        station: Arc<Station>,
        world: &GraspConfig,
    ) -> anyhow::Result<Self> {
        let digest = sha256(&file.bytes);
        if digest != file.sha256 {
            bail!("the encoder has the SHA-256 {digest}, expected {}: it was altered", file.sha256);
        }
        let encoder = Encoder::from_bytes(Path::new("the policy's encoder"), &file.bytes)?;
        let sizes = [
            ("channels", encoder.num_channels(), station.layout.num_channels()),
            ("joints", encoder.num_joints(), station.robot.num_dofs()),
        ];
        if let Some((what, made_for, found)) = sizes.iter().find(|(_, made_for, found)| made_for != found) {
            bail!(
                "the encoder was pretrained on a hand with {made_for} {what}, the station {:?} has {found}; take an \
                 encoder that was pretrained on this station",
                station.id
            );
        }
        if encoder.width() != file.num_features {
            let (found, expected) = (encoder.width(), file.num_features);
            bail!("the encoder makes {found} features, the policy expects {expected}");
        }
        Ok(Self { encoder: Some(encoder), ..Self::points(observation, station, world)? })
    }

    /// Of each channel where its taxel is in the hand's frame and whether it is on, as far as `observation` lets the policy see.
    ///
    /// # Errors
    /// A world whose hand is none of the station's links.
    pub fn points(
        observation: &ObservationConfig,
        station: Arc<Station>,
        world: &GraspConfig,
    ) -> anyhow::Result<Self> {
        let hand_root = station.robot.link_index(&world.hand_root).with_context(|| {
            format!(
                "the world's hand_root is {:?}, which is no link of the station {:?}",
                world.hand_root, station.id
            )
        })?;
        let shape =
            Shape { dofs: station.robot.num_dofs(), channels: station.layout.num_channels(), features: 0 };
        let taxels = Taxels::new(&station, hand_root);
        let (touch, tracking) = (observation.touch, observation.tracking);
        Ok(Self { encoder: None, station, taxels, shape, touch, tracking })
    }

    /// Numbers of a moment.
    pub fn num_features(&self) -> usize {
        self.encoder.as_ref().map_or(POINT * self.shape.channels, Encoder::width)
    }

    /// What makes the features that `policy` wants; nothing if it wants none.
    ///
    /// # Errors
    /// See [`Self::new`].
    pub fn of_policy(
        policy: &Cloned,
        station: &Arc<Station>,
        world: &GraspConfig,
    ) -> anyhow::Result<Option<Arc<Self>>> {
        let observation = &policy.config().observation;
        if observation.points {
            return Ok(Some(Arc::new(Self::points(observation, Arc::clone(station), world)?)));
        }
        let Some(file) = policy.encoder() else { return Ok(None) };
        let features = Self::new(file, observation, Arc::clone(station), world);
        Ok(Some(Arc::new(features.context("the policy's encoder does not fit")?)))
    }
}

/// The features of one trial, step by step.
#[derive(Clone, Debug)]
pub struct FeatureRun {
    features: Arc<Features>,
    /// The last frames as the encoder is told them, the newest last.
    frames: VecDeque<Vec<f32>>,
}

impl FeatureRun {
    /// A trial begins.
    pub fn new(features: Arc<Features>) -> Self {
        Self { frames: VecDeque::new(), features }
    }

    /// Another trial begins.
    pub fn begin(&mut self) {
        self.frames.clear();
    }

    /// The features of the moment of the next control step; those that `now` may have are not looked at. Each step has to be
    /// seen.
    ///
    /// # Errors
    /// Numbers that are none.
    pub fn see(&mut self, now: &Moment<'_>) -> anyhow::Result<Vec<f32>> {
        let frame = self.features.shape.frame(&Moment { features: &[], ..*now });
        self.see_frame(&frame)
    }

    /// The same of a moment that was kept ([`Shape::frame`]), without features.
    ///
    /// # Errors
    /// Numbers that are none.
    pub fn see_frame(&mut self, frame: &[f32]) -> anyhow::Result<Vec<f32>> {
        let newest = self.points(frame);
        let features = Arc::clone(&self.features);
        let Some(encoder) = &features.encoder else { return Ok(newest) };
        let input = self.window(newest, encoder.history());
        encoder.encode(&input).context("the encoder cannot look at what was read of the hand")
    }

    /// Where the taxels are in the moment of this `frame`, and which channels are on.
    fn points(&self, frame: &[f32]) -> Vec<f32> {
        let Features { station, taxels, shape, touch, tracking, .. } = &*self.features;
        let (commands, rest) = frame.split_at(shape.dofs);
        let (errors, felt) = rest.split_at(shape.dofs);
        let read = commands.iter().zip(errors).map(|(command, error)| command - error);
        let positions: Vec<f32> = if *tracking { read.collect() } else { commands.to_vec() };
        let felt = felt.iter().map(|&felt| if *touch { felt } else { 0.0 });
        let mut newest = Vec::with_capacity(POINT * shape.channels);
        taxels.push_frame(&station.robot, &positions, felt, &mut newest);
        newest
    }

    /// What the encoder looks at when the moment of the `newest` points has come: before the first comes that one again.
    fn window(&mut self, newest: Vec<f32>, history: usize) -> Vec<f32> {
        if self.frames.len() == history {
            self.frames.pop_front();
        }
        self.frames.push_back(newest);
        let missing = history - self.frames.len();
        let first = self.frames.iter().take(1).cycle().take(missing);
        first.chain(&self.frames).flatten().copied().collect()
    }
}

#[cfg(test)]
mod tests;
