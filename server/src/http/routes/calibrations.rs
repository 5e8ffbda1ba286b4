//! Calibration runs.

use std::sync::Arc;

use axum::{
    Json,
    extract::{OriginalUri, State},
    http::{StatusCode, header},
    response::{Html, IntoResponse, Response},
};
use palpate_wire::api::{CalibrationRequest, CalibrationRun, ModelSummary, SaveModelRequest};

use super::accepted;
use crate::{
    AppState,
    http::{
        documented::{CalibrationRunSchema, Refusal},
        extract::{Body, Ids, Key, Owner, Page, Params, check_limit},
        pages::page_of,
        problem::Answer,
    },
    hub::List,
    work::Kind,
};

/// Starts a calibration, which is a job of kind `calibrate`.
#[utoipa::path(
    post,
    path = "/calibrations",
    tag = "calibrations",
    params(Key),
    request_body = CalibrationRequest,
    responses(
        (status = 202, description = "It is queued.", body = CalibrationRunSchema, headers(("Location" = String, description = "Path of the calibration"))),
        (status = 200, description = "It was started by an earlier request with the same key.", body = CalibrationRunSchema, headers(("Location" = String, description = "Path of the calibration"))),
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
    Body(request): Body<CalibrationRequest>,
) -> Answer<Response> {
    let start = move |state: &AppState| state.calibrations().start(&request, &owner, key.as_deref());
    let (run, is_new) = state.run(Kind::Read, start).await?;
    let location = [(header::LOCATION, format!("/api/v1/calibrations/{}", run.id))];
    Ok((accepted(is_new), location, Json(run)).into_response())
}

/// Lists calibrations, newest first, without reports and texts of models.
#[utoipa::path(
    get,
    path = "/calibrations",
    tag = "calibrations",
    params(Page),
    responses(
        (status = 200, description = "Done.", body = Vec<CalibrationRunSchema>, headers(("Link" = Option<String>, description = "Path of the next page, `rel=\"next\"`, where there is one"))),
    ),
)]
pub(super) async fn list(
    State(state): State<Arc<AppState>>,
    OriginalUri(uri): OriginalUri,
    Params(page): Params<Page>,
) -> Answer<Response> {
    check_limit(page.limit)?;
    let list = move |state: &AppState| state.calibrations().list(page.limit, page.cursor);
    let (runs, next) = state.run(Kind::Read, list).await?;
    Ok(page_of(&uri, Json(runs), next.as_deref()))
}

/// Answers with a calibration, and its report once it is done.
#[utoipa::path(
    get,
    path = "/calibrations/{run}",
    tag = "calibrations",
    responses(
        (status = 200, description = "Done.", body = CalibrationRunSchema),
        Refusal<404>,
    ),
)]
pub(super) async fn detail(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<CalibrationRun>> {
    state.run(Kind::Read, move |state| state.calibrations().get(&id).map(Json)).await
}

/// Asks a calibration to stop; one that has ended stays as it is.
#[utoipa::path(
    post,
    path = "/calibrations/{run}/cancel",
    tag = "calibrations",
    responses(
        (status = 200, description = "Done.", body = CalibrationRunSchema),
        Refusal<404>,
    ),
)]
pub(super) async fn cancel(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<CalibrationRun>> {
    state.run(Kind::Read, move |state| state.calibrations().cancel(&id).map(Json)).await
}

/// Keeps the sensor model that a calibration found.
#[utoipa::path(
    post,
    path = "/calibrations/{run}/save",
    tag = "calibrations",
    request_body = SaveModelRequest,
    responses(
        (status = 201, description = "The model is there.", body = ModelSummary, headers(("Location" = String, description = "Path of the model"))),
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
    Body(request): Body<SaveModelRequest>,
) -> Answer<Response> {
    let saved =
        state.run(Kind::Read, move |state| state.calibrations().save_model(&id, &request.name)).await?;
    state.hub().publish_changed(List::Models, &saved.id);
    let location = [(header::LOCATION, format!("/api/v1/models/{}", saved.id))];
    Ok((StatusCode::CREATED, location, Json(saved)).into_response())
}

/// Answers with the report of a calibration for people, a page of its own.
#[utoipa::path(
    get,
    path = "/calibrations/{run}/report.html",
    tag = "calibrations",
    responses(
        (status = 200, description = "Done.", body = String, content_type = "text/html"),
        Refusal<404>,
    ),
)]
pub(super) async fn report(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Html<String>> {
    state.run(Kind::Read, move |state| Ok(Html(state.calibrations().html(&id)?))).await
}

/// Answers with numbers of a calibration as a table: `metrics.csv` (both models, on all takes, by sensor type, take and
/// channel) or `intervals.csv` (95 % intervals).
#[utoipa::path(
    get,
    path = "/calibrations/{run}/tables/{file}",
    tag = "calibrations",
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
    let text = state.run(Kind::Compute, move |state| state.calibrations().table(&id, file)).await?;
    Ok(([(header::CONTENT_TYPE, "text/csv; charset=utf-8")], text).into_response())
}
