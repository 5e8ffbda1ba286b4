//! `palpate-train tune` as a job.

use std::path::PathBuf;

use palpate_wire::api::{ArtifactSort, TuneRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, names, parse,
    training::{
        Arguments, SCRIPT_FILE, check_counts, check_object, check_start, model_file, object, script_for,
        training, usual_script,
    },
};
use crate::{Error, Store};

/// Tunes a closing script on one object.
pub(crate) const TUNE: JobKind = training(names::TUNE, "tuning-", ArtifactSort::Script, check, work);

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: TuneRequest = parse(TUNE.name, request)?;
    check_counts(&[
        ("generations", request.generations),
        ("candidates", request.candidates),
        ("elite", request.elite),
        ("trials", request.trials),
        ("check_trials", request.check_trials),
    ])?;
    check_start(request.start_cm)?;
    // What is absent is as palpate-train has it.
    let (elite, candidates) = (request.elite.unwrap_or(10), request.candidates.unwrap_or(64));
    if elite > candidates {
        return Err(Error::Argument(format!(
            "elite = {elite}; expected at most the {candidates} candidates"
        )));
    }
    let mut files: Vec<PathBuf> = check_object(store, &request.object)?.into_iter().collect();
    if let Some(script) = &request.script {
        files.extend(script_for(store, Some(script), &request.object)?.own());
    }
    files.extend(model_file(store, request.model.as_deref())?);
    Ok(files)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: TuneRequest = parse(TUNE.name, request)?;
    // An attempt that was cut off begins from the start, and finds the same.
    cx.forget_metrics()?;
    let script = match &request.script {
        Some(script) => script_for(cx.store, Some(script), &request.object)?,
        None => usual_script(cx.store)?,
    };
    let arguments = Arguments::of("tune")
        .with("object", object(cx.store, &request.object))
        .with("script", script.argument())
        .with("seed", cx.seed.to_string())
        .maybe("generations", request.generations)
        .maybe("candidates", request.candidates)
        .maybe("elite", request.elite)
        .maybe("trials", request.trials)
        .maybe("check-trials", request.check_trials)
        .path("model", model_file(cx.store, request.model.as_deref())?)
        .maybe("start-cm", request.start_cm)
        .with("out", cx.folder.file(SCRIPT_FILE));
    cx.train_and_report(arguments)
}
