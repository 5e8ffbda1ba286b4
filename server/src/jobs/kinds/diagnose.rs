//! `palpate diagnose` as a job.

use std::path::PathBuf;

use palpate_diagnosis::DiagnosisConfig;
use palpate_recording::Session;
use palpate_wire::api::{ArtifactSort, DiagnosisRequest};
use serde_json::Value;

use super::{HTML_FILE, JobKind, JobWork, LONG, MODEL_FILE, files_of, hold_out, parse};
use crate::{
    Error, Store,
    data::bars::Bars,
    jobs::{BarConfig, check_diagnosis, diagnose_sessions},
};

/// The calibrated model, without the effects that were named.
pub(crate) const CALIBRATED_FILE: &str = "calibrated.toml";
/// The text of the saved model that the diagnosis started from.
pub(crate) const BASE_FILE: &str = "base.toml";

/// Names what the calibrated model of a session lacks.
pub(crate) const DIAGNOSE: JobKind = JobKind {
    name: "diagnose",
    prefix: "diagnosis-",
    resources: LONG,
    needs_trainer: false,
    makes: Some(ArtifactSort::Model),
    sharding: None,
    check,
    work,
};

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: DiagnosisRequest = parse(DIAGNOSE.name, request)?;
    let session = store.session(&request.session)?;
    let config = config_of(&request, &session, 0)?;
    check_diagnosis(&config, request.null_sessions)?;
    let mut files = files_of(&session);
    if let Some(model) = &request.model {
        files.push(store.model_file(model)?);
    }
    Ok(files)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: DiagnosisRequest = parse(DIAGNOSE.name, request)?;
    let session = cx.store.session(&request.session)?;
    let config = config_of(&request, &session, cx.seed)?;
    let start = request.model.as_deref().map(|model| cx.store.model(model)).transpose()?;
    let bars = Bars::of(cx.store.root());
    let artifacts = diagnose_sessions(
        cx.library,
        std::slice::from_ref(&session),
        &config,
        start.as_ref().map(|(model, _)| model),
        BarConfig { bars: &bars, null_sessions: request.null_sessions },
        cx.progress,
        cx.cancel,
    )?;
    cx.save(MODEL_FILE, &artifacts.model.to_toml())?;
    cx.save(CALIBRATED_FILE, &artifacts.calibrated.to_toml())?;
    if let Some((_, text)) = &start {
        cx.save(BASE_FILE, text)?;
    }
    cx.save(HTML_FILE, &artifacts.html)?;
    cx.save_report(&artifacts.report)
}

/// What `request` asks of `session`, or why it cannot be done.
fn config_of(request: &DiagnosisRequest, session: &Session, seed: u64) -> Result<DiagnosisConfig, Error> {
    let default = DiagnosisConfig::default();
    Ok(DiagnosisConfig {
        hold_out: hold_out(request.hold_out.as_deref(), session)?,
        max_effects: request.max_effects.unwrap_or(default.max_effects),
        without: request.without.clone(),
        seed,
        ..default
    })
}
