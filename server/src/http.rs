//! The HTTP service: who may come in, the routes, the sockets and the page.

mod bucket;
mod connection;
mod control_socket;
mod docs;
mod document;
mod documented;
mod door;
mod download;
mod etag;
mod examples;
mod extract;
mod foxglove;
mod identity;
pub(crate) mod listener;
mod login_page;
mod pacing;
pub(crate) mod page;
mod pages;
mod problem;
mod route;
mod routes;
mod stream;

use std::{sync::Arc, time::Duration};

use axum::{
    Router,
    http::{Method, Uri},
    middleware::{from_fn, from_fn_with_state},
    response::Response,
    routing::get,
};
use palpate_wire::api::ProblemType;
pub use route::{Needs, NeedsLease, Route};
pub use routes::{openapi_document, root_routes, routes};
use tower_http::timeout::RequestBodyTimeoutLayer;

use crate::AppState;
use door::{Door, guard};
use identity::Gate;
use problem::problem;

/// A body of which nothing more comes in for this long is given up.
const BODY_TIMEOUT: Duration = Duration::from_secs(15);

/// The whole service.
pub fn app(state: Arc<AppState>) -> Router {
    let api = guarded(&state, routes(&state));
    let root = guarded(&state, root_routes(&state));
    let api =
        api.fallback(no_such_route).method_not_allowed_fallback(no_such_method).layer(from_fn(etag::tag));
    let door = Arc::new(Door::new(&state));
    let door = from_fn_with_state(door, guard);
    let page = get(page::serve).layer(from_fn_with_state(state.clone(), identity::page_needs_login));
    root.with_state(state.clone())
        .nest("/api/v1", api.with_state(state))
        .route(docs::PAGE_PATH, get(docs::page))
        .route(docs::SCRIPT_PATH, get(docs::script))
        .route("/api/{*rest}", get(no_such_route))
        .fallback_service(page)
        .layer(RequestBodyTimeoutLayer::new(BODY_TIMEOUT))
        .layer(door)
}

/// A router of `routes`, each of which looks at who asks before anything else is done.
fn guarded(state: &Arc<AppState>, routes: Vec<Route>) -> Router<Arc<AppState>> {
    routes.into_iter().fold(Router::new(), |router, route| {
        let gate = Gate { state: state.clone(), needs: route.needs };
        router
            .route(route.path, route.handler.route_layer(from_fn_with_state(Arc::new(gate), identity::allow)))
    })
}

async fn no_such_route(uri: Uri) -> Response {
    let detail = format!("nothing is at {}; the API is below /api/v1/", uri.path());
    problem(ProblemType::NoRoute, &detail)
}

async fn no_such_method(method: Method, uri: Uri) -> Response {
    let detail = format!("{} does not take {method}", uri.path());
    problem(ProblemType::MethodNotAllowed, &detail)
}
