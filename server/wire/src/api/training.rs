//! Jobs that `palpate-train` works on, and which kinds of jobs a studio can do.

use serde::{Deserialize, Serialize};

use super::Resources;

/// `GET /api/v1/kinds`: a kind of job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct JobKindDocument {
    /// As requests name it.
    pub kind: String,
    /// What it needs of the machine, where a request does not say so.
    pub resources: Resources,
    /// Whether this studio can do it on its own computer.
    pub is_available: bool,
    /// Why not, and what to do.
    pub problem: Option<String>,
}

/// Request of a job of kind `expert`: learns to grasp one object by touch. An attempt that was cut off goes on from its last
/// checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct ExpertRequest {
    /// Id of the object, shipped or in `objects/` of the data folder.
    pub object: String,
    /// How to learn: `quick` or `paper`; absent means `quick`.
    pub preset: Option<String>,
    /// How to learn: the text of a configuration (docs/learning.md) in place of a preset.
    pub config: Option<String>,
    /// Steps of all environments together; absent means the configuration's.
    pub total_steps: Option<u64>,
    /// The script that is learned on top of: a job of kind `tune`, or the name of a shipped one; absent means the one that is
    /// shipped for the object, or the usual one.
    pub script: Option<String>,
    /// Learn the whole motion instead of what is added to a script.
    #[serde(default)]
    pub without_script: bool,
    /// Saved sensor model that makes touch; absent means the station's nominal model.
    pub model: Option<String>,
    /// Half the edge length of the square that objects start in, cm; absent means the world's.
    pub start_cm: Option<f64>,
    /// The robot feels nothing.
    #[serde(default)]
    pub silence_touch: bool,
}

/// Request of a job of kind `evaluation`: scores a policy in fresh trials.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct EvaluationRequest {
    /// A job of kind `expert`, the name of a shipped policy, or, under a protocol, a job of kind `imitation` or `pipeline`.
    pub policy: String,
    /// Trials; absent means the protocol's, or 50.
    pub trials: Option<u64>,
    /// Saved sensor model that makes touch; absent means the station's nominal model.
    pub model: Option<String>,
    /// Half the edge length of the square that objects start in, cm; a protocol says so itself.
    pub start_cm: Option<f64>,
    /// The robot feels nothing.
    #[serde(default)]
    pub silence_touch: bool,
    /// Compare under this shipped protocol: `paper`, `wide`, `wide_20s` or `claim`.
    pub protocol: Option<String>,
    /// Under a protocol: ids of objects, or one of `seen`, `unseen` and `all`; absent means the one that the policy was trained
    /// with, or `seen`.
    #[serde(default)]
    pub objects: Vec<String>,
    /// Under a protocol: compare with script, blind repetition, an oracle and the silenced policy.
    #[serde(default)]
    pub controls: bool,
}

/// Request of a job of kind `demonstrations`: rolls a policy out and keeps what succeeds. An attempt that was cut off goes on
/// from its last file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct DemonstrationsRequest {
    /// A job of kind `expert`, or the name of a shipped policy.
    pub policy: String,
    /// How many.
    pub count: u64,
    /// Demonstrations in a file; absent means 64.
    pub shard_demos: Option<u64>,
    /// Saved sensor model that makes touch; absent means the station's nominal model.
    pub model: Option<String>,
    /// Half the edge length of the square that objects start in, cm; absent means the world's.
    pub start_cm: Option<f64>,
}

/// Request of a job of kind `pretraining`: pretrains the tactile encoder on demonstrations. An attempt that was cut off goes on
/// from its last checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct PretrainingRequest {
    /// Jobs of kind `demonstrations`, at least one.
    pub demonstrations: Vec<String>,
    /// How to learn: `quick` or `paper`; absent means `quick`.
    pub preset: Option<String>,
    /// How to learn: the text of a configuration (docs/learning.md) in place of a preset.
    pub config: Option<String>,
    /// How often to go through the samples; absent means the configuration's.
    pub epochs: Option<u64>,
    /// Tell the encoder what taxels feel only, not where they are.
    #[serde(default)]
    pub without_positions: bool,
    /// Tell the encoder where taxels are only, not what they feel.
    #[serde(default)]
    pub silence_touch: bool,
}

/// Experts of a [`GatheringRequest`], the usual one first: the searching expert with both senses, with one of them, and blind
/// repetition.
pub const EXPERTS: [&str; 4] = ["search", "search:touch", "search:tracking", "repetition"];

/// Request of a job of kind `gathering`: lets the searching expert grasp and keeps every trial, to imitate. An attempt that
/// was cut off goes on from the last object.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct GatheringRequest {
    /// Ids of objects, or one of `seen`, `unseen` and `all`; absent means `seen`.
    #[serde(default)]
    pub objects: Vec<String>,
    /// Trials on each object; absent means 300.
    pub count: Option<u64>,
    /// Where objects start, and for how long the expert may search: a shipped protocol; absent means `wide`. The job's seed
    /// must not be the protocol's.
    pub protocol: Option<String>,
    /// Who grasps: `search`, `search:touch`, `search:tracking` or `repetition`; absent means `search`.
    #[serde(default)]
    pub expert: Option<String>,
    /// Saved sensor model that makes touch; absent means the station's nominal model.
    pub model: Option<String>,
}

/// Request of a job of kind `pipeline`: from a sensor model to policies that are scored. An attempt that was cut off goes on
/// with the stage that it was at. Seeds are part of the configuration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct PipelineRequest {
    /// What to do: `small`, `tables` or `paper`; absent means `small`.
    pub preset: Option<String>,
    /// The text of a configuration (`palpate-train pipeline --print-config`) in place of a preset.
    pub config: Option<String>,
    /// Saved sensor model that makes touch; absent means the station's nominal model.
    pub model: Option<String>,
}

/// Request of a job of kind `rollouts`: makes the trials of a campaign on the hand, one after the other. Somebody places
/// each object and begins its trial at the page; the job takes control, lets the policy move, and tells the campaign what
/// came of it. It needs a studio with a station, and whoever asks needs the scope `control`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct RolloutsRequest {
    /// Id of the campaign. Policies are what its plan says: `script:NAME`, or the name of a shipped policy or of a job that
    /// made one. The object's id stands in the place of `{object}`.
    pub campaign: String,
    /// Make trials that were scored void once more, after all others.
    #[serde(default)]
    pub repeat_void: bool,
    /// Id of the session that each trial becomes a take of, which is made if there is none; absent means the campaign's id
    /// with `-takes` after it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// Record no takes: what the trials felt is then in their records alone, at the rate of the live stream.
    #[serde(default)]
    pub without_recording: bool,
}

impl RolloutsRequest {
    /// Id of the session that takes go into; `None` where none are recorded.
    pub fn recorded_into(&self) -> Option<String> {
        let usual = || format!("{}-takes", self.campaign);
        (!self.without_recording).then(|| self.session.clone().unwrap_or_else(usual))
    }
}

/// Request of a job of kind `tune`: tunes a closing script on one object by the cross-entropy method.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct TuneRequest {
    /// Id of the object, shipped or in `objects/` of the data folder.
    pub object: String,
    /// The script to begin with: a job of kind `tune`, or the name of a shipped one; absent means the usual one.
    pub script: Option<String>,
    /// Rounds of candidates; absent means 8.
    pub generations: Option<u64>,
    /// Scripts drawn in each; absent means 64.
    pub candidates: Option<u64>,
    /// The best of them, which the next ones are drawn around; absent means 10.
    pub elite: Option<u64>,
    /// Trials of each candidate; absent means 4.
    pub trials: Option<u64>,
    /// Trials that choose the best generation; absent means 50.
    pub check_trials: Option<u64>,
    /// Saved sensor model that makes touch; absent means the station's nominal model.
    pub model: Option<String>,
    /// Half the edge length of the square that objects start in, cm; absent means the world's.
    pub start_cm: Option<f64>,
}
