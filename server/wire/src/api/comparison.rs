//! The trials of a campaign beside the same starts in simulation: what is asked for, and what comes out.

use serde::{Deserialize, Serialize};

use super::{SuccessRate, TrialVerdict};

/// The model of the station itself, where a comparison names models.
pub const NOMINAL_MODEL: &str = "nominal";

/// Request of a job of kind `comparison`: makes the trials of a campaign once more in simulation, from the same starts, once
/// with each sensor model. It reads the records that a job of kind `rollouts` left in the campaign's folder.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct ComparisonRequest {
    /// Id of the campaign. A blind one has to be closed before, because the outcome says which policy moved the hand.
    pub campaign: String,
    /// Ids of saved sensor models; `nominal` is the station's own. Empty means the nominal one alone.
    #[serde(default)]
    pub models: Vec<String>,
}

/// `report.json` of a job of kind `comparison`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ComparisonReport {
    /// Id of the campaign.
    pub campaign: String,
    /// The sensor models, in the order of each trial's verdicts.
    pub models: Vec<ComparedModel>,
    /// Trials that were compared, by number.
    pub trials: Vec<ComparedTrial>,
    /// Trials that were not, by number, and why.
    pub left_out: Vec<LeftOutTrial>,
    /// Each policy on each object with each model, then all of a model together where there is more than one.
    pub pairings: Vec<ComparedPairing>,
}

/// A sensor model that trials were simulated with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ComparedModel {
    /// `nominal`, or the id of a saved model.
    pub id: String,
    /// Name for people.
    pub name: String,
}

/// A trial on the hand beside the same start in simulation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ComparedTrial {
    /// Its number in the campaign.
    pub trial: u32,
    /// Id of its policy.
    pub policy: String,
    /// Id of its object.
    pub object: String,
    /// What it came to on the hand.
    pub hand: TrialVerdict,
    /// Who says so.
    pub said_by: SaidBy,
    /// What it came to in simulation with each model, in the report's order.
    pub simulated: Vec<TrialVerdict>,
    /// The take that was recorded, `session/take`.
    pub take: Option<String>,
    /// The take has where the object was during the trial. Without, it has where the object stood at the begin alone.
    pub is_followed: bool,
    /// Nobody measured where the object stood at the begin: it is taken to be where the plan has it.
    pub is_start_planned: bool,
}

impl ComparedTrial {
    /// Whether some model gives another verdict than the hand.
    pub fn differs(&self) -> bool {
        self.simulated.iter().any(|verdict| *verdict != self.hand)
    }
}

/// Whose verdict of a trial on the hand counts: that of scorers, else that of an emulated station's operator, else the
/// robot's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SaidBy {
    /// People scored it.
    Scorers,
    /// The operator of an emulated station saw it.
    Operator,
    /// The robot suggests it; nobody looked.
    Robot,
}

/// A trial that could not be compared.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct LeftOutTrial {
    /// Its number in the campaign.
    pub trial: u32,
    /// Why, in words.
    pub why: String,
}

/// Trials on the hand beside those of one sensor model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ComparedPairing {
    /// Id of the policy; absent where those of all policies and objects are counted together.
    pub policy: Option<String>,
    /// Id of the object; absent as the policy is.
    pub object: Option<String>,
    /// The model's id.
    pub model: String,
    /// Won on the hand.
    pub hand: SuccessRate,
    /// Won in simulation.
    pub simulated: SuccessRate,
    /// Trials with the same verdict on both sides.
    pub same_verdict: u64,
    /// Trials won on the hand alone.
    pub only_hand: u64,
    /// Trials won in simulation alone.
    pub only_simulated: u64,
    /// McNemar's exact test, two-sided.
    pub p_mcnemar: f64,
    /// How well touch agrees from the same start; absent where everything is counted together.
    pub touch: Option<ComparedTouch>,
}

/// How well touch in simulation agrees with touch on the hand, over all channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ComparedTouch {
    /// F1 over channels and control steps; absent where nobody felt anything.
    pub f1: Option<f64>,
    /// Mismatch, seconds a channel-second.
    pub gap: Option<f64>,
    /// Mean absolute difference of onsets that belong together, ms.
    pub onset_error_ms: Option<f64>,
    /// Contacts on the hand.
    pub hand_contacts: u64,
    /// Contacts in simulation.
    pub simulated_contacts: u64,
}
