//! `palpate-train gather` as a job.

use std::path::PathBuf;

use palpate_wire::api::{ArtifactSort, GatheringRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, parse,
    training::{
        Arguments, TRIALS_DIR, check_counts, check_objects, check_protocol, model_file, objects, training,
    },
};
use crate::{Error, Store};

/// Keeps what the searching expert does.
pub(crate) const GATHERING: JobKind =
    training("gathering", "gathering-", ArtifactSort::Demonstrations, check, work);

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: GatheringRequest = parse(&GATHERING, request)?;
    check_counts(&[("count", request.count)])?;
    if let Some(protocol) = &request.protocol {
        check_protocol(protocol)?;
    }
    let mut files = check_objects(store, &request.objects)?;
    files.extend(model_file(store, request.model.as_deref())?);
    Ok(files)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: GatheringRequest = parse(&GATHERING, request)?;
    // Objects whose trials are there already tell their points again.
    cx.forget_metrics()?;
    let mut arguments = Arguments::of("gather")
        .maybe("count", request.count)
        .maybe("protocol", request.protocol)
        .with("seed", cx.seed.to_string())
        .path("model", model_file(cx.store, request.model.as_deref())?)
        .with("out", cx.folder.file(TRIALS_DIR));
    if !request.objects.is_empty() {
        arguments = arguments.with("objects", objects(cx.store, &request.objects));
    }
    cx.train_and_report(arguments)
}
