//! JSON documents of the HTTP API and of `palpate --json`. Field names are a contract.

mod campaigns;
mod comparison;
mod docs;
mod imitation;
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
pub use docs::*;
pub use imitation::*;
pub use jobs::*;
pub use lineage::*;
pub use live::*;
pub use objects::*;
use palpate_reports::{CalibrationReport, DiagnosisReport, ModelEffect, StreamThetaReport, ThetaReport};
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

/// `POST /api/v1/diagnoses`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct DiagnosisRequest {
    /// Session id.
    pub session: String,
    /// Id of a saved model to start from; absent means the station's nominal one. Theta of a model without effects is
    /// calibrated first; that of a model with effects is fitted beside them.
    #[serde(default)]
    pub model: Option<String>,
    /// Confirm takes; absent means chosen automatically.
    #[serde(default)]
    pub hold_out: Option<Vec<String>>,
    /// Most effects to name.
    #[serde(default)]
    pub max_effects: Option<usize>,
    /// Effects to leave out of the library, by id.
    #[serde(default)]
    pub without: Vec<String>,
    /// Sessions with nothing missing to simulate first, from which the station's bar is set anew; absent means that the
    /// bar kept for the station is used, else the shipped one.
    #[serde(default)]
    pub null_sessions: Option<usize>,
    /// Ids of at least three sessions of the same station in which nothing is wrong: limits are then what such sessions leave;
    /// empty means the shipped ones.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub references: Vec<String>,
}

/// State of a diagnosis: `GET /api/v1/diagnoses/{job}`.
pub type DiagnosisRun = Run<DiagnosisRequest, DiagnosisReport>;

/// `POST /api/v1/diagnoses/{job}/save`: keeps the calibrated model with the named effects, or some of them. Exactly one
/// of `name` and `to` says where.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct SaveDiagnosisRequest {
    /// Which of the named effects, by their position in the report; absent means all.
    #[serde(default)]
    pub effects: Option<Vec<usize>>,
    /// Name for people of a new model; its id is made from it.
    #[serde(default)]
    pub name: Option<String>,
    /// Id of the model to add them to: the one that the diagnosis started from. Its earlier version is kept, and
    /// `POST /api/v1/models/{id}/undo` brings it back.
    #[serde(default)]
    pub to: Option<String>,
}

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
