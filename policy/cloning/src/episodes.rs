//! What an expert did.

use std::sync::Arc;

use palpate_training::{generator, permutation};

use crate::history::observation;
use crate::{CloneConfig, CloneError, Moment, Shape};

/// What noise is for: which episodes are held out.
const HELD_OUT: u64 = 3;

/// What the robot knew in a control step, and what the expert made of it.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// What was known.
    pub moment: Moment<'a>,
    /// Where each joint was sent, rad or m.
    pub targets: &'a [f64],
    /// Whether the expert said that it holds the object.
    pub claims_held: bool,
}

/// One trial of an expert, step by step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Episode {
    /// `[steps, 2 * dofs + channels + features]`: commands, how far joints are from them (rad or m), channels (0 or 1,
    /// or from 0 to 1 with [`Self::with_strengths`]), features of an encoder.
    pub frames: Vec<f32>,
    /// `[steps, dofs + 1]`: where each joint was sent (rad or m), and whether the expert claimed to hold the object (0
    /// or 1).
    pub targets: Vec<f32>,
    /// `[steps]`: time since the trial began, s.
    pub times_s: Vec<f32>,
    /// Half the edge length of the square that the object began in, m; `None` where nobody kept it.
    pub half_width_m: Option<f32>,
    /// The first step that is learned from, 0 for all: before it somebody else than the expert moved the robot. What was seen
    /// then is in the windows of later steps all the same.
    pub taught_from: usize,
}

impl Episode {
    /// Adds the next step, of a robot of this `shape`.
    ///
    /// # Panics
    /// If its numbers are not as many as the shape says: a caller's bug.
    pub fn push(&mut self, shape: Shape, step: &Step<'_>) {
        assert_eq!(step.targets.len(), shape.dofs, "one target per joint");
        self.frames.extend(shape.frame(&step.moment));
        self.targets.extend(step.targets.iter().map(|&target| target as f32));
        self.targets.push(f32::from(u8::from(step.claims_held)));
        self.times_s.push(step.moment.time_s as f32);
    }

    /// This episode of a robot of this `shape`, which has no features, with `features` of `num_features` numbers for each
    /// step.
    ///
    /// # Panics
    /// If they are not as many: a caller's bug.
    pub fn with_features(&self, shape: Shape, num_features: usize, features: &[f32]) -> Self {
        let frame_len = shape.frame_len();
        assert_eq!(
            [self.frames.len(), features.len()],
            [self.len() * frame_len, self.len() * num_features],
            "one frame and its features per step"
        );
        let mut frames = Vec::with_capacity(self.frames.len() + features.len());
        for step in 0..self.len() {
            frames.extend_from_slice(&self.frames[step * frame_len..][..frame_len]);
            frames.extend_from_slice(&features[step * num_features..][..num_features]);
        }
        Self { frames, ..self.clone() }
    }

    /// This episode of a robot of this `shape` with how strongly each channel was touched, `[steps, channels]` from 0
    /// to 1, in place of whether it was on.
    ///
    /// # Panics
    /// If they are not as many: a caller's bug.
    #[must_use]
    pub fn with_strengths(mut self, shape: Shape, strengths: &[f32]) -> Self {
        assert_eq!(strengths.len(), self.len() * shape.channels, "one strength per channel and step");
        let frames = self.frames.chunks_exact_mut(shape.frame_len());
        for (frame, strengths) in frames.zip(strengths.chunks_exact(shape.channels)) {
            frame[2 * shape.dofs..][..shape.channels].copy_from_slice(strengths);
        }
        self
    }

    /// Steps.
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.times_s.is_empty()
    }
}

/// The file of the encoder that made features. What is in it only those know who make features.
#[derive(Clone, Debug, PartialEq)]
pub struct EncoderFile {
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// Their SHA-256, in hexadecimal digits.
    pub sha256: String,
    /// Numbers that it makes of a moment.
    pub num_features: usize,
}

/// Episodes of one robot.
#[derive(Clone, Debug)]
pub struct Episodes {
    shape: Shape,
    episodes: Vec<Episode>,
    encoder: Option<Arc<EncoderFile>>,
}

/// An observation and the chunk that followed it.
pub(crate) struct Sample {
    pub(crate) input: Vec<f32>,
    pub(crate) chunk: Vec<f32>,
}

impl Episodes {
    /// Episodes of a robot of this `shape`.
    ///
    /// # Errors
    /// An episode with another number of numbers, or with some that are none.
    pub fn new(shape: Shape, episodes: Vec<Episode>) -> Result<Self, CloneError> {
        for (idx, episode) in episodes.iter().enumerate() {
            let steps = episode.len();
            let sizes = [
                ("frames", &episode.frames, steps * shape.frame_len()),
                ("targets", &episode.targets, steps * shape.action_len()),
                ("times", &episode.times_s, steps),
            ];
            for (what, values, expected) in sizes {
                if values.len() != expected {
                    let found = values.len();
                    return Err(CloneError::Shape(format!(
                        "episode {idx} has {found} numbers of {what} in {steps} steps, expected {expected}"
                    )));
                }
                if let Some(value) = values.iter().find(|value| !value.is_finite()) {
                    return Err(CloneError::Shape(format!(
                        "episode {idx} has {value} in its {what}, expected finite numbers"
                    )));
                }
            }
        }
        Ok(Self { shape, episodes, encoder: None })
    }

    /// The same, whose features `encoder` made.
    ///
    /// # Errors
    /// An encoder that makes another number of features.
    pub fn encoded_by(self, encoder: Arc<EncoderFile>) -> Result<Self, CloneError> {
        let (found, made) = (self.shape.features, encoder.num_features);
        if found != made {
            return Err(CloneError::Shape(format!(
                "the episodes have {found} features in each step, their encoder makes {made}"
            )));
        }
        Ok(Self { encoder: Some(encoder), ..self })
    }

    /// What made their features, if they have any.
    pub fn encoder(&self) -> Option<&Arc<EncoderFile>> {
        self.encoder.as_ref()
    }

    /// Sizes of the robot.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// Half the edge lengths of the squares that objects began in, m, by episode; `None` where nobody kept it.
    pub(crate) fn half_widths_m(&self) -> impl Iterator<Item = Option<f32>> {
        self.episodes.iter().map(|episode| episode.half_width_m)
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.episodes.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.episodes.is_empty()
    }

    /// Steps of all of them that are learned from.
    pub fn num_steps(&self) -> usize {
        self.moments().len()
    }

    /// Episodes to learn from and held-out ones, at least one each where there are two.
    pub fn split(self, config: &CloneConfig) -> [Self; 2] {
        let num_held_out = ((self.len() as f64 * config.held_out_share).round() as usize).max(1);
        let order = permutation(&mut generator(config.seed, HELD_OUT, 0, 0), self.len());
        let mut is_held_out = vec![false; self.len()];
        order.iter().take(num_held_out).for_each(|&idx| is_held_out[idx] = true);
        let (mut train, mut held_out) = (Vec::new(), Vec::new());
        for (episode, is_held_out) in self.episodes.into_iter().zip(is_held_out) {
            if is_held_out { held_out.push(episode) } else { train.push(episode) }
        }
        [train, held_out].map(|episodes| Self { shape: self.shape, episodes, encoder: self.encoder.clone() })
    }

    /// Episode and step of every sample: the expert's.
    pub(crate) fn moments(&self) -> Vec<(usize, usize)> {
        let taught = |episode: &Episode| episode.taught_from.min(episode.len())..episode.len();
        let of = |(idx, episode): (usize, &Episode)| taught(episode).map(move |step| (idx, step));
        self.episodes.iter().enumerate().flat_map(of).collect()
    }

    /// The sample of a moment. A chunk that reaches beyond the end repeats the last targets.
    pub(crate) fn sample(&self, config: &CloneConfig, (idx, step): (usize, usize)) -> Sample {
        let episode = &self.episodes[idx];
        let (frame_len, action_len) = (self.shape.frame_len(), self.shape.action_len());
        let frame = |back: usize| &episode.frames[step.saturating_sub(back) * frame_len..][..frame_len];
        let time_s = f64::from(episode.times_s[step]);
        let input = observation(&config.observation, self.shape, (time_s, episode.half_width_m), frame);
        let from: Vec<f32> = self.shape.joints(config.relative_to, frame(0)).collect();
        let mut chunk = Vec::with_capacity(config.predicted * action_len);
        for ahead in 0..config.predicted {
            let at = (step + ahead).min(episode.len() - 1);
            let (targets, claim) = episode.targets[at * action_len..][..action_len].split_at(self.shape.dofs);
            chunk.extend(targets.iter().zip(&from).map(|(target, from)| target - from));
            chunk.extend_from_slice(claim);
        }
        Sample { input, chunk }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{History, JointValues, ObservationConfig, Touch};

    /// Episodes of a robot of one joint and one channel that goes to 1 in steps of `pace`, and feels something at the
    /// end.
    pub(crate) fn reaching(paces: &[f64], steps: usize) -> Episodes {
        let shape = Shape { dofs: 1, channels: 1, features: 0 };
        let episode = |&pace: &f64| {
            let mut episode = Episode::default();
            let mut command = 0.0;
            for step in 0..steps {
                let target = f64::min(command + pace, 1.0);
                let moment = Moment {
                    time_s: 0.05 * step as f64,
                    positions: &[command - 0.1 * pace],
                    commands: &[command],
                    touch: Touch::Events(&[command >= 1.0]),
                    features: &[],
                };
                episode.push(shape, &Step { moment, targets: &[target], claims_held: command >= 1.0 });
                command = target;
            }
            episode
        };
        Episodes::new(shape, paces.iter().map(episode).collect()).expect("they fit")
    }

    /// What [`encoded`] makes of a moment: where the joint is, and what it feels, in other words.
    pub(crate) fn features_of(position: f64, active: bool) -> [f32; 3] {
        [2.0 * position as f32, f32::from(u8::from(active)) - 0.5, (7.0 * position as f32).sin()]
    }

    /// An encoder, as far as anybody here can tell; `name` tells it from others.
    pub(crate) fn encoder(name: &str) -> Arc<EncoderFile> {
        let (bytes, sha256) = (format!("encoder {name}").into_bytes(), format!("digest of {name}"));
        Arc::new(EncoderFile { bytes, sha256, num_features: 3 })
    }

    /// The same episodes with features, made by the encoder called `name`.
    pub(crate) fn encoded(paces: &[f64], steps: usize, name: &str) -> Episodes {
        let plain = reaching(paces, steps);
        let of_frame = |frame: &[f32]| features_of(f64::from(frame[0]) - f64::from(frame[1]), frame[2] > 0.0);
        let episode = |episode: &Episode| {
            let features: Vec<f32> = episode.frames.chunks(3).flat_map(of_frame).collect();
            episode.with_features(plain.shape, 3, &features)
        };
        let episodes = plain.episodes.iter().map(episode).collect();
        let shape = Shape { features: 3, ..plain.shape };
        Episodes::new(shape, episodes).and_then(|all| all.encoded_by(encoder(name))).expect("they fit")
    }

    impl Episodes {
        /// The same with `count` more numbers in each frame.
        pub(crate) fn with_numbers(self, count: usize) -> Self {
            let shape = self.shape;
            let numbers = |steps: usize| (0..steps * count).map(|idx| (idx as f32).sin()).collect::<Vec<_>>();
            let episodes = self.episodes.iter();
            let episodes = episodes.map(|one| one.with_features(shape, count, &numbers(one.len()))).collect();
            Self::new(Shape { features: count, ..shape }, episodes).expect("they fit")
        }

        /// The same, all of one region.
        pub(crate) fn in_one_region(mut self, half_width_m: f32) -> Self {
            self.episodes.iter_mut().for_each(|episode| episode.half_width_m = Some(half_width_m));
            self
        }
    }

    #[test]
    fn a_chunk_is_where_the_expert_went_from_the_last_command() {
        let episodes = reaching(&[0.25], 6);
        let config = CloneConfig { predicted: 3, ..CloneConfig::default() };
        assert_eq!(episodes.sample(&config, (0, 1)).chunk, [0.25, 0.0, 0.5, 0.0, 0.75, 0.0]);
        // At the end the last targets are repeated.
        assert_eq!(episodes.sample(&config, (0, 5)).chunk, [0.0, 1.0].repeat(3));
    }

    #[test]
    fn a_chunk_may_be_where_the_expert_went_from_where_joints_were_read() {
        let episodes = reaching(&[0.25], 6);
        let config =
            CloneConfig { predicted: 2, relative_to: JointValues::Positions, ..CloneConfig::default() };
        // Joints are read a tenth of a step behind their commands.
        let chunk = episodes.sample(&config, (0, 1)).chunk;
        for (found, expected) in chunk.iter().zip([0.275, 0.0, 0.525, 0.0]) {
            assert!((found - expected).abs() < 1e-6, "{chunk:?}");
        }
    }

    #[test]
    fn only_the_experts_part_of_an_episode_teaches_and_what_came_before_is_seen() {
        let mut episodes = reaching(&[0.25, 0.1], 6);
        let all = episodes.moments();
        episodes.episodes[0].taught_from = 4;
        assert_eq!(episodes.moments(), [&[(0, 4), (0, 5)], &all[6..]].concat());
        let config = CloneConfig::default();
        let before = episodes.sample(&config, (0, 4));
        episodes.episodes[0].taught_from = 0;
        assert_eq!(episodes.sample(&config, (0, 4)).input, before.input);
        episodes.episodes[0].taught_from = 7;
        assert_eq!(episodes.moments(), all[6..]);
    }

    #[test]
    fn training_sees_the_bits_that_a_policy_sees() {
        let episodes = reaching(&[0.07], 40);
        for observation in [
            ObservationConfig { frames: 4, stride: 3, ..ObservationConfig::default() },
            ObservationConfig { frames: 2, stride: 5, touch: false, ..ObservationConfig::default() },
        ] {
            let config = CloneConfig { observation: observation.clone(), ..CloneConfig::default() };
            let mut history = History::new(observation, episodes.shape(), None);
            let mut command = 0.0;
            for step in 0..40 {
                history.see(&Moment {
                    time_s: f64::from(0.05_f32 * step as f32),
                    positions: &[command - 0.1 * 0.07],
                    commands: &[command],
                    touch: Touch::Events(&[command >= 1.0]),
                    features: &[],
                });
                let [seen, learned] = [history.observation(), episodes.sample(&config, (0, step)).input];
                let (time, rest) = (seen.len() - 1, ..seen.len() - 1);
                assert_eq!(seen[rest], learned[rest]);
                assert!((seen[time] - learned[time]).abs() < 1e-6);
                command = f64::min(command + 0.07, 1.0);
            }
        }
    }

    #[test]
    fn strengths_stand_where_events_were() {
        let shape = Shape { dofs: 1, channels: 1, features: 0 };
        let episode = reaching(&[0.5], 3).episodes.remove(0);
        let strengths = [0.0, 0.25, 1.0];
        let strong = episode.clone().with_strengths(shape, &strengths);
        for ((plain, strong), strength) in
            episode.frames.chunks(3).zip(strong.frames.chunks(3)).zip(strengths)
        {
            assert_eq!((&plain[..2], strength), (&strong[..2], strong[2]));
        }
        let seen = Moment {
            time_s: 0.0,
            positions: &[-0.05],
            commands: &[0.0],
            touch: Touch::Strengths(&[0.25]),
            features: &[],
        };
        assert_eq!(shape.frame(&seen)[2..], [0.25]);
    }

    #[test]
    fn each_episode_is_learned_from_or_held_out() {
        let paces: Vec<f64> = (1..=40).map(|idx| 0.01 * f64::from(idx)).collect();
        let config = CloneConfig { held_out_share: 0.1, ..CloneConfig::default() };
        let [train, held_out] = reaching(&paces, 3).split(&config);
        assert_eq!((train.len(), held_out.len(), train.num_steps()), (36, 4, 108));
        let again = reaching(&paces, 3).split(&config);
        assert_eq!(again[1].episodes, held_out.episodes, "the seed says which");
    }

    #[test]
    fn features_stand_behind_what_they_were_made_of() {
        let (plain, encoded) = (reaching(&[0.07], 5), encoded(&[0.07], 5, "a"));
        assert_eq!(encoded.shape(), Shape { dofs: 1, channels: 1, features: 3 });
        let [plain, with] = [&plain, &encoded].map(|episodes| &episodes.episodes[0]);
        for (plain, with) in plain.frames.chunks(3).zip(with.frames.chunks(6)) {
            assert_eq!(plain, &with[..3]);
            assert_eq!(features_of(f64::from(plain[0]) - f64::from(plain[1]), plain[2] > 0.0), with[3..]);
        }
        let [_, held_out] = encoded.split(&CloneConfig { held_out_share: 0.5, ..CloneConfig::default() });
        assert_eq!(held_out.encoder(), Some(&encoder("a")), "whoever holds a part knows who made it");
        let problem = reaching(&[0.07], 5).encoded_by(encoder("a")).expect_err("they have none").to_string();
        assert_eq!(problem, "the episodes have 0 features in each step, their encoder makes 3");
    }

    #[test]
    fn numbers_that_do_not_fit_are_refused() {
        let shape = Shape { dofs: 1, channels: 1, features: 0 };
        let good = reaching(&[0.5], 2).episodes.remove(0);
        let refused = |spoil: &dyn Fn(&mut Episode)| {
            let mut episode = good.clone();
            spoil(&mut episode);
            Episodes::new(shape, vec![good.clone(), episode]).expect_err("it is wrong").to_string()
        };
        assert_eq!(
            refused(&|episode| episode.targets.truncate(3)),
            "episode 1 has 3 numbers of targets in 2 steps, expected 4"
        );
        assert_eq!(
            refused(&|episode| episode.frames[0] = f32::NAN),
            "episode 1 has NaN in its frames, expected finite numbers"
        );
    }
}
