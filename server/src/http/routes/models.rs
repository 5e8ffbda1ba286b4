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
    http::{extract::Ids, problem::Answer},
    hub::List,
    work::Kind,
};

pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<ModelSummary>>> {
    state.run(Kind::Read, move |state| Ok(Json(state.store().models()?))).await
}

pub(super) async fn text(State(state): State<Arc<AppState>>, Ids(id): Ids<String>) -> Answer<Response> {
    state
        .run(Kind::Read, move |state| {
            let (_, text) = state.store().model(&id)?;
            Ok(([(header::CONTENT_TYPE, "application/toml")], text).into_response())
        })
        .await
}

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
