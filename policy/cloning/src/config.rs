//! How to learn, as a file.

use palpate_training::{Expectation, TrainingError};
use serde::{Deserialize, Serialize};

use crate::CloneError;

/// What turns an observation into a chunk of actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Head {
    /// Predicts the mean of what the expert does: mean squared error.
    Regression,
    /// Draws from what the expert does: a one-dimensional U-Net with FiLM that predicts noise.
    Diffusion,
    /// Predicts what the expert does in the commonest style: a conditional variational autoencoder of Transformers.
    Act,
}

/// What a diffusion predicts of a chunk that noise was added to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Predicts {
    /// The chunk itself.
    #[default]
    Chunk,
    /// The noise (Ho et al. 2020). What is wrong about it counts in the chunk over the share of the signal that is left, so
    /// it takes more updates until a policy can act.
    Noise,
}

/// What is made small between a chunk and what is predicted of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActLoss {
    /// The mean absolute error.
    Absolute,
    /// The mean squared error.
    Squared,
}

/// What makes one observation of a window of frames, before the head.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Memory {
    /// All frames side by side.
    Window,
    /// The last state of a GRU that reads one frame after the other, the oldest first.
    Recurrent,
}

/// Which numbers stand for the joints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointValues {
    /// Where each joint was sent last.
    #[default]
    Commands,
    /// Where each joint is as it is read.
    Positions,
}

/// How to learn. Fields that a file leaves out have the values of the preset `small`, which are given here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CloneConfig {
    /// Seed of weights, order and noise; 0.
    pub seed: u64,
    /// Updates, at least 1; 16000.
    pub updates: u64,
    /// Samples of an update, at least 1; 128.
    pub batch_size: usize,
    /// Step size of AdamW after the warm-up, in 0..=1; 3e-4. It falls along a half cosine to zero.
    pub learning_rate: f64,
    /// Updates over which the step size rises from zero; 500.
    pub warmup_updates: u64,
    /// What AdamW takes from each parameter, over the step size, 0 or more; 1e-6.
    pub weight_decay: f64,
    /// Longest gradient, over all parameters, above 0; 1.
    pub max_gradient_norm: f64,
    /// The policy's parameters are a moving average of those that are learned; its memory grows up to this share, below
    /// 1; 0.999.
    pub average_decay: f64,
    /// Updates between checkpoints, at least 1; 500. Held-out episodes are predicted then.
    pub checkpoint_updates: u64,
    /// Share of episodes that nothing is learned from, above 0, below 1; 0.05.
    pub held_out_share: f64,
    /// H: steps of a chunk, at least 1, for diffusion even; 8.
    pub predicted: usize,
    /// N_a: steps of a chunk that are carried out before the policy looks again, 1 to `predicted`; 3.
    pub executed: usize,
    /// What the steps of a chunk are differences to; commands. Left out of files where it is commands.
    #[serde(skip_serializing_if = "is_default")]
    pub relative_to: JointValues,
    /// What is seen.
    pub observation: ObservationConfig,
    /// How the frames of a window are joined; side by side.
    pub memory: Memory,
    /// What only a recurrent memory needs.
    pub recurrent: RecurrentConfig,
    /// Widths of the layers that every head begins with, at least one; 512, 512, 256.
    pub trunk: Vec<usize>,
    /// What predicts.
    pub head: Head,
    /// What only diffusion needs.
    pub diffusion: DiffusionConfig,
    /// What only action chunking with Transformers needs; absent for the defaults of [`ActConfig`], and in the files of policies
    /// with another head, so that those of before keep their bytes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub act: Option<ActConfig>,
}

/// What a policy sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObservationConfig {
    /// T_o: frames of a window, at least 1; 16.
    pub frames: usize,
    /// Steps from a frame to the next, at least 1; 8. What was felt some seconds ago says where not to look again.
    pub stride: usize,
    /// Which channels are on; yes.
    pub touch: bool,
    /// How strongly each channel is touched, in place of whether it is on; no. Only simulated touch tells it, so a
    /// policy that sees it moves no hand. Left out of files where it is not seen.
    #[serde(skip_serializing_if = "is_default")]
    pub strengths: bool,
    /// How far each joint is from where it was sent; yes.
    pub tracking: bool,
    /// What is seen of each joint; where it was sent, and with `tracking` how far it is from there. Where positions are
    /// seen, commands are not, nor how far joints are from them. Left out of files where it is commands.
    #[serde(skip_serializing_if = "is_default")]
    pub joints: JointValues,
    /// The features that a pretrained encoder makes of each frame; no. They are made of what `touch` and `tracking` let the
    /// policy see, and the episodes have to come with them.
    pub features: bool,
    /// Of each frame where every channel's taxel is in the hand's frame and whether it is on; no. The episodes have to come with
    /// that, as they do with features, and it goes without these. Left out of files where it is not seen.
    #[serde(skip_serializing_if = "is_default")]
    pub points: bool,
    /// Half the edge length of the square that the object begins in, which whoever starts a trial knows; no. The episodes have
    /// to say it. Left out of files where it is not seen, so that policies of before keep their bytes.
    #[serde(skip_serializing_if = "is_default")]
    pub region: bool,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// A gated recurrent unit (Cho et al. 2014).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecurrentConfig {
    /// Numbers of its state, at least 1; 128.
    pub width: usize,
}

/// Denoising diffusion (Ho et al. 2020), with the cosine schedule of Nichol and Dhariwal 2021.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DiffusionConfig {
    /// Channels of the two levels of the U-Net, at least 1 each; 64 and 128.
    pub channels: [usize; 2],
    /// Taps of a convolution, odd; 3.
    pub kernel: usize,
    /// Steps in which noise is added, at least 2; 50.
    pub steps: usize,
    /// Steps in which it is taken away (DDIM, Song et al. 2021), 1 to `steps`; 10.
    pub sampled_steps: usize,
    /// What is predicted; absent for the chunk, and in the files of policies with another head. Files of diffusion policies
    /// that do not say it are from before it could be chosen, and predict the noise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub predicts: Option<Predicts>,
}

/// Action chunking with Transformers (Zhao et al. 2023).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ActConfig {
    /// Numbers of a token, at least 1; 128.
    pub width: usize,
    /// Heads of an attention, a divisor of `width`; 4.
    pub heads: usize,
    /// Hidden numbers of a feed-forward part, at least 1; 512.
    pub feed_forward: usize,
    /// Layers of the decoder, at least 1; 2.
    pub layers: usize,
    /// Layers of the encoder that reads the style off a chunk, at least 1; 2.
    pub style_layers: usize,
    /// Numbers of the style, at least 1; 16.
    pub style: usize,
    /// Beta: what the divergence of the style from its prior counts beside the error, 0 or more; 10.
    pub divergence_weight: f64,
    /// What the error is; absolute.
    pub loss: ActLoss,
}

impl Default for ActConfig {
    fn default() -> Self {
        Self {
            width: 128,
            heads: 4,
            feed_forward: 512,
            layers: 2,
            style_layers: 2,
            style: 16,
            divergence_weight: 10.0,
            loss: ActLoss::Absolute,
        }
    }
}

impl Default for CloneConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            updates: 16_000,
            batch_size: 128,
            learning_rate: 3e-4,
            warmup_updates: 500,
            weight_decay: 1e-6,
            max_gradient_norm: 1.0,
            average_decay: 0.999,
            checkpoint_updates: 500,
            held_out_share: 0.05,
            predicted: 8,
            executed: 3,
            relative_to: JointValues::Commands,
            observation: ObservationConfig::default(),
            memory: Memory::Window,
            recurrent: RecurrentConfig::default(),
            trunk: vec![512, 512, 256],
            head: Head::Regression,
            diffusion: DiffusionConfig::default(),
            act: None,
        }
    }
}

impl Default for ObservationConfig {
    fn default() -> Self {
        Self {
            frames: 16,
            stride: 8,
            touch: true,
            strengths: false,
            tracking: true,
            joints: JointValues::Commands,
            features: false,
            points: false,
            region: false,
        }
    }
}

impl Default for RecurrentConfig {
    fn default() -> Self {
        Self { width: 128 }
    }
}

impl Default for DiffusionConfig {
    fn default() -> Self {
        Self { channels: [64, 128], kernel: 3, steps: 50, sampled_steps: 10, predicts: None }
    }
}

impl DiffusionConfig {
    /// What is predicted of a chunk that noise was added to.
    pub fn predicts(&self) -> Predicts {
        self.predicts.unwrap_or_default()
    }
}

impl CloneConfig {
    /// Preset `small` (two cores, a quarter of an hour) or `paper` (the method's numbers).
    ///
    /// # Errors
    /// Any other name.
    pub fn preset(name: &str) -> Result<Self, CloneError> {
        match name {
            "small" => Self::from_toml("preset small", include_str!("../presets/small.toml")),
            "paper" => Self::from_toml("preset paper", include_str!("../presets/paper.toml")),
            other => Err(CloneError::Shape(format!("the preset is {other:?}, expected small or paper"))),
        }
    }

    /// Reads `text`; `file` names it in errors.
    ///
    /// # Errors
    /// Unknown fields, wrong types and values that make no sense, each with its line.
    ///
    /// ```
    /// # use palpate_cloning::{CloneConfig, Head};
    /// let config = CloneConfig::from_toml("run.toml", "head = \"diffusion\"")?;
    /// assert_eq!((config.head, config.predicted), (Head::Diffusion, 8));
    /// let err = CloneConfig::from_toml("run.toml", "seed = 1\nexecuted = 9").unwrap_err();
    /// assert_eq!(err.to_string(), "run.toml:2: executed is 9, expected 1 to predicted");
    /// # Ok::<(), palpate_cloning::CloneError>(())
    /// ```
    pub fn from_toml(file: &str, text: &str) -> Result<Self, CloneError> {
        let config: Self = palpate_training::parse(file, text)?;
        palpate_training::check(file, text, config.expectations())?;
        Ok(config)
    }

    /// This configuration as a file with every field, but for those that say where they are left out.
    pub fn to_toml(&self) -> String {
        toml::to_string(&self.spelled_out()).expect("numbers, tables and names are TOML")
    }

    /// This configuration as its file has it: what only one head needs is said in full where that is the head, and left out
    /// elsewhere.
    pub(crate) fn spelled_out(&self) -> Self {
        let act = (self.head == Head::Act).then(|| self.act());
        let predicts = (self.head == Head::Diffusion).then(|| self.diffusion.predicts());
        Self { act, diffusion: DiffusionConfig { predicts, ..self.diffusion.clone() }, ..self.clone() }
    }

    /// What action chunking with Transformers needs.
    pub fn act(&self) -> ActConfig {
        self.act.clone().unwrap_or_default()
    }

    /// Whether the loss is the mean absolute error and not the mean squared one.
    pub(crate) fn is_loss_absolute(&self) -> bool {
        self.head == Head::Act && self.act().loss == ActLoss::Absolute
    }

    /// Whether every value makes sense.
    ///
    /// # Errors
    /// The first field that does not.
    pub fn validate(&self) -> Result<(), TrainingError> {
        palpate_training::check("configuration", "", self.expectations())
    }

    fn expectations(&self) -> Vec<Expectation> {
        let (count, share) = (Expectation::count, Expectation::share);
        let below_one = |path, value: f64, least: bool| Expectation {
            path,
            value: value.to_string(),
            holds: (value > 0.0 || (least && value == 0.0)) && value < 1.0,
            expected: if least { "a number in 0..1" } else { "a number above 0 and below 1" },
        };
        let within = |path, value: usize, most: usize, expected| Expectation {
            path,
            value: value.to_string(),
            holds: (1..=most).contains(&value),
            expected,
        };
        // Positions say how far joints are from their commands.
        let positions = |path, values: JointValues| Expectation {
            path,
            value: format!("{values:?}").to_lowercase(),
            holds: values == JointValues::Commands || self.observation.tracking,
            expected: "commands where observation.tracking is false",
        };
        let (diffusion, act) = (&self.diffusion, self.act());
        vec![
            count(&["updates"], self.updates),
            count(&["batch_size"], self.batch_size as u64),
            share(&["learning_rate"], self.learning_rate),
            Expectation::not_negative(&["weight_decay"], self.weight_decay),
            Expectation::positive(&["max_gradient_norm"], self.max_gradient_norm),
            below_one(&["average_decay"], self.average_decay, true),
            count(&["checkpoint_updates"], self.checkpoint_updates),
            below_one(&["held_out_share"], self.held_out_share, false),
            count(&["predicted"], self.predicted as u64),
            Expectation {
                path: &["predicted"],
                value: self.predicted.to_string(),
                holds: self.head != Head::Diffusion || self.predicted.is_multiple_of(2),
                expected: "an even number for diffusion",
            },
            within(&["executed"], self.executed, self.predicted, "1 to predicted"),
            positions(&["relative_to"], self.relative_to),
            count(&["observation", "frames"], self.observation.frames as u64),
            count(&["observation", "stride"], self.observation.stride as u64),
            Expectation {
                path: &["observation", "points"],
                value: self.observation.points.to_string(),
                holds: !(self.observation.points && self.observation.features),
                expected: "false where observation.features is true: an encoder is told the points",
            },
            positions(&["observation", "joints"], self.observation.joints),
            Expectation {
                path: &["observation", "strengths"],
                value: self.observation.strengths.to_string(),
                holds: !self.observation.strengths || (self.observation.touch && !self.observation.features),
                expected: "false where observation.touch is false or observation.features is true: encoders are told events",
            },
            count(&["recurrent", "width"], self.recurrent.width as u64),
            Expectation {
                path: &["trunk"],
                value: format!("{:?}", self.trunk),
                holds: !self.trunk.is_empty() && self.trunk.iter().all(|&width| width >= 1),
                expected: "one width or more, each 1 or more",
            },
            Expectation {
                path: &["diffusion", "channels"],
                value: format!("{:?}", diffusion.channels),
                holds: diffusion.channels.iter().all(|&width| width >= 1),
                expected: "two numbers, each 1 or more",
            },
            Expectation {
                path: &["diffusion", "kernel"],
                value: diffusion.kernel.to_string(),
                holds: !diffusion.kernel.is_multiple_of(2),
                expected: "an odd number",
            },
            Expectation {
                path: &["diffusion", "steps"],
                value: diffusion.steps.to_string(),
                holds: diffusion.steps >= 2,
                expected: "2 or more",
            },
            within(
                &["diffusion", "sampled_steps"],
                diffusion.sampled_steps,
                diffusion.steps,
                "1 to diffusion.steps",
            ),
            count(&["act", "width"], act.width as u64),
            Expectation {
                path: &["act", "heads"],
                value: act.heads.to_string(),
                holds: act.heads >= 1 && act.width.is_multiple_of(act.heads),
                expected: "a divisor of act.width",
            },
            count(&["act", "feed_forward"], act.feed_forward as u64),
            count(&["act", "layers"], act.layers as u64),
            count(&["act", "style_layers"], act.style_layers as u64),
            count(&["act", "style"], act.style as u64),
            Expectation::not_negative(&["act", "divergence_weight"], act.divergence_weight),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(text: &str) -> String {
        CloneConfig::from_toml("run.toml", text).expect_err(text).to_string()
    }

    #[test]
    fn the_paper_preset_is_the_papers_numbers() {
        let paper = CloneConfig::preset("paper").expect("a preset");
        assert_eq!((paper.observation.frames, paper.predicted, paper.executed), (5, 8, 3));
        assert_eq!((paper.learning_rate, paper.weight_decay, paper.warmup_updates), (1e-4, 1e-6, 2000));
        assert_eq!((paper.batch_size, paper.diffusion.channels), (512, [256, 512]));
        assert_eq!(paper.diffusion.predicts(), Predicts::Noise);
        assert_eq!((paper.head, paper.observation.stride), (Head::Diffusion, 1));
        let act = paper.act();
        assert_eq!((act.layers, act.width, act.heads, act.feed_forward), (4, 512, 8, 2048));
        assert_eq!(act.loss, ActLoss::Squared);
    }

    #[test]
    fn presets_survive_their_own_file_and_the_small_one_is_what_is_left_out() {
        for name in ["small", "paper"] {
            let config = CloneConfig::preset(name).expect("a preset");
            let again = CloneConfig::from_toml("again", &config.to_toml()).expect("its own file");
            assert_eq!(again, config.spelled_out());
        }
        assert_eq!(CloneConfig::preset("small").expect("a preset"), CloneConfig::default());
    }

    #[test]
    fn what_act_needs_is_part_of_a_file_only_where_it_is_the_head() {
        let mut config = CloneConfig {
            act: Some(ActConfig { width: 8, ..ActConfig::default() }),
            ..CloneConfig::default()
        };
        assert!(!config.to_toml().contains("[act]"), "files of before keep their bytes");
        config = CloneConfig { head: Head::Act, act: None, ..config };
        let again = CloneConfig::from_toml("again", &config.to_toml()).expect("its own file");
        assert_eq!(again.act, Some(ActConfig::default()), "all of it, should a default ever change");
        assert_eq!(again.spelled_out(), config.spelled_out());
    }

    #[test]
    fn what_a_diffusion_predicts_is_part_of_a_file_only_where_that_is_the_head() {
        assert!(!CloneConfig::default().to_toml().contains("predicts"), "files of before keep their bytes");
        let config = CloneConfig { head: Head::Diffusion, ..CloneConfig::default() };
        let again = CloneConfig::from_toml("again", &config.to_toml()).expect("its own file");
        assert_eq!(again.diffusion.predicts, Some(Predicts::Chunk), "said, should the default ever change");
    }

    #[test]
    fn positions_are_refused_where_tracking_is_hidden() {
        let config =
            CloneConfig::from_toml("run.toml", "relative_to = \"positions\"").expect("it makes sense");
        assert!(config.to_toml().contains("relative_to = \"positions\""), "{}", config.to_toml());
        assert!(
            !CloneConfig::default().to_toml().contains("relative_to"),
            "files of before keep their bytes"
        );
        let hidden = "[observation]\ntracking = false\n";
        assert_eq!(
            refusal(&format!("relative_to = \"positions\"\n{hidden}")),
            "run.toml:1: relative_to is positions, expected commands where observation.tracking is false"
        );
        assert_eq!(
            refusal(&format!("{hidden}joints = \"positions\"\n")),
            "run.toml:3: observation.joints is positions, expected commands where observation.tracking is false"
        );
    }

    #[test]
    fn the_region_is_part_of_a_file_only_where_it_is_seen() {
        let mut config = CloneConfig::default();
        assert!(!config.to_toml().contains("region"), "files of before keep their bytes");
        config.observation.region = true;
        assert!(config.to_toml().contains("region = true"));
        assert_eq!(CloneConfig::from_toml("again", &config.to_toml()).expect("its own file"), config);
        let differs = palpate_training::difference(&CloneConfig::default(), &config);
        assert_eq!(differs, Some(("observation.region".to_owned(), "null".to_owned(), "true".to_owned())));
    }

    #[test]
    fn nonsense_is_refused_by_line_and_field() {
        for (text, expected) in [
            ("seed = 1\nupdates = 0", "run.toml:2: updates is 0, expected 1 or more"),
            ("learning_rate = nan", "run.toml:1: learning_rate is NaN, expected a number in 0..=1"),
            ("held_out_share = 0.0", "held_out_share is 0, expected a number above 0 and below 1"),
            ("average_decay = 1.0", "average_decay is 1, expected a number in 0..1"),
            ("executed = 0", "executed is 0, expected 1 to predicted"),
            (
                "head = \"diffusion\"\npredicted = 7",
                "run.toml:2: predicted is 7, expected an even number for diffusion",
            ),
            ("memory = \"attention\"", "unknown variant `attention`"),
            ("[recurrent]\nwidth = 0", "run.toml:2: recurrent.width is 0, expected 1 or more"),
            ("trunk = []", "trunk is [], expected one width or more, each 1 or more"),
            ("[diffusion]\nkernel = 4", "run.toml:2: diffusion.kernel is 4, expected an odd number"),
            (
                "[diffusion]\nsampled_steps = 51",
                "diffusion.sampled_steps is 51, expected 1 to diffusion.steps",
            ),
            ("[diffusion]\npredicts = \"slope\"", "unknown variant `slope`"),
            (
                "[observation]\nfeatures = true\npoints = true",
                "run.toml:3: observation.points is true, expected false",
            ),
            ("[act]\nwidth = 10", "act.heads is 4, expected a divisor of act.width"),
            ("[act]\nheads = 0", "run.toml:2: act.heads is 0, expected a divisor of act.width"),
            ("[act]\nstyle = 0", "run.toml:2: act.style is 0, expected 1 or more"),
            ("[act]\nloss = \"huber\"", "unknown variant `huber`"),
            ("[observation]\nframe = 3", "unknown field `frame`"),
            ("[observation]\nfeatures = 96", "run.toml:2: invalid type: integer `96`, expected a boolean"),
            ("head = \"transformer\"", "unknown variant `transformer`"),
        ] {
            let refusal = refusal(text);
            assert!(refusal.contains(expected), "{text}: {refusal}");
        }
        let refusal = CloneConfig::preset("fast").expect_err("no preset").to_string();
        assert_eq!(refusal, "the preset is \"fast\", expected small or paper");
    }
}
