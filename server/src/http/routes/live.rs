//! The live station: what it is up to, what it hears, and what is wrong with an emulated one.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use axum::{
    Json,
    extract::State,
    http::{HeaderValue, header},
    response::{IntoResponse as _, Response},
};
use palpate_control::{Claim, read_audit};
use palpate_emulator::devices::{Faults, StationControl};
use palpate_robot_model::Station;
use palpate_wire::{
    api::{LiveDevice, LiveDocument, LiveModel, PlaceObject},
    bits,
    proto::{ControlState, LiveFrame, control_state::Phase, device_status::Link},
};
use serde::Deserialize;

use crate::{
    AppState, Error, chain,
    http::{
        extract::{Body, Lease, Params},
        problem::{Answer, Problem},
    },
    work::Kind,
};

/// What was noted until now is waited for this long.
const AUDIT_PATIENCE: Duration = Duration::from_millis(500);

/// `GET /api/v1/live`.
pub(super) async fn document(State(state): State<Arc<AppState>>) -> Answer<Json<LiveDocument>> {
    let Some(live) = state.live() else { return Err(Problem(Error::no_station())) };
    let frame = state.hub().newest_frame().unwrap_or_default();
    Ok(Json(live_document(live.station(), &frame)))
}

/// Of the audit log this much is sent at a time, bytes: days of work.
const AUDIT_PAGE_BYTES: u64 = 1 << 20;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AuditParams {
    /// Where the page that was read before begins, as its header `Link` says.
    before: Option<String>,
}

/// `GET /api/v1/audit[?before=PLACE]`: who moved or stopped the station and changed data, a JSON document a line, the newest
/// of them or those before a place. The header `Link` names what is older, if anything is.
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

/// `GET /api/v1/emulator/faults`: what is wrong with the emulated devices, as a file of faults.
pub(super) async fn faults(State(state): State<Arc<AppState>>) -> Answer<Response> {
    let text = emulated(&state)?.faults().to_toml();
    let text = text.map_err(|err| Error::Internal(format!("the faults have no text: {err}")))?;
    Ok(([(header::CONTENT_TYPE, "application/toml")], text).into_response())
}

/// `PUT /api/v1/emulator/faults`: says what is wrong from now on, in place of what was.
pub(super) async fn set_faults(
    State(state): State<Arc<AppState>>,
    Lease(claim): Lease,
    text: String,
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

/// `POST /api/v1/emulator/object`: puts an object where the plan has it, or takes it away.
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

/// `PUT /api/v1/live/model`: what the live twin simulates with from now on.
pub(super) async fn set_model(
    State(state): State<Arc<AppState>>,
    Body(request): Body<LiveModel>,
) -> Answer<()> {
    state
        .run(Kind::Read, move |state| {
            let live = state.live().ok_or_else(Error::no_station)?;
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
    let live = state.live().ok_or_else(Error::no_station)?;
    let not_emulated =
        || Error::Conflict("the station is real; only emulated devices can be given faults".to_owned());
    live.emulated().ok_or_else(not_emulated)
}

/// Refuses what would surprise an operator who has control, unless it is the operator who asks.
fn authorise(state: &AppState, claim: &Claim, what: &str) -> Result<(), Error> {
    let live = state.live().ok_or_else(Error::no_station)?;
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
