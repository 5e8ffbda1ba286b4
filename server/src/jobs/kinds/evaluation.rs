//! `palpate-train evaluate` as a job.

use std::{ffi::OsString, ops::Range, path::PathBuf};

use palpate_jobs::{JobFolder, Shard};
use palpate_wire::api::{ArtifactSort, EvaluationRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, Sharding, parse, shards,
    training::{
        Arguments, PolicyOf, TRIALS_DIR, check_counts, check_objects, check_protocol, check_start,
        model_file, named_objects, objects, training,
    },
};
use crate::{Error, Store};

/// Scores a policy.
pub(crate) const EVALUATION: JobKind = JobKind {
    sharding: Some(Sharding { parts: "objects", count, shard, take_over }),
    ..training("evaluation", "evaluation-", ArtifactSort::Evaluation, check, work)
};

/// Objects of an imitation that names none.
const USUAL_OBJECTS: &str = "seen";

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: EvaluationRequest = parse(EVALUATION.name, request)?;
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
            "policy {:?} imitates an expert on many objects; give a protocol that says where they start",
            request.policy
        )));
    }
    let mut files = policy.own_files(store);
    files.extend(check_objects(store, &request.objects)?);
    files.extend(model_file(store, request.model.as_deref())?);
    Ok(files)
}

fn count(request: &Value) -> Result<u64, Error> {
    let request: EvaluationRequest = parse(EVALUATION.name, request)?;
    let why = match (&request.protocol, &request.objects[..]) {
        (Some(_), [_, ..]) => return Ok(named_objects(&request.objects, USUAL_OBJECTS).len() as u64),
        (None, _) => "without a protocol an evaluation is of one object",
        (Some(_), []) => {
            "the request does not say which objects the shards share; give objects, or \"seen\", \"unseen\" or \"all\""
        }
    };
    Err(Error::Argument(format!("resources.shards: {why}")))
}

fn shard(request: &Value, seed: u64, of_shard: Range<u64>) -> Result<Shard, Error> {
    let of_all: EvaluationRequest = parse(EVALUATION.name, request)?;
    let objects = shards::some_of(named_objects(&of_all.objects, USUAL_OBJECTS), of_shard);
    shards::shard(&EvaluationRequest { objects, ..of_all }, seed)
}

fn take_over(cx: &JobWork<'_>, shard: &JobFolder) -> Result<(), Error> {
    shards::take_files_over(&shard.file(TRIALS_DIR), &cx.folder.file(TRIALS_DIR))
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: EvaluationRequest = parse(EVALUATION.name, request)?;
    cx.forget_metrics()?;
    let file = |name: &str| request.protocol.is_some().then(|| cx.folder.file(name));
    let (out, trials) = (file("comparison.json"), file(TRIALS_DIR));
    let policy = PolicyOf::find(cx.store, &request.policy)?;
    let named = match (&policy, &request.objects[..]) {
        (PolicyOf::Imitation { .. }, []) => Some(OsString::from(USUAL_OBJECTS)),
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
        .path("by-object", trials)
        .path("out", out);
    cx.train_and_report(arguments)
}
