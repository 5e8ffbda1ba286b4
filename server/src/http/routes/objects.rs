//! Objects.

use std::sync::Arc;

use axum::{Json, extract::State};
use palpate_wire::api::ObjectEntry;

use crate::{AppState, data::objects, http::problem::Answer, work::Kind};

pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<ObjectEntry>>> {
    state.run(Kind::Read, move |state| Ok(Json(objects::list(state.store(), state.library())?))).await
}
