//! How to learn, as a file.

use palpate_training::{Expectation, TrainingError};
use serde::{Deserialize, Serialize};

use crate::PpoError;

/// How to learn. Fields that a file leaves out have the values of the preset `quick`, which are given here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PpoConfig {
    /// Seed of weights, noise and order; 0.
    pub seed: u64,
    /// Steps to learn from, of all environments together, at least 1; 1 million. The last update may go beyond.
    pub total_steps: u64,
    /// Environments that step together, at least 1; 64.
    pub num_envs: usize,
    /// Steps of an environment that count as one item of a batch, at least 1; 100.
    pub unroll_length: usize,
    /// Items of a minibatch, at least 1; 16. `batch_size * num_minibatches` is a multiple of `num_envs`: an update learns
    /// from `batch_size * num_minibatches / num_envs * unroll_length` steps of every environment (as in Brax's PPO).
    pub batch_size: usize,
    /// Minibatches an epoch, at least 1; 4.
    pub num_minibatches: usize,
    /// How often an update goes through its batch, at least 1; 4. Too many and the policy runs from its data.
    pub num_epochs: usize,
    /// Step size of Adam, in 0..=1; 1e-4. At 0 nothing is learned.
    pub learning_rate: f64,
    /// gamma: what a reward is worth one step later, in 0..=1; 0.99. Episodes of N steps want about 1 - 1/N.
    pub discount: f64,
    /// lambda of advantage estimation, in 0..=1; 0.95. Lower believes the critic, higher the noise of returns.
    pub gae_lambda: f64,
    /// epsilon: how far an update moves the probability of an action, above 0, below 1; 0.2.
    pub clip: f64,
    /// Updates at the beginning in which only the critic learns, 0 or more; 6. A policy that begins as something that works is
    /// led away from it by a critic that knows nothing yet.
    pub critic_warmup_updates: u64,
    /// Weight of entropy in the loss, 0 or more; 5e-4. Too low and exploration dies early, too high and it never does.
    pub entropy_coefficient: f64,
    /// Weight of the critic's loss, above 0; 0.5.
    pub value_coefficient: f64,
    /// Longest gradient, over all parameters, above 0; 1.
    pub max_gradient_norm: f64,
    /// Spread of the first actions, above 0; 0.15.
    pub initial_std: f64,
    /// Normalised observations end at plus and minus this, above 0; 10.
    pub observation_clip: f64,
    /// Updates between checkpoints, at least 1; 10. Every checkpoint begins new episodes everywhere, so that a run that
    /// resumes from it is the run that went on.
    pub checkpoint_updates: u64,
    /// Shapes of the networks.
    pub networks: NetworksConfig,
    /// When to stop early; never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stop: Option<StopConfig>,
}

/// Shapes of the networks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworksConfig {
    /// Widths of the actor's hidden layers, each at least 1; `[512, 256, 128]`.
    pub actor: Vec<usize>,
    /// Widths of the critic's hidden layers, each at least 1; `[512, 256, 128]`.
    pub critic: Vec<usize>,
    /// What follows each hidden layer; `"elu"`.
    pub activation: Activation,
}

/// What follows a hidden layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// `x` above 0, `exp(x) - 1` below.
    Elu,
    /// `x` above 0, 0 below.
    Relu,
    /// Hyperbolic tangent.
    Tanh,
}

/// When a policy is good enough.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StopConfig {
    /// Share of successful episodes that suffices, above 0, up to 1.
    pub success_rate: f64,
    /// The newest episodes that are counted, at least 1.
    pub episodes: usize,
}

impl Default for PpoConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            total_steps: 1_000_000,
            num_envs: 64,
            unroll_length: 100,
            batch_size: 16,
            num_minibatches: 4,
            num_epochs: 4,
            learning_rate: 1e-4,
            discount: 0.99,
            gae_lambda: 0.95,
            clip: 0.2,
            critic_warmup_updates: 6,
            entropy_coefficient: 5e-4,
            value_coefficient: 0.5,
            max_gradient_norm: 1.0,
            initial_std: 0.15,
            observation_clip: 10.0,
            checkpoint_updates: 10,
            networks: NetworksConfig::default(),
            stop: None,
        }
    }
}

impl Default for NetworksConfig {
    fn default() -> Self {
        Self { actor: vec![512, 256, 128], critic: vec![512, 256, 128], activation: Activation::Elu }
    }
}

impl PpoConfig {
    /// Preset `quick` (two cores, minutes) or `paper` (the method's table, 2048 environments).
    ///
    /// # Errors
    /// Any other name.
    pub fn preset(name: &str) -> Result<Self, PpoError> {
        match name {
            "quick" => Ok(Self::default()),
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
    /// # use palpate_ppo::PpoConfig;
    /// let config = PpoConfig::from_toml("run.toml", "learning_rate = 1e-3")?;
    /// assert_eq!(config.discount, 0.99);
    /// let err = PpoConfig::from_toml("run.toml", "seed = 1\nlearning_rate = -1.0").unwrap_err();
    /// assert_eq!(err.to_string(), "run.toml:2: learning_rate is -1, expected a number in 0..=1");
    /// # Ok::<(), palpate_ppo::PpoError>(())
    /// ```
    pub fn from_toml(file: &str, text: &str) -> Result<Self, PpoError> {
        let config: Self = palpate_training::parse(file, text)?;
        config.check(file, text)?;
        Ok(config)
    }

    /// This configuration as a file with every field.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("numbers, lists and names are TOML")
    }

    /// Whether every value makes sense.
    ///
    /// # Errors
    /// The first field that does not.
    pub fn validate(&self) -> Result<(), PpoError> {
        self.check("configuration", "")
    }

    /// Steps of every environment that one update learns from, if [`PpoConfig::validate`] accepts this.
    pub fn horizon(&self) -> usize {
        self.batch_size * self.num_minibatches / self.num_envs * self.unroll_length
    }

    /// Updates that it takes to reach [`PpoConfig::total_steps`], if [`PpoConfig::validate`] accepts this.
    pub fn num_updates(&self) -> u64 {
        self.total_steps.div_ceil((self.horizon() * self.num_envs) as u64)
    }

    fn check(&self, file: &str, text: &str) -> Result<(), PpoError> {
        Ok(palpate_training::check(file, text, self.expectations())?)
    }

    fn expectations(&self) -> Vec<Expectation> {
        let (count, share, positive) = (Expectation::count, Expectation::share, Expectation::positive);
        let widths = |path, widths: &[usize]| Expectation {
            path,
            value: format!("{widths:?}"),
            holds: !widths.is_empty() && widths.iter().all(|&width| width >= 1),
            expected: "one or more widths, each 1 or more",
        };
        let items = self.batch_size.checked_mul(self.num_minibatches);
        let steps = items.and_then(|items| items.checked_mul(self.unroll_length));
        let mut all = vec![
            count(&["total_steps"], self.total_steps),
            count(&["num_envs"], self.num_envs as u64),
            count(&["unroll_length"], self.unroll_length as u64),
            count(&["batch_size"], self.batch_size as u64),
            count(&["num_minibatches"], self.num_minibatches as u64),
            count(&["num_epochs"], self.num_epochs as u64),
            count(&["checkpoint_updates"], self.checkpoint_updates),
            Expectation {
                path: &["batch_size"],
                value: format!(
                    "{} (x {} minibatches, for {} environments)",
                    self.batch_size, self.num_minibatches, self.num_envs
                ),
                holds: items.is_some_and(|items| items > 0 && items.is_multiple_of(self.num_envs.max(1))),
                expected: "batch_size * num_minibatches to be a multiple of num_envs",
            },
            share(&["learning_rate"], self.learning_rate),
            share(&["discount"], self.discount),
            share(&["gae_lambda"], self.gae_lambda),
            Expectation {
                path: &["clip"],
                value: self.clip.to_string(),
                holds: self.clip > 0.0 && self.clip < 1.0,
                expected: "a number above 0 and below 1",
            },
            Expectation::not_negative(&["entropy_coefficient"], self.entropy_coefficient),
            positive(&["value_coefficient"], self.value_coefficient),
            positive(&["max_gradient_norm"], self.max_gradient_norm),
            positive(&["initial_std"], self.initial_std),
            positive(&["observation_clip"], self.observation_clip),
            Expectation {
                path: &["unroll_length"],
                value: self.unroll_length.to_string(),
                holds: steps.is_some(),
                expected: "batch_size * num_minibatches * unroll_length steps to be countable",
            },
            widths(&["networks", "actor"], &self.networks.actor),
            widths(&["networks", "critic"], &self.networks.critic),
        ];
        if let Some(stop) = &self.stop {
            all.push(count(&["stop", "episodes"], stop.episodes as u64));
            all.push(Expectation {
                path: &["stop", "success_rate"],
                value: stop.success_rate.to_string(),
                holds: stop.success_rate > 0.0 && stop.success_rate <= 1.0,
                expected: "a number above 0, up to 1",
            });
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(text: &str) -> String {
        PpoConfig::from_toml("run.toml", text).expect_err(text).to_string()
    }

    #[test]
    fn the_paper_preset_is_its_table() {
        let paper = PpoConfig::preset("paper").expect("a preset");
        assert_eq!(paper.total_steps, 200_000_000);
        assert_eq!((paper.num_envs, paper.batch_size, paper.num_minibatches), (2048, 2048, 16));
        assert_eq!((paper.num_epochs, paper.unroll_length), (16, 40));
        assert_eq!((paper.learning_rate, paper.discount, paper.entropy_coefficient), (3e-4, 0.99, 0.01));
        assert_eq!(paper.networks, NetworksConfig::default());
        assert_eq!(paper.horizon(), 640);
    }

    #[test]
    fn presets_make_sense_and_survive_their_own_file() {
        for name in ["quick", "paper"] {
            let config = PpoConfig::preset(name).expect("a preset");
            config.validate().expect("values that make sense");
            assert_eq!(PpoConfig::from_toml("again", &config.to_toml()).expect("its own file"), config);
        }
        assert_eq!(
            PpoConfig::preset("fast").expect_err("no preset").to_string(),
            r#"there is no preset "fast", expected one of "quick", "paper""#
        );
    }

    #[test]
    fn nonsense_is_refused_by_line_and_field() {
        assert_eq!(
            refusal("# a comment\n\nnum_minibatches = 0"),
            "run.toml:3: num_minibatches is 0, expected 1 or more"
        );
        assert_eq!(
            refusal("seed = 1\nbatch_size = 3"),
            "run.toml:2: batch_size is 3 (x 4 minibatches, for 64 environments), \
             expected batch_size * num_minibatches to be a multiple of num_envs"
        );
        assert_eq!(
            refusal("[networks]\nactor = [64, 0]"),
            "run.toml:2: networks.actor is [64, 0], expected one or more widths, each 1 or more"
        );
        assert_eq!(
            refusal("[stop]\nepisodes = 100\nsuccess_rate = 1.2"),
            "run.toml:3: stop.success_rate is 1.2, expected a number above 0, up to 1"
        );
        // The field that breaks the rule may be another one than the file sets.
        assert!(refusal("num_envs = 65").starts_with("run.toml: batch_size is 16 (x 4"));
    }

    #[test]
    fn every_number_is_checked_against_nan_and_its_ends() {
        let fields = [
            ("learning_rate", "-1e-9"),
            ("learning_rate", "1.1"),
            ("discount", "1.01"),
            ("gae_lambda", "-0.1"),
            ("clip", "0.0"),
            ("clip", "1.0"),
            ("entropy_coefficient", "-0.1"),
            ("value_coefficient", "0.0"),
            ("max_gradient_norm", "inf"),
            ("initial_std", "0.0"),
            ("observation_clip", "-1.0"),
        ];
        for (field, value) in fields.into_iter().chain(fields.map(|(field, _)| (field, "nan"))) {
            let message = refusal(&format!("\n{field} = {value}"));
            assert!(message.starts_with(&format!("run.toml:2: {field} is ")), "{message}");
        }
        for field in
            ["total_steps", "num_envs", "unroll_length", "batch_size", "num_epochs", "checkpoint_updates"]
        {
            assert!(refusal(&format!("{field} = 0")).contains(&format!("{field} is 0")), "{field}");
        }
    }

    #[test]
    fn unknown_fields_and_wrong_types_have_their_line() {
        let message = refusal("seed = 1\nlearning_rte = 1e-3");
        assert!(message.starts_with("run.toml:2: unknown field `learning_rte`"), "{message}");
        let message = refusal("seed = 1\nclip = \"wide\"");
        assert!(message.starts_with("run.toml:2: invalid type: string"), "{message}");
        let message = refusal("seed = -1");
        assert!(message.starts_with("run.toml:1: "), "{message}");
    }
}
