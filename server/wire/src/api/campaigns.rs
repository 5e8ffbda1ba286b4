//! Campaigns: policies tried on the hand, object by object, each trial scored by people.

use serde::{Deserialize, Serialize};

/// How a trial ended (paper, appendix "Detailed Real-World Failure Mode Analysis").
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub enum TrialVerdict {
    /// The object was lifted and held as long as the campaign asks.
    #[serde(rename = "success")]
    Success,
    /// Empty grasp: the hand never had the object.
    #[serde(rename = "EG")]
    EmptyGrasp,
    /// Slip during lifting: the hand had the object and lost it.
    #[serde(rename = "SL")]
    Slip,
    /// Emergency stop: a safety limit or a person ended the trial.
    #[serde(rename = "ES")]
    EmergencyStop,
    /// The trial says nothing about the policy, e.g. because the object was placed wrongly.
    #[serde(rename = "void")]
    Void,
}

impl TrialVerdict {
    /// All of them, as tables show them.
    pub const ALL: [Self; 5] = [Self::Success, Self::EmptyGrasp, Self::Slip, Self::EmergencyStop, Self::Void];

    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::EmptyGrasp => "EG",
            Self::Slip => "SL",
            Self::EmergencyStop => "ES",
            Self::Void => "void",
        }
    }

    /// The verdict of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|verdict| verdict.name() == name)
    }

    /// Its name for people.
    pub fn label(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::EmptyGrasp => "empty grasp",
            Self::Slip => "slip",
            Self::EmergencyStop => "emergency stop",
            Self::Void => "void",
        }
    }
}

/// A policy of a campaign.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct CampaignPolicy {
    /// Short name, e.g. `pretrained-dp`; a campaign has each once.
    pub id: String,
    /// What the rollout is started with: a policy file, or `script:NAME`.
    pub source: String,
    /// Its touch is silenced: a control that shows what touch is worth.
    #[serde(default)]
    pub is_silenced: bool,
}

/// An object of a campaign.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct CampaignObject {
    /// Id of the object.
    pub id: String,
    /// `seen` in training, or `unseen`; absent where the difference has no meaning.
    #[serde(default)]
    pub group: Option<String>,
}

/// The order of trials.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum TrialOrder {
    /// Objects and starts in random order; at each, all policies in random order. What drifts meanwhile hits all alike.
    #[default]
    Interleaved,
    /// Objects in random order, each until all its trials are done: fewer changes of object by hand.
    ByObject,
}

/// `POST /api/v1/campaigns`, and the plan that the campaign keeps: it does not change once there is a campaign, because what
/// is decided after looking at results is worth nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct CampaignPlan {
    /// Name for people; its id is made from it.
    pub name: String,
    /// Policies, in the order of tables.
    pub policies: Vec<CampaignPolicy>,
    /// Objects, in the order of tables.
    pub objects: Vec<CampaignObject>,
    /// Starts of each object; every policy is tried once from each.
    pub starts: u32,
    /// The object lies within plus and minus this of the middle of the workspace, along x and y, m.
    pub half_width_m: f64,
    /// Seed of starts and order.
    #[serde(default)]
    pub seed: u64,
    /// Order of the trials.
    #[serde(default)]
    pub order: TrialOrder,
    /// Scorers do not learn which policy they see, nor what the rollout suggests, until the campaign is closed.
    #[serde(default)]
    pub is_blind: bool,
    /// People who score each trial, 1 or 2.
    #[serde(default = "one")]
    pub scorers: u32,
    /// Chance that the sequential comparison of two equal policies calls them different.
    #[serde(default = "usual_alpha")]
    pub alpha: f64,
    /// What a success is, as scorers are told, e.g. `3 cm above the table for 1 s`.
    #[serde(default)]
    pub criterion: String,
}

fn one() -> u32 {
    1
}

fn usual_alpha() -> f64 {
    0.05
}

/// Where the object lies when a trial begins, from the middle of the workspace.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct TrialStart {
    /// Along x of the base frame, m.
    pub x_m: f64,
    /// Along y of the base frame, m.
    pub y_m: f64,
    /// Turned about the vertical, rad.
    pub yaw_rad: f64,
    /// Which of its stable poses the object stands in: a number from 0 to 1 that falls on one of them by their shares.
    pub side: f64,
    /// Seed of whatever else a simulated trial draws.
    pub seed: u64,
}

/// What a rollout says of its trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct RolloutOutcome {
    /// The verdict that it suggests; absent where nobody measured.
    #[serde(default)]
    pub suggested: Option<TrialVerdict>,
    /// Why: what was felt, what moved, how long it held.
    #[serde(default)]
    pub reasons: Vec<String>,
    /// From the first motion until the object was lifted, s.
    #[serde(default)]
    pub time_to_grasp_s: Option<f64>,
    /// How long it was held, s.
    #[serde(default)]
    pub held_s: Option<f64>,
    /// The take that was recorded, `session/take`.
    #[serde(default)]
    pub take: Option<String>,
    /// The rollout's own record, as the computer that it ran on names the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub record: Option<String>,
}

/// `POST /api/v1/campaigns/{campaign}/trials/{trial}/outcome`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct TrialEnd {
    /// The attempt that has ended, from 0.
    pub attempt: u32,
    /// What its rollout says.
    pub outcome: RolloutOutcome,
}

/// `POST /api/v1/campaigns/{campaign}/trials/{trial}/unscore`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct ScoreBack {
    /// Name of whoever takes their score back, as in [`ScoreRequest`].
    #[serde(default)]
    pub scorer: String,
    /// The attempt, from 0.
    pub attempt: u32,
}

/// `POST /api/v1/campaigns/{campaign}/trials/{trial}/score`, and `.../settle`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct ScoreRequest {
    /// Name of whoever scores, where nobody logs in; a login's own name counts before it.
    #[serde(default)]
    pub scorer: String,
    /// The attempt that was seen, from 0; another one has begun meanwhile if it is not the trial's last.
    pub attempt: u32,
    /// The verdict.
    pub verdict: TrialVerdict,
    /// Whatever else is worth knowing.
    #[serde(default)]
    pub note: String,
}

/// A verdict that somebody gave.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct TrialScore {
    /// Who.
    pub scorer: String,
    /// When, RFC 3339.
    pub time: String,
    /// The verdict.
    pub verdict: TrialVerdict,
    /// Whatever else they found worth knowing.
    pub note: String,
}

/// Where a trial stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum TrialState {
    /// Its turn has not come.
    Waiting,
    /// The object is placed and the rollout has begun.
    Running,
    /// It has ended; scores are missing.
    Unscored,
    /// Scorers differ.
    Unsettled,
    /// It has a verdict.
    Scored,
}

/// One try of a trial. A void one can be repeated; it stays in every table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Attempt {
    /// When the object was placed and the rollout began, RFC 3339.
    pub began: String,
    /// Who said so.
    pub by: String,
    /// What the rollout says; absent while it runs, and for a scorer who is not to know.
    pub outcome: Option<RolloutOutcome>,
    /// The take that was recorded, `session/take`.
    pub take: Option<String>,
    /// It has ended.
    pub has_ended: bool,
    /// Scores, in the order in which they came. A blind scorer sees their own alone.
    pub scores: Vec<TrialScore>,
    /// What was settled where scorers differed.
    pub settled: Option<TrialScore>,
    /// The verdict that counts.
    pub verdict: Option<TrialVerdict>,
}

/// A trial of a campaign.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Trial {
    /// Its place in the order, from 1.
    pub number: u32,
    /// Id of its policy; absent for a scorer who is not to know.
    pub policy: Option<String>,
    /// Id of its object.
    pub object: String,
    /// Which of the object's starts, from 1: trials of one object and start are compared in pairs.
    pub start_number: u32,
    /// Where the object lies.
    pub start: TrialStart,
    /// Where it stands.
    pub state: TrialState,
    /// Its tries, in order.
    pub attempts: Vec<Attempt>,
}

/// An entry of `GET /api/v1/campaigns`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CampaignSummary {
    /// Id: the folder's name.
    pub id: String,
    /// Name for people.
    pub name: String,
    /// When it was made, RFC 3339.
    pub created: String,
    /// Trials that were planned.
    pub planned: u32,
    /// Trials that have a verdict.
    pub scored: u32,
    /// Trials that wait for scores or for scorers to settle.
    pub to_score: u32,
    /// Since when no trial begins until somebody resumes it, RFC 3339.
    #[serde(default)]
    pub paused: Option<String>,
    /// When it was closed, RFC 3339.
    pub closed: Option<String>,
    /// Why it cannot be opened; the rest is empty then.
    pub error: Option<String>,
}

/// `GET /api/v1/campaigns/{campaign}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Campaign {
    /// As in the list.
    pub summary: CampaignSummary,
    /// What was planned. Sources of policies are left out for a scorer who is not to know.
    pub plan: CampaignPlan,
    /// Its trials, in order.
    pub trials: Vec<Trial>,
    /// The trial whose turn it is: the first that waits or runs.
    pub next: Option<u32>,
    /// The first trial that whoever asks has to score.
    pub next_to_score: Option<u32>,
}

/// A success rate with its 95 % intervals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SuccessRate {
    /// Successes.
    pub successes: u64,
    /// Trials with a verdict, void ones not among them.
    pub trials: u64,
    /// Successes / trials; absent without trials.
    pub rate: Option<f64>,
    /// Wilson's interval: what to show.
    pub wilson_95: [f64; 2],
    /// Clopper and Pearson's interval, which covers at least 95 %: what to claim.
    pub clopper_pearson_95: [f64; 2],
}

/// How many trials ended in which way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FailureModes {
    /// Empty grasps.
    #[serde(rename = "EG")]
    pub empty_grasp: u64,
    /// Slips.
    #[serde(rename = "SL")]
    pub slip: u64,
    /// Emergency stops.
    #[serde(rename = "ES")]
    pub emergency_stop: u64,
}

/// Results of one policy on one object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ObjectResult {
    /// Id of the object.
    pub object: String,
    /// `seen`, `unseen`, or absent.
    pub group: Option<String>,
    /// Its success rate.
    pub rate: SuccessRate,
    /// Its failures.
    pub failures: FailureModes,
    /// Attempts that were void, those that were repeated among them.
    pub void: u64,
    /// Trials without a verdict.
    pub open: u64,
}

/// Chance that k trials in a row succeed, averaged over objects.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PassHatK {
    /// Trials in a row.
    pub k: u64,
    /// The chance.
    pub chance: f64,
}

/// Results of one policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PolicyResult {
    /// Its id.
    pub policy: String,
    /// By object, as planned.
    pub objects: Vec<ObjectResult>,
    /// Objects of group `seen`; absent if there are none.
    pub seen: Option<SuccessRate>,
    /// Objects of group `unseen`; absent if there are none.
    pub unseen: Option<SuccessRate>,
    /// All objects.
    pub overall: SuccessRate,
    /// Failures on all objects.
    pub failures: FailureModes,
    /// Void attempts on all objects.
    pub void: u64,
    /// Trials without a verdict.
    pub open: u64,
    /// Median time from the first motion to the lift over successes that know theirs, s.
    pub median_time_to_grasp_s: Option<f64>,
    /// pass^k for k from 1 to the fewest trials that an object has; empty while an object has none.
    pub pass_hat_k: Vec<PassHatK>,
}

/// Two policies on the same starts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PolicyComparison {
    /// Id of the first.
    pub a: String,
    /// Id of the second.
    pub b: String,
    /// Starts from which both have a verdict.
    pub pairs: u64,
    /// Both succeeded.
    pub both: u64,
    /// Only the first succeeded.
    pub only_a: u64,
    /// Only the second succeeded.
    pub only_b: u64,
    /// Two-sided p-value of McNemar's exact test on these pairs.
    pub p_mcnemar: f64,
    /// Two-sided p-value of Barnard's exact test on all trials, as if starts had not been matched.
    pub p_barnard: Option<f64>,
    /// The exact sequential test, which may be looked at after every pair.
    pub sequential: SequentialResult,
}

/// What the sequential test says so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SequentialResult {
    /// Pairs that were planned.
    pub max_pairs: u64,
    /// Chance that two equal policies are called different.
    pub alpha: f64,
    /// Id of the policy that is better; absent while nothing is shown.
    pub better: Option<String>,
    /// All pairs are made, and neither was shown to be better.
    pub is_exhausted: bool,
    /// So many more pairs would settle it with a chance of 80 % if both go on as they did; absent where not even all
    /// planned pairs would.
    pub pairs_to_settle: Option<u64>,
}

/// How two scorers agree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Agreement {
    /// The two who scored most trials together.
    pub scorers: [String; 2],
    /// Attempts that both scored.
    pub attempts: u64,
    /// Of them with the same verdict.
    pub agreed: u64,
    /// Cohen's kappa; absent where both always gave one and the same verdict.
    pub kappa: Option<f64>,
    /// Numbers of trials on which scorers differ and nothing is settled yet.
    pub to_settle: Vec<u32>,
}

/// Published results, for comparison. They are never counted with the campaign's own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct PublishedResult {
    /// Whose.
    pub label: String,
    /// Where they were published.
    pub source: String,
    /// `[successes, trials]` by object.
    #[serde(default)]
    pub objects: std::collections::BTreeMap<String, [u64; 2]>,
    /// `[successes, trials]` of objects seen in training.
    pub seen: [u64; 2],
    /// `[successes, trials]` of the others.
    pub unseen: [u64; 2],
}

/// `GET /api/v1/campaigns/{campaign}/results`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CampaignResults {
    /// Id of the campaign.
    pub campaign: String,
    /// Trials that were planned.
    pub planned: u64,
    /// Trials that have a verdict, void ones among them.
    pub scored: u64,
    /// By policy, as planned.
    pub policies: Vec<PolicyResult>,
    /// Every two policies.
    pub comparisons: Vec<PolicyComparison>,
    /// How scorers agree; absent until two have scored the same attempt.
    pub agreement: Option<Agreement>,
    /// Published results beside them.
    pub published: Vec<PublishedResult>,
}
