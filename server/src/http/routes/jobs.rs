//! Jobs of every kind.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
};
use palpate_jobs::{ListFilter, Submitted};
use palpate_recording::files::{read_file, resolve_in};
use palpate_wire::api::{IDEMPOTENCY_HEADER, Job, JobChanges, JobPage, JobRequest, JobState};
use serde::Deserialize;

use crate::{
    AppState, Error,
    data::files,
    http::{
        extract::{Body, Ids, Owner, Params},
        problem::{Answer, Problem},
    },
    work::Kind,
};

/// Longest idempotency key, bytes.
const MAX_KEY_BYTES: usize = 255;
/// This much of a log or of metrics is sent, from its end, bytes.
const MAX_TAIL_BYTES: u64 = 1 << 20;
/// Largest file of a job that is sent, bytes.
const MAX_FILE_BYTES: u64 = 256 << 20;

/// 202 for a new job, 200 for one that the same key made before.
pub(super) async fn submit(
    State(state): State<Arc<AppState>>,
    Owner(owner): Owner,
    headers: HeaderMap,
    Body(request): Body<JobRequest>,
) -> Answer<Response> {
    let key = key_of(&headers).map_err(Problem)?;
    let submitted =
        state.run(Kind::Read, move |state| state.jobs().submit(&request, &owner, key.as_deref())).await?;
    Ok(accepted(submitted))
}

/// The same for a job like another one.
pub(super) async fn clone(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Owner(owner): Owner,
    headers: HeaderMap,
    Body(changes): Body<JobChanges>,
) -> Answer<Response> {
    let key = key_of(&headers).map_err(Problem)?;
    let submitted = state
        .run(Kind::Read, move |state| state.jobs().clone_job(&id, changes, &owner, key.as_deref()))
        .await?;
    Ok(accepted(submitted))
}

fn accepted(submitted: Submitted) -> Response {
    let status = if submitted.is_new { StatusCode::ACCEPTED } else { StatusCode::OK };
    let location = [(header::LOCATION, format!("/api/v1/jobs/{}", submitted.job.id))];
    (status, location, Json(submitted.job)).into_response()
}

fn key_of(headers: &HeaderMap) -> Result<Option<String>, Error> {
    let Some(value) = headers.get(IDEMPOTENCY_HEADER) else { return Ok(None) };
    let key = value.to_str().ok().map(str::trim).filter(|key| !key.is_empty() && key.len() <= MAX_KEY_BYTES);
    key.map(|key| Some(key.to_owned())).ok_or_else(|| {
        Error::Argument(format!(
            "the header {IDEMPOTENCY_HEADER} must be a text of 1 to {MAX_KEY_BYTES} ASCII characters"
        ))
    })
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ListParams {
    state: Option<JobState>,
    kind: Option<String>,
    limit: Option<u32>,
    cursor: Option<String>,
}

pub(super) async fn list(
    State(state): State<Arc<AppState>>,
    Params(params): Params<ListParams>,
) -> Answer<Json<JobPage>> {
    let ListParams { state: job_state, kind, limit, cursor } = params;
    let filter = ListFilter { state: job_state, kind, limit, cursor };
    state.run(Kind::Read, move |state| Ok(Json(state.jobs().scheduler().list(&filter)?))).await
}

pub(super) async fn detail(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Json<Job>> {
    state.run(Kind::Read, move |state| Ok(Json(state.jobs().scheduler().job(&id)?))).await
}

pub(super) async fn discard(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<StatusCode> {
    state
        .run(Kind::Read, move |state| {
            state.jobs().scheduler().delete(&id)?;
            Ok(StatusCode::NO_CONTENT)
        })
        .await
}

pub(super) async fn cancel(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Json<Job>> {
    state.run(Kind::Read, move |state| Ok(Json(state.jobs().scheduler().cancel(&id)?))).await
}

pub(super) async fn retry(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Json<Job>> {
    state.run(Kind::Read, move |state| Ok(Json(state.jobs().scheduler().retry(&id)?))).await
}

pub(super) async fn log(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Response> {
    state
        .run(Kind::Read, move |state| {
            let job = state.jobs().scheduler().job(&id)?;
            let text = state.jobs().scheduler().folder(&job.id).log_tail(MAX_TAIL_BYTES)?;
            Ok(([(header::CONTENT_TYPE, "text/plain; charset=utf-8")], text).into_response())
        })
        .await
}

pub(super) async fn metrics(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Response> {
    state
        .run(Kind::Read, move |state| {
            let job = state.jobs().scheduler().job(&id)?;
            let text = state.jobs().scheduler().folder(&job.id).metrics_tail(MAX_TAIL_BYTES)?;
            Ok(([(header::CONTENT_TYPE, "application/jsonl")], text).into_response())
        })
        .await
}

/// A file that the job has left, by its name in the job's folder.
pub(super) async fn file(
    State(state): State<Arc<AppState>>,
    Ids((id, name)): Ids<(String, String)>,
) -> Answer<Response> {
    state
        .run(Kind::Read, move |state| {
            let job = state.jobs().scheduler().job(&id)?;
            files::check_id("file", &name)?;
            let folder = state.jobs().scheduler().folder(&job.id);
            let path = folder.file(&name);
            if !path.is_file() {
                return Err(Error::NotFound {
                    what: "file of the job",
                    id: name,
                    hint: "a job that is done has report.json, and those that fit a model have model.toml",
                });
            }
            resolve_in(folder.path(), &path)?;
            let bytes = read_file(&path, MAX_FILE_BYTES)?;
            Ok(([(header::CONTENT_TYPE, content_type(&name))], bytes).into_response())
        })
        .await
}

fn content_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, ending)| ending) {
        "json" => "application/json",
        "jsonl" => "application/jsonl",
        "html" => "text/html; charset=utf-8",
        "toml" => "application/toml",
        "txt" | "sh" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}
