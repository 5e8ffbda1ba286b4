//! Objects.

use std::sync::Arc;

use axum::{Json, extract::State};
use palpate_wire::api::ObjectEntry;

use super::problem::Answer;
use crate::{AppState, objects, work::Kind};

pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<ObjectEntry>>> {
    state.run(Kind::Read, move |state| Ok(Json(objects::list(state)?))).await
}
