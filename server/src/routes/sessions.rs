//! Sessions: list, detail, check, station; in by upload, out to the trash and back.

use std::sync::Arc;

use axum::{
    Json,
    body::Body,
    extract::State,
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
};
use http_body_util::BodyExt as _;
use palpate_recording::check_session;
use palpate_wire::api::{CheckReport, SessionDetail, SessionSummary, StationDocument};
use serde::Deserialize;
use tokio::io::AsyncWriteExt as _;

use super::{
    blocking,
    extract::{Ids, Params},
    problem::{Answer, Problem},
    station_document,
};
use crate::{AppState, Error, store::Kind, upload};

pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<SessionSummary>>> {
    blocking(move || {
        let sessions = state.store().sessions()?;
        let entries = sessions.iter().map(|(id, dir)| state.library().list_entry(id, dir));
        Ok(Json(entries.collect()))
    })
    .await
}

pub(super) async fn detail(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<SessionDetail>> {
    blocking(move || Ok(Json(state.library().detail(&state.store().session(&id)?)?))).await
}

pub(super) async fn check(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<CheckReport>> {
    blocking(move || Ok(Json(check_session(&state.store().session(&id)?)?))).await
}

pub(super) async fn station(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<StationDocument>> {
    blocking(move || {
        let session = state.store().session(&id)?;
        Ok(Json(station_document(&state.library().take(&session, 0)?.station.files)))
    })
    .await
}

pub(super) async fn discard(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<StatusCode> {
    blocking(move || state.store().discard(Kind::Session, &id).map(|()| StatusCode::NO_CONTENT)).await
}

pub(super) async fn restore(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<SessionDetail>> {
    blocking(move || {
        state.store().restore(Kind::Session, &id)?;
        Ok(Json(state.library().detail(&state.store().session(&id)?)?))
    })
    .await
}

#[derive(Deserialize)]
pub(super) struct UploadParams {
    name: String,
    station: Option<String>,
}

pub(super) async fn upload(
    State(state): State<Arc<AppState>>,
    Params(params): Params<UploadParams>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let content_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or("");
    if !content_type.starts_with("application/zip") {
        return Err(Problem(Error::Argument(format!(
            "content type {content_type:?}; expected application/zip with a folder of takes"
        ))));
    }
    // Refused before half a gigabyte is sent.
    state.store().free_session_dir(&params.name)?;
    let incoming = upload::incoming(state.store())?;
    let archive = incoming.path().join("upload.zip");
    receive(body, &archive).await?;
    blocking(move || {
        let UploadParams { name, station } = params;
        let session = upload::add_session(state.store(), &incoming, &archive, &name, station.as_deref())?;
        let detail = state.library().detail(&session)?;
        let location = [(header::LOCATION, format!("/api/v1/sessions/{}", encode(&name)))];
        Ok((StatusCode::CREATED, location, Json(detail)).into_response())
    })
    .await
}

/// Writes `body` to `path` as it comes in.
async fn receive(mut body: Body, path: &std::path::Path) -> Result<(), Error> {
    let mut file = tokio::fs::File::create(path).await.map_err(Error::io("write", path))?;
    let mut received: u64 = 0;
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|err| Error::Content(format!("the upload broke off: {err}; try again")))?;
        let Ok(data) = frame.into_data() else { continue };
        received += data.len() as u64;
        if received > upload::MAX_ARCHIVE_BYTES {
            return Err(Error::TooLarge(format!(
                "the archive is larger than {} MB; upload fewer takes at a time, or use `palpate import`",
                upload::MAX_ARCHIVE_BYTES / 1_000_000
            )));
        }
        file.write_all(&data).await.map_err(Error::io("write", path))?;
    }
    file.flush().await.map_err(Error::io("write", path))
}

/// Percent-encodes a path segment (RFC 3986, unreserved characters stay).
fn encode(segment: &str) -> String {
    let unreserved = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
    let bytes = segment.bytes();
    bytes
        .map(|byte| if unreserved(byte) { (byte as char).to_string() } else { format!("%{byte:02X}") })
        .collect()
}
