//! Jobs of every kind.

use std::{sync::Arc, time::Duration};

use axum::{
    Json,
    extract::{OriginalUri, State},
    http::{HeaderMap, HeaderName, StatusCode, header},
    response::{
        IntoResponse, Response, Sse,
        sse::{Event, KeepAlive},
    },
};
use palpate_jobs::{JobFolder, ListFilter, Submitted};
use palpate_people::Principal;
use palpate_recording::files::{read_file, resolve_in};
use palpate_wire::api::{Job, JobChanges, JobKindDocument, JobPage, JobRequest, JobState, Role, Scope};
use serde::Deserialize;
use utoipa::IntoParams;

use super::accepted;
use crate::{
    AppState, Error,
    data::files,
    http::{
        documented::{Binary, JobEvent, Refusal},
        download::Download,
        extract::{Asking, Body, Ids, Key, Owner, Params, check_limit},
        identity,
        pages::page_of,
        problem::Answer,
    },
    jobs::{kinds, tables::curves},
    work::Kind,
};

const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");
/// A client hears something this often, so that it, and proxies between, take the connection for alive.
const KEEP_ALIVE: Duration = Duration::from_secs(10);
/// This much of a log or of metrics is sent, from its end, bytes.
const MAX_TAIL_BYTES: u64 = 1 << 20;
/// Largest file of a job that is sent, bytes.
const MAX_FILE_BYTES: u64 = 256 << 20;

/// What answers a request that queues a job.
#[derive(utoipa::IntoResponses)]
#[expect(dead_code, reason = "the document asks only for its form")]
enum Queued {
    /// It is queued.
    #[response(status = 202, headers(("Location" = String, description = "Path of the job")))]
    Now(Job),
    /// It was queued by an earlier request with the same key.
    #[response(status = 200, headers(("Location" = String, description = "Path of the job")))]
    Before(Job),
}

/// Queues a job. It is on disk when the answer comes, and outlives the studio (`docs/jobs.md`).
#[utoipa::path(
    post,
    path = "/jobs",
    tag = "jobs",
    params(Key),
    request_body = JobRequest,
    responses(Queued, Refusal<404>, Refusal<409>),
)]
pub(super) async fn submit(
    State(state): State<Arc<AppState>>,
    Owner(owner): Owner,
    Asking(asking): Asking,
    Key { key }: Key,
    Body(request): Body<JobRequest>,
) -> Answer<Response> {
    let submit = move |state: &AppState| {
        check_may_move(state, &request.kind, &asking)?;
        state.jobs().submit(&request, &owner, key.as_deref())
    };
    Ok(submitted(state.run(Kind::Read, submit).await?))
}

/// Queues another job like one that is there, but for the changes, on the data as it is now.
#[utoipa::path(
    post,
    path = "/jobs/{job}/clone",
    tag = "jobs",
    params(Key),
    request_body = JobChanges,
    responses(Queued, Refusal<404>, Refusal<409>),
)]
pub(super) async fn clone(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Owner(owner): Owner,
    Asking(asking): Asking,
    Key { key }: Key,
    Body(changes): Body<JobChanges>,
) -> Answer<Response> {
    let clone = move |state: &AppState| {
        check_may_move(state, &state.jobs().scheduler().job(&id)?.kind, &asking)?;
        state.jobs().clone_job(&id, changes, &owner, key.as_deref())
    };
    Ok(submitted(state.run(Kind::Read, clone).await?))
}

/// Refuses a job of `kind` that moves the robot to whoever may not, and where there is none.
fn check_may_move(state: &AppState, kind: &str, asking: &Principal) -> Result<(), Error> {
    if !kinds::kind(kind)?.resources.station {
        return Ok(());
    }
    if let Some(lack) = identity::lack(asking, Role::Operator, Scope::Control) {
        return Err(Error::NotPermitted(format!("a job of kind {kind:?} moves the robot: {lack}")));
    }
    state.live().map(drop).ok_or(Error::NoStation)
}

fn submitted(submitted: Submitted) -> Response {
    let location = [(header::LOCATION, format!("/api/v1/jobs/{}", submitted.job.id))];
    (accepted(submitted.is_new), location, Json(submitted.job)).into_response()
}

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ListParams {
    /// Only jobs in this state.
    #[param(inline)]
    state: Option<JobState>,
    /// Only jobs of this kind.
    kind: Option<String>,
    /// Most jobs of the answer; 100 without.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// Where the page before ended: its `next_cursor`.
    cursor: Option<String>,
}

/// Lists jobs of every kind, newest first: 100 a page, or `limit`.
#[utoipa::path(
    get,
    path = "/jobs",
    tag = "jobs",
    params(ListParams),
    responses((status = 200, description = "Done.", body = JobPage)),
)]
pub(super) async fn list(
    State(state): State<Arc<AppState>>,
    OriginalUri(uri): OriginalUri,
    Params(params): Params<ListParams>,
) -> Answer<Response> {
    let ListParams { state: job_state, kind, limit, cursor } = params;
    check_limit(limit)?;
    let filter = ListFilter { state: job_state, kind, limit, cursor };
    let page = state.run(Kind::Read, move |state| Ok(state.jobs().scheduler().list(&filter)?)).await?;
    let next = page.next_cursor.clone();
    Ok(page_of(&uri, Json(page), next.as_deref()))
}

/// Lists the kinds of jobs, and says which of them this studio cannot do, and why.
#[utoipa::path(
    get,
    path = "/kinds",
    tag = "jobs",
    responses((status = 200, description = "Done.", body = Vec<JobKindDocument>)),
)]
pub(super) async fn kinds(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<JobKindDocument>>> {
    let kinds = move |state: &AppState| {
        let mut kinds = state.jobs().kinds();
        if state.live().is_none() {
            for kind in kinds.iter_mut().filter(|kind| kind.resources.station) {
                (kind.is_available, kind.problem) = (false, Some(Error::NoStation.to_string()));
            }
        }
        Ok(Json(kinds))
    };
    state.run(Kind::Read, kinds).await
}

/// Answers with where a job stands.
#[utoipa::path(
    get,
    path = "/jobs/{job}",
    tag = "jobs",
    responses((status = 200, description = "Done.", body = Job), Refusal<404>),
)]
pub(super) async fn detail(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Json<Job>> {
    state.run(Kind::Read, move |state| Ok(Json(state.jobs().scheduler().job(&id)?))).await
}

/// Moves a job that has ended to the trash, with its files.
#[utoipa::path(
    delete,
    path = "/jobs/{job}",
    tag = "jobs",
    responses((status = 204, description = "It is in the trash."), Refusal<404>, Refusal<409>),
)]
pub(super) async fn discard(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<StatusCode> {
    state
        .run(Kind::Read, move |state| {
            state.jobs().scheduler().delete(&id)?;
            Ok(StatusCode::NO_CONTENT)
        })
        .await
}

/// Asks a job to stop, and ends it if it does not; one that has ended stays as it is.
#[utoipa::path(
    post,
    path = "/jobs/{job}/cancel",
    tag = "jobs",
    responses((status = 200, description = "Done.", body = Job), Refusal<404>),
)]
pub(super) async fn cancel(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Json<Job>> {
    state.run(Kind::Read, move |state| Ok(Json(state.jobs().scheduler().cancel(&id)?))).await
}

/// Queues a job that failed or was cancelled once more.
#[utoipa::path(
    post,
    path = "/jobs/{job}/retry",
    tag = "jobs",
    responses((status = 200, description = "Done.", body = Job), Refusal<404>, Refusal<409>),
)]
pub(super) async fn retry(
    State(state): State<Arc<AppState>>,
    Asking(asking): Asking,
    Ids(id): Ids<String>,
) -> Answer<Json<Job>> {
    let retry = move |state: &AppState| {
        check_may_move(state, &state.jobs().scheduler().job(&id)?.kind, &asking)?;
        Ok(Json(state.jobs().scheduler().retry(&id)?))
    };
    state.run(Kind::Read, retry).await
}

/// Answers with the newest part of what the process of a job printed, 1 MiB at most.
#[utoipa::path(
    get,
    path = "/jobs/{job}/log",
    tag = "jobs",
    responses((status = 200, description = "Done.", body = String, content_type = "text/plain"), Refusal<404>),
)]
pub(super) async fn log(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Response> {
    let media_type = "text/plain; charset=utf-8";
    text_of(&state, Kind::Read, id, media_type, |folder| Ok(folder.log_tail(MAX_TAIL_BYTES)?)).await
}

/// Answers with the newest part of the curves of a job, a JSON document a line, 1 MiB at most.
#[utoipa::path(
    get,
    path = "/jobs/{job}/metrics",
    tag = "jobs",
    responses((status = 200, description = "Done.", body = String, content_type = "application/jsonl"), Refusal<404>),
)]
pub(super) async fn metrics(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Response> {
    let media_type = "application/jsonl";
    text_of(&state, Kind::Read, id, media_type, |folder| Ok(folder.metrics_tail(MAX_TAIL_BYTES)?)).await
}

/// Answers with the curves of a job as a table: a row for each step, a column for each number.
#[utoipa::path(
    get,
    path = "/jobs/{job}/metrics.csv",
    tag = "jobs",
    responses((status = 200, description = "Done.", body = String, content_type = "text/csv"), Refusal<404>),
)]
pub(super) async fn metrics_csv(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Response> {
    let media_type = "text/csv; charset=utf-8";
    text_of(&state, Kind::Compute, id, media_type, |folder| curves(&folder.metrics_tail(MAX_FILE_BYTES)?))
        .await
}

/// Answers with a text that `read` makes of the folder of job `id`.
async fn text_of(
    state: &Arc<AppState>,
    kind: Kind,
    id: String,
    media_type: &'static str,
    read: fn(&JobFolder) -> Result<String, Error>,
) -> Answer<Response> {
    let text = move |state: &AppState| {
        let scheduler = state.jobs().scheduler();
        read(&scheduler.folder(&scheduler.job(&id)?.id))
    };
    let text = state.run(kind, text).await?;
    Ok(([(header::CONTENT_TYPE, media_type)], text).into_response())
}

/// Answers with a file that a job has left, e.g. `report.json`, `report.html` or `model.toml` (`docs/jobs.md`).
///
/// With `Range: bytes=...` a part of it comes, so that a download that broke off can go on; `If-Range` with the `ETag` of
/// before makes sure that it is the same file still.
#[utoipa::path(
    get,
    path = "/jobs/{job}/files/{file}",
    tag = "jobs",
    params(
        ("Range" = Option<String>, Header, description = "A part, such as `bytes=1000-`"),
        ("If-Range" = Option<String>, Header, description = "The `ETag` of the file of which a part is wanted"),
    ),
    responses(
        (status = 200, description = "The file.",
            content((Object = "application/json"), (String = "application/jsonl"), (String = "application/toml"),
                (String = "text/html"), (String = "text/plain"), (Binary = "application/octet-stream")),
            headers(("Repr-Digest" = String, description = "SHA-256 of the whole file (RFC 9530)"),
                ("Accept-Ranges" = String, description = "`bytes`"))),
        (status = 206, description = "The part that `Range` asks for.", body = Binary, content_type = "*/*",
            headers(("Content-Range" = String, description = "Which part of how many bytes"),
                ("Repr-Digest" = String, description = "SHA-256 of the whole file (RFC 9530)"))),
        Refusal<404>, Refusal<416>, Refusal<422>,
    ),
)]
pub(super) async fn file(
    State(state): State<Arc<AppState>>,
    Ids((id, name)): Ids<(String, String)>,
    headers: HeaderMap,
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
            Download::of_bytes(bytes.into(), content_type(&name)).answer(&headers)
        })
        .await
}

/// Answers with where a job stands whenever that changes, as server-sent events, until it has ended.
///
/// The first event tells where it stands now. Every event is a `Job` in JSON, so that none is missed by a client that comes
/// late or comes back; one that comes back after the last event is answered by 204, which ends an `EventSource`.
#[utoipa::path(
    get,
    path = "/jobs/{job}/events",
    tag = "jobs",
    params(("Last-Event-ID" = Option<String>, Header, description = "Id of the last event that the client has seen")),
    responses(
        (status = 200, description = "Events until the job has ended.", body = JobEvent,
            content_type = "text/event-stream"),
        (status = 204, description = "The client has seen the last event."),
        Refusal<404>,
    ),
)]
pub(super) async fn events(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    headers: HeaderMap,
) -> Answer<Response> {
    // Before the job is looked up, so that no change between is missed.
    let watcher = state.hub().watch_job(&id);
    let job = state.run(Kind::Read, move |state| Ok(state.jobs().scheduler().job(&id)?)).await?;
    let seen = headers.get(LAST_EVENT_ID).and_then(|id| id.to_str().ok());
    if !job.is_unfinished() && seen == Some(event_id(&job).as_str()) {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let shutdown = state.shutdown();
    let begin = Some((Some(Arc::new(job)), watcher, shutdown));
    let events = futures_util::stream::unfold(begin, async |at| {
        let (known, watcher, mut shutdown) = at?;
        let job = match known {
            Some(job) => job,
            None => tokio::select! {
                job = watcher.next() => job,
                _ = shutdown.wait_for(|&ends| ends) => return None,
            },
        };
        let event = Event::default().event("job").id(event_id(&job)).json_data(&*job);
        let next = job.is_unfinished().then_some((None, watcher, shutdown));
        Some((event, next))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// Changes with what a client must not miss: states and attempts.
fn event_id(job: &Job) -> String {
    format!("{}-{}", job.attempts, job.state.name())
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
