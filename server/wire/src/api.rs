//! JSON documents of the HTTP API and of `palpate --json`. Field names are a contract.

mod campaigns;
mod comparison;
mod diagnosis;
mod docs;
mod jobs;
mod lineage;
mod live;
mod objects;
mod people;
mod problem;
mod recording;
mod training;
mod trash;

use std::collections::BTreeMap;

pub use campaigns::*;
pub use comparison::*;
pub use diagnosis::*;
pub use docs::*;
pub use jobs::*;
pub use lineage::*;
pub use live::*;
pub use objects::*;
pub use people::*;
pub use problem::*;
pub use recording::*;
use serde::{Deserialize, Serialize};
pub use training::*;
pub use trash::*;

/// Header of HTTP requests that only the operator may make: the lease's number, decimal, as `ControlReply` gives it.
pub const LEASE_HEADER: &str = "palpate-lease";

/// `GET /api/v1/info`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Info {
    /// `palpate`.
    pub name: String,
    /// Software version.
    pub version: String,
    /// Name of the live station, if one runs.
    pub station: Option<String>,
    /// Where live data comes from.
    pub source: Source,
    /// The server listens beyond this computer without a login (`--insecure`): anybody in the network may take control.
    #[serde(default)]
    pub insecure: bool,
}

/// Where data comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// Hardware.
    Real,
    /// The emulated station.
    Emulated,
    /// Only recordings.
    Replay,
}

/// An entry of `GET /api/v1/sessions`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SessionSummary {
    /// Id: the folder's name.
    pub id: String,
    /// Station of its takes.
    pub station: String,
    /// Number of takes.
    pub takes: usize,
    /// Joint frames in all takes.
    pub frames: usize,
    /// Duration of all takes, s.
    pub duration_s: f64,
    /// Objects touched, by id.
    pub objects: Vec<String>,
    /// When it was recorded, RFC 3339; empty if unknown.
    pub recorded: String,
    /// Why the session cannot be opened; the rest is empty then.
    pub error: Option<String>,
}

/// `GET /api/v1/sessions/{session}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SessionDetail {
    /// As in the list.
    pub summary: SessionSummary,
    /// Its takes, in order.
    pub takes: Vec<TakeSummary>,
}

/// One take of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct TakeSummary {
    /// Id: the file's stem, e.g. `take-03`.
    pub id: String,
    /// Object touched, by id.
    pub object: String,
    /// Its pose in the base frame: x, y, z in m, then w, x, y, z.
    pub object_pose: [f64; 7],
    /// Primitive, e.g. `tap`.
    pub primitive: String,
    /// Joint frames.
    pub frames: usize,
    /// Duration, s.
    pub duration_s: f64,
    /// Whether the operator accepted it.
    pub accepted: bool,
    /// Whether raw readings were recorded beside the binary ones.
    pub has_raw: bool,
}

/// `GET /api/v1/sessions/{session}/station`: the station's texts, which the page parses with `palpate_robot_model`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct StationDocument {
    /// The station file.
    pub station_toml: String,
    /// Everything it names, by path relative to the station file; bytes as base64.
    pub files_base64: BTreeMap<String, String>,
}

/// `palpate session check --json` and `GET /api/v1/sessions/{session}/check`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CheckReport {
    /// The session.
    pub session: String,
    /// No problem of severity `error`.
    pub ok: bool,
    /// Joint frames in all takes.
    pub frames: usize,
    /// Duration of all takes, s.
    pub duration_s: f64,
    /// Per take.
    pub takes: Vec<TakeCheck>,
    /// Per channel, in order.
    pub coverage: Vec<ChannelCoverage>,
    /// What is wrong, worst first.
    pub problems: Vec<Problem>,
}

/// Rates and clocks of one take.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct TakeCheck {
    /// Id of the take.
    pub id: String,
    /// Streams by topic: joints, then the layout's.
    pub streams: Vec<StreamCheck>,
}

/// Rates, gaps and clock order of one stream in one take.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct StreamCheck {
    /// `joints` or the stream's id.
    pub stream: String,
    /// Number of samples.
    pub samples: usize,
    /// Mean rate, Hz.
    pub rate_hz: f64,
    /// Nominal rate, Hz.
    pub nominal_rate_hz: f64,
    /// Longest gap between samples, s.
    pub longest_gap_s: f64,
    /// Gaps longer than three nominal periods.
    pub gaps: usize,
    /// Host times that do not increase.
    pub clock_steps_back: usize,
}

/// How often a channel was touched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ChannelCoverage {
    /// Channel id.
    pub channel: String,
    /// Contact episodes in all takes.
    pub touches: usize,
    /// Contact episodes in each half of the takes (by order).
    pub touches_by_half: [usize; 2],
    /// Seconds active in all.
    pub active_s: f64,
}

/// Something wrong with a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Problem {
    /// How bad.
    pub severity: Severity,
    /// Where: take, stream, channel.
    pub place: String,
    /// What, and what to do.
    pub message: String,
}

/// How bad a problem is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The data cannot be used.
    Error,
    /// The data can be used with care.
    Warning,
    /// Worth knowing.
    Info,
}

/// The result of a calibration: `palpate calibrate --json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CalibrationReport {
    /// The nominal model on all takes.
    pub nominal: Metrics,
    /// The calibrated model on all takes.
    pub calibrated: Metrics,
    /// Both, on the held-out takes only.
    pub held_out: HeldOut,
    /// The calibrated parameters. Of streams that have their own, see `streams`.
    pub theta: ThetaReport,
    /// The nominal parameters.
    pub nominal_theta: ThetaReport,
    /// By stream id, what was fitted to each stream for itself; empty where streams share theta.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub streams: BTreeMap<String, StreamFit>,
    /// Joint frames in all takes.
    pub frames: usize,
    /// Channels.
    pub channels: usize,
    /// Objective evaluations (thresholds looked at by the exact search count one each alpha and lambda).
    pub evaluations: u64,
    /// Wall time of the search, s.
    pub seconds: f64,
    /// `exact` or `grid`.
    pub method: String,
    /// Both models on all takes, by stream id.
    pub by_modality: BTreeMap<String, MetricsPair>,
    /// Both models by take id, with whether the take was held out.
    pub by_take: BTreeMap<String, TakeMetrics>,
    /// Both models by channel id, on all takes.
    pub by_channel: BTreeMap<String, MetricsPair>,
    /// 95 % intervals from resampling takes, on the held-out takes where there are at least two, else on all.
    pub intervals_95: Option<Intervals>,
    /// The objective as a picture; empty where each stream has its own, in `streams`.
    pub objective: Objective,
    /// Ids of held-out takes.
    pub held_out_takes: Vec<String>,
    /// What a reader of the numbers should know: parameters that could not be fitted, an optimum at a bound.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// Both models on held-out takes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct HeldOut {
    /// Nominal model.
    pub nominal: Metrics,
    /// Calibrated model.
    pub calibrated: Metrics,
}

/// Both models on the same data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MetricsPair {
    /// Nominal model.
    pub nominal: Metrics,
    /// Calibrated model.
    pub calibrated: Metrics,
}

/// Both models on one take.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct TakeMetrics {
    /// Nominal model.
    pub nominal: Metrics,
    /// Calibrated model.
    pub calibrated: Metrics,
    /// Whether the fit has not seen this take.
    pub held_out: bool,
}

/// How well simulated events match real ones. `None` where there is nothing to average over.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Metrics {
    /// Mean absolute time between paired contact onsets, ms.
    pub onset_error_ms: Option<f64>,
    /// Mean absolute time between paired contact ends, ms.
    pub offset_error_ms: Option<f64>,
    /// 2 TP / (2 TP + FP + FN) over channel-frames.
    pub f1: Option<f64>,
    /// FP / (FP + TN) over channel-frames.
    pub fpr: Option<f64>,
    /// Channel-frames that differ.
    pub l1: u64,
    /// Real contacts that found a simulated partner, of all real contacts.
    pub onset_coverage: Option<f64>,
    /// Real contacts.
    pub real_contacts: u64,
    /// Simulated contacts.
    pub simulated_contacts: u64,
}

/// theta in the contract's names.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ThetaReport {
    /// m.
    pub lambda_con_m: f64,
    /// 1/m.
    pub alpha_per_m: f64,
    /// Pa.
    pub lambda_pre_pa: f64,
}

/// The parameters that a stream has of its own: those that sensors of its kind use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct StreamThetaReport {
    /// m; of proximity streams.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lambda_con_m: Option<f64>,
    /// 1/m; of pressure streams.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alpha_per_m: Option<f64>,
    /// Pa; of pressure streams.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lambda_pre_pa: Option<f64>,
}

/// The search for the parameters of one stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct StreamFit {
    /// The calibrated parameters.
    pub theta: StreamThetaReport,
    /// The nominal parameters.
    pub nominal_theta: StreamThetaReport,
    /// The objective over the channels of this stream.
    pub objective: Objective,
}

/// 95 % intervals of the metrics and of their change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Intervals {
    /// Nominal model.
    pub nominal: MetricIntervals,
    /// Calibrated model.
    pub calibrated: MetricIntervals,
    /// Calibrated less nominal.
    pub change: MetricIntervals,
    /// Resamples.
    pub resamples: usize,
    /// Seed.
    pub seed: u64,
}

/// `[low, high]` of each metric.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MetricIntervals {
    /// ms.
    pub onset_error_ms: Option<[f64; 2]>,
    /// ms.
    pub offset_error_ms: Option<[f64; 2]>,
    /// Share.
    pub f1: Option<[f64; 2]>,
    /// Share.
    pub fpr: Option<[f64; 2]>,
}

/// The objective around the optimum, for pictures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Objective {
    /// Rows of the heat map, 1/m.
    pub alphas_per_m: Vec<f64>,
    /// Columns of the heat map, Pa.
    pub lambda_pres_pa: Vec<f64>,
    /// L1 of the pressure channels on fitted takes, `[alpha][lambda_pre]`.
    pub pressure_l1: Vec<Vec<u64>>,
    /// Abscissa of the curve, m.
    pub lambda_cons_m: Vec<f64>,
    /// L1 of the proximity channels on fitted takes.
    pub proximity_l1: Vec<u64>,
}

/// `POST /api/v1/calibrations`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct CalibrationRequest {
    /// Session id.
    pub session: String,
    /// `exact` (default) or `grid`.
    #[serde(default)]
    pub method: Option<String>,
    /// Take ids to hold out; absent means chosen automatically.
    #[serde(default)]
    pub hold_out: Option<Vec<String>>,
    /// Whether all streams of a kind share one theta; else each has its own.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub shared_theta: bool,
}

/// State of a calibration: `GET /api/v1/calibrations/{job}`.
pub type CalibrationRun = Run<CalibrationRequest, CalibrationReport>;

/// State of a run: what was asked (`Q`), and what was found (`R`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Run<Q, R> {
    /// Id of the run.
    pub id: String,
    /// What was asked.
    pub request: Q,
    /// Where it stands.
    pub state: JobState,
    /// Done so far, 0..=1.
    pub fraction: f64,
    /// What is being done, for people.
    pub stage: String,
    /// Estimated time left, s.
    pub seconds_left: Option<f64>,
    /// Why it failed.
    pub error: Option<String>,
    /// The result, once done.
    pub report: Option<R>,
    /// The model file that was found, once done: of a diagnosis, with every named effect.
    pub model_toml: Option<String>,
    /// Id under which the model was saved, once it was.
    pub saved_as: Option<String>,
}

impl<Q, R> Run<Q, R> {
    /// Whether it waits or works.
    pub fn is_unfinished(&self) -> bool {
        matches!(self.state, JobState::Queued | JobState::Running)
    }
}

/// Where a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Waiting.
    Queued,
    /// Working.
    Running,
    /// Finished.
    Done,
    /// Stopped by an error.
    Failed,
    /// Stopped by somebody.
    Cancelled,
}

impl JobState {
    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// The state of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        let all = [Self::Queued, Self::Running, Self::Done, Self::Failed, Self::Cancelled];
        all.into_iter().find(|state| state.name() == name)
    }
}

/// `POST /api/v1/calibrations/{job}/save`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct SaveModelRequest {
    /// Name for people; the id is made from it.
    pub name: String,
}

/// An entry of `GET /api/v1/models`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ModelSummary {
    /// Id: the file's stem.
    pub id: String,
    /// Name for people.
    pub name: String,
    /// Its parameters.
    pub theta: ThetaReport,
    /// By stream id, what streams have of these for themselves.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub streams: BTreeMap<String, StreamThetaReport>,
    /// Where the numbers came from.
    pub provenance: Vec<String>,
    /// Effects beyond the three parameters, in the order in which they were added.
    #[serde(default)]
    pub effects: Vec<ModelEffect>,
    /// Earlier versions of the file that `POST /api/v1/models/{id}/undo` goes back through.
    #[serde(default)]
    pub earlier_versions: usize,
}
