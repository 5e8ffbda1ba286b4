//! `palpate-train gather` as a job.

use std::{ops::Range, path::PathBuf};

use palpate_jobs::{JobFolder, Shard};
use palpate_wire::api::{ArtifactSort, GatheringRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, Sharding, names, parse, shards,
    training::{
        Arguments, TRIALS_DIR, check_counts, check_objects, check_protocol, model_file, named_objects,
        objects, training,
    },
};
use crate::{Error, Store};

/// Keeps what the searching expert does.
pub(crate) const GATHERING: JobKind = JobKind {
    sharding: Some(Sharding { parts: "objects", count, shard, take_over }),
    ..training(names::GATHERING, "gathering-", ArtifactSort::Demonstrations, check, work)
};

/// Objects of a request that names none.
const USUAL_OBJECTS: &str = "seen";

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: GatheringRequest = parse(GATHERING.name, request)?;
    check_counts(&[("count", request.count)])?;
    if let Some(protocol) = &request.protocol {
        check_protocol(protocol)?;
    }
    let mut files = check_objects(store, &request.objects)?;
    files.extend(model_file(store, request.model.as_deref())?);
    Ok(files)
}

fn count(request: &Value) -> Result<u64, Error> {
    let request: GatheringRequest = parse(GATHERING.name, request)?;
    Ok(named_objects(&request.objects, USUAL_OBJECTS).len() as u64)
}

fn shard(request: &Value, seed: u64, of_shard: Range<u64>) -> Result<Shard, Error> {
    let of_all: GatheringRequest = parse(GATHERING.name, request)?;
    let objects = shards::some_of(named_objects(&of_all.objects, USUAL_OBJECTS), of_shard);
    shards::shard(&GatheringRequest { objects, ..of_all }, seed)
}

fn take_over(cx: &JobWork<'_>, shard: &JobFolder) -> Result<(), Error> {
    shards::take_files_over(&shard.file(TRIALS_DIR), &cx.folder.file(TRIALS_DIR))
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: GatheringRequest = parse(GATHERING.name, request)?;
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
