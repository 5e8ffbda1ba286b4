//! What was made from what.

use std::sync::Arc;

use axum::{Json, extract::State};
use palpate_wire::api::Lineage;

use super::campaigns::Who;
use crate::{AppState, http::problem::Answer, jobs::lineage, work::Kind};

/// Lists what was recorded, fitted, trained and tried, and what each was made from. Somebody who scores a blind campaign
/// does not learn here which policies it tries.
#[utoipa::path(
    get,
    path = "/lineage",
    tag = "models",
    responses((status = 200, description = "Done.", body = Lineage)),
)]
pub(super) async fn document(State(state): State<Arc<AppState>>, who: Who) -> Answer<Json<Lineage>> {
    let viewer = who.operator();
    let trace = move |state: &AppState| {
        let campaigns = state.campaigns();
        let ids = campaigns.list()?.into_iter().filter(|summary| summary.error.is_none());
        let seen: Result<Vec<_>, _> = ids.map(|summary| campaigns.campaign(&summary.id, &viewer)).collect();
        Ok(Json(lineage::lineage(state.store(), state.jobs().scheduler(), &seen?)?))
    };
    state.run(Kind::Read, trace).await
}
