//! Calibration runs.

use axum::http::StatusCode;
use palpate_wire::api::{CalibrationRequest, CalibrationRun, ModelSummary, SaveModelRequest};

use super::runs::{kept, names::*, run_routes};
use crate::http::documented::CalibrationRunSchema;

run_routes! {
    runs: calibrations,
    run: "calibration",
    location: "Path of the calibration",
    job: "calibrate",
    request: CalibrationRequest,
    answer: CalibrationRun as CalibrationRunSchema,
    tables: "`metrics.csv` (both models, on all takes, by sensor type, take and\nchannel) or `intervals.csv` (95 % intervals).",
}

/// Keeps the sensor model that a calibration found.
#[utoipa::path(
    post,
    path = "/calibrations/{run}/save",
    tag = "calibrations",
    request_body = SaveModelRequest,
    responses(
        (status = 201, description = "The model is there.", body = ModelSummary,
            headers(("Location" = String, description = "Path of the model"))),
        Refusal<404>, Refusal<409>,
    ),
)]
pub(super) async fn save(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Body(request): Body<SaveModelRequest>,
) -> Answer<Response> {
    let save = move |state: &AppState| state.calibrations().save_model(&id, &request.name);
    let saved = state.run(Kind::Read, save).await?;
    Ok(kept(&state, StatusCode::CREATED, saved))
}
