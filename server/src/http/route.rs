//! A route of the API: where it is, what it needs, and what is said of it.

use std::sync::Arc;

use axum::{http::Method, routing::MethodRouter};
use palpate_wire::api::{Role, Scope};

use super::documented::Documented;
use crate::AppState;

/// What a request must show to be carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    /// What whoever asks must be at least; `None` where nobody has to log in.
    pub role: Option<Role>,
    /// The part of the API, to which a token may be limited.
    pub scope: Scope,
    /// Whether it needs the lease as well.
    pub lease: NeedsLease,
}

/// Whether a request needs the lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NeedsLease {
    /// No.
    No,
    /// The lease in force.
    Always,
    /// The lease in force, while somebody has one or a session is being recorded.
    IfAny,
}

const fn needs(role: Role, scope: Scope, lease: NeedsLease) -> Needs {
    Needs { role: Some(role), scope, lease }
}

/// Nobody has to log in.
pub(super) const OPEN: Needs = Needs { role: None, scope: Scope::Read, lease: NeedsLease::No };
/// Reads.
pub(super) const VIEW: Needs = needs(Role::Viewer, Scope::Read, NeedsLease::No);
/// Starts, stops and deletes jobs.
pub(super) const JOBS: Needs = needs(Role::Operator, Scope::Jobs, NeedsLease::No);
/// Changes or deletes sessions and models.
pub(super) const DATA: Needs = needs(Role::Operator, Scope::Data, NeedsLease::No);
/// Runs the trials of a campaign; the lease of whoever moves the hand is the rollout's.
pub(super) const TRIALS: Needs = needs(Role::Operator, Scope::Control, NeedsLease::No);
/// Scores trials.
pub(super) const SCORE: Needs = needs(Role::Scorer, Scope::Score, NeedsLease::No);
/// Changes what the station shows.
pub(super) const STATION: Needs = needs(Role::Operator, Scope::Control, NeedsLease::No);
/// Moves the robot, or decides what it does next.
pub(super) const MOVE: Needs = needs(Role::Operator, Scope::Control, NeedsLease::Always);
/// Would surprise whoever has control.
pub(super) const SETUP: Needs = needs(Role::Operator, Scope::Control, NeedsLease::IfAny);
/// Says who the people are.
pub(super) const PEOPLE: Needs = needs(Role::Admin, Scope::People, NeedsLease::No);
/// Changes one's own password and tokens.
pub(super) const OWN: Needs = needs(Role::Viewer, Scope::People, NeedsLease::No);

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
    /// What the OpenAPI document says of it; `None` outside `/api/v1`.
    pub(super) documented: Option<Documented>,
}

/// A handler and what the OpenAPI document says of it.
type Row = (MethodRouter<Arc<AppState>>, Documented);

pub(super) fn route(method: Method, path: &'static str, needs: Needs, (handler, documented): Row) -> Route {
    debug_assert_eq!(documented.disagreement(&method, path), None);
    Route { method, path, needs, handler, documented: Some(documented) }
}

/// A route outside `/api/v1`.
pub(super) fn root(
    method: Method,
    path: &'static str,
    needs: Needs,
    handler: MethodRouter<Arc<AppState>>,
) -> Route {
    Route { method, path, needs, handler, documented: None }
}
