//! Guided recording on the live station.

use std::sync::Arc;

use axum::{Json, extract::State};
use palpate_wire::api::{RecordingAction, RecordingDocument, StartRecording, WantedTake};

use crate::{
    AppState, Error,
    data::files,
    http::{
        extract::{Body, Ids, Lease},
        problem::Answer,
    },
    work::Kind,
};

pub(super) async fn document(State(state): State<Arc<AppState>>) -> Answer<Json<RecordingDocument>> {
    with_station(&state, |handle| Ok(handle.recording()?)).await
}

pub(super) async fn start(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Body(request): Body<StartRecording>,
) -> Answer<Json<RecordingDocument>> {
    files::check_id("session", &request.session)?;
    with_station(&state, move |handle| Ok(handle.start_recording(&claim, request)?)).await
}

pub(super) async fn act(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Body(action): Body<RecordingAction>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.act(&claim, action)?)).await
}

pub(super) async fn want(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Body(wanted): Body<WantedTake>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.want(&claim, wanted)?)).await
}

pub(super) async fn unwant(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Ids((object, primitive)): Ids<(String, String)>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.unwant(&claim, &object, &primitive)?)).await
}

async fn with_station(
    state: &Arc<AppState>,
    work: impl FnOnce(&palpate_control::Handle) -> Result<RecordingDocument, Error> + Send + 'static,
) -> Answer<Json<RecordingDocument>> {
    let speak = move |state: &AppState| {
        let live = state.live().ok_or_else(Error::no_station)?;
        work(live.handle()).map(Json)
    };
    state.run(Kind::Control, speak).await
}
