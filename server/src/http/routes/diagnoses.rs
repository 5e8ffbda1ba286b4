//! Diagnoses.

use axum::http::StatusCode;
use palpate_wire::api::{DiagnosisRequest, DiagnosisRun, ModelSummary, SaveDiagnosisRequest};

use super::runs::{kept, names::*, run_routes};
use crate::http::documented::DiagnosisRunSchema;

run_routes! {
    runs: diagnoses,
    run: "diagnosis",
    location: "Path of the diagnosis",
    job: "diagnose",
    request: DiagnosisRequest,
    answer: DiagnosisRun as DiagnosisRunSchema,
    tables: "`effects.csv`, `metrics.csv` or `waterfall.csv`.",
}

/// Keeps the calibrated model with the effects that a diagnosis named, or some of them.
#[utoipa::path(
    post,
    path = "/diagnoses/{run}/save",
    tag = "diagnoses",
    request_body = SaveDiagnosisRequest,
    responses(
        (status = 201, description = "The new model is there.", body = ModelSummary,
            headers(("Location" = String, description = "Path of the model"))),
        (status = 200, description = "The effects were added to a model.", body = ModelSummary,
            headers(("Location" = String, description = "Path of the model"))),
        Refusal<404>, Refusal<409>,
    ),
)]
pub(super) async fn save(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Body(request): Body<SaveDiagnosisRequest>,
) -> Answer<Response> {
    let status = if request.to.is_some() { StatusCode::OK } else { StatusCode::CREATED };
    let saved = state.run(Kind::Read, move |state| state.diagnoses().save(&id, &request)).await?;
    Ok(kept(&state, status, saved))
}
