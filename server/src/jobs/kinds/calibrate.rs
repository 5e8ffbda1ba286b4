//! `palpate calibrate` as a job.

use std::path::PathBuf;

use palpate_calibration::{CalibrationConfig, Method};
use palpate_recording::Session;
use palpate_wire::api::{ArtifactSort, CalibrationRequest};
use serde_json::Value;

use super::{HTML_FILE, JobKind, JobWork, MODEL_FILE, SHORT, files_of, hold_out, parse};
use crate::{Error, Store, jobs::calibrate_session};

/// Fits the sensor model to a session.
pub(crate) const CALIBRATE: JobKind = JobKind {
    name: "calibrate",
    prefix: "run-",
    resources: SHORT,
    needs_trainer: false,
    makes: Some(ArtifactSort::Model),
    sharding: None,
    check,
    work,
};

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: CalibrationRequest = parse(CALIBRATE.name, request)?;
    let session = store.session(&request.session)?;
    config_of(&request, &session, 0)?;
    Ok(files_of(&session))
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: CalibrationRequest = parse(CALIBRATE.name, request)?;
    let session = cx.store.session(&request.session)?;
    let config = config_of(&request, &session, cx.seed)?;
    let artifacts = calibrate_session(cx.library, &session, &config, cx.progress, cx.cancel)?;
    cx.save(MODEL_FILE, &artifacts.model.to_toml())?;
    cx.save(HTML_FILE, &artifacts.html)?;
    cx.save_report(&artifacts.report)
}

/// What `request` asks of `session`, or why it cannot be done.
fn config_of(request: &CalibrationRequest, session: &Session, seed: u64) -> Result<CalibrationConfig, Error> {
    let method = match request.method.as_deref() {
        None | Some("exact") => Method::Exact,
        Some("grid") => Method::Grid,
        Some(other) => {
            return Err(Error::Argument(format!("no method {other:?}; expected \"exact\" or \"grid\"")));
        }
    };
    let hold_out = hold_out(request.hold_out.as_deref(), session)?;
    let shared_theta = request.shared_theta;
    Ok(CalibrationConfig { method, hold_out, shared_theta, seed, ..CalibrationConfig::default() })
}
