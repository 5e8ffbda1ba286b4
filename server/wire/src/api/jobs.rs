//! Jobs: long work that outlives the request, and the studio that was asked for it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::JobState;

/// Header of requests that start a job: a text of the client's choice. The same text with the same request gives the same
/// job again, so that a client that heard no answer can ask once more.
pub const IDEMPOTENCY_HEADER: &str = "idempotency-key";

/// `POST /api/v1/jobs`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct JobRequest {
    /// Kind of job, e.g. `diagnose`.
    pub kind: String,
    /// What is asked, in the form of its kind: `CalibrationRequest`, `DiagnosisRequest`, `EmulateRequest`, `BlindRequest`,
    /// `ExpertRequest`, `EvaluationRequest`, `DemonstrationsRequest`, `PretrainingRequest`, `GatheringRequest`,
    /// `ImitationRequest`, `PipelineRequest`, `RolloutsRequest`, `ComparisonRequest`, `TuneRequest`.
    #[cfg_attr(feature = "openapi", schema(value_type = Object))]
    pub request: Value,
    /// Seed of everything random.
    #[serde(default)]
    pub seed: u64,
    /// Jobs of a higher priority start first; 0 is usual.
    #[serde(default)]
    pub priority: i32,
    /// What it needs of the machine; absent means what its kind needs.
    #[serde(default)]
    pub resources: Option<Resources>,
    /// Where it runs: `process`, or the name of a runner in `runners.toml`; absent means the first that there is.
    #[serde(default)]
    pub runner: Option<String>,
}

/// `POST /api/v1/jobs/{id}/clone`: what is different from the job that is asked for again. What is absent stays.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct JobChanges {
    /// Fields of the request, each in place of the one of that name; `null` takes a field out.
    #[serde(default)]
    #[cfg_attr(feature = "openapi", schema(value_type = Object))]
    pub request: serde_json::Map<String, Value>,
    /// Seed of everything random.
    #[serde(default)]
    pub seed: Option<u64>,
    /// Jobs of a higher priority start first.
    #[serde(default)]
    pub priority: Option<i32>,
    /// What it needs of the machine.
    #[serde(default)]
    pub resources: Option<Resources>,
    /// Where it runs.
    #[serde(default)]
    pub runner: Option<String>,
}

/// What a job is, written down: everything that its result depends on. File `spec.json` of its folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct JobSpec {
    /// Kind of job.
    pub kind: String,
    /// What is asked, in the form of its kind.
    #[cfg_attr(feature = "openapi", schema(value_type = Object))]
    pub request: Value,
    /// SHA-256 of every file that it reads, hexadecimal, by path relative to the data folder.
    #[serde(default)]
    pub inputs: BTreeMap<String, String>,
    /// Seed of everything random.
    #[serde(default)]
    pub seed: u64,
    /// Name and version of the program that was asked.
    pub software: String,
    /// Jobs of a higher priority start first.
    #[serde(default)]
    pub priority: i32,
    /// What it needs of the machine.
    #[serde(default)]
    pub resources: Resources,
}

/// What a job needs of the machine that it runs on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Resources {
    /// Cores; 0 means all of them. A number above what the machine has means all of them too.
    #[serde(default)]
    pub cores: u32,
    /// The GPU, which no other job has meanwhile.
    #[serde(default)]
    pub gpu: bool,
    /// The live station, which no other job has meanwhile.
    #[serde(default)]
    pub station: bool,
    /// Most memory, MiB; a job that asks the operating system for more fails.
    #[serde(default)]
    pub memory_mib: Option<u64>,
    /// It takes seconds, so it does not wait for jobs that take longer.
    #[serde(default)]
    pub short: bool,
    /// Shards into which the work is divided, each a process or a task of a Slurm array; 0: it is not divided. What is said
    /// of cores, GPU and memory is then what each of them has.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub shards: u32,
    /// Shards that work at once at most; 0: as many as there is room for.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub at_once: u32,
}

impl Resources {
    /// Shards that may work at once; 1 where the work is not divided.
    pub fn max_at_once(&self) -> u32 {
        let limit = if self.at_once == 0 { self.shards } else { self.at_once };
        limit.min(self.shards).max(1)
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it by reference")]
fn is_zero(number: &u32) -> bool {
    *number == 0
}

/// Where a job stands, without its outcome: `GET /api/v1/jobs/{id}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Job {
    /// Id, also the name of its folder.
    pub id: String,
    /// Kind of job.
    pub kind: String,
    /// Where it stands.
    pub state: JobState,
    /// When it was asked for, RFC 3339.
    pub created: String,
    /// When its last attempt began, RFC 3339.
    pub started: Option<String>,
    /// When it ended, RFC 3339.
    pub ended: Option<String>,
    /// How many times it was begun.
    pub attempts: u32,
    /// Who asked for it.
    pub owner: String,
    /// Where it runs.
    pub runner: String,
    /// Done so far, 0..=1.
    pub fraction: f64,
    /// What is being done, for people.
    pub stage: String,
    /// Estimated time left, s.
    pub seconds_left: Option<f64>,
    /// Why it failed.
    pub problem: Option<String>,
    /// Somebody has asked it to stop.
    #[serde(default)]
    pub cancel_requested: bool,
    /// Id under which its outcome was saved, once it was.
    pub saved_as: Option<String>,
    /// What was asked.
    pub spec: JobSpec,
}

impl Job {
    /// Whether it waits or works.
    pub fn is_unfinished(&self) -> bool {
        matches!(self.state, JobState::Queued | JobState::Running)
    }
}

/// `GET /api/v1/jobs?state=&kind=&limit=&cursor=`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct JobPage {
    /// Jobs, newest first.
    pub jobs: Vec<Job>,
    /// What to give as `cursor` for the next page; absent on the last one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_cursor: Option<String>,
}

/// How far a job is. File `progress.json` of its folder, replaced as a whole.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct JobProgress {
    /// The attempt that says so.
    pub attempt: u32,
    /// Done so far, 0..=1.
    pub fraction: f64,
    /// What is being done, for people.
    pub stage: String,
    /// Estimated time left, s.
    pub seconds_left: Option<f64>,
}

/// How an attempt ended, in the words of the job's own process. File `exit.json` of its folder: whoever finds it knows
/// that everything else there is complete.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct JobExit {
    /// Which attempt.
    pub attempt: u32,
    /// How it ended: `done`, `failed` or `cancelled`.
    pub outcome: JobState,
    /// Exit code of the process.
    pub code: u8,
    /// Why it failed.
    pub problem: Option<String>,
    /// When it began, RFC 3339.
    pub started: String,
    /// When it ended, RFC 3339.
    pub ended: String,
    /// Name of the computer it ran on.
    pub host: String,
}

/// Request of a job of kind `emulate`: records a session from an emulated station.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulateRequest {
    /// What the emulated world is like: the name of a shipped truth file, e.g. `demo`.
    pub truth: String,
    /// Id of the session to make.
    pub session: String,
}

/// Request of a job of kind `blind`: hides effects in emulated sessions, has them diagnosed, and scores the names. Its
/// seed is that of the first round.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct BlindRequest {
    /// What to hide effects in.
    #[serde(default)]
    pub domain: BlindDomain,
    /// Rounds of the catalogue, each with places and noise of its own.
    #[serde(default = "one")]
    pub seeds: u64,
    /// Sessions with nothing hidden in each round.
    #[serde(default = "twenty")]
    pub nulls: usize,
    /// The world of the touch sessions: the name of a shipped truth file; absent means that of the reports.
    #[serde(default)]
    pub truth: Option<String>,
    /// Leave out the second diagnosis of each session without its raw readings.
    #[serde(default)]
    pub raw_only: bool,
    /// Leave out the diagnoses with an effect taken out of the library.
    #[serde(default)]
    pub whole_library: bool,
    /// Run only cases whose label contains one of these; empty means all.
    #[serde(default)]
    pub only: Vec<String>,
}

/// What effects are hidden in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum BlindDomain {
    /// Sessions of touch.
    #[default]
    Tactile,
    /// Logs of servos.
    Actuator,
}

fn one() -> u64 {
    1
}

fn twenty() -> usize {
    20
}
