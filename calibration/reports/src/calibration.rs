//! What a calibration found.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

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
