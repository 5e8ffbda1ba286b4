//! `palpate-train demos` as a job.

use std::path::PathBuf;

use palpate_wire::api::{ArtifactSort, DemonstrationsRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork,
    expert::EXPERT,
    names, parse,
    training::{Arguments, DEMONSTRATIONS_DIR, PolicyOf, check_counts, check_start, model_file, training},
};
use crate::{Error, Store};

/// Rolls a policy out and keeps what succeeds.
pub(crate) const DEMONSTRATIONS: JobKind =
    training(names::DEMONSTRATIONS, "demonstrations-", ArtifactSort::Demonstrations, check, work);

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: DemonstrationsRequest = parse(DEMONSTRATIONS.name, request)?;
    check_counts(&[("count", Some(request.count)), ("shard_demos", request.shard_demos)])?;
    check_start(request.start_cm)?;
    let policy = PolicyOf::find(store, &request.policy)?;
    if matches!(policy, PolicyOf::Imitation { .. }) {
        return Err(Error::Argument(format!(
            "job {:?} imitates an expert; demonstrations are made by a job of kind {:?} or a shipped policy",
            request.policy, EXPERT.name
        )));
    }
    let mut files = policy.own_files(store);
    files.extend(model_file(store, request.model.as_deref())?);
    Ok(files)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: DemonstrationsRequest = parse(DEMONSTRATIONS.name, request)?;
    let out = cx.folder.file(DEMONSTRATIONS_DIR);
    if !out.exists() {
        cx.forget_metrics()?;
    }
    let arguments = PolicyOf::find(cx.store, &request.policy)?
        .task(Arguments::of("demos"), cx.store)
        .with("count", request.count.to_string())
        .maybe("shard-demos", request.shard_demos)
        .with("seed", cx.seed.to_string())
        .path("model", model_file(cx.store, request.model.as_deref())?)
        .maybe("start-cm", request.start_cm)
        .with("out", out);
    cx.train_and_report(arguments)
}
