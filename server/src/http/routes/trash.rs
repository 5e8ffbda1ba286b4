//! What was deleted and can be taken out of the trash again; how is among the routes of each sort.

use std::sync::Arc;

use axum::{Json, extract::State};
use palpate_wire::api::TrashEntry;

use crate::{AppState, http::problem::Answer, work::Kind};

/// Lists deleted sessions and sensor models, the one that was deleted last first.
#[utoipa::path(
    get,
    path = "/trash",
    tag = "trash",
    responses((status = 200, description = "Done.", body = Vec<TrashEntry>)),
)]
pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<TrashEntry>>> {
    state.run(Kind::Read, move |state| Ok(Json(state.store().trash()?))).await
}
