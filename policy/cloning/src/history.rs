//! What a policy sees: the same in training, in evaluation and on the robot.

use std::collections::VecDeque;

use crate::{JointValues, ObservationConfig};

/// Time that counts as 1, s.
const TIME_UNIT_S: f64 = 10.0;
/// Half-width of a region that counts as 1, m.
const REGION_UNIT_M: f32 = 0.1;
/// Numbers of a point: x, y, z, and whether its channel is on.
const POINT: usize = 4;

/// Sizes of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Degrees of freedom.
    pub dofs: usize,
    /// Touch channels.
    pub channels: usize,
    /// Numbers that an encoder makes of a moment, or those of its points; 0 without either.
    pub features: usize,
}

impl Shape {
    /// The same robot, seen as `config` has it, where an encoder makes `encoded` features.
    pub(crate) fn seen(self, config: &ObservationConfig, encoded: usize) -> Self {
        let features = if config.points { self.num_points_numbers() } else { encoded };
        Self { features, ..self }
    }

    /// Numbers of the points of all channels.
    pub(crate) fn num_points_numbers(self) -> usize {
        POINT * self.channels
    }

    /// Numbers of one frame: commands, how far joints are from them, channels, features.
    pub fn frame_len(self) -> usize {
        2 * self.dofs + self.channels + self.features
    }

    /// What is kept of a moment: commands, how far joints are from them (rad or m), touch (0 or 1, or from 0 to 1),
    /// features.
    ///
    /// # Panics
    /// If its numbers are not as many as the shape says: a caller's bug.
    pub fn frame(self, now: &Moment<'_>) -> Vec<f32> {
        assert_eq!(
            [now.positions.len(), now.commands.len(), now.touch.len(), now.features.len()],
            [self.dofs, self.dofs, self.channels, self.features],
            "one number per joint, channel and feature"
        );
        let tracking = now.commands.iter().zip(now.positions).map(|(command, read)| command - read);
        let joints = now.commands.iter().copied().chain(tracking).map(|value| value as f32);
        let mut frame: Vec<f32> = joints.collect();
        match now.touch {
            Touch::Events(events) => frame.extend(events.iter().map(|&on| f32::from(u8::from(on)))),
            Touch::Strengths(strengths) => frame.extend_from_slice(strengths),
        }
        frame.extend_from_slice(now.features);
        frame
    }

    /// These `values` of the joints in a `frame`, rad or m.
    pub(crate) fn joints(self, values: JointValues, frame: &[f32]) -> impl Iterator<Item = f32> {
        let commands = frame.iter().take(self.dofs);
        commands.zip(frame.iter().skip(self.dofs)).map(move |(command, tracking)| match values {
            JointValues::Commands => *command,
            JointValues::Positions => command - tracking,
        })
    }

    /// Numbers of one step of a chunk: differences to a value of each joint, and the claim that the object is held.
    pub(crate) fn action_len(self) -> usize {
        self.dofs + 1
    }

    /// Numbers of an observation: the frames, the newest first, then the time, then the region if it is seen.
    pub(crate) fn input_len(self, config: &ObservationConfig) -> usize {
        config.frames * self.frame_len() + 1 + usize::from(config.region)
    }
}

/// What channels feel, one value each.
#[derive(Clone, Copy, Debug)]
pub enum Touch<'a> {
    /// Whether each is on.
    Events(&'a [bool]),
    /// How strongly each is touched, from 0 to 1.
    Strengths(&'a [f32]),
}

impl Touch<'_> {
    /// Channels.
    pub fn len(self) -> usize {
        match self {
            Self::Events(events) => events.len(),
            Self::Strengths(strengths) => strengths.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }
}

/// What a robot knows at the beginning of a control step.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// Time since the trial began, s.
    pub time_s: f64,
    /// Joint positions as they are read, rad or m.
    pub positions: &'a [f64],
    /// Where each joint was sent last, rad or m.
    pub commands: &'a [f64],
    /// What each channel feels.
    pub touch: Touch<'a>,
    /// What an encoder makes of this moment and those before it, or its points; none where the policy sees neither.
    pub features: &'a [f32],
}

/// The window of moments that a policy looks back on.
#[derive(Clone, Debug)]
pub struct History {
    config: ObservationConfig,
    shape: Shape,
    /// The newest first.
    frames: VecDeque<Vec<f32>>,
    time_s: f64,
    half_width_m: Option<f32>,
}

impl History {
    /// Nothing has been seen yet in a trial whose object began within `half_width_m` of the middle, along both axes. That has
    /// to be known where `config` shows the region.
    pub(crate) fn new(config: ObservationConfig, shape: Shape, half_width_m: Option<f32>) -> Self {
        Self { config, shape, frames: VecDeque::new(), time_s: 0.0, half_width_m }
    }

    /// Sees the moment of the next control step. Each step must be seen, whether the policy plans in it or not.
    ///
    /// # Panics
    /// If its numbers are not as many as the shape says: a caller's bug.
    pub fn see(&mut self, now: &Moment<'_>) {
        let frame = self.shape.frame(now);
        self.frames.push_front(frame);
        self.frames.truncate((self.config.frames - 1) * self.config.stride + 1);
        self.time_s = now.time_s;
    }

    /// How far each joint is from where it was sent, rad or m.
    ///
    /// # Panics
    /// If nothing has been seen: a caller's bug.
    pub(crate) fn tracking(&self) -> &[f32] {
        let newest = self.frames.front().expect("something has been seen");
        &newest[self.shape.dofs..][..self.shape.dofs]
    }

    /// The observation now; before a window is full, its oldest frames are the first that was seen.
    ///
    /// # Panics
    /// If nothing has been seen: a caller's bug.
    pub fn observation(&self) -> Vec<f32> {
        let last = self.frames.len().checked_sub(1).expect("something has been seen");
        let told = (self.time_s, self.half_width_m);
        observation(&self.config, self.shape, told, |back| &self.frames[back.min(last)][..])
    }
}

/// The observation at `time_s` in a region of `half_width_m`, of frames that lie some steps back.
pub(crate) fn observation<'a>(
    config: &ObservationConfig,
    shape: Shape,
    (time_s, half_width_m): (f64, Option<f32>),
    frame: impl Fn(usize) -> &'a [f32],
) -> Vec<f32> {
    let mut observation = Vec::with_capacity(shape.input_len(config));
    for back in (0..config.frames).map(|frame| frame * config.stride) {
        let frame = frame(back);
        let (tracking, rest) = frame[shape.dofs..].split_at(shape.dofs);
        let (touch, features) = rest.split_at(shape.channels);
        observation.extend(shape.joints(config.joints, frame));
        let mut sense = |values: &[f32], is_told: bool| {
            observation.extend(values.iter().map(|&value| if is_told { value } else { 0.0 }));
        };
        sense(tracking, config.tracking && config.joints == JointValues::Commands);
        sense(touch, config.touch);
        // Their encoder was not shown what is hidden.
        observation.extend_from_slice(features);
    }
    observation.push((time_s / TIME_UNIT_S) as f32);
    observation
        .extend(half_width_m.filter(|_| config.region).map(|half_width_m| half_width_m / REGION_UNIT_M));
    observation
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: Shape = Shape { dofs: 1, channels: 2, features: 0 };

    fn see(history: &mut History, step: u32) {
        let value = f64::from(step);
        let active = [step.is_multiple_of(2), false];
        history.see(&Moment {
            time_s: value,
            positions: &[value - 0.5],
            commands: &[value],
            touch: Touch::Events(&active),
            features: &[],
        });
    }

    #[test]
    fn a_window_holds_every_stride_th_frame_and_begins_with_the_first() {
        let config = ObservationConfig { frames: 3, stride: 2, ..ObservationConfig::default() };
        let mut history = History::new(config, SHAPE, None);
        see(&mut history, 0);
        assert_eq!(
            history.observation(),
            [[0.0, 0.5, 1.0, 0.0]; 3].concat().into_iter().chain([0.0]).collect::<Vec<_>>()
        );
        for step in 1..=5 {
            see(&mut history, step);
        }
        let expected = [[5.0, 0.5, 0.0, 0.0], [3.0, 0.5, 0.0, 0.0], [1.0, 0.5, 0.0, 0.0]].concat();
        assert_eq!(history.observation()[..12], expected);
        assert_eq!(history.observation()[12..], [0.5]);
    }

    #[test]
    fn what_is_hidden_is_zero() {
        let hidden = ObservationConfig { touch: false, tracking: false, ..ObservationConfig::default() };
        let config = ObservationConfig { frames: 1, stride: 1, ..hidden };
        let mut history = History::new(config, SHAPE, None);
        see(&mut history, 2);
        assert_eq!(history.observation(), [2.0, 0.0, 0.0, 0.0, 0.2]);
    }

    #[test]
    fn where_positions_are_seen_commands_are_not() {
        let joints = JointValues::Positions;
        let config = ObservationConfig { frames: 1, stride: 1, joints, ..ObservationConfig::default() };
        let mut history = History::new(config, SHAPE, None);
        see(&mut history, 2);
        assert_eq!(history.observation(), [1.5, 0.0, 1.0, 0.0, 0.2]);
        assert_eq!(history.tracking(), [0.5]);
    }

    #[test]
    fn the_region_is_the_last_number_where_it_is_seen() {
        let seen = |region: bool| {
            let config = ObservationConfig { frames: 1, stride: 1, region, ..ObservationConfig::default() };
            let mut history = History::new(config.clone(), SHAPE, Some(0.08));
            see(&mut history, 2);
            assert_eq!(history.observation().len(), SHAPE.input_len(&config));
            history.observation()
        };
        assert_eq!(seen(true), [2.0, 0.5, 1.0, 0.0, 0.2, 0.08_f32 / 0.1]);
        assert_eq!(seen(false), [2.0, 0.5, 1.0, 0.0, 0.2]);
    }

    #[test]
    fn features_are_the_last_numbers_of_each_frame() {
        let config =
            ObservationConfig { frames: 2, stride: 1, features: true, ..ObservationConfig::default() };
        let mut history = History::new(config, Shape { features: 3, ..SHAPE }, None);
        for step in [1.0, 2.0] {
            let features = [10.0 * step, 0.1, -7.0].map(|value| value as f32);
            history.see(&Moment {
                time_s: step,
                positions: &[step],
                commands: &[step],
                touch: Touch::Events(&[true, false]),
                features: &features,
            });
        }
        let expected =
            [[2.0, 0.0, 1.0, 0.0, 20.0, 0.1, -7.0], [1.0, 0.0, 1.0, 0.0, 10.0, 0.1, -7.0]].concat();
        assert_eq!(history.observation()[..14], expected);
    }
}
