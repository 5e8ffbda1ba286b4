//! How the studio is: alive, ready, and in numbers.

use std::{
    sync::{Arc, atomic::AtomicU64},
    time::Duration,
};

use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
    response::{IntoResponse as _, Response},
};
use palpate_wire::{
    api::Readiness,
    proto::{ControlState, LiveFrame, device_status::Link},
};
use prometheus_client::{
    encoding::text::encode,
    metrics::{counter::Counter, family::Family, gauge::Gauge, info::Info},
    registry::{Registry, Unit},
};

use crate::{
    AppState, Error, chain,
    data::upload::free_bytes,
    http::problem::{Answer, Problem},
    work::Kind,
};

/// A control loop that publishes nothing for this long stands still; it publishes 30 times a second.
const MAX_SILENCE: Duration = Duration::from_secs(2);
/// With less space than this, recordings end soon, bytes.
const MIN_FREE_BYTES: u64 = 256 << 20;

type Labels = Vec<(&'static str, String)>;
type Gauges = Family<Labels, Gauge<f64, AtomicU64>>;
type Counters = Family<Labels, Counter>;

/// `GET /healthz`: the process answers. It says nothing of the station.
pub(super) async fn alive() -> &'static str {
    "ok\n"
}

/// `GET /readyz`: 200 if everything that the studio needs is there, 503 with the reasons if not.
pub(super) async fn ready(State(state): State<Arc<AppState>>) -> Response {
    let reasons = state.run(Kind::Read, |state| Ok(reasons(state))).await;
    let reasons = reasons.unwrap_or_else(|Problem(err)| vec![chain(&err)]);
    let is_ready = reasons.is_empty();
    let status = if is_ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (status, [(header::CACHE_CONTROL, "no-store")], Json(Readiness { ready: is_ready, reasons }))
        .into_response()
}

/// Why the studio is not ready. Everybody may read it, so it names no paths.
fn reasons(state: &AppState) -> Vec<String> {
    let mut reasons = Vec::new();
    if *state.shutdown().borrow() {
        reasons.push("the studio is shutting down".to_owned());
    }
    if let Err(err) = state.jobs().scheduler().totals() {
        tracing::warn!(err = chain(&err), "the table of jobs cannot be read");
        reasons.push("the table of jobs cannot be read; see the log".to_owned());
    }
    match free_bytes(state.data()) {
        None => reasons.push("the disk of the data folder cannot be asked for its space".to_owned()),
        Some(free) if free < MIN_FREE_BYTES => {
            reasons.push(format!("the disk of the data folder has only {} MB free", free / 1_000_000));
        }
        Some(_) => {}
    }
    if !state.audit().problem().is_empty() {
        reasons.push("the audit log cannot be written; see the log".to_owned());
    }
    if state.live().is_some() {
        match state.hub().silent_for() {
            Some(silent) if silent <= MAX_SILENCE => {}
            Some(silent) => {
                reasons.push(format!(
                    "the control loop has published nothing for {:.1} s",
                    silent.as_secs_f64()
                ));
            }
            None => reasons.push("the control loop has published nothing yet".to_owned()),
        }
    }
    reasons
}

/// `GET /metrics`: numbers for Prometheus, in its OpenMetrics form.
pub(super) async fn metrics(State(state): State<Arc<AppState>>) -> Answer<Response> {
    let text = state.run(Kind::Read, exposition).await?;
    let content_type = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    Ok(([(header::CONTENT_TYPE, content_type)], text).into_response())
}

fn exposition(state: &AppState) -> Result<String, Error> {
    let mut registry = Registry::with_prefix("palpate");
    let source = state.live().map_or("replay", |live| match live.source() {
        palpate_wire::api::Source::Real => "real",
        palpate_wire::api::Source::Emulated => "emulated",
        palpate_wire::api::Source::Replay => "replay",
    });
    let build = vec![("version", env!("CARGO_PKG_VERSION")), ("source", source)];
    registry.register("build", "The program, and what its station is", Info::new(build));

    let frame = state.hub().newest_frame().unwrap_or_default();
    if state.live().is_some() {
        station(&mut registry, &frame, state.hub().silent_for());
    }

    let (jobs, seconds) = (Gauges::default(), Gauges::default());
    for total in state.jobs().scheduler().totals()? {
        let labels = vec![("kind", total.kind), ("state", total.state.name().to_owned())];
        jobs.get_or_create(&labels).set(total.jobs as f64);
        seconds.get_or_create(&labels).set(total.seconds);
    }
    registry.register("jobs", "Jobs in the table, by kind and state", jobs);
    registry.register_with_unit(
        "jobs_run",
        "Time that these jobs have run for, all together",
        Unit::Seconds,
        seconds,
    );

    let clients = Gauge::<i64>::default();
    clients.set(i64::try_from(state.hub().num_clients()).unwrap_or(i64::MAX));
    registry.register("stream_clients", "Open sockets of the stream", clients);
    counter(
        &mut registry,
        "stream_frames_dropped",
        "Live frames that clients were too slow for",
        state.hub().num_dropped(),
    );
    counter(
        &mut registry,
        "audit_lines_lost",
        "Lines that the audit log lost to a slow disk",
        state.audit().num_lost(),
    );
    if let Some(free) = free_bytes(state.data()) {
        let gauge = Gauge::<f64, AtomicU64>::default();
        gauge.set(free as f64);
        registry.register_with_unit(
            "disk_free",
            "Space left on the disk of the data folder",
            Unit::Bytes,
            gauge,
        );
    }
    let mut text = String::new();
    encode(&mut text, &registry).map_err(|err| Error::Internal(format!("metrics have no text: {err}")))?;
    Ok(text)
}

fn counter(registry: &mut Registry, name: &str, help: &str, value: u64) {
    let counter = Counter::<u64>::default();
    counter.inc_by(value);
    registry.register(name, help, counter);
}

/// The control loop and the buses.
fn station(registry: &mut Registry, frame: &LiveFrame, silent: Option<Duration>) {
    let idle = ControlState::default();
    let control = frame.control.as_ref().unwrap_or(&idle);
    let of = |values: &[(&'static str, f32)]| {
        let gauges = Gauges::default();
        for (stat, value) in values {
            gauges.get_or_create(&vec![("stat", (*stat).to_owned())]).set(f64::from(*value));
        }
        gauges
    };
    registry.register(
        "control_loop_rate_hz",
        "Turns of the control loop a second: over the last second, mean since the start, of the worst second",
        of(&[
            ("now", control.loop_hz),
            ("mean", control.loop_mean_hz),
            ("worst_second", control.loop_worst_hz),
        ]),
    );
    // What the worst second lost against the mean.
    let jitter = Gauge::<f64, AtomicU64>::default();
    if control.loop_mean_hz > 0.0 {
        jitter.set((1.0 - f64::from(control.loop_worst_hz) / f64::from(control.loop_mean_hz)).max(0.0));
    }
    registry.register(
        "control_loop_jitter_ratio",
        "Share of the turns that the worst second lacked against the mean second",
        jitter,
    );
    registry.register(
        "sensing_latency_milliseconds",
        "From a device's byte to a live frame: the newest, and the 95th percentile of ten seconds",
        of(&[("now", control.latency_ms), ("p95", control.latency_p95_ms)]),
    );
    let silence = Gauge::<f64, AtomicU64>::default();
    silence.set(silent.map_or(f64::INFINITY, |silent| silent.as_secs_f64()));
    registry.register_with_unit("control_loop_silent", "Since the newest live frame", Unit::Seconds, silence);
    let (up, rates) = (Gauges::default(), Gauges::default());
    let (gaps, bad, again) = (Counters::default(), Counters::default(), Counters::default());
    for device in &control.devices {
        let labels = vec![("device", device.id.clone())];
        up.get_or_create(&labels).set(f64::from(u8::from(device.link() == Link::Ready)));
        rates.get_or_create(&labels).set(f64::from(device.rate_hz));
        gaps.get_or_create(&labels).inc_by(device.gaps);
        bad.get_or_create(&labels).inc_by(device.bad_frames);
        again.get_or_create(&labels).inc_by(device.reconnects);
    }
    registry.register("device_up", "1 while the device is ready", up);
    registry.register("device_rate_hz", "Samples of the device over the last second", rates);
    registry.register("device_gaps", "Samples that did not come in time", gaps);
    registry.register("device_bad_frames", "Frames dropped for a bad checksum or form", bad);
    registry.register("device_reconnects", "Times that the device was connected again", again);
}
