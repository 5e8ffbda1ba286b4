//! Objects.

use std::sync::Arc;

use axum::{Json, extract::State};
use palpate_wire::api::ObjectEntry;

use super::{blocking, problem::Answer};
use crate::{AppState, objects};

pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<ObjectEntry>>> {
    blocking(move || Ok(Json(objects::list(&state)?))).await
}
