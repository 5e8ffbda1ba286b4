//! The studio's server and everything the `palpate` command line does.
//!
//! [`app`] is the whole HTTP service as an axum router over an [`AppState`]; [`serve`] binds it to a socket. The folder
//! `http` uses the state, the state uses `station`, `jobs` and `data`. Long work lives in [`jobs`], which the command
//! line and the server call alike. Data is plain files below one folder ([`Store`]): `sessions/`, `models/`, `objects/`
//! (one's own), `runs/` (a folder a job), `bars/`, and `trash/` for what was deleted. The table of jobs is a database
//! in it (`palpate.sqlite`).
//!
//! # Routes
//!
//! | method | path | answer |
//! |---|---|---|
//! | GET | `/api/v1/info` | `Info` |
//! | GET | `/api/v1/station` | `StationDocument` of the live station; 404 without one |
//! | GET | `/api/v1/stations` | ids of the stations that the binary carries |
//! | GET | `/api/v1/sessions` | `[SessionSummary]` |
//! | POST | `/api/v1/sessions?name=NAME[&station=ID]` | body `application/zip`: a CSV import folder (without `station`: of the shipped one that has its streams) or a session folder; 201 `SessionDetail`, `Location` |
//! | GET, DELETE | `/api/v1/sessions/{id}` | `SessionDetail`; DELETE moves it to the trash, 204 |
//! | POST | `/api/v1/sessions/{id}/restore` | undoes the DELETE; `SessionDetail` |
//! | GET | `/api/v1/sessions/{id}/check` | `CheckReport` |
//! | GET | `/api/v1/sessions/{id}/station` | `StationDocument` |
//! | GET | `/api/v1/sessions/{id}/takes/{take}/trace` | protobuf `TakeTrace`, `application/x-protobuf` |
//! | GET | `/api/v1/sessions/{id}/takes/{take}/replay?model=nominal\|MODEL_ID\|run:RUN_ID\|diagnosis:RUN_ID\|calibrated:RUN_ID` | protobuf `ReplayTrace` |
//! | GET | `/api/v1/models` | `[ModelSummary]` |
//! | GET, DELETE | `/api/v1/models/{id}` | TOML; DELETE moves it to the trash, 204 |
//! | POST | `/api/v1/models/{id}/restore` | undoes the DELETE; `ModelSummary` |
//! | GET | `/api/v1/objects` | `[ObjectEntry]`: the binary's objects and those in `objects/` of the data folder |
//! | POST | `/api/v1/calibrations` | body `CalibrationRequest`; 202 `CalibrationRun`, `Location` |
//! | GET | `/api/v1/calibrations` | `[CalibrationRun]`, newest first, without report and model text |
//! | GET | `/api/v1/calibrations/{id}` | `CalibrationRun` |
//! | POST | `/api/v1/calibrations/{id}/cancel` | `CalibrationRun` |
//! | POST | `/api/v1/calibrations/{id}/save` | body `SaveModelRequest`; 201 `ModelSummary`, `Location` |
//! | GET | `/api/v1/calibrations/{id}/report.html` | the self-contained report |
//! | POST | `/api/v1/models/{id}/undo` | brings the version before the last addition back, byte for byte; `ModelSummary` |
//! | POST | `/api/v1/diagnoses` | body `DiagnosisRequest`; 202 `DiagnosisRun`, `Location` |
//! | GET | `/api/v1/diagnoses` | `[DiagnosisRun]`, newest first, without report and model text |
//! | GET | `/api/v1/diagnoses/{id}` | `DiagnosisRun` |
//! | POST | `/api/v1/diagnoses/{id}/cancel` | `DiagnosisRun` |
//! | POST | `/api/v1/diagnoses/{id}/save` | body `SaveDiagnosisRequest`; 201 (new model) or 200 (added to one) `ModelSummary`, `Location` |
//! | GET | `/api/v1/diagnoses/{id}/report.html` | the self-contained report |
//! | GET | `/api/v1/jobs?state=STATE&kind=KIND&limit=N&cursor=CURSOR` | `JobPage`: jobs of every kind, newest first |
//! | POST | `/api/v1/jobs` | body `JobRequest`; 202 `Job`, `Location`; with a header `Idempotency-Key` that came before: 200 and the job it made then |
//! | GET, DELETE | `/api/v1/jobs/{id}` | `Job`; DELETE moves one that has ended to the trash, 204 |
//! | POST | `/api/v1/jobs/{id}/cancel` | asks it to stop, and ends it if it does not; `Job` |
//! | POST | `/api/v1/jobs/{id}/retry` | queues one that failed or was cancelled once more; `Job` |
//! | POST | `/api/v1/jobs/{id}/clone` | body `JobChanges`: queues another like it but for these; as `POST /api/v1/jobs` |
//! | GET | `/api/v1/jobs/{id}/log` | the newest part of what its process printed: text |
//! | GET | `/api/v1/jobs/{id}/metrics` | the newest part of its curves: JSON lines |
//! | GET | `/api/v1/jobs/{id}/files/{name}` | a file of its folder, e.g. `report.json` (`docs/jobs.md`) |
//! | GET | `/api/v1/stream` | WebSocket; binary protobuf `StreamMessage` |
//! | GET | `/api/v1/live` | `LiveDocument`; 404 without a live station, as the routes below |
//! | PUT | `/api/v1/live/model` | body `LiveModel`: what the live twin simulates with |
//! | GET | `/api/v1/control` | WebSocket; binary protobuf `ControlRequest`, each answered by a `ControlReply` |
//! | GET | `/api/v1/recording` | `RecordingDocument` |
//! | POST | `/api/v1/recording` | body `StartRecording`; `RecordingDocument`; operator |
//! | POST | `/api/v1/recording/act` | body `RecordingAction`; `RecordingDocument`; operator |
//! | POST | `/api/v1/recording/wanted` | body `WantedTake`; `RecordingDocument`; operator, if there is one |
//! | DELETE | `/api/v1/recording/wanted/{object}/{primitive}` | takes it back; `RecordingDocument`; operator, if there is one |
//! | GET | `/api/v1/audit[?before=PLACE]` | who moved or stopped the station and changed data: JSON lines; `Link` leads to older ones |
//! | POST | `/api/v1/login`, `/api/v1/logout` | body `Login`; sets the cookie, or takes it away; open to everybody |
//! | GET | `/api/v1/me` | `Me` |
//! | POST | `/api/v1/me/password` | body `PasswordChange`; 204 |
//! | GET, POST | `/api/v1/people` | `[Person]`; body `NewPerson`; admin |
//! | PATCH, DELETE | `/api/v1/people/{person}` | body `PersonChanges`; `Person`; 204; admin |
//! | GET, POST | `/api/v1/tokens` | `[Token]`; body `NewToken`; 201 `CreatedToken` |
//! | DELETE | `/api/v1/tokens/{token}` | 204 |
//! | GET, PUT | `/api/v1/emulator/faults` | what is wrong with emulated devices, TOML (`docs/emulated_devices.md`); PUT: operator, if there is one |
//! | POST | `/api/v1/emulator/object` | body `PlaceObject`; operator, if there is one |
//! | GET | `/healthz`, `/readyz` | whether the process is alive; `Readiness`, 503 if not; open to everybody |
//! | GET | `/metrics` | OpenMetrics |
//! | GET, POST | `/login`, POST `/logout` | the login page |
//! | GET | everything else | the page |
//!
//! "Operator" means that the request carries the lease of an open control connection in the header `Palpate-Lease`; it is
//! refused with 403 otherwise. Where there is a login, each route needs the role that the table in `http/routes.rs` states: 401
//! without a login or token, 403 where it may not. Every request passes the door, which checks Host and Origin (421, 403). 503 with
//! `Retry-After` means that too much work of that kind waits, 429 that a connection asks too often.
//!
//! Errors are RFC 9457 `application/problem+json` (`ProblemDetails`); `detail` says what happened, where, and what to
//! do. The types are those of [`palpate_wire`].
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
mod serve;
mod state;
mod station;
mod tls;
mod work;

pub use backup::{BackupReport, backup};
pub use data::Store;
pub use error::{Class, Error, chain};
pub use http::{Needs, NeedsLease, Route, app, root_routes, routes};
pub use hub::Hub;
pub use serve::{Ready, ServeConfig, Served, open_people, serve, serve_on};
pub use state::{Access, AppState, Studio};
pub use station::{EmulatedDevices, LiveStation, RunningStation};
pub use tls::Tls;
