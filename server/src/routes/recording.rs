//! Guided recording on the live station.

use std::sync::Arc;

use axum::{Json, extract::State};
use palpate_wire::api::{RecordingAction, RecordingDocument, StartRecording, WantedTake};

use super::{
    blocking,
    extract::{Body, Ids},
    problem::{Answer, Problem},
};
use crate::{AppState, Error, files};

pub(super) async fn document(State(state): State<Arc<AppState>>) -> Answer<Json<RecordingDocument>> {
    with_station(&state, |handle| Ok(handle.recording()?)).await
}

pub(super) async fn start(
    State(state): State<Arc<AppState>>,
    Body(request): Body<StartRecording>,
) -> Answer<Json<RecordingDocument>> {
    files::check_id("session", &request.session)?;
    with_station(&state, move |handle| Ok(handle.start_recording(request)?)).await
}

pub(super) async fn act(
    State(state): State<Arc<AppState>>,
    Body(action): Body<RecordingAction>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.act(action)?)).await
}

pub(super) async fn want(
    State(state): State<Arc<AppState>>,
    Body(wanted): Body<WantedTake>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.want(wanted)?)).await
}

pub(super) async fn unwant(
    State(state): State<Arc<AppState>>,
    Ids((object, primitive)): Ids<(String, String)>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.unwant(&object, &primitive)?)).await
}

async fn with_station(
    state: &AppState,
    work: impl FnOnce(&palpate_control::Handle) -> Result<RecordingDocument, Error> + Send + 'static,
) -> Answer<Json<RecordingDocument>> {
    let Some(live) = state.live() else { return Err(Problem(Error::no_station())) };
    let handle = live.handle().clone();
    blocking(move || work(&handle).map(Json)).await
}
