//! The live station: what it is up to, what it hears, and what is wrong with an emulated one.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use axum::{
    Json,
    extract::State,
    http::{HeaderValue, header},
    response::{IntoResponse as _, Response},
};
use palpate_control::{Claim, read_audit};
use palpate_emulator::{Faults, StationControl};
use palpate_messages::bits;
use palpate_robot_model::Station;
use palpate_wire::{
    api::{LiveDevice, LiveDocument, LiveModel, PlaceObject},
    proto::{ControlState, LiveFrame, control_state::Phase, device_status::Link},
};
use serde::Deserialize;

use crate::{
    AppState, Error, chain,
    http::{
        documented::Refusal,
        extract::{Body, Lease, Params, Text},
        problem::{Answer, Problem},
    },
    work::Kind,
};

/// What was noted until now is waited for this long.
const AUDIT_PATIENCE: Duration = Duration::from_millis(500);

/// Answers with the newest state of the live station.
#[utoipa::path(
    get,
    path = "/live",
    tag = "station",
    responses((status = 200, description = "Done.", body = LiveDocument), Refusal<404>),
)]
pub(super) async fn document(State(state): State<Arc<AppState>>) -> Answer<Json<LiveDocument>> {
    let Some(live) = state.live() else { return Err(Problem(Error::NoStation)) };
    let frame = state.hub().newest_frame().unwrap_or_default();
    Ok(Json(live_document(live.station(), &frame)))
}

/// Of the audit log this much is sent at a time, bytes: days of work.
const AUDIT_PAGE_BYTES: u64 = 1 << 20;

#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct AuditParams {
    /// Where the page that was read before begins, as its header `Link` says.
    before: Option<String>,
}

/// Answers with who moved or stopped the station and changed data, a JSON document a line: the newest of them, or those before
/// a place. The header `Link` names what is older, if anything is.
#[utoipa::path(
    get,
    path = "/audit",
    tag = "station",
    params(AuditParams),
    responses((status = 200, description = "Done.", body = String, content_type = "application/jsonl")),
)]
pub(super) async fn audit(
    State(state): State<Arc<AppState>>,
    Params(AuditParams { before }): Params<AuditParams>,
) -> Answer<Response> {
    let before = before.map(|before| before.parse()).transpose().map_err(Error::Argument)?;
    let read = move |state: &AppState| {
        let path = state.store().audit_path();
        // What has just been done is among it; a disk that stands still is not waited for.
        state.audit().flush(AUDIT_PATIENCE);
        let page = read_audit(&path, before, AUDIT_PAGE_BYTES).map_err(Error::io("read", &path))?;
        let mut response = ([(header::CONTENT_TYPE, "application/jsonl")], page.lines).into_response();
        let link = page.older.map(|older| format!("</api/v1/audit?before={older}>; rel=\"next\""));
        if let Some(link) = link.and_then(|link| HeaderValue::from_str(&link).ok()) {
            response.headers_mut().insert(header::LINK, link);
        }
        Ok(response)
    };
    state.run(Kind::Read, read).await
}

/// Answers with what is wrong with the emulated devices, as a file of faults (`docs/emulated_devices.md`).
#[utoipa::path(
    get,
    path = "/emulator/faults",
    tag = "emulator",
    responses(
        (status = 200, description = "Done.", body = String, content_type = "application/toml"),
        Refusal<404>, Refusal<409>,
    ),
)]
pub(super) async fn faults(State(state): State<Arc<AppState>>) -> Answer<Response> {
    let text = emulated(&state)?.faults().to_toml();
    let text = text.map_err(|err| Error::Internal(format!("the faults have no text: {err}")))?;
    Ok(([(header::CONTENT_TYPE, "application/toml")], text).into_response())
}

/// Says what is wrong with the emulated devices from now on, in place of what was.
#[utoipa::path(
    put,
    path = "/emulator/faults",
    tag = "emulator",
    request_body(content = Option<String>, description = "A file of faults; nothing is wrong where it is empty", content_type = "application/toml"),
    responses(
        (status = 200, description = "Done.", body = String, content_type = "application/toml"),
        Refusal<404>, Refusal<409>, Refusal<413>, Refusal<422>,
    ),
)]
pub(super) async fn set_faults(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Text(text): Text,
) -> Answer<Response> {
    let set = move |state: &AppState| {
        let emulated = emulated(state)?;
        let faults = Faults::parse("faults", &text, emulated.station())?;
        authorise(state, &claim, "give emulated devices other faults")?;
        emulated.set_faults(faults).map_err(|err| Error::Content(chain(&err)))
    };
    state.run(Kind::Control, set).await?;
    faults(State(state)).await
}

/// Puts an object where the plan of an emulated station has it, or takes it away.
#[utoipa::path(
    post,
    path = "/emulator/object",
    tag = "emulator",
    request_body = PlaceObject,
    responses((status = 200, description = "It is there."), Refusal<404>, Refusal<409>),
)]
pub(super) async fn place_object(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    Body(request): Body<PlaceObject>,
) -> Answer<()> {
    let place = move |state: &AppState| {
        let emulated = emulated(state)?;
        authorise(state, &claim, "place an object on the emulated station")?;
        emulated.place_object(request.object.as_deref()).map_err(|err| Error::Content(chain(&err)))
    };
    state.run(Kind::Control, place).await
}

/// Chooses what the live twin simulates with from now on.
#[utoipa::path(
    put,
    path = "/live/model",
    tag = "station",
    request_body = LiveModel,
    responses((status = 200, description = "It simulates with it."), Refusal<404>, Refusal<409>),
)]
pub(super) async fn set_model(
    State(state): State<Arc<AppState>>,
    Body(request): Body<LiveModel>,
) -> Answer<()> {
    state
        .run(Kind::Read, move |state| {
            let live = state.live().ok_or(Error::NoStation)?;
            let model = match request.model.as_str() {
                "nominal" => None,
                id => Some(state.store().model(id)?.0),
            };
            let name = live.handle().set_model(model)?;
            tracing::info!(model = name, "the live twin has another sensor model");
            Ok(())
        })
        .await
}

fn emulated(state: &AppState) -> Result<&StationControl, Error> {
    let live = state.live().ok_or(Error::NoStation)?;
    let not_emulated =
        || Error::Conflict("the station is real; only emulated devices can be given faults".to_owned());
    live.emulated().ok_or_else(not_emulated)
}

/// Refuses what would surprise an operator who has control, unless it is the operator who asks.
fn authorise(state: &AppState, claim: &Claim, what: &str) -> Result<(), Error> {
    let live = state.live().ok_or(Error::NoStation)?;
    Ok(live.handle().authorise(claim, what, true)?)
}

fn live_document(station: &Station, frame: &LiveFrame) -> LiveDocument {
    let by_joint = |positions: &[f32]| -> BTreeMap<String, f64> {
        let names = station.robot.dofs().map(|joint| joint.name.clone());
        names.zip(positions.iter().map(|&position| f64::from(position))).collect()
    };
    let channels = station.layout.channels.iter().enumerate();
    let active = channels
        .filter(|(channel, _)| bits::get(&frame.active, *channel))
        .map(|(_, channel)| channel.id.clone())
        .collect();
    let idle = ControlState::default();
    let control = frame.control.as_ref().unwrap_or(&idle);
    LiveDocument {
        time_s: frame.time_s,
        joints: by_joint(&frame.joint_positions),
        commanded: by_joint(&control.commanded),
        active,
        phase: phase_word(control.phase()).to_owned(),
        reason: control.reason.clone(),
        holder: control.holder.clone(),
        stop_confirmed: control.stop_confirmed,
        loop_hz: [control.loop_hz, control.loop_mean_hz, control.loop_worst_hz].map(f64::from),
        latency_ms: [control.latency_ms, control.latency_p95_ms].map(f64::from),
        devices: control
            .devices
            .iter()
            .map(|device| LiveDevice {
                id: device.id.clone(),
                link: link_word(device.link()).to_owned(),
                problem: device.problem.clone(),
                rate_hz: [device.rate_hz, device.rate_mean_hz, device.rate_worst_hz].map(f64::from),
                gaps: device.gaps,
                bad_frames: device.bad_frames,
                reconnects: device.reconnects,
            })
            .collect(),
    }
}

fn phase_word(phase: Phase) -> &'static str {
    match phase {
        Phase::Unspecified | Phase::Disarmed => "disarmed",
        Phase::Arming => "arming",
        Phase::Armed => "armed",
        Phase::Holding => "holding",
        Phase::Disarming => "disarming",
        Phase::Stopped => "stopped",
    }
}

fn link_word(link: Link) -> &'static str {
    match link {
        Link::Unspecified | Link::Connecting => "connecting",
        Link::Ready => "ready",
        Link::Fault => "fault",
        Link::Lost => "lost",
    }
}
