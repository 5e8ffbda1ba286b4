//! What an expert did.

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
    /// `[steps, 2 * dofs + channels]`: commands, how far joints are from them (rad or m), channels (0 or 1).
    pub frames: Vec<f32>,
    /// `[steps, dofs + 1]`: where each joint was sent (rad or m), and whether the expert claimed to hold the object (0
    /// or 1).
    pub targets: Vec<f32>,
    /// `[steps]`: time since the trial began, s.
    pub times_s: Vec<f32>,
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

    /// Steps.
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.times_s.is_empty()
    }
}

/// Episodes of one robot.
#[derive(Clone, Debug)]
pub struct Episodes {
    shape: Shape,
    episodes: Vec<Episode>,
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
        Ok(Self { shape, episodes })
    }

    /// Sizes of the robot.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.episodes.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.episodes.is_empty()
    }

    /// Steps of all of them.
    pub fn num_steps(&self) -> usize {
        self.episodes.iter().map(Episode::len).sum()
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
        [train, held_out].map(|episodes| Self { shape: self.shape, episodes })
    }

    /// Episode and step of every sample.
    pub(crate) fn moments(&self) -> Vec<(usize, usize)> {
        let of = |(idx, episode): (usize, &Episode)| (0..episode.len()).map(move |step| (idx, step));
        self.episodes.iter().enumerate().flat_map(of).collect()
    }

    /// The sample of a moment. A chunk that reaches beyond the end repeats the last targets.
    pub(crate) fn sample(&self, config: &CloneConfig, (idx, step): (usize, usize)) -> Sample {
        let episode = &self.episodes[idx];
        let (frame_len, action_len) = (self.shape.frame_len(), self.shape.action_len());
        let frame = |back: usize| &episode.frames[step.saturating_sub(back) * frame_len..][..frame_len];
        let time_s = f64::from(episode.times_s[step]);
        let input = observation(&config.observation, self.shape, time_s, frame);
        let commands = &frame(0)[..self.shape.dofs];
        let mut chunk = Vec::with_capacity(config.predicted * action_len);
        for ahead in 0..config.predicted {
            let at = (step + ahead).min(episode.len() - 1);
            let (targets, claim) = episode.targets[at * action_len..][..action_len].split_at(self.shape.dofs);
            chunk.extend(targets.iter().zip(commands).map(|(target, command)| target - command));
            chunk.extend_from_slice(claim);
        }
        Sample { input, chunk }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{History, ObservationConfig};

    /// Episodes of a robot of one joint and one channel that goes to 1 in steps of `pace`, and feels something at the
    /// end.
    pub(crate) fn reaching(paces: &[f64], steps: usize) -> Episodes {
        let shape = Shape { dofs: 1, channels: 1 };
        let episode = |&pace: &f64| {
            let mut episode = Episode::default();
            let mut command = 0.0;
            for step in 0..steps {
                let target = f64::min(command + pace, 1.0);
                let moment = Moment {
                    time_s: 0.05 * step as f64,
                    positions: &[command - 0.1 * pace],
                    commands: &[command],
                    active: &[command >= 1.0],
                };
                episode.push(shape, &Step { moment, targets: &[target], claims_held: command >= 1.0 });
                command = target;
            }
            episode
        };
        Episodes::new(shape, paces.iter().map(episode).collect()).expect("they fit")
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
    fn training_sees_the_bits_that_a_policy_sees() {
        let episodes = reaching(&[0.07], 40);
        for observation in [
            ObservationConfig { frames: 4, stride: 3, ..ObservationConfig::default() },
            ObservationConfig { frames: 2, stride: 5, touch: false, tracking: true },
        ] {
            let config = CloneConfig { observation: observation.clone(), ..CloneConfig::default() };
            let mut history = History::new(observation, episodes.shape());
            let mut command = 0.0;
            for step in 0..40 {
                history.see(&Moment {
                    time_s: f64::from(0.05_f32 * step as f32),
                    positions: &[command - 0.1 * 0.07],
                    commands: &[command],
                    active: &[command >= 1.0],
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
    fn each_episode_is_learned_from_or_held_out() {
        let paces: Vec<f64> = (1..=40).map(|idx| 0.01 * f64::from(idx)).collect();
        let config = CloneConfig { held_out_share: 0.1, ..CloneConfig::default() };
        let [train, held_out] = reaching(&paces, 3).split(&config);
        assert_eq!((train.len(), held_out.len(), train.num_steps()), (36, 4, 108));
        let again = reaching(&paces, 3).split(&config);
        assert_eq!(again[1].episodes, held_out.episodes, "the seed says which");
    }

    #[test]
    fn numbers_that_do_not_fit_are_refused() {
        let shape = Shape { dofs: 1, channels: 1 };
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
