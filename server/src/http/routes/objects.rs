//! Objects.

use std::sync::Arc;

use axum::{Json, extract::State};
use palpate_wire::api::ObjectEntry;

use crate::{AppState, data::objects, http::problem::Answer, work::Kind};

/// Lists objects: those of the program and those in `objects/` of the data folder.
#[utoipa::path(
    get,
    path = "/objects",
    tag = "objects",
    responses((status = 200, description = "Done.", body = Vec<ObjectEntry>)),
)]
pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<ObjectEntry>>> {
    state.run(Kind::Read, move |state| Ok(Json(objects::list(state.store(), state.library())?))).await
}
