//! `palpate-train evaluate` as a job.

use std::path::PathBuf;

use palpate_wire::api::EvaluationRequest;
use serde_json::Value;

use super::{
    JobKind, JobWork, parse,
    training::{Arguments, PolicyOf, TRAINING, check_counts, check_start, model_file},
};
use crate::{Error, Store, assets};

/// Scores a policy.
pub(crate) const EVALUATION: JobKind = JobKind {
    name: "evaluation",
    prefix: "evaluation-",
    resources: TRAINING,
    needs_trainer: true,
    check,
    work,
};

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: EvaluationRequest = parse(&EVALUATION, request)?;
    check_counts(&[("trials", request.trials)])?;
    check_start(request.start_cm)?;
    match &request.protocol {
        None if request.controls => {
            return Err(Error::Argument(
                "controls belong to a protocol; give one, or leave them out".to_owned(),
            ));
        }
        Some(_) if request.start_cm.is_some() => {
            return Err(Error::Argument(
                "a protocol says itself where objects start; leave start_cm out".to_owned(),
            ));
        }
        Some(protocol) => {
            let shipped = assets::names_in("grasp/protocols", ".toml");
            if !shipped.contains(&protocol.as_str()) {
                return Err(Error::Argument(format!(
                    "no protocol {protocol:?}; shipped are {}",
                    shipped.join(", ")
                )));
            }
        }
        None => {}
    }
    let mut files = PolicyOf::find(store, &request.policy)?.own_files(store);
    files.extend(model_file(store, request.model.as_deref())?);
    Ok(files)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: EvaluationRequest = parse(&EVALUATION, request)?;
    cx.forget_metrics()?;
    let out = request.protocol.is_some().then(|| cx.folder.file("comparison.json"));
    let arguments = PolicyOf::find(cx.store, &request.policy)?
        .task(Arguments::of("evaluate"), cx.store)
        .maybe("trials", request.trials)
        .with("seed", cx.seed.to_string())
        .path("model", model_file(cx.store, request.model.as_deref())?)
        .maybe("start-cm", request.start_cm)
        .flag("silence-touch", request.silence_touch)
        .maybe("protocol", request.protocol)
        .flag("controls", request.controls)
        .path("out", out);
    let report = cx.train(arguments)?;
    cx.save_report(&report)
}
