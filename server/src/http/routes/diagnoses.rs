//! Diagnoses.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
    response::{Html, IntoResponse, Response},
};
use palpate_wire::api::{DiagnosisRequest, DiagnosisRun, SaveDiagnosisRequest};

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
    Body(request): Body<DiagnosisRequest>,
) -> Answer<Response> {
    let run = state.run(Kind::Read, move |state| state.diagnoses().start(&request, &owner)).await?;
    let location = [(header::LOCATION, format!("/api/v1/diagnoses/{}", run.id))];
    Ok((StatusCode::ACCEPTED, location, Json(run)).into_response())
}

pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<DiagnosisRun>>> {
    state.run(Kind::Read, move |state| state.diagnoses().list().map(Json)).await
}

pub(super) async fn detail(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<DiagnosisRun>> {
    state.run(Kind::Read, move |state| state.diagnoses().get(&id).map(Json)).await
}

pub(super) async fn cancel(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<DiagnosisRun>> {
    state.run(Kind::Read, move |state| state.diagnoses().cancel(&id).map(Json)).await
}

/// 201 for a new model, 200 for one that was added to.
pub(super) async fn save(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Body(request): Body<SaveDiagnosisRequest>,
) -> Answer<Response> {
    let status = if request.to.is_some() { StatusCode::OK } else { StatusCode::CREATED };
    let saved = state.run(Kind::Read, move |state| state.diagnoses().save(&id, &request)).await?;
    let location = [(header::LOCATION, format!("/api/v1/models/{}", saved.id))];
    Ok((status, location, Json(saved)).into_response())
}

pub(super) async fn report(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Html<String>> {
    state.run(Kind::Read, move |state| Ok(Html(state.diagnoses().html(&id)?))).await
}
