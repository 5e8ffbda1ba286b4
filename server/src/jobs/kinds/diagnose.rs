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
    check_diagnosis(&config, request.null_sessions, request.references.len())?;
    let mut files = files_of(&session);
    for reference in references_of(store, &request)? {
        let station = &reference.file.station;
        if *station != session.file.station {
            return Err(Error::Argument(format!(
                "references: session {:?} is of station {station:?}, but {:?} is of {:?}; name sessions of one station",
                reference.id, session.id, session.file.station
            )));
        }
        files.extend(files_of(&reference));
    }
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
        &references_of(cx.store, &request)?,
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

/// The sessions of `request` in which nothing is wrong.
fn references_of(store: &Store, request: &DiagnosisRequest) -> Result<Vec<Session>, Error> {
    for (idx, id) in request.references.iter().enumerate() {
        if *id == request.session || request.references[..idx].contains(id) {
            return Err(Error::Argument(format!(
                "references: session {id:?} is given twice; name each once, and not the session that is diagnosed"
            )));
        }
    }
    request.references.iter().map(|id| store.session(id)).collect()
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
