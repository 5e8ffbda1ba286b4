//! What a diagnosis says: `palpate diagnose --json`, `palpate actuator diagnose --json` and the Diagnose screen.

use std::collections::BTreeMap;

use palpate_robot_model::Place;
use serde::{Deserialize, Serialize};

use super::Metrics;

/// Fewest reference sessions from which one can tell what is usual.
pub const MIN_REFERENCES: usize = 3;

/// What the data says about the simulator as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The named effects account for all that repeats.
    Explained,
    /// Effects are named, and something that repeats is left.
    PartlyExplained,
    /// Something repeats, and no effect of the library accounts for it.
    Unexplained,
    /// Nothing beyond noise.
    NoDiscrepancy,
    /// No motion is repeated, so that nobody can tell whether anything is left beside the named effects, if there are
    /// any.
    CannotBeJudged,
}

/// The result of a diagnosis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct DiagnosisReport {
    /// The whole in one word.
    pub verdict: Verdict,
    /// The whole in one sentence, for an operator.
    pub sentence: String,
    /// Named effects, in the order in which they were added.
    pub effects: Vec<NamedEffect>,
    /// Effects that were identified and not added: they come near, but a measure speaks against each.
    #[serde(default)]
    pub in_doubt: Vec<EffectInDoubt>,
    /// What was tried and not named, best first, as of the first round: the evidence behind the names.
    pub candidates: Vec<Candidate>,
    /// Smallest set of cells that holds 80 % of the excess of the calibrated model.
    #[serde(rename = "where")]
    pub cells: Vec<Cell>,
    /// Gap on the confirm takes, which nothing but this report has looked at: mean L1 mismatch a channel-second (tactile),
    /// mean absolute position error in rad (actuator). Of all takes where none is kept for it; a note says so.
    pub gap: Gap,
    /// The same as `gap`.
    pub held_out: Gap,
    /// The same of the takes that were fitted.
    #[serde(default)]
    pub fitted: Gap,
    /// The gap on confirm takes step by step: nominal, calibrated, then one more effect each, with 95 % intervals.
    pub waterfall: Vec<WaterfallStep>,
    /// Event metrics on confirm takes: `nominal`, `calibrated`, `diagnosed`. Empty for actuators.
    pub metrics: BTreeMap<String, Metrics>,
    /// What no named effect accounts for.
    pub unexplained: Unexplained,
    /// What to record next; `None` if nothing would help or nothing needs to.
    pub next_experiment: Option<NextExperiment>,
    /// Mismatch of each channel, calibrated and diagnosed, by phase, on confirm takes: what the residual map shows.
    pub residual_map: Vec<ChannelResidual>,
    /// Takes by their part: `fit`, each of which is left out in turn where candidates are compared, and `confirm`.
    pub takes: BTreeMap<String, Vec<String>>,
    /// Evidence that an effect must reach to be named, and where it comes from.
    pub bar: Bar,
    /// Reference sessions, in which nothing is wrong, that set the limits; absent if the shipped ones apply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_sessions: Option<usize>,
    /// What a reader of the numbers should know.
    pub notes: Vec<String>,
    /// Wall time, s.
    pub seconds: f64,
}

/// An effect that was named.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct NamedEffect {
    /// Id in the library.
    pub id: String,
    /// Where it acts.
    #[serde(rename = "where")]
    pub place: Place,
    /// Fitted parameters by name (units are in the names).
    pub parameters: BTreeMap<String, f64>,
    /// 95 % intervals by parameter name.
    pub interval: BTreeMap<String, [f64; 2]>,
    /// Gap on confirm takes before it was added.
    pub gap_before: f64,
    /// Gap on confirm takes after it was added.
    pub gap_after: f64,
    /// Share of sessions simulated with nothing missing in which any candidate has evidence this strong; absent where
    /// the station has no such sessions ([`Bar::null_sessions`]).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p_value: Option<f64>,
    /// Evidence for it, on the scale of [`Bar::evidence`].
    pub evidence: f64,
    /// Takes whose mismatch it lowers, of all takes: `8/9`.
    pub takes_improved: String,
    /// Ids that the data cannot tell apart, itself among them.
    pub class: Vec<String>,
    /// The other members of the class.
    pub rivals: Vec<Rival>,
    /// One sentence that an operator understands.
    pub explanation: String,
}

/// An effect that was identified and not added.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct EffectInDoubt {
    /// Id in the library.
    pub id: String,
    /// Where it would act.
    #[serde(rename = "where")]
    pub place: Place,
    /// Parameters as they were fitted when it was withheld.
    pub parameters: BTreeMap<String, f64>,
    /// What speaks against it.
    pub doubt: Vec<Doubt>,
}

/// A measure that speaks against an effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Doubt {
    /// Id of the rule: `docs/diagnosis.md` lists what each measures.
    pub check: String,
    /// What it measured.
    pub measured: f64,
    /// Above which it withholds.
    pub limit: f64,
}

/// An effect that explains the data nearly as well as the one that was named.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Rival {
    /// Id in the library.
    pub id: String,
    /// Where it would act.
    #[serde(rename = "where")]
    pub place: Place,
    /// Gap on confirm takes with it instead, everything else fitted anew.
    pub gap_after: f64,
}

/// An effect that was tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Candidate {
    /// Id in the library.
    pub id: String,
    /// Where it would act.
    #[serde(rename = "where")]
    pub place: Place,
    /// Its parameters, fitted beside the calibrated model.
    pub parameters: BTreeMap<String, f64>,
    /// Evidence for it, on the scale of [`Bar::evidence`].
    pub evidence: f64,
    /// Share of the excess that it would remove on takes it was not fitted to.
    pub share_removed: f64,
    /// One sentence that an operator understands.
    pub explanation: String,
}

/// A part of the data in which simulation and measurement disagree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Cell {
    /// Stream id; absent for actuators.
    pub stream: Option<String>,
    /// Channel ids.
    pub channels: Vec<String>,
    /// Joint names whose motion coincides with it.
    pub joints: Vec<String>,
    /// `onset`, `sustained`, `release` or `no_contact`; for actuators `moving`, `holding` or `reversing`.
    pub phase: String,
    /// Takes it shows in.
    pub takes: Vec<String>,
    /// Share of all excess.
    pub excess: f64,
    /// Mean signed residual over its standard deviation.
    pub effect_size: f64,
    /// Against whole repetitions with their signs flipped.
    pub p_value: f64,
}

/// The gap of several models on the same data.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Gap {
    /// Nominal model.
    pub nominal: f64,
    /// Calibrated model.
    pub calibrated: f64,
    /// Calibrated model with the named effects.
    pub diagnosed: f64,
    /// What repetitions of the same motion differ by.
    pub noise_floor: Option<f64>,
}

/// One step of the waterfall.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct WaterfallStep {
    /// `nominal`, `calibrated`, then the ids of the effects as they are added.
    pub step: String,
    /// Gap on confirm takes.
    pub gap: f64,
    /// From resampling whole repetitions; `None` where there are too few.
    pub interval_95: Option<[f64; 2]>,
}

/// What no named effect accounts for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Unexplained {
    /// Share of the calibrated model's excess that is left.
    pub fraction: f64,
    /// Whether what is left repeats more than it would by chance.
    pub significant: bool,
    /// Where it is.
    #[serde(rename = "where")]
    pub cells: Vec<Cell>,
    /// Why the verdict says that something is left (touch only): each measure that is above its limit.
    #[serde(default)]
    pub because: Vec<TooMuchLeft>,
    /// By stream of touch, how much the response of a channel differs from take to take beyond the model: what a gain of its own
    /// for each take removes beyond one gain for all takes, in variances for each such gain. 1 where noise is all that is left;
    /// of a stream that no two takes press there is none.
    #[serde(default)]
    pub touch_to_touch: BTreeMap<String, f64>,
}

/// A measure of what is left after naming that is above its limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct TooMuchLeft {
    /// Id of the measure, as in `docs/diagnosis.md`.
    pub check: String,
    /// What it measured.
    pub measured: f64,
    /// What it allows.
    pub limit: f64,
    /// The patch or stream in which it is largest; none of a measure over all signals.
    #[serde(rename = "where", default, skip_serializing_if = "Option::is_none")]
    pub place: Option<Place>,
    /// The same as a sentence for an operator.
    pub sentence: String,
}

/// What an experiment is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Purpose {
    /// It tells an effect, named or withheld, from its strongest rival.
    #[default]
    Separate,
    /// It repeats a motion, so that what is left can be told from noise.
    Repeat,
    /// It shows more of what is left and has no name.
    ShowMore,
}

/// What to record next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct NextExperiment {
    /// Primitive id.
    pub primitive: String,
    /// Object id.
    pub object: String,
    /// Ids of the effects it separates; empty unless that is its purpose.
    pub separates: Vec<String>,
    /// What a repetition is worth, in standard deviations of the noise: expected distance between the effects' predictions,
    /// or size of the residual that repetitions share; 0 where it is for repeating.
    pub expected_gain: f64,
    /// The same as a sentence for an operator.
    pub sentence: String,
    /// What it is for.
    #[serde(default)]
    pub purpose: Purpose,
}

/// Mismatch of one channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ChannelResidual {
    /// Channel id.
    pub channel: String,
    /// Calibrated model: L1 a second by phase.
    pub calibrated: BTreeMap<String, f64>,
    /// Diagnosed model: L1 a second by phase.
    pub diagnosed: BTreeMap<String, f64>,
}

/// The evidence that an effect must reach to be named.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Bar {
    /// Least evidence: how far the estimate lies beyond the smallest size that matters, in standard errors, squared.
    pub evidence: f64,
    /// Sessions simulated with nothing missing behind it; 0 if it is the shipped default.
    pub null_sessions: usize,
    /// Highest evidence in each of those sessions, ascending.
    pub null_maxima: Vec<f64>,
}

/// An effect of a saved model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ModelEffect {
    /// Id in the library.
    pub id: String,
    /// Where it acts.
    #[serde(rename = "where")]
    pub place: Place,
    /// Its parameters by name (units are in the names).
    pub parameters: BTreeMap<String, f64>,
}
