//! The studio's server and everything the `palpate` command line does.
//!
//! [`app`] is the whole HTTP service as an axum router over an [`AppState`]; [`serve()`] binds it to a socket. The folder
//! `http` uses the state, the state uses `station`, `jobs` and `data`. Long work lives in [`jobs`], which the command
//! line and the server call alike. Data is plain files below one folder ([`Store`]): `sessions/`, `models/`, `objects/`
//! (one's own), `runs/` (a folder a job), `bars/`, and `trash/` for what was deleted. The table of jobs is a database
//! in it (`palpate.sqlite`).
//!
//! # Routes
//!
//! The table is `http/routes.rs`; [`openapi_document`] is made from it and from what stands above each handler, is served as
//! `/api/v1/openapi.json`, shown at `/api/docs` and kept in `docs/openapi.json`. `docs/api.md` says how to script it.
//! Every path below `/api` that is not in the table is a problem of type `no-route`; everything else is the page.
//!
//! Every request passes the door, which checks Host and Origin and finds out who asks. Where there is a login, each route
//! needs the role that the table states; without one everybody is the local operator. Only an operator's requests carry the
//! lease of an open control connection, in the header `Palpate-Lease`. Errors are RFC 9457 `application/problem+json`
//! (`palpate_wire::api::ProblemDetails`), and `palpate_wire::api::ProblemType` names their kinds.
//!
//! # The stream
//!
//! A client gets the live station's frames at 30 Hz at most, and every job's progress when it changes. Each client has
//! a bounded queue: the oldest live frames are dropped and counted in `dropped`; a newer state of a job replaces an
//! older one that still waits, and no job's state is dropped otherwise. A ping follows every message, and few messages may
//! be without its answer (WebSocket clients answer pings by themselves once they have read so far), so that a client that
//! reads slowly sees few pictures but no old ones.

pub mod assets;
mod backup;
pub mod data;
mod error;
mod http;
mod hub;
pub mod jobs;
mod manual;
mod retention;
mod serve;
mod state;
mod station;
mod tls;
mod work;

pub use backup::{BackupReport, backup};
pub use data::Store;
pub use data::database::open_people;
pub use error::{Class, Error, chain};
pub use http::{Needs, NeedsLease, Route, app, openapi_document, root_routes, routes};
pub use hub::Hub;
pub use retention::{
    RetentionAct, RetentionConfig, RetentionKept, RetentionPlan, RetentionStep,
    carry_out as carry_out_retention, plan as plan_retention,
};
pub use serve::{Ready, ServeConfig, Served, serve, serve_on};
pub use state::{Access, AppState, Studio};
pub use station::{EmulatedDevices, LiveStation, RunningStation};
pub use tls::Tls;
