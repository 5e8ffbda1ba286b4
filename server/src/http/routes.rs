//! The HTTP API, route by route.

mod calibrations;
mod campaigns;
mod diagnoses;
mod docs;
mod health;
mod jobs;
mod lineage;
mod live;
mod models;
mod objects;
pub(super) mod people;
mod recording;
mod runs;
mod sessions;
mod takes;
mod trash;

use std::{collections::BTreeMap, sync::Arc};

use axum::{
    Json,
    extract::State,
    http::{Method, StatusCode},
    response::Response,
    routing::{get, post},
};
use base64::Engine as _;
use palpate_robot_model::StationFiles;
use palpate_wire::api::{Info, Source, StationDocument};

use super::{
    control_socket, document,
    documented::{Documented, Refusal},
    foxglove, login_page,
    problem::{Answer, Problem},
    route::{DATA, JOBS, MOVE, OPEN, OWN, PEOPLE, Route, SCORE, SETUP, STATION, TRIALS, VIEW, root, route},
    stream,
};
use crate::{AppState, Error, assets, work::Kind};

/// Rows of the table. What `#[utoipa::path]` says above a handler goes with it into the document: a handler without cannot
/// be a row.
macro_rules! table {
    ($(route($method:expr, $path:literal, $needs:expr, $verb:ident($($handler:tt)+) $(,)?)),+ $(,)?) => {
        vec![$(
            route($method, $path, $needs, {
                let (schemas, paths, handler) = utoipa_axum::routes!($($handler)+);
                (handler, Documented::new(stringify!($($handler)+), stringify!($verb), schemas, paths))
            })
        ),+]
    };
}

/// The OpenAPI document of every route that a studio can have.
pub fn openapi_document() -> serde_json::Value {
    document::written(&all_routes(true))
}

/// Every route of the API that `state` serves: the service is built from this table, and tests walk it.
pub fn routes(state: &AppState) -> Vec<Route> {
    // A real station has no routes of the emulator at all.
    all_routes(state.live().is_none_or(|live| live.source() != Source::Real))
}

/// The same without a studio.
pub(super) fn all_routes(with_emulator: bool) -> Vec<Route> {
    let mut routes = table![
        route(Method::GET, "/info", VIEW, get(info)),
        route(Method::GET, "/station", VIEW, get(station)),
        route(Method::GET, "/stations", VIEW, get(stations)),
        route(Method::GET, "/sessions", VIEW, get(sessions::list)),
        route(Method::POST, "/sessions", DATA, post(sessions::upload)),
        route(Method::GET, "/sessions/{session}", VIEW, get(sessions::detail)),
        route(Method::DELETE, "/sessions/{session}", DATA, delete(sessions::discard)),
        route(Method::POST, "/sessions/{session}/restore", DATA, post(sessions::restore)),
        route(Method::GET, "/sessions/{session}/check", VIEW, get(sessions::check)),
        route(Method::GET, "/sessions/{session}/station", VIEW, get(sessions::station)),
        route(Method::GET, "/sessions/{session}/session.zip", VIEW, get(sessions::packed)),
        route(Method::GET, "/sessions/{session}/takes/{take}/take.mcap", VIEW, get(takes::file)),
        route(Method::GET, "/sessions/{session}/takes/{take}/trace", VIEW, get(takes::trace)),
        route(Method::GET, "/sessions/{session}/takes/{take}/replay", VIEW, get(takes::replay)),
        route(Method::GET, "/models", VIEW, get(models::list)),
        route(Method::GET, "/models/{model}", VIEW, get(models::text)),
        route(Method::DELETE, "/models/{model}", DATA, delete(models::discard)),
        route(Method::POST, "/models/{model}/restore", DATA, post(models::restore)),
        route(Method::GET, "/trash", VIEW, get(trash::list)),
        route(Method::GET, "/objects", VIEW, get(objects::list)),
        route(Method::GET, "/lineage", VIEW, get(lineage::document)),
        route(Method::GET, "/calibrations", VIEW, get(calibrations::list)),
        route(Method::POST, "/calibrations", JOBS, post(calibrations::start)),
        route(Method::GET, "/calibrations/{run}", VIEW, get(calibrations::detail)),
        route(Method::POST, "/calibrations/{run}/cancel", JOBS, post(calibrations::cancel)),
        route(Method::POST, "/calibrations/{run}/save", DATA, post(calibrations::save)),
        route(Method::GET, "/calibrations/{run}/report.html", VIEW, get(calibrations::report)),
        route(Method::GET, "/calibrations/{run}/tables/{file}", VIEW, get(calibrations::table)),
        route(Method::POST, "/models/{model}/undo", DATA, post(models::undo)),
        route(Method::GET, "/diagnoses", VIEW, get(diagnoses::list)),
        route(Method::POST, "/diagnoses", JOBS, post(diagnoses::start)),
        route(Method::GET, "/diagnoses/{run}", VIEW, get(diagnoses::detail)),
        route(Method::POST, "/diagnoses/{run}/cancel", JOBS, post(diagnoses::cancel)),
        route(Method::POST, "/diagnoses/{run}/save", DATA, post(diagnoses::save)),
        route(Method::GET, "/diagnoses/{run}/report.html", VIEW, get(diagnoses::report)),
        route(Method::GET, "/diagnoses/{run}/tables/{file}", VIEW, get(diagnoses::table)),
        route(Method::GET, "/kinds", VIEW, get(jobs::kinds)),
        route(Method::GET, "/jobs", VIEW, get(jobs::list)),
        route(Method::POST, "/jobs", JOBS, post(jobs::submit)),
        route(Method::GET, "/jobs/{job}", VIEW, get(jobs::detail)),
        route(Method::DELETE, "/jobs/{job}", JOBS, delete(jobs::discard)),
        route(Method::POST, "/jobs/{job}/cancel", JOBS, post(jobs::cancel)),
        route(Method::POST, "/jobs/{job}/retry", JOBS, post(jobs::retry)),
        route(Method::POST, "/jobs/{job}/clone", JOBS, post(jobs::clone)),
        route(Method::GET, "/jobs/{job}/log", VIEW, get(jobs::log)),
        route(Method::GET, "/jobs/{job}/metrics", VIEW, get(jobs::metrics)),
        route(Method::GET, "/jobs/{job}/metrics.csv", VIEW, get(jobs::metrics_csv)),
        route(Method::GET, "/jobs/{job}/events", VIEW, get(jobs::events)),
        route(Method::GET, "/jobs/{job}/files/{file}", VIEW, get(jobs::file)),
        route(Method::GET, "/campaigns", VIEW, get(campaigns::list)),
        route(Method::POST, "/campaigns", DATA, post(campaigns::create)),
        route(Method::GET, "/campaigns/{campaign}", VIEW, get(campaigns::detail)),
        route(Method::GET, "/campaigns/{campaign}/results", VIEW, get(campaigns::results)),
        route(Method::GET, "/campaigns/{campaign}/tables/{file}", VIEW, get(campaigns::table)),
        route(Method::POST, "/campaigns/{campaign}/pause", TRIALS, post(campaigns::pause)),
        route(Method::POST, "/campaigns/{campaign}/resume", TRIALS, post(campaigns::resume)),
        route(Method::POST, "/campaigns/{campaign}/close", DATA, post(campaigns::close)),
        route(Method::POST, "/campaigns/{campaign}/reopen", DATA, post(campaigns::reopen)),
        route(Method::POST, "/campaigns/{campaign}/trials/{trial}/begin", TRIALS, post(campaigns::begin)),
        route(Method::POST, "/campaigns/{campaign}/trials/{trial}/outcome", TRIALS, post(campaigns::outcome)),
        route(Method::POST, "/campaigns/{campaign}/trials/{trial}/score", SCORE, post(campaigns::score)),
        route(Method::POST, "/campaigns/{campaign}/trials/{trial}/unscore", SCORE, post(campaigns::unscore)),
        route(Method::POST, "/campaigns/{campaign}/trials/{trial}/settle", DATA, post(campaigns::settle)),
        route(Method::GET, "/stream", VIEW, get(stream::upgrade)),
        route(Method::GET, "/foxglove", VIEW, get(foxglove::upgrade)),
        route(Method::GET, "/live", VIEW, get(live::document)),
        route(Method::PUT, "/live/model", STATION, put(live::set_model)),
        route(Method::GET, "/control", VIEW, get(control_socket::upgrade)),
        route(Method::GET, "/recording", VIEW, get(recording::document)),
        route(Method::POST, "/recording", MOVE, post(recording::start)),
        route(Method::GET, "/recording/plans", VIEW, get(recording::plans)),
        route(Method::POST, "/recording/act", MOVE, post(recording::act)),
        route(Method::POST, "/recording/take", MOVE, post(recording::begin_take)),
        route(Method::POST, "/recording/take/act", MOVE, post(recording::act_on_take)),
        route(Method::POST, "/recording/wanted", SETUP, post(recording::want)),
        route(Method::DELETE, "/recording/wanted/{object}/{primitive}", SETUP, delete(recording::unwant),),
        route(Method::GET, "/audit", VIEW, get(live::audit)),
        route(Method::POST, "/login", OPEN, post(people::log_in)),
        route(Method::POST, "/logout", OPEN, post(people::log_out)),
        route(Method::GET, "/me", VIEW, get(people::me)),
        route(Method::POST, "/me/password", OWN, post(people::change_own_password)),
        route(Method::GET, "/people", PEOPLE, get(people::list)),
        route(Method::POST, "/people", PEOPLE, post(people::add)),
        route(Method::PATCH, "/people/{person}", PEOPLE, patch(people::change)),
        route(Method::DELETE, "/people/{person}", PEOPLE, delete(people::remove)),
        route(Method::GET, "/tokens", OWN, get(people::tokens)),
        route(Method::POST, "/tokens", OWN, post(people::create_token)),
        route(Method::DELETE, "/tokens/{token}", OWN, delete(people::revoke_token)),
        route(Method::GET, "/docs", VIEW, get(docs::list)),
        route(Method::GET, "/docs/{doc}", VIEW, get(docs::text)),
        route(Method::GET, "/docs/pictures/{picture}", VIEW, get(docs::picture)),
        route(Method::GET, "/openapi.json", VIEW, get(openapi)),
    ];
    if with_emulator {
        routes.extend(table![
            route(Method::GET, "/emulator/faults", VIEW, get(live::faults)),
            route(Method::PUT, "/emulator/faults", SETUP, put(live::set_faults)),
            route(Method::POST, "/emulator/object", SETUP, post(live::place_object)),
        ]);
    }
    routes
}

/// Routes outside `/api/v1`, but for the page's files.
pub fn root_routes(_state: &AppState) -> Vec<Route> {
    vec![
        root(Method::GET, "/healthz", OPEN, get(health::alive)),
        root(Method::GET, "/readyz", OPEN, get(health::ready)),
        root(Method::GET, "/metrics", VIEW, get(health::metrics)),
        root(Method::GET, "/login", OPEN, get(login_page::show)),
        root(Method::POST, "/login", OPEN, post(login_page::log_in)),
        root(Method::GET, "/logout", OPEN, get(login_page::ask_to_log_out)),
        root(Method::POST, "/logout", OPEN, post(login_page::log_out)),
    ]
}

impl AppState {
    /// Runs the work of a request away from the threads that answer requests, within the limits of its kind.
    pub(super) async fn run<T: Send + 'static>(
        self: &Arc<Self>,
        kind: Kind,
        work: impl FnOnce(&Self) -> Result<T, Error> + Send + 'static,
    ) -> Answer<T> {
        let state = self.clone();
        self.work().run(kind, move || work(&state)).await.map_err(Problem)
    }
}

/// Answers with this document, OpenAPI 3.1.
#[utoipa::path(
    get,
    path = "/openapi.json",
    tag = "studio",
    responses((status = 200, description = "Done.", body = Object)),
)]
async fn openapi(State(state): State<Arc<AppState>>) -> Response {
    let with_emulator = state.live().is_none_or(|live| live.source() != Source::Real);
    document::answer(with_emulator, || all_routes(with_emulator))
}

/// Says what studio this is.
#[utoipa::path(
    get,
    path = "/info",
    tag = "studio",
    responses((status = 200, description = "Done.", body = Info)),
)]
async fn info(State(state): State<Arc<AppState>>) -> Json<Info> {
    Json(Info {
        name: "palpate".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        station: state.live().map(|live| live.station().label.clone()),
        source: state.live().map_or(Source::Replay, |live| live.source()),
        insecure: state.access().insecure,
    })
}

/// Lists the stations that the program carries, by id.
#[utoipa::path(
    get,
    path = "/stations",
    tag = "station",
    responses((status = 200, description = "Done.", body = Vec<String>)),
)]
async fn stations() -> Json<Vec<String>> {
    Json(assets::station_ids())
}

/// Answers with the live station: robot, layout, objects and limits, as its files have them.
#[utoipa::path(
    get,
    path = "/station",
    tag = "station",
    responses((status = 200, description = "Done.", body = StationDocument), Refusal<404>),
)]
async fn station(State(state): State<Arc<AppState>>) -> Answer<Json<StationDocument>> {
    let Some(live) = state.live() else { return Err(Problem(Error::NoStation)) };
    Ok(Json(station_document(&live.station().files)))
}

/// 202 for work that was queued, 200 where an earlier request with the same idempotency key had done so.
fn accepted(is_new: bool) -> StatusCode {
    if is_new { StatusCode::ACCEPTED } else { StatusCode::OK }
}

fn station_document(files: &StationFiles) -> StationDocument {
    let base64 = base64::engine::general_purpose::STANDARD;
    let files_base64: BTreeMap<String, String> =
        files.files.iter().map(|(path, bytes)| (path.clone(), base64.encode(bytes))).collect();
    StationDocument { station_toml: files.station_toml.clone(), files_base64 }
}
