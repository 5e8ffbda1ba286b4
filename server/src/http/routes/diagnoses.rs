//! Diagnoses.

use std::sync::Arc;

use axum::{
    Json,
    extract::{OriginalUri, State},
    http::{StatusCode, header},
    response::{Html, IntoResponse, Response},
};
use palpate_wire::api::{DiagnosisRequest, DiagnosisRun, ModelSummary, SaveDiagnosisRequest};

use super::accepted;
use crate::{
    AppState,
    http::{
        documented::{DiagnosisRunSchema, Refusal},
        extract::{Body, Ids, Key, Owner, Page, Params, check_limit},
        pages::page_of,
        problem::Answer,
    },
    hub::List,
    work::Kind,
};

/// Starts a diagnosis, which is a job of kind `diagnose`.
#[utoipa::path(
    post,
    path = "/diagnoses",
    tag = "diagnoses",
    params(Key),
    request_body = DiagnosisRequest,
    responses(
        (status = 202, description = "It is queued.", body = DiagnosisRunSchema, headers(("Location" = String, description = "Path of the diagnosis"))),
        (status = 200, description = "It was started by an earlier request with the same key.", body = DiagnosisRunSchema, headers(("Location" = String, description = "Path of the diagnosis"))),
        Refusal<404>,
        Refusal<409>,
        Refusal<413>,
        Refusal<415>,
        Refusal<422>,
    ),
)]
pub(super) async fn start(
    State(state): State<Arc<AppState>>,
    Owner(owner): Owner,
    Key { key }: Key,
    Body(request): Body<DiagnosisRequest>,
) -> Answer<Response> {
    let start = move |state: &AppState| state.diagnoses().start(&request, &owner, key.as_deref());
    let (run, is_new) = state.run(Kind::Read, start).await?;
    let location = [(header::LOCATION, format!("/api/v1/diagnoses/{}", run.id))];
    Ok((accepted(is_new), location, Json(run)).into_response())
}

/// Lists diagnoses, newest first, without reports and texts of models.
#[utoipa::path(
    get,
    path = "/diagnoses",
    tag = "diagnoses",
    params(Page),
    responses(
        (status = 200, description = "Done.", body = Vec<DiagnosisRunSchema>, headers(("Link" = Option<String>, description = "Path of the next page, `rel=\"next\"`, where there is one"))),
    ),
)]
pub(super) async fn list(
    State(state): State<Arc<AppState>>,
    OriginalUri(uri): OriginalUri,
    Params(page): Params<Page>,
) -> Answer<Response> {
    check_limit(page.limit)?;
    let list = move |state: &AppState| state.diagnoses().list(page.limit, page.cursor);
    let (runs, next) = state.run(Kind::Read, list).await?;
    Ok(page_of(&uri, Json(runs), next.as_deref()))
}

/// Answers with a diagnosis, and its report once it is done.
#[utoipa::path(
    get,
    path = "/diagnoses/{run}",
    tag = "diagnoses",
    responses(
        (status = 200, description = "Done.", body = DiagnosisRunSchema),
        Refusal<404>,
    ),
)]
pub(super) async fn detail(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<DiagnosisRun>> {
    state.run(Kind::Read, move |state| state.diagnoses().get(&id).map(Json)).await
}

/// Asks a diagnosis to stop; one that has ended stays as it is.
#[utoipa::path(
    post,
    path = "/diagnoses/{run}/cancel",
    tag = "diagnoses",
    responses(
        (status = 200, description = "Done.", body = DiagnosisRunSchema),
        Refusal<404>,
    ),
)]
pub(super) async fn cancel(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<DiagnosisRun>> {
    state.run(Kind::Read, move |state| state.diagnoses().cancel(&id).map(Json)).await
}

/// Keeps the calibrated model with the effects that a diagnosis named, or some of them.
#[utoipa::path(
    post,
    path = "/diagnoses/{run}/save",
    tag = "diagnoses",
    request_body = SaveDiagnosisRequest,
    responses(
        (status = 201, description = "The new model is there.", body = ModelSummary, headers(("Location" = String, description = "Path of the model"))),
        (status = 200, description = "The effects were added to a model.", body = ModelSummary, headers(("Location" = String, description = "Path of the model"))),
        Refusal<404>,
        Refusal<409>,
        Refusal<413>,
        Refusal<415>,
        Refusal<422>,
    ),
)]
pub(super) async fn save(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Body(request): Body<SaveDiagnosisRequest>,
) -> Answer<Response> {
    let status = if request.to.is_some() { StatusCode::OK } else { StatusCode::CREATED };
    let saved = state.run(Kind::Read, move |state| state.diagnoses().save(&id, &request)).await?;
    state.hub().publish_changed(List::Models, &saved.id);
    let location = [(header::LOCATION, format!("/api/v1/models/{}", saved.id))];
    Ok((status, location, Json(saved)).into_response())
}

/// Answers with the report of a diagnosis for people, a page of its own.
#[utoipa::path(
    get,
    path = "/diagnoses/{run}/report.html",
    tag = "diagnoses",
    responses(
        (status = 200, description = "Done.", body = String, content_type = "text/html"),
        Refusal<404>,
    ),
)]
pub(super) async fn report(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Html<String>> {
    state.run(Kind::Read, move |state| Ok(Html(state.diagnoses().html(&id)?))).await
}

/// Answers with numbers of a diagnosis as a table: `effects.csv`, `metrics.csv` or `waterfall.csv`.
#[utoipa::path(
    get,
    path = "/diagnoses/{run}/tables/{file}",
    tag = "diagnoses",
    responses(
        (status = 200, description = "Done.", body = String, content_type = "text/csv"),
        Refusal<404>,
        Refusal<409>,
    ),
)]
pub(super) async fn table(
    State(state): State<Arc<AppState>>,
    Ids((id, file)): Ids<(String, String)>,
) -> Answer<Response> {
    let text = state.run(Kind::Compute, move |state| state.diagnoses().table(&id, file)).await?;
    Ok(([(header::CONTENT_TYPE, "text/csv; charset=utf-8")], text).into_response())
}
