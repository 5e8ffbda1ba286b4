//! Saved sensor models.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use palpate_wire::api::ModelSummary;

use crate::{
    AppState,
    data::store,
    http::{documented::Refusal, extract::Ids, problem::Answer},
    hub::List,
    work::Kind,
};

/// Lists saved sensor models, by id.
#[utoipa::path(
    get,
    path = "/models",
    tag = "models",
    responses((status = 200, description = "Done.", body = Vec<ModelSummary>)),
)]
pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<ModelSummary>>> {
    state.run(Kind::Read, move |state| Ok(Json(state.store().models()?))).await
}

/// Answers with the file of a sensor model.
#[utoipa::path(
    get,
    path = "/models/{model}",
    tag = "models",
    responses(
        (status = 200, description = "Done.", body = String, content_type = "application/toml"),
        Refusal<404>, Refusal<422>,
    ),
)]
pub(super) async fn text(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Response> {
    state
        .run(Kind::Read, move |state| {
            let (_, text) = state.store().model(&id)?;
            Ok(([(header::CONTENT_TYPE, "application/toml")], text).into_response())
        })
        .await
}

/// Moves a sensor model to the trash.
#[utoipa::path(
    delete,
    path = "/models/{model}",
    tag = "models",
    responses((status = 204, description = "It is in the trash."), Refusal<404>, Refusal<409>),
)]
pub(super) async fn discard(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<StatusCode> {
    state
        .run(Kind::Read, move |state| {
            state.store().discard(store::Kind::Model, &id)?;
            state.hub().publish_changed(List::Models, &id);
            state.jobs().scheduler().forget_saved(&id, None)?;
            Ok(StatusCode::NO_CONTENT)
        })
        .await
}

/// Brings the version of a sensor model before the last addition back, byte for byte.
#[utoipa::path(
    post,
    path = "/models/{model}/undo",
    tag = "models",
    responses((status = 200, description = "Done.", body = ModelSummary), Refusal<404>, Refusal<409>, Refusal<422>),
)]
pub(super) async fn undo(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<ModelSummary>> {
    state
        .run(Kind::Read, move |state| {
            let (summary, by) = state.store().undo_model(&id)?;
            state.hub().publish_changed(List::Models, &id);
            state.jobs().scheduler().forget_saved(&id, Some(&by))?;
            Ok(Json(summary))
        })
        .await
}

/// Takes a sensor model out of the trash again.
#[utoipa::path(
    post,
    path = "/models/{model}/restore",
    tag = "models",
    responses((status = 200, description = "Done.", body = ModelSummary), Refusal<404>, Refusal<409>, Refusal<422>),
)]
pub(super) async fn restore(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
) -> Answer<Json<ModelSummary>> {
    state
        .run(Kind::Read, move |state| {
            state.store().restore(store::Kind::Model, &id)?;
            state.hub().publish_changed(List::Models, &id);
            Ok(Json(state.store().model_summary(&id)?))
        })
        .await
}
