//! Protocols: which trials a policy is scored in.

use serde::{Deserialize, Serialize};

use crate::{GraspConfig, GraspError};

/// What the trials of a comparison have in common, as read from TOML.
///
/// Trial number i of an object begins at the start that `seed` and i give, whatever moves the robot, so that policies are
/// compared on the same starts. Protocols of one `half_width_m` and `seed` share their starts.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Protocol {
    /// Half the edge length of the square that objects start in, m.
    pub half_width_m: f64,
    /// Longest episode, the final holding included, s.
    pub episode_s: f64,
    /// Whether the policy says itself that it holds the object, and may be wrong: see [`crate::TaskConfig::one_claim`].
    pub one_claim: bool,
    /// Starts an object.
    pub trials: u64,
    /// Seed of starts and randomised physics.
    pub seed: u64,
}

impl Protocol {
    /// Reads a protocol. `file` names it in errors.
    ///
    /// # Errors
    /// Unknown and missing keys; lengths and times that are not finite or have the wrong sign; no trials.
    ///
    /// ```
    /// use palpate_grasp::Protocol;
    ///
    /// let text = "half_width_m = 0.08\nepisode_s = 10.0\none_claim = false\ntrials = 50\nseed = 2";
    /// let protocol = Protocol::from_toml("wide.toml", text)?;
    /// assert_eq!(protocol.trials, 50);
    /// # Ok::<(), palpate_grasp::GraspError>(())
    /// ```
    pub fn from_toml(file: &str, text: &str) -> Result<Self, GraspError> {
        let error = |problem: String| GraspError::Config { file: file.to_owned(), problem };
        let protocol: Self = toml::from_str(text).map_err(|err| error(err.to_string()))?;
        if !(protocol.half_width_m.is_finite() && protocol.half_width_m >= 0.0) {
            return Err(error(format!(
                "half_width_m is {}, expected a finite number, not negative",
                protocol.half_width_m
            )));
        }
        if !(protocol.episode_s.is_finite() && protocol.episode_s > 0.0) {
            return Err(error(format!(
                "episode_s is {}, expected a finite number above zero",
                protocol.episode_s
            )));
        }
        if protocol.trials == 0 {
            return Err(error("trials is 0, expected at least 1".to_owned()));
        }
        Ok(protocol)
    }

    /// Makes `config` the world of this protocol.
    pub fn apply(&self, config: &mut GraspConfig) {
        config.task.half_width_m = self.half_width_m;
        config.task.episode_s = self.episode_s;
        config.task.one_claim = self.one_claim;
    }
}
