//! Calibration runs.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
    response::{Html, IntoResponse, Response},
};
use palpate_wire::api::{CalibrationRequest, CalibrationRun, SaveModelRequest};

use crate::{
    AppState,
    http::{
        extract::{Body, Ids, Owner},
        problem::Answer,
    },
    work::Kind,
};

pub(super) async fn start(
    State(state): State<Arc<AppState>>,
    Owner(owner): Owner,
    Body(request): Body<CalibrationRequest>,
) -> Answer<Response> {
    let run = state.run(Kind::Read, move |state| state.calibrations().start(&request, &owner)).await?;
    let location = [(header::LOCATION, format!("/api/v1/calibrations/{}", run.id))];
    Ok((StatusCode::ACCEPTED, location, Json(run)).into_response())
}

pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<CalibrationRun>>> {
    state.run(Kind::Read, move |state| state.calibrations().list().map(Json)).await
}

pub(super) async fn detail(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<CalibrationRun>> {
    state.run(Kind::Read, move |state| state.calibrations().get(&id).map(Json)).await
}

pub(super) async fn cancel(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<CalibrationRun>> {
    state.run(Kind::Read, move |state| state.calibrations().cancel(&id).map(Json)).await
}

pub(super) async fn save(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Body(request): Body<SaveModelRequest>,
) -> Answer<Response> {
    let saved =
        state.run(Kind::Read, move |state| state.calibrations().save_model(&id, &request.name)).await?;
    let location = [(header::LOCATION, format!("/api/v1/models/{}", saved.id))];
    Ok((StatusCode::CREATED, location, Json(saved)).into_response())
}

pub(super) async fn report(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Html<String>> {
    state.run(Kind::Read, move |state| Ok(Html(state.calibrations().html(&id)?))).await
}
