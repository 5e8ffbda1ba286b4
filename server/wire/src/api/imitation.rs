//! What a job is asked that learns from an expert's trials, and which of its fields do not go together. Studio and page
//! refuse the same, before anything waits or starts.

use std::fmt;

use serde::{Deserialize, Serialize};

/// What predicts.
pub const HEADS: [&str; 3] = ["regression", "diffusion", "act"];
/// How the frames of a window are joined.
pub const MEMORIES: [&str; 2] = ["window", "recurrent"];
/// The policies that the method's paper compares (docs/learning.md).
pub const PAPER_POLICIES: [&str; 5] =
    ["raw-dp", "kinematic-dp", "pretrained-dp", "pretrained-act", "pretrained-bc"];

/// Policies of the paper whose names begin so see the features of an encoder.
const PRETRAINED: &str = "pretrained-";

/// Request of a job of kind `imitation`: learns to do what an expert did. An attempt that was cut off goes on from its
/// last checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct ImitationRequest {
    /// Jobs of kind `gathering`, at least one.
    pub trials: Vec<String>,
    /// How to learn: `small` or `paper`; absent means `small`.
    pub preset: Option<String>,
    /// How to learn: the text of a configuration (docs/learning.md) in place of a preset.
    pub config: Option<String>,
    /// A policy of the paper: `raw-dp`, `kinematic-dp`, `pretrained-dp`, `pretrained-act` or `pretrained-bc`. It says
    /// how touch is seen and what predicts, so `head` and `features` are left out; sizes come from `preset`.
    #[serde(default)]
    pub policy: Option<String>,
    /// What predicts: `regression`, `diffusion` or `act`; absent means the configuration's.
    pub head: Option<String>,
    /// How the frames of a window are joined: `window`, side by side, or `recurrent`, by a GRU; absent means the
    /// configuration's.
    #[serde(default)]
    pub memory: Option<String>,
    /// Updates of the weights; absent means the configuration's.
    pub updates: Option<u64>,
    /// The policy does not feel touch.
    #[serde(default)]
    pub silence_touch: bool,
    /// The policy does not see how far joints are from where they were sent.
    #[serde(default)]
    pub hide_tracking: bool,
    /// The policy sees the features that `encoder` makes of touch.
    #[serde(default)]
    pub features: bool,
    /// A job of kind `pretraining` whose encoder makes features. It becomes part of the policy's file.
    #[serde(default)]
    pub encoder: Option<String>,
    /// The policy is told how wide the region is that objects begin in; the trials have to be of several regions.
    #[serde(default)]
    pub region: bool,
    /// Learn from the trials that were won, and not from the others.
    #[serde(default)]
    pub only_won: bool,
}

/// What the configuration of an [`ImitationRequest`] says of what the policy sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConfiguredObservation {
    /// The features of an encoder.
    pub features: bool,
    /// How wide the region is that objects begin in.
    pub region: bool,
}

/// A field of a request, and what is wrong with it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldProblem {
    /// Its name in the request.
    pub field: &'static str,
    /// What was found, and what to do.
    pub problem: String,
}

impl fmt::Display for FieldProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.field, self.problem)
    }
}

impl ImitationRequest {
    /// Whether its fields go together; `configured` is what its configuration says.
    ///
    /// # Errors
    /// The first field that has no such value, or does not go with another one.
    pub fn check(&self, configured: ConfiguredObservation) -> Result<(), FieldProblem> {
        one_of("policy", self.policy.as_deref(), &PAPER_POLICIES)?;
        one_of("head", self.head.as_deref(), &HEADS)?;
        one_of("memory", self.memory.as_deref(), &MEMORIES)?;
        let refused = |field, problem: String| Err(FieldProblem { field, problem });
        let sees_features = match &self.policy {
            Some(policy) if self.head.is_some() => {
                return refused(
                    "head",
                    format!("the policy {policy:?} says this itself; leave one of the two out"),
                );
            }
            Some(policy) if self.features => {
                return refused(
                    "features",
                    format!(
                        "the policy {policy:?} says itself whether it sees features; leave one of the two out"
                    ),
                );
            }
            Some(policy) => policy.starts_with(PRETRAINED),
            None => self.features || configured.features,
        };
        match &self.encoder {
            None if sees_features => {
                return refused(
                    "encoder",
                    "there is none, and the policy is to see the features that one makes; name a job of kind \"pretraining\""
                        .to_owned(),
                );
            }
            Some(encoder) if !sees_features => {
                let with = format!("{PRETRAINED}...");
                return refused(
                    "encoder",
                    format!(
                        "the policy would not see the features that {encoder:?} makes; set features, choose a policy \
                         {with}, or leave the encoder out"
                    ),
                );
            }
            _ => {}
        }
        if (self.region || configured.region) && self.trials.len() == 1 {
            return refused(
                "region",
                "one gathering is of one region, and nothing is learned of a number that never changes; name gatherings of \
                 several regions (protocols wide and paper), or leave this out"
                    .to_owned(),
            );
        }
        Ok(())
    }
}

/// Refuses a value of `field` that is not among `known`.
fn one_of(field: &'static str, value: Option<&str>, known: &[&str]) -> Result<(), FieldProblem> {
    match value {
        Some(value) if !known.contains(&value) => {
            Err(FieldProblem { field, problem: format!("{value:?} is none of {}", known.join(", ")) })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_go_together_is_refused_by_field() {
        let asked = |text: &str| -> ImitationRequest {
            serde_json::from_str(&format!("{{ \"trials\": [\"gathering-1\"], {text} }}")).unwrap()
        };
        for (text, field, words) in [
            (r#""head": "guess""#, "head", "\"guess\" is none of regression, diffusion, act"),
            (r#""memory": "none""#, "memory", "none of window, recurrent"),
            (r#""policy": "dp""#, "policy", "none of raw-dp, kinematic-dp"),
            (r#""policy": "raw-dp", "head": "act""#, "head", "the policy \"raw-dp\" says this itself"),
            (r#""policy": "raw-dp", "features": true"#, "features", "whether it sees features"),
            (r#""policy": "pretrained-act""#, "encoder", "there is none"),
            (r#""features": true"#, "encoder", "there is none"),
            (r#""policy": "raw-dp", "encoder": "pretraining-1""#, "encoder", "would not see the features"),
            (r#""encoder": "pretraining-1""#, "encoder", "set features"),
            (r#""region": true"#, "region", "of several regions"),
        ] {
            let problem = asked(text).check(ConfiguredObservation::default()).unwrap_err();
            assert!(problem.field == field && problem.problem.contains(words), "{text}: {problem}");
        }
        for text in [
            r#""head": "act", "memory": "recurrent""#,
            r#""policy": "kinematic-dp", "hide_tracking": true"#,
            r#""policy": "pretrained-bc", "encoder": "pretraining-1""#,
            r#""features": true, "encoder": "pretraining-1", "head": "diffusion""#,
        ] {
            assert_eq!(asked(text).check(ConfiguredObservation::default()), Ok(()), "{text}");
        }
    }

    #[test]
    fn a_configuration_counts_as_what_the_request_says() {
        let plain =
            ImitationRequest { trials: vec!["gathering-1".to_owned()], ..ImitationRequest::default() };
        let of = |features, region| ConfiguredObservation { features, region };
        assert_eq!(plain.check(of(true, false)).unwrap_err().field, "encoder");
        assert_eq!(plain.check(of(false, true)).unwrap_err().field, "region");
        let encoder = Some("pretraining-1".to_owned());
        assert_eq!(ImitationRequest { encoder, ..plain.clone() }.check(of(true, false)), Ok(()));
        // What a policy of the paper sees, a configuration does not change.
        let raw = ImitationRequest { policy: Some("raw-dp".to_owned()), ..plain };
        assert_eq!(raw.check(of(true, false)), Ok(()));
    }
}
