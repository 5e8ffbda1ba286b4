//! Guided recording on the live station.

use std::sync::Arc;

use axum::{Json, extract::State};
use palpate_control::ControlError;
use palpate_wire::api::{
    PlanDocument, RecordingAction, RecordingDocument, StartRecording, StartTake, TakeAction, WantedTake,
};

use crate::{
    AppState, Error,
    data::{files, objects},
    http::{
        documented::Refusal,
        extract::{Body, Ids, Lease},
        problem::Answer,
    },
    work::Kind,
};

/// Answers with the plans of the live station, and the session under way.
#[utoipa::path(
    get,
    path = "/recording",
    tag = "recording",
    responses((status = 200, description = "Done.", body = RecordingDocument), Refusal<404>),
)]
pub(super) async fn document(State(state): State<Arc<AppState>>) -> Answer<Json<RecordingDocument>> {
    with_station(&state, |handle| Ok(handle.recording()?)).await
}

/// Lists the plans of the live station with their takes.
#[utoipa::path(
    get,
    path = "/recording/plans",
    tag = "recording",
    responses((status = 200, description = "Done.", body = Vec<PlanDocument>), Refusal<404>),
)]
pub(super) async fn plans(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<PlanDocument>>> {
    with_station(&state, |handle| Ok(handle.plans()?)).await
}

/// Begins a session by a plan, or goes on with one that was begun.
#[utoipa::path(
    post,
    path = "/recording",
    tag = "recording",
    request_body = StartRecording,
    responses(
        (status = 200, description = "Done.", body = RecordingDocument),
        Refusal<404>, Refusal<409>, Refusal<507>,
    ),
)]
pub(super) async fn start(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Body(request): Body<StartRecording>,
) -> Answer<Json<RecordingDocument>> {
    files::check_id("session", &request.session)?;
    with_station(&state, move |handle| Ok(handle.start_recording(&claim, request)?)).await
}

/// Does something with the step under way. Some actions move the robot, and need an armed station.
#[utoipa::path(
    post,
    path = "/recording/act",
    tag = "recording",
    request_body = RecordingAction,
    responses(
        (status = 200, description = "Done.", body = RecordingDocument),
        Refusal<404>, Refusal<409>, Refusal<507>,
    ),
)]
pub(super) async fn act(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Body(action): Body<RecordingAction>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.act(&claim, action)?)).await
}

/// Begins a take outside guided sessions, in a session that is made if there is none.
#[utoipa::path(
    post,
    path = "/recording/take",
    tag = "recording",
    request_body = StartTake,
    responses(
        (status = 200, description = "Done.", body = RecordingDocument),
        Refusal<404>, Refusal<409>, Refusal<507>,
    ),
)]
pub(super) async fn begin_take(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Body(request): Body<StartTake>,
) -> Answer<Json<RecordingDocument>> {
    files::check_id("session", &request.session)?;
    let begin = move |state: &AppState| {
        let live = state.live().ok_or(Error::NoStation)?;
        let find = |object: &str| {
            // What a station is told is why not, in words.
            objects::files(state.store(), object).map_err(|error| ControlError::Refused(crate::chain(&error)))
        };
        Ok(Json(live.handle().begin_take(&claim, request, &find)?))
    };
    state.run(Kind::Control, begin).await
}

/// Marks spans of the take that is recorded outside guided sessions, or ends it.
#[utoipa::path(
    post,
    path = "/recording/take/act",
    tag = "recording",
    request_body = TakeAction,
    responses((status = 200, description = "Done.", body = RecordingDocument), Refusal<404>, Refusal<409>),
)]
pub(super) async fn act_on_take(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Body(action): Body<TakeAction>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.act_on_take(&claim, action)?)).await
}

/// Adds a take to what is recorded next.
#[utoipa::path(
    post,
    path = "/recording/wanted",
    tag = "recording",
    request_body = WantedTake,
    responses((status = 200, description = "Done.", body = RecordingDocument), Refusal<404>, Refusal<409>),
)]
pub(super) async fn want(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Body(wanted): Body<WantedTake>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.want(&claim, wanted)?)).await
}

/// Takes a wanted take off the list, as long as it has not been recorded.
#[utoipa::path(
    delete,
    path = "/recording/wanted/{object}/{primitive}",
    tag = "recording",
    responses((status = 200, description = "Done.", body = RecordingDocument), Refusal<404>, Refusal<409>),
)]
pub(super) async fn unwant(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Ids((object, primitive)): Ids<(String, String)>,
) -> Answer<Json<RecordingDocument>> {
    with_station(&state, move |handle| Ok(handle.unwant(&claim, &object, &primitive)?)).await
}

async fn with_station<T: Send + 'static>(
    state: &Arc<AppState>,
    work: impl FnOnce(&palpate_control::Handle) -> Result<T, Error> + Send + 'static,
) -> Answer<Json<T>> {
    let speak = move |state: &AppState| {
        let live = state.live().ok_or(Error::NoStation)?;
        work(live.handle()).map(Json)
    };
    state.run(Kind::Control, speak).await
}
