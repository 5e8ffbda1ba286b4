//! What checks of sessions and takes found.

use serde::{Deserialize, Serialize};

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

/// The automatic quality check of a take.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct TakeVerdict {
    /// Whether it can be accepted without a second look.
    pub good: bool,
    /// One sentence.
    pub summary: String,
    /// What is wrong, each with what to do.
    pub problems: Vec<String>,
    /// Channels that were touched, by id.
    pub covered: Vec<String>,
    /// Planned channels that were not, by id.
    pub missed: Vec<String>,
    /// Samples per second of joints and of each stream, by name.
    pub rates_hz: Vec<(String, f64)>,
}
