//! One episode on the data set's clock.

use crate::{
    clock::Clock,
    columns::{Column, Values},
    source::{Episode, Log, POSE_NAMES, Setup},
};

use super::{Action, integers};

/// What every episode of a data set looks like.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    pub(super) setup: Setup,
    pub(super) fps: u32,
    pub(super) action: Action,
    /// For each stream, whether its readings were recorded.
    pub(super) with_raw: Vec<bool>,
    /// Whether it says where the object is.
    pub(super) with_object: bool,
}

/// A feature of ours.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Feature<'a> {
    pub(super) name: &'static str,
    pub(super) dtype: &'static str,
    /// Names of its numbers.
    pub(super) names: Vec<&'a str>,
}

impl Shape {
    /// Features beside those that every data set has.
    pub(super) fn features(&self) -> impl Iterator<Item = Feature<'_>> {
        let joints: Vec<&str> = self.setup.joints.iter().map(String::as_str).collect();
        let action = (self.action != Action::None).then(|| joints.clone());
        let features = [
            ("observation.state", "float32", Some(joints)),
            ("action", "float32", action),
            ("observation.tactile.raw", "float32", Some(self.channels(true))),
            ("observation.tactile.active", "bool", Some(self.channels(false))),
            ("observation.environment_state", "float32", self.with_object.then(|| POSE_NAMES.to_vec())),
        ];
        let features = features
            .into_iter()
            .filter_map(|(name, dtype, names)| Some(Feature { name, dtype, names: names? }));
        features.filter(|feature| !feature.names.is_empty())
    }

    /// Ids of the channels, or of those that have readings.
    fn channels(&self, with_raw_only: bool) -> Vec<&str> {
        let streams = self.setup.streams.iter().zip(&self.with_raw);
        let streams = streams.filter(|(_, with_raw)| **with_raw || !with_raw_only);
        streams.flat_map(|(stream, _)| stream.channels.iter().map(String::as_str)).collect()
    }
}

/// Where an episode lies in the data set.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) episode: usize,
    /// Index of its first frame over all episodes.
    pub(super) first_index: usize,
    pub(super) task: usize,
}

/// The frames of one episode, as they are written.
#[derive(Clone, Debug)]
pub(super) struct Frames {
    pub(super) num_frames: usize,
    /// When the first frame is, s since the recording's start.
    pub(super) first_s: f64,
    /// For joints, then each stream: the greatest age of what a frame holds, s.
    pub(super) longest_age_s: Vec<(String, f64)>,
    pub(super) columns: Vec<Column>,
}

impl Frames {
    /// `None` where joints and streams do not overlap in time.
    pub(super) fn sample(shape: &Shape, episode: &Episode, place: Place) -> Option<Self> {
        let joints = &episode.joints;
        let mut logs = vec![joints.times_ns.as_slice()];
        logs.extend(episode.streams.iter().map(|stream| stream.active.times_ns.as_slice()));
        let clock = Clock::common(&logs, shape.fps)?;
        let num_dofs = shape.setup.joints.len();
        let state = sampled(&clock, joints, num_dofs)?;
        let (mut raw, mut active) = (Vec::new(), Vec::new());
        let num_channels: usize = shape.setup.streams.iter().map(|stream| stream.channels.len()).sum();
        let num_raw = shape.channels(true).len();
        let mut streams: Vec<_> =
            episode.streams.iter().map(|stream| clock.newest(&stream.active.times_ns)).collect();
        for _ in 0..clock.num_frames {
            for ((samples, stream), setup) in
                streams.iter_mut().zip(&episode.streams).zip(&shape.setup.streams)
            {
                let width = setup.channels.len();
                let sample = samples.next()??;
                let row = sample * width..(sample + 1) * width;
                active.extend_from_slice(stream.active.values.get(row.clone())?);
                // Empty where the stream gives events only.
                raw.extend_from_slice(stream.raw.get(row).unwrap_or_default());
            }
        }
        let mut columns = vec![Column::list("observation.state", num_dofs, Values::F32(state.clone()))];
        if let Some(action) = action(shape.action, &clock, episode, &state, num_dofs) {
            columns.push(Column::list("action", num_dofs, Values::F32(action)));
        }
        if num_raw > 0 {
            columns.push(Column::list("observation.tactile.raw", num_raw, Values::F32(raw)));
        }
        if num_channels > 0 {
            columns.push(Column::list("observation.tactile.active", num_channels, Values::Bool(active)));
        }
        if shape.with_object {
            let poses = Values::F32(object_poses(&clock, &episode.object_poses));
            columns.push(Column::list("observation.environment_state", POSE_NAMES.len(), poses));
        }
        let num_frames = clock.num_frames;
        let seconds = (0..num_frames).map(|frame| (frame as f64 / f64::from(shape.fps)) as f32);
        let always = |value: usize| std::iter::repeat_n(value, num_frames);
        columns.extend([
            Column::plain("timestamp", Values::F32(seconds.collect())),
            integers("frame_index", 0..num_frames),
            integers("episode_index", always(place.episode)),
            integers("index", place.first_index..place.first_index + num_frames),
            integers("task_index", always(place.task)),
        ]);
        let names = std::iter::once("joints".to_owned())
            .chain(shape.setup.streams.iter().map(|stream| stream.id.clone()));
        let ages = names.zip(logs).map(|(name, log)| Some((name, clock.longest_age_s(log)?)));
        Some(Self {
            num_frames,
            first_s: clock.start_ns as f64 / 1e9,
            longest_age_s: ages.collect::<Option<_>>()?,
            columns,
        })
    }
}

/// The newest row of `log` at each frame; `None` if there is none at one.
fn sampled(clock: &Clock, log: &Log<f64>, width: usize) -> Option<Vec<f32>> {
    let mut values = Vec::with_capacity(clock.num_frames * width);
    for sample in clock.newest(&log.times_ns) {
        let sample = sample?;
        values
            .extend(log.values.get(sample * width..(sample + 1) * width)?.iter().map(|&value| value as f32));
    }
    Some(values)
}

/// Where the object is at each frame: as its newest pose says; before the first pose it stands there. NaN where nothing
/// says so.
fn object_poses(clock: &Clock, log: &Log<f64>) -> Vec<f32> {
    let width = POSE_NAMES.len();
    let mut values = Vec::with_capacity(clock.num_frames * width);
    for sample in clock.newest(&log.times_ns) {
        let first = sample.unwrap_or(0) * width;
        match log.values.get(first..first + width) {
            Some(pose) => values.extend(pose.iter().map(|&value| value as f32)),
            None => values.extend([f32::NAN; POSE_NAMES.len()]),
        }
    }
    values
}

/// What is written as action, given the sampled `state`; `None` where there is none.
fn action(
    action: Action,
    clock: &Clock,
    episode: &Episode,
    state: &[f32],
    num_dofs: usize,
) -> Option<Vec<f32>> {
    match action {
        Action::None => None,
        Action::NextState => {
            let last = &state[state.len() - num_dofs..];
            Some([&state[num_dofs..], last].concat())
        }
        Action::Commands => {
            let commands = &episode.commands;
            let mut values = Vec::with_capacity(state.len());
            for (sample, state) in clock.newest(&commands.times_ns).zip(state.chunks_exact(num_dofs)) {
                match sample
                    .and_then(|sample| commands.values.get(sample * num_dofs..(sample + 1) * num_dofs))
                {
                    Some(command) => values.extend(command.iter().map(|&value| value as f32)),
                    // Nobody has said anything yet.
                    None => values.extend_from_slice(state),
                }
            }
            Some(values)
        }
    }
}
