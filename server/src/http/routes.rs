//! The HTTP API, route by route.

mod calibrations;
mod campaigns;
mod diagnoses;
mod jobs;
mod live;
mod models;
mod objects;
mod recording;
mod sessions;
mod takes;

use std::{collections::BTreeMap, sync::Arc};

use axum::{
    Json,
    extract::State,
    http::Method,
    routing::{MethodRouter, delete, get, post, put},
};
use base64::Engine as _;
use palpate_robot_model::StationFiles;
use palpate_wire::api::{Info, Source, StationDocument};

use super::{
    control_socket,
    problem::{Answer, Problem},
    stream,
};
use crate::{AppState, Error, assets, work::Kind};

/// What a request must show to be carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needs {
    /// Nothing beyond what the door asks.
    Nothing,
    /// The lease in force.
    Operator,
    /// The lease in force, while somebody has one or a session is being recorded.
    OperatorIfAny,
}

/// A route of the API.
#[derive(Clone, Debug)]
pub struct Route {
    /// Its method.
    pub method: Method,
    /// Its path below `/api/v1`, with parameters in braces.
    pub path: &'static str,
    /// What a request must show.
    pub needs: Needs,
    pub(super) handler: MethodRouter<Arc<AppState>>,
}

fn route(method: Method, path: &'static str, needs: Needs, handler: MethodRouter<Arc<AppState>>) -> Route {
    Route { method, path, needs, handler }
}

/// Every route of the API that `state` serves: the service is built from this table, and tests walk it.
pub fn routes(state: &AppState) -> Vec<Route> {
    let mut routes = vec![
        route(Method::GET, "/info", Needs::Nothing, get(info)),
        route(Method::GET, "/station", Needs::Nothing, get(station)),
        route(Method::GET, "/stations", Needs::Nothing, get(async || Json(assets::station_ids()))),
        route(Method::GET, "/sessions", Needs::Nothing, get(sessions::list)),
        route(Method::POST, "/sessions", Needs::Nothing, post(sessions::upload)),
        route(Method::GET, "/sessions/{session}", Needs::Nothing, get(sessions::detail)),
        route(Method::DELETE, "/sessions/{session}", Needs::Nothing, delete(sessions::discard)),
        route(Method::POST, "/sessions/{session}/restore", Needs::Nothing, post(sessions::restore)),
        route(Method::GET, "/sessions/{session}/check", Needs::Nothing, get(sessions::check)),
        route(Method::GET, "/sessions/{session}/station", Needs::Nothing, get(sessions::station)),
        route(Method::GET, "/sessions/{session}/takes/{take}/trace", Needs::Nothing, get(takes::trace)),
        route(Method::GET, "/sessions/{session}/takes/{take}/replay", Needs::Nothing, get(takes::replay)),
        route(Method::GET, "/models", Needs::Nothing, get(models::list)),
        route(Method::GET, "/models/{model}", Needs::Nothing, get(models::text)),
        route(Method::DELETE, "/models/{model}", Needs::Nothing, delete(models::discard)),
        route(Method::POST, "/models/{model}/restore", Needs::Nothing, post(models::restore)),
        route(Method::GET, "/objects", Needs::Nothing, get(objects::list)),
        route(Method::GET, "/calibrations", Needs::Nothing, get(calibrations::list)),
        route(Method::POST, "/calibrations", Needs::Nothing, post(calibrations::start)),
        route(Method::GET, "/calibrations/{run}", Needs::Nothing, get(calibrations::detail)),
        route(Method::POST, "/calibrations/{run}/cancel", Needs::Nothing, post(calibrations::cancel)),
        route(Method::POST, "/calibrations/{run}/save", Needs::Nothing, post(calibrations::save)),
        route(Method::GET, "/calibrations/{run}/report.html", Needs::Nothing, get(calibrations::report)),
        route(Method::POST, "/models/{model}/undo", Needs::Nothing, post(models::undo)),
        route(Method::GET, "/diagnoses", Needs::Nothing, get(diagnoses::list)),
        route(Method::POST, "/diagnoses", Needs::Nothing, post(diagnoses::start)),
        route(Method::GET, "/diagnoses/{run}", Needs::Nothing, get(diagnoses::detail)),
        route(Method::POST, "/diagnoses/{run}/cancel", Needs::Nothing, post(diagnoses::cancel)),
        route(Method::POST, "/diagnoses/{run}/save", Needs::Nothing, post(diagnoses::save)),
        route(Method::GET, "/diagnoses/{run}/report.html", Needs::Nothing, get(diagnoses::report)),
        route(Method::GET, "/jobs", Needs::Nothing, get(jobs::list)),
        route(Method::POST, "/jobs", Needs::Nothing, post(jobs::submit)),
        route(Method::GET, "/jobs/{job}", Needs::Nothing, get(jobs::detail)),
        route(Method::DELETE, "/jobs/{job}", Needs::Nothing, delete(jobs::discard)),
        route(Method::POST, "/jobs/{job}/cancel", Needs::Nothing, post(jobs::cancel)),
        route(Method::POST, "/jobs/{job}/retry", Needs::Nothing, post(jobs::retry)),
        route(Method::POST, "/jobs/{job}/clone", Needs::Nothing, post(jobs::clone)),
        route(Method::GET, "/jobs/{job}/log", Needs::Nothing, get(jobs::log)),
        route(Method::GET, "/jobs/{job}/metrics", Needs::Nothing, get(jobs::metrics)),
        route(Method::GET, "/jobs/{job}/files/{file}", Needs::Nothing, get(jobs::file)),
        route(Method::GET, "/campaigns", Needs::Nothing, get(campaigns::list)),
        route(Method::POST, "/campaigns", Needs::Nothing, post(campaigns::create)),
        route(Method::GET, "/campaigns/{campaign}", Needs::Nothing, get(campaigns::detail)),
        route(Method::GET, "/campaigns/{campaign}/results", Needs::Nothing, get(campaigns::results)),
        route(Method::GET, "/campaigns/{campaign}/tables/{file}", Needs::Nothing, get(campaigns::table)),
        route(Method::POST, "/campaigns/{campaign}/close", Needs::Nothing, post(campaigns::close)),
        route(Method::POST, "/campaigns/{campaign}/reopen", Needs::Nothing, post(campaigns::reopen)),
        route(
            Method::POST,
            "/campaigns/{campaign}/trials/{trial}/begin",
            Needs::Nothing,
            post(campaigns::begin),
        ),
        route(
            Method::POST,
            "/campaigns/{campaign}/trials/{trial}/outcome",
            Needs::Nothing,
            post(campaigns::outcome),
        ),
        route(
            Method::POST,
            "/campaigns/{campaign}/trials/{trial}/score",
            Needs::Nothing,
            post(campaigns::score),
        ),
        route(
            Method::POST,
            "/campaigns/{campaign}/trials/{trial}/unscore",
            Needs::Nothing,
            post(campaigns::unscore),
        ),
        route(
            Method::POST,
            "/campaigns/{campaign}/trials/{trial}/settle",
            Needs::Nothing,
            post(campaigns::settle),
        ),
        route(Method::GET, "/stream", Needs::Nothing, get(stream::upgrade)),
        route(Method::GET, "/live", Needs::Nothing, get(live::document)),
        route(Method::PUT, "/live/model", Needs::Nothing, put(live::set_model)),
        route(Method::GET, "/control", Needs::Nothing, get(control_socket::upgrade)),
        route(Method::GET, "/recording", Needs::Nothing, get(recording::document)),
        route(Method::POST, "/recording", Needs::Operator, post(recording::start)),
        route(Method::POST, "/recording/act", Needs::Operator, post(recording::act)),
        route(Method::POST, "/recording/wanted", Needs::OperatorIfAny, post(recording::want)),
        route(
            Method::DELETE,
            "/recording/wanted/{object}/{primitive}",
            Needs::OperatorIfAny,
            delete(recording::unwant),
        ),
        route(Method::GET, "/audit", Needs::Nothing, get(live::audit)),
    ];
    // A real station has no such routes at all.
    if state.live().is_none_or(|live| live.source() != Source::Real) {
        routes.extend([
            route(Method::GET, "/emulator/faults", Needs::Nothing, get(live::faults)),
            route(Method::PUT, "/emulator/faults", Needs::OperatorIfAny, put(live::set_faults)),
            route(Method::POST, "/emulator/object", Needs::OperatorIfAny, post(live::place_object)),
        ]);
    }
    routes
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

async fn info(State(state): State<Arc<AppState>>) -> Json<Info> {
    Json(Info {
        name: "palpate".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        station: state.live().map(|live| live.station().label.clone()),
        source: state.live().map_or(Source::Replay, |live| live.source()),
        insecure: state.access().insecure,
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
