//! The HTTP API, route by route.

mod calibrations;
mod diagnoses;
mod extract;
mod live;
mod models;
mod objects;
mod problem;
mod recording;
mod sessions;
mod takes;

use std::{collections::BTreeMap, sync::Arc};

use axum::{
    Json, Router,
    extract::State,
    http::{Method, StatusCode, Uri},
    response::{IntoResponse as _, Response},
    routing::{delete, get, post, put},
};
use base64::Engine as _;
use palpate_robot_model::StationFiles;
use palpate_wire::api::{Info, Source, StationDocument};

use crate::{AppState, Error, assets, control_socket, page, stream};
pub(crate) use problem::Problem;
use problem::{Answer, problem_response};

/// The whole service.
pub fn app(state: Arc<AppState>) -> Router {
    let api = Router::new()
        .route("/info", get(info))
        .route("/station", get(station))
        .route("/stations", get(async || Json(assets::station_ids())))
        .route("/sessions", get(sessions::list).post(sessions::upload))
        .route("/sessions/{session}", get(sessions::detail).delete(sessions::discard))
        .route("/sessions/{session}/restore", post(sessions::restore))
        .route("/sessions/{session}/check", get(sessions::check))
        .route("/sessions/{session}/station", get(sessions::station))
        .route("/sessions/{session}/takes/{take}/trace", get(takes::trace))
        .route("/sessions/{session}/takes/{take}/replay", get(takes::replay))
        .route("/models", get(models::list))
        .route("/models/{model}", get(models::text).delete(models::discard))
        .route("/models/{model}/restore", post(models::restore))
        .route("/objects", get(objects::list))
        .route("/calibrations", get(calibrations::list).post(calibrations::start))
        .route("/calibrations/{run}", get(calibrations::detail))
        .route("/calibrations/{run}/cancel", post(calibrations::cancel))
        .route("/calibrations/{run}/save", post(calibrations::save))
        .route("/calibrations/{run}/report.html", get(calibrations::report))
        .route("/models/{model}/undo", post(models::undo))
        .route("/diagnoses", get(diagnoses::list).post(diagnoses::start))
        .route("/diagnoses/{run}", get(diagnoses::detail))
        .route("/diagnoses/{run}/cancel", post(diagnoses::cancel))
        .route("/diagnoses/{run}/save", post(diagnoses::save))
        .route("/diagnoses/{run}/report.html", get(diagnoses::report))
        .route("/stream", get(stream::upgrade))
        .route("/live", get(live::document))
        .route("/live/model", put(live::set_model))
        .route("/control", get(control_socket::upgrade))
        .route("/recording", get(recording::document).post(recording::start))
        .route("/recording/act", post(recording::act))
        .route("/recording/wanted", post(recording::want))
        .route("/recording/wanted/{object}/{primitive}", delete(recording::unwant))
        .route("/audit", get(live::audit))
        .route("/emulator/faults", get(live::faults).put(live::set_faults))
        .route("/emulator/object", post(live::place_object))
        .fallback(no_such_route)
        .method_not_allowed_fallback(no_such_method)
        .with_state(state);
    Router::new()
        .nest("/api/v1", api)
        .route("/api/{*rest}", get(no_such_route))
        .fallback_service(get(page::serve))
}

async fn info(State(state): State<Arc<AppState>>) -> Json<Info> {
    Json(Info {
        name: "palpate".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        station: state.live().map(|live| live.station().label.clone()),
        source: state.live().map_or(Source::Replay, |live| live.source()),
    })
}

async fn station(State(state): State<Arc<AppState>>) -> Answer<Json<StationDocument>> {
    let Some(live) = state.live() else { return Err(Problem(Error::no_station())) };
    Ok(Json(station_document(&live.station().files)))
}

fn station_document(files: &StationFiles) -> StationDocument {
    let base64 = base64::engine::general_purpose::STANDARD;
    let files_base64: BTreeMap<String, String> =
        files.files.iter().map(|(path, bytes)| (path.clone(), base64.encode(bytes))).collect();
    StationDocument { station_toml: files.station_toml.clone(), files_base64 }
}

async fn no_such_route(uri: Uri) -> Response {
    let detail = format!("nothing is at {}; the API is below /api/v1/", uri.path());
    problem_response(StatusCode::NOT_FOUND, &detail).into_response()
}

async fn no_such_method(method: Method, uri: Uri) -> Response {
    let detail = format!("{} does not take {method}", uri.path());
    problem_response(StatusCode::METHOD_NOT_ALLOWED, &detail).into_response()
}

/// Runs what reads files or computes away from the threads that answer requests.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> Result<T, Error> + Send + 'static) -> Answer<T> {
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => result.map_err(Problem),
        Err(err) => {
            Err(Problem(Error::Internal(format!("the request's work did not end: {err}; see the log"))))
        }
    }
}
