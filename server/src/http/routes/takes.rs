//! Takes and their replays, as protobuf.

use std::sync::Arc;

use axum::{
    extract::State,
    http::{HeaderMap, header},
    response::{IntoResponse, Response},
};
use palpate_sim::SensorModel;
use prost::Message;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::{
    AppState, Error,
    data::{
        archive::{Outgoing, open_take},
        library::{nominal_model, replay_trace, take_index, take_trace},
    },
    http::{
        documented::{Binary, Refusal},
        download::Download,
        extract::{Ids, Params},
        problem::Answer,
    },
    work::Kind,
};

/// Answers with what was recorded in a take: a protobuf message `palpate.TakeTrace` (`server/wire/proto/palpate/trace.proto`).
#[utoipa::path(
    get,
    path = "/sessions/{session}/takes/{take}/trace",
    tag = "sessions",
    responses(
        (status = 200, description = "Done.", body = Binary, content_type = "application/x-protobuf"),
        Refusal<404>, Refusal<409>, Refusal<422>,
    ),
)]
pub(super) async fn trace(
    State(state): State<Arc<AppState>>,
    Ids((session, take)): Ids<(String, String)>,
) -> Answer<Response> {
    state
        .run(Kind::Compute, move |state| {
            let session = state.store().session(&session)?;
            let take = state.library().take(&session, take_index(&session, &take)?)?;
            Ok(protobuf(&take_trace(&take)))
        })
        .await
}

/// Answers with a take as it was recorded: an MCAP file, which Foxglove, Rerun and PlotJuggler open (`docs/tools.md`).
///
/// With `Range: bytes=...` a part of it comes.
#[utoipa::path(
    get,
    path = "/sessions/{session}/takes/{take}/take.mcap",
    tag = "sessions",
    params(
        ("Range" = Option<String>, Header, description = "A part, such as `bytes=1000-`"),
        ("If-Range" = Option<String>, Header, description = "The `ETag` of the take of which a part is wanted"),
    ),
    responses(
        (status = 200, description = "The file.", body = Binary, content_type = "application/octet-stream",
            headers(("Accept-Ranges" = String, description = "`bytes`"))),
        (status = 206, description = "The part that `Range` asks for.", body = Binary,
            content_type = "application/octet-stream",
            headers(("Content-Range" = String, description = "Which part of how many bytes"))),
        Refusal<404>, Refusal<409>, Refusal<416>, Refusal<422>,
    ),
)]
pub(super) async fn file(
    State(state): State<Arc<AppState>>,
    Ids((session, take)): Ids<(String, String)>,
    headers: HeaderMap,
) -> Answer<Response> {
    let open = move |state: &AppState| {
        let session = state.store().session(&session)?;
        let Outgoing { file, version } = open_take(&session, take_index(&session, &take)?)?;
        let download = Download::of_file(file, &version, "application/octet-stream");
        let name = format!("{}-{take}.mcap", session.id);
        download.map_err(Error::io("read", &session.dir))?.named(name).answer(&headers)
    };
    state.run(Kind::Read, move |state| open(state).map_err(|err| state.store().for_client(err))).await
}

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct ReplayParams {
    /// `nominal`, the id of a saved model, or `run:ID`, `diagnosis:ID`, `calibrated:ID` for the model that a job found.
    #[serde(default = "nominal")]
    model: String,
}

fn nominal() -> String {
    "nominal".to_owned()
}

/// Answers with a take as a sensor model feels it: a protobuf message `palpate.ReplayTrace`
/// (`server/wire/proto/palpate/trace.proto`).
#[utoipa::path(
    get,
    path = "/sessions/{session}/takes/{take}/replay",
    tag = "sessions",
    params(ReplayParams),
    responses(
        (status = 200, description = "Done.", body = Binary, content_type = "application/x-protobuf"),
        Refusal<404>, Refusal<409>, Refusal<422>,
    ),
)]
pub(super) async fn replay(
    State(state): State<Arc<AppState>>,
    Ids((session, take)): Ids<(String, String)>,
    Params(ReplayParams { model }): Params<ReplayParams>,
) -> Answer<Response> {
    state
        .run(Kind::Compute, move |state| {
            let session = state.store().session(&session)?;
            let take_idx = take_index(&session, &take)?;
            let take = state.library().take(&session, take_idx)?;
            let model: SensorModel = match model.split_once(':') {
                None if model == "nominal" => nominal_model(&take)?,
                Some(("run", run)) => state.calibrations().model(run)?,
                Some(("diagnosis", run)) => state.diagnoses().model(run)?,
                Some(("calibrated", run)) => state.diagnoses().calibrated(run)?,
                _ => state.store().model(&model)?.0,
            };
            let paired = state.library().paired(&session, take_idx)?;
            Ok::<_, Error>(protobuf(&replay_trace(&take, &paired, &model)?))
        })
        .await
}

fn protobuf(message: &impl Message) -> Response {
    ([(header::CONTENT_TYPE, "application/x-protobuf")], message.encode_to_vec()).into_response()
}
