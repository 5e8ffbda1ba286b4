//! How to learn, as a file.

use palpate_training::{Expectation, TrainingError};
use serde::{Deserialize, Serialize};

use crate::EncoderError;

/// How to learn. Fields that a file leaves out have the values of the preset `quick`, which are given here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EncoderConfig {
    /// Seed of weights, order, points on surfaces, and of which demonstrations are held out; 0.
    pub seed: u64,
    /// How often the training goes through its samples, at least 1; 12.
    pub epochs: u64,
    /// Samples of an update, at least 1; 64.
    pub batch_size: usize,
    /// Step size of AdamW at the beginning, in 0..=1; 1e-3.
    pub learning_rate: f64,
    /// Step size at the end, in 0..=1; 1e-4. It falls along a line; paper: constant.
    pub final_learning_rate: f64,
    /// What AdamW takes from each parameter, over the step size, 0 or more; 0.01. The paper names none: this is PyTorch's.
    pub weight_decay: f64,
    /// Longest gradient, over all parameters, above 0; 1.
    pub max_gradient_norm: f64,
    /// Updates between checkpoints, at least 1; 250. Held-out samples are predicted then.
    pub checkpoint_updates: u64,
    /// H: frames of an input, at least 1; 16.
    pub history: usize,
    /// Every n-th frame of a demonstration is a sample, at least 1; 16.
    pub frame_stride: usize,
    /// Share of demonstrations that nothing is learned from, above 0, below 1; 0.1.
    pub held_out_share: f64,
    /// Points of the hand, at least 1, a multiple of `network.points_per_query`; 256.
    pub hand_points: usize,
    /// Points of the object, at least 2, a multiple of `network.points_per_query`; 256.
    pub object_points: usize,
    /// What the encoder sees.
    pub inputs: InputsConfig,
    /// Shape of the networks.
    pub network: NetworkConfig,
    /// What is wanted of predictions.
    pub loss: LossConfig,
}

/// What the encoder sees; what it does not see is zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InputsConfig {
    /// Places of taxels; yes.
    pub positions: bool,
    /// Activations; yes.
    pub touch: bool,
}

/// Shape of the networks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkConfig {
    /// d: numbers of a token, at least 1, a multiple of `heads`; 96.
    pub width: usize,
    /// Layers of the encoder, at least 1; 2.
    pub layers: usize,
    /// Layers of the decoder, at least 1; 1.
    pub decoder_layers: usize,
    /// Attention heads, at least 1; 4.
    pub heads: usize,
    /// Width inside feed-forward parts, at least 1; 384.
    pub feed_forward: usize,
    /// Points that one query of the decoder predicts, at least 1; 32.
    pub points_per_query: usize,
}

/// Weights of the losses, each 0 or more, with the paper's names of them; and what shapes them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// lambda_hand: Chamfer distance of the hand; 5.
    pub hand: f64,
    /// lambda_obj: Chamfer distance of the object; 5.
    pub object: f64,
    /// lambda_rot: rotation of the object; 0.1.
    pub rotation: f64,
    /// lambda_qpos: joints; 1.
    pub joints: f64,
    /// lambda_contact: contacts; 2.
    pub contact: f64,
    /// lambda_rep: points of the object that are too near each other; 0.5.
    pub repulsion: f64,
    /// lambda_pen: points of the object that are too near the hand; 0.5.
    pub penetration: f64,
    /// lambda_empty_obj: points of an object that nothing feels; 5.
    pub empty_object: f64,
    /// lambda_empty_pose: place of an object that nothing feels; 2.
    pub empty_pose: f64,
    /// Focal loss: weight of active channels against idle ones, in 0..=1; 0.25.
    pub focal_alpha: f64,
    /// Focal loss: how much what is known already counts less, 0 or more; 2.
    pub focal_gamma: f64,
    /// Points of the object repel each other below this distance, m, above 0; 0.005 (paper: 0.015).
    pub repulsion_m: f64,
    /// Points of the object are inside the hand below this distance from one of its points, m, above 0; 0.003 (paper: 0.005).
    pub penetration_m: f64,
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            epochs: 12,
            batch_size: 64,
            learning_rate: 1e-3,
            final_learning_rate: 1e-4,
            weight_decay: 0.01,
            max_gradient_norm: 1.0,
            checkpoint_updates: 250,
            history: 16,
            frame_stride: 16,
            held_out_share: 0.1,
            hand_points: 256,
            object_points: 256,
            inputs: InputsConfig::default(),
            network: NetworkConfig::default(),
            loss: LossConfig::default(),
        }
    }
}

impl Default for InputsConfig {
    fn default() -> Self {
        Self { positions: true, touch: true }
    }
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self { width: 96, layers: 2, decoder_layers: 1, heads: 4, feed_forward: 384, points_per_query: 32 }
    }
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            hand: 5.0,
            object: 5.0,
            rotation: 0.1,
            joints: 1.0,
            contact: 2.0,
            repulsion: 0.5,
            penetration: 0.5,
            empty_object: 5.0,
            empty_pose: 2.0,
            focal_alpha: 0.25,
            focal_gamma: 2.0,
            repulsion_m: 0.005,
            penetration_m: 0.003,
        }
    }
}

impl EncoderConfig {
    /// Preset `quick` (two cores, minutes) or `paper` (the method's numbers).
    ///
    /// # Errors
    /// Any other name.
    pub fn preset(name: &str) -> Result<Self, EncoderError> {
        match name {
            "quick" => Self::from_toml("preset quick", include_str!("../presets/quick.toml")),
            "paper" => Self::from_toml("preset paper", include_str!("../presets/paper.toml")),
            other => Err(TrainingError::UnknownPreset(other.to_owned()).into()),
        }
    }

    /// Reads `text`; `file` names it in errors.
    ///
    /// # Errors
    /// Unknown fields, wrong types and values that make no sense, each with its line.
    ///
    /// ```
    /// # use palpate_encoder::EncoderConfig;
    /// let config = EncoderConfig::from_toml("run.toml", "epochs = 3")?;
    /// assert_eq!((config.epochs, config.loss.hand), (3, 5.0));
    /// let err = EncoderConfig::from_toml("run.toml", "seed = 1\nhistory = 0").unwrap_err();
    /// assert_eq!(err.to_string(), "run.toml:2: history is 0, expected 1 or more");
    /// # Ok::<(), palpate_encoder::EncoderError>(())
    /// ```
    pub fn from_toml(file: &str, text: &str) -> Result<Self, EncoderError> {
        let config: Self = palpate_training::parse(file, text)?;
        palpate_training::check(file, text, config.expectations())?;
        Ok(config)
    }

    /// This configuration as a file with every field.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("numbers, tables and names are TOML")
    }

    /// Whether every value makes sense.
    ///
    /// # Errors
    /// The first field that does not.
    pub fn validate(&self) -> Result<(), EncoderError> {
        Ok(palpate_training::check("configuration", "", self.expectations())?)
    }

    fn expectations(&self) -> Vec<Expectation> {
        let (count, share) = (Expectation::count, Expectation::share);
        let (positive, weight) = (Expectation::positive, Expectation::not_negative);
        let multiple = |path, value: usize, of: usize, least: usize, expected| Expectation {
            path,
            value: value.to_string(),
            holds: value >= least && of >= 1 && value.is_multiple_of(of),
            expected,
        };
        let (network, loss) = (&self.network, &self.loss);
        vec![
            count(&["epochs"], self.epochs),
            count(&["batch_size"], self.batch_size as u64),
            share(&["learning_rate"], self.learning_rate),
            share(&["final_learning_rate"], self.final_learning_rate),
            weight(&["weight_decay"], self.weight_decay),
            positive(&["max_gradient_norm"], self.max_gradient_norm),
            count(&["checkpoint_updates"], self.checkpoint_updates),
            count(&["history"], self.history as u64),
            count(&["frame_stride"], self.frame_stride as u64),
            Expectation {
                path: &["held_out_share"],
                value: self.held_out_share.to_string(),
                holds: self.held_out_share > 0.0 && self.held_out_share < 1.0,
                expected: "a number above 0 and below 1",
            },
            count(&["network", "heads"], network.heads as u64),
            count(&["network", "points_per_query"], network.points_per_query as u64),
            multiple(
                &["network", "width"],
                network.width,
                network.heads,
                1,
                "1 or more, a multiple of network.heads",
            ),
            multiple(
                &["hand_points"],
                self.hand_points,
                network.points_per_query,
                1,
                "1 or more, a multiple of network.points_per_query",
            ),
            multiple(
                &["object_points"],
                self.object_points,
                network.points_per_query,
                2,
                "2 or more, a multiple of network.points_per_query",
            ),
            count(&["network", "layers"], network.layers as u64),
            count(&["network", "decoder_layers"], network.decoder_layers as u64),
            count(&["network", "feed_forward"], network.feed_forward as u64),
            weight(&["loss", "hand"], loss.hand),
            weight(&["loss", "object"], loss.object),
            weight(&["loss", "rotation"], loss.rotation),
            weight(&["loss", "joints"], loss.joints),
            weight(&["loss", "contact"], loss.contact),
            weight(&["loss", "repulsion"], loss.repulsion),
            weight(&["loss", "penetration"], loss.penetration),
            weight(&["loss", "empty_object"], loss.empty_object),
            weight(&["loss", "empty_pose"], loss.empty_pose),
            share(&["loss", "focal_alpha"], loss.focal_alpha),
            weight(&["loss", "focal_gamma"], loss.focal_gamma),
            positive(&["loss", "repulsion_m"], loss.repulsion_m),
            positive(&["loss", "penetration_m"], loss.penetration_m),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(text: &str) -> String {
        EncoderConfig::from_toml("run.toml", text).expect_err(text).to_string()
    }

    #[test]
    fn the_paper_preset_is_the_papers_numbers() {
        let paper = EncoderConfig::preset("paper").expect("a preset");
        assert_eq!((paper.history, paper.hand_points, paper.object_points), (16, 1024, 1024));
        assert_eq!((paper.epochs, paper.batch_size, paper.max_gradient_norm), (200, 256, 1.0));
        assert_eq!((paper.learning_rate, paper.final_learning_rate), (3e-4, 3e-4));
        let network = &paper.network;
        assert_eq!((network.width, network.layers, network.heads, network.feed_forward), (384, 6, 6, 1536));
        assert_eq!((paper.frame_stride, paper.inputs), (1, InputsConfig { positions: true, touch: true }));
        assert_eq!((network.decoder_layers, network.points_per_query), (6, 16));
        let ours = LossConfig::default();
        assert_eq!((ours.focal_alpha, ours.focal_gamma), (0.25, 2.0));
        assert_eq!(paper.loss, LossConfig { repulsion_m: 0.015, penetration_m: 0.005, ..ours });
    }

    #[test]
    fn the_weights_of_the_losses_are_the_papers() {
        let loss = LossConfig::default();
        assert_eq!((loss.hand, loss.object, loss.rotation, loss.joints), (5.0, 5.0, 0.1, 1.0));
        assert_eq!((loss.contact, loss.repulsion, loss.penetration), (2.0, 0.5, 0.5));
        assert_eq!((loss.empty_object, loss.empty_pose), (5.0, 2.0));
    }

    #[test]
    fn presets_survive_their_own_file_and_the_quick_one_is_what_is_left_out() {
        for name in ["quick", "paper"] {
            let config = EncoderConfig::preset(name).expect("a preset");
            assert_eq!(EncoderConfig::from_toml("again", &config.to_toml()).expect("its own file"), config);
        }
        assert_eq!(EncoderConfig::preset("quick").expect("a preset"), EncoderConfig::default());
    }

    #[test]
    fn nonsense_is_refused_by_line_and_field() {
        let texts = [
            "seed = 1\nhistory = 0",
            "\nheld_out_share = 1.0",
            "learning_rate = nan",
            "[network]\nwidth = 97",
            "[network]\nheads = 0",
            "object_points = 250",
            "seed = 1\n[loss]\nrotation = -0.1",
            "[loss]\nrepulsion_m = 0.0",
            "seed = 1\nepoch = 3",
            "inputs = { touch = 1 }",
        ];
        let mut refusals: Vec<String> = texts.map(refusal).to_vec();
        refusals.push(EncoderConfig::preset("fast").expect_err("no preset").to_string());
        assert_eq!(refusals.join("\n"), include_str!("../tests/refusals/configurations.txt").trim_end());
    }
}
