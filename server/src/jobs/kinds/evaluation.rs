//! `palpate-train evaluate` as a job.

use std::{ffi::OsString, path::PathBuf};

use palpate_wire::api::{ArtifactSort, EvaluationRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, parse,
    training::{
        Arguments, PolicyOf, check_counts, check_objects, check_protocol, check_start, model_file, objects,
        training,
    },
};
use crate::{Error, Store};

/// Scores a policy.
pub(crate) const EVALUATION: JobKind =
    training("evaluation", "evaluation-", ArtifactSort::Evaluation, check, work);

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
        None if !request.objects.is_empty() => {
            return Err(Error::Argument(
                "objects belong to a protocol; give one, or leave them out".to_owned(),
            ));
        }
        Some(protocol) => check_protocol(protocol)?,
        None => {}
    }
    let policy = PolicyOf::find(store, &request.policy)?;
    if request.protocol.is_none() && matches!(policy, PolicyOf::Imitation { .. }) {
        return Err(Error::Argument(format!(
            "job {:?} imitates an expert on many objects; give a protocol that says where they start",
            request.policy
        )));
    }
    let mut files = policy.own_files(store);
    files.extend(check_objects(store, &request.objects)?);
    files.extend(model_file(store, request.model.as_deref())?);
    Ok(files)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: EvaluationRequest = parse(&EVALUATION, request)?;
    cx.forget_metrics()?;
    let out = request.protocol.is_some().then(|| cx.folder.file("comparison.json"));
    let policy = PolicyOf::find(cx.store, &request.policy)?;
    let named = match (&policy, &request.objects[..]) {
        (PolicyOf::Imitation { .. }, []) => Some(OsString::from("seen")),
        (_, []) => None,
        (_, ids) => Some(objects(cx.store, ids)),
    };
    let arguments = policy
        .task(Arguments::of("evaluate"), cx.store)
        .maybe("trials", request.trials)
        .with("seed", cx.seed.to_string())
        .path("model", model_file(cx.store, request.model.as_deref())?)
        .maybe("start-cm", request.start_cm)
        .flag("silence-touch", request.silence_touch)
        .maybe("protocol", request.protocol)
        .path("objects", named)
        .flag("controls", request.controls)
        .path("out", out);
    cx.train_and_report(arguments)
}
