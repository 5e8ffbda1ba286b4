//! Sessions: list, detail, check, station; in by upload, out to the trash and back.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{
    Json,
    body::Body,
    extract::{OriginalUri, State},
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
};
use http_body_util::BodyExt as _;
use palpate_recording::check_session;
use palpate_reports::CheckReport;
use palpate_wire::api::{SessionDetail, SessionSummary, StationDocument};
use serde::Deserialize;
use tokio::io::AsyncWriteExt as _;
use utoipa::IntoParams;

use super::station_document;
use crate::{
    AppState, Error,
    data::{
        archive::{Outgoing, pack},
        store, upload,
    },
    http::{
        documented::{Binary, Refusal},
        download::Download,
        extract::{Ids, Page, Params, USUAL_PAGE, check_limit},
        pages::{encode, page_of},
        problem::{Answer, Problem},
    },
    hub::List,
    work::Kind,
};

/// Lists sessions, by id.
#[utoipa::path(
    get,
    path = "/sessions",
    tag = "sessions",
    params(Page),
    responses((status = 200, description = "Done.", body = Vec<SessionSummary>)),
)]
pub(super) async fn list(
    State(state): State<Arc<AppState>>,
    OriginalUri(uri): OriginalUri,
    Params(page): Params<Page>,
) -> Answer<Response> {
    check_limit(page.limit)?;
    let list = move |state: &AppState| {
        let mut sessions = state.store().sessions()?;
        if let Some(cursor) = &page.cursor {
            sessions.retain(|id| id > cursor);
        }
        // A page that begins in the middle is not the whole list.
        let limit = page.limit.or(page.cursor.is_some().then_some(USUAL_PAGE));
        let limit = limit.map_or(usize::MAX, |limit| limit as usize);
        let more = sessions.len() > limit;
        sessions.truncate(limit);
        let next = sessions.last().filter(|_| more).cloned();
        let entries = sessions.iter().map(|id| {
            state.library().list_entry(id, state.store().session(id), |err| state.store().for_client(err))
        });
        Ok((entries.collect::<Vec<SessionSummary>>(), next))
    };
    let (entries, next) = with_store(&state, Kind::Read, list).await?;
    Ok(page_of(&uri, Json(entries), next.as_deref()))
}

/// Answers with a session and its takes.
#[utoipa::path(
    get,
    path = "/sessions/{session}",
    tag = "sessions",
    responses((status = 200, description = "Done.", body = SessionDetail), Refusal<404>, Refusal<409>, Refusal<422>),
)]
pub(super) async fn detail(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<SessionDetail>> {
    with_store(&state, Kind::Read, move |state| {
        Ok(Json(state.library().detail(&state.store().session(&id)?)?))
    })
    .await
}

/// Checks rates, gaps, clocks and coverage of a session.
#[utoipa::path(
    get,
    path = "/sessions/{session}/check",
    tag = "sessions",
    responses((status = 200, description = "Done.", body = CheckReport), Refusal<404>, Refusal<409>, Refusal<422>),
)]
pub(super) async fn check(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<CheckReport>> {
    with_store(&state, Kind::Compute, move |state| Ok(Json(check_session(&state.store().session(&id)?)?)))
        .await
}

/// Answers with the station that recorded a session.
#[utoipa::path(
    get,
    path = "/sessions/{session}/station",
    tag = "sessions",
    responses((status = 200, description = "Done.", body = StationDocument), Refusal<404>, Refusal<409>, Refusal<422>),
)]
pub(super) async fn station(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<StationDocument>> {
    with_store(&state, Kind::Read, move |state| {
        let session = state.store().session(&id)?;
        Ok(Json(station_document(&state.library().take(&session, 0)?.station.files)))
    })
    .await
}

/// Answers with a session as a zip archive: its `session.toml` and the takes that this lists.
///
/// Any studio takes the archive in again (`POST /sessions`). With `Range: bytes=...` a part of it comes, so that a download
/// that broke off can go on.
#[utoipa::path(
    get,
    path = "/sessions/{session}/session.zip",
    tag = "sessions",
    params(
        ("Range" = Option<String>, Header, description = "A part, such as `bytes=1000-`"),
        ("If-Range" = Option<String>, Header, description = "The `ETag` of the archive of which a part is wanted"),
    ),
    responses(
        (status = 200, description = "The archive.", body = Binary, content_type = "application/zip",
            headers(("Accept-Ranges" = String, description = "`bytes`"))),
        (status = 206, description = "The part that `Range` asks for.", body = Binary, content_type = "application/zip",
            headers(("Content-Range" = String, description = "Which part of how many bytes"))),
        Refusal<404>, Refusal<409>, Refusal<416>, Refusal<422>, Refusal<507>,
    ),
)]
pub(super) async fn packed(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    headers: HeaderMap,
) -> Answer<Response> {
    with_store(&state, Kind::Compute, move |state| {
        let Outgoing { file, version } = pack(state.store(), &state.store().session(&id)?)?;
        let download = Download::of_file(file, &version, "application/zip");
        download.map_err(Error::io("read", state.store().root()))?.named(format!("{id}.zip")).answer(&headers)
    })
    .await
}

/// Moves a session to the trash.
#[utoipa::path(
    delete,
    path = "/sessions/{session}",
    tag = "sessions",
    responses((status = 204, description = "It is in the trash."), Refusal<404>, Refusal<409>),
)]
pub(super) async fn discard(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<StatusCode> {
    with_store(&state, Kind::Read, move |state| {
        state.store().discard(store::Kind::Session, &id)?;
        state.hub().publish_changed(List::Sessions, &id);
        Ok(StatusCode::NO_CONTENT)
    })
    .await
}

/// Takes a session out of the trash again.
#[utoipa::path(
    post,
    path = "/sessions/{session}/restore",
    tag = "sessions",
    responses((status = 200, description = "Done.", body = SessionDetail), Refusal<404>, Refusal<409>, Refusal<422>),
)]
pub(super) async fn restore(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<SessionDetail>> {
    with_store(&state, Kind::Read, move |state| {
        state.store().restore(store::Kind::Session, &id)?;
        state.hub().publish_changed(List::Sessions, &id);
        Ok(Json(state.library().detail(&state.store().session(&id)?)?))
    })
    .await
}

/// While an upload comes in, free space is asked for after so many bytes.
const LOOK_AT_DISK_BYTES: u64 = 16 << 20;

/// An upload comes in at this rate at least, after a while.
const MIN_UPLOAD_BYTES_PER_S: u64 = 20_000;
const UPLOAD_GRACE: Duration = Duration::from_secs(20);

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct UploadParams {
    /// Id of the session to make.
    name: String,
    /// Id of the shipped station that CSV recordings belong to; without, the one that has their streams.
    station: Option<String>,
}

/// Adds a session from a zip archive.
///
/// The archive holds a session folder, or a folder of CSV recordings, one folder a take. The limit is 512 MB.
#[utoipa::path(
    post,
    path = "/sessions",
    tag = "sessions",
    params(UploadParams),
    request_body(content = Binary, description = "A zip archive", content_type = "application/zip"),
    responses(
        (status = 201, description = "The session is there.", body = SessionDetail,
            headers(("Location" = String, description = "Path of the session"))),
        Refusal<404>, Refusal<409>, Refusal<413>, Refusal<415>, Refusal<422>, Refusal<507>,
    ),
)]
pub(super) async fn upload(
    State(state): State<Arc<AppState>>,
    Params(params): Params<UploadParams>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let content_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or("");
    if !content_type.starts_with("application/zip") {
        return Err(Problem(Error::MediaType(format!(
            "content type {content_type:?}; expected application/zip with a folder of takes"
        ))));
    }
    // Refused before half a gigabyte is sent.
    state.store().free_session_dir(&params.name)?;
    let announced = headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse().ok());
    let for_client = |err: Error| state.store().for_client(err);
    if announced.is_some_and(|announced| announced > upload::MAX_ARCHIVE_BYTES) {
        return Err(Problem(archive_too_large()));
    }
    let incoming = upload::incoming(state.store(), announced).map_err(for_client)?;
    let archive = incoming.path().join("upload.zip");
    receive(body, &archive).await.map_err(|err| upload::as_client_knows(err, &[incoming.path()]))?;
    with_store(&state, Kind::Compute, move |state| {
        let UploadParams { name, station } = params;
        let session = upload::add_session(state.store(), &incoming, &archive, &name, station.as_deref())?;
        let detail = state.library().detail(&session)?;
        state.hub().publish_changed(List::Sessions, &name);
        let location = [(header::LOCATION, format!("/api/v1/sessions/{}", encode(&name)))];
        Ok((StatusCode::CREATED, location, Json(detail)).into_response())
    })
    .await
}

/// Runs `work` within the limits of its kind; errors name files as clients know them.
async fn with_store<T: Send + 'static>(
    state: &Arc<AppState>,
    kind: Kind,
    work: impl FnOnce(&AppState) -> Result<T, Error> + Send + 'static,
) -> Answer<T> {
    state.run(kind, move |state| work(state).map_err(|err| state.store().for_client(err))).await
}

/// Writes `body` to `path` as it comes in, as long as the disk has space.
async fn receive(mut body: Body, path: &std::path::Path) -> Result<(), Error> {
    let mut file = tokio::fs::File::create(path).await.map_err(Error::io("write", path))?;
    let mut received: u64 = 0;
    let begun = Instant::now();
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|err| Error::Content(format!("the upload broke off: {err}; try again")))?;
        let Ok(data) = frame.into_data() else { continue };
        received += data.len() as u64;
        if received > upload::MAX_ARCHIVE_BYTES {
            return Err(archive_too_large());
        }
        // There is room for few uploads at a time, which nobody may keep for ever.
        let expected = begun.elapsed().saturating_sub(UPLOAD_GRACE).as_secs() * MIN_UPLOAD_BYTES_PER_S;
        if received < expected {
            return Err(Error::Content(format!(
                "the upload came in at less than {} kB/s; try again from a better connection",
                MIN_UPLOAD_BYTES_PER_S / 1000
            )));
        }
        if received / LOOK_AT_DISK_BYTES != (received - data.len() as u64) / LOOK_AT_DISK_BYTES {
            upload::check_space(upload::free_bytes(path), 0)?;
        }
        file.write_all(&data).await.map_err(Error::io("write", path))?;
    }
    file.flush().await.map_err(Error::io("write", path))
}

fn archive_too_large() -> Error {
    Error::TooLarge(format!(
        "the archive is larger than {} MB; upload fewer takes at a time, or use `palpate import`",
        upload::MAX_ARCHIVE_BYTES / 1_000_000
    ))
}
