//! `palpate-train gather` as a job.

use std::{ops::Range, path::PathBuf};

use palpate_jobs::{JobFolder, Shard};
use palpate_wire::api::{ArtifactSort, EXPERTS, GatheringRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, Sharding, names, parse, shards,
    training::{
        Arguments, TRIALS_DIR, check_counts, check_objects, check_protocol, model_file, named_objects,
        objects, request_of, training,
    },
};
use crate::{Error, Store, assets};

/// Keeps what the searching expert does.
pub(crate) const GATHERING: JobKind = JobKind {
    sharding: Some(Sharding { parts: "objects", count, shard, take_over }),
    ..training(names::GATHERING, "gathering-", ArtifactSort::Demonstrations, check, work)
};

/// Objects of a request that names none.
const USUAL_OBJECTS: &str = "seen";
/// The protocol of a request that names none.
const USUAL_PROTOCOL: &str = "wide";

/// Half the edge length of the square that the objects of the gathering `id` began in, m.
pub(super) fn half_width_m(store: &Store, id: &str) -> Result<f64, Error> {
    let request: GatheringRequest = parse(GATHERING.name, &request_of(store, id)?)?;
    let protocol = request.protocol.as_deref().unwrap_or(USUAL_PROTOCOL);
    let text = assets::text(&format!("grasp/protocols/{protocol}.toml")).unwrap_or_default();
    let file: toml::Table = text.parse().unwrap_or_default();
    file.get("half_width_m").and_then(toml::Value::as_float).ok_or_else(|| {
        Error::Argument(format!(
            "the gathering {id:?} is of the protocol {protocol:?}, which this version does not ship; leave it out"
        ))
    })
}

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: GatheringRequest = parse(GATHERING.name, request)?;
    check_counts(&[("count", request.count)])?;
    if let Some(protocol) = &request.protocol {
        check_protocol(protocol)?;
    }
    if let Some(expert) = request.expert.as_deref().filter(|expert| !EXPERTS.contains(expert)) {
        return Err(Error::Argument(format!("expert: {expert:?} is none of {}", EXPERTS.join(", "))));
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
        .maybe("expert", request.expert)
        .with("seed", cx.seed.to_string())
        .path("model", model_file(cx.store, request.model.as_deref())?)
        .with("out", cx.folder.file(TRIALS_DIR));
    if !request.objects.is_empty() {
        arguments = arguments.with("objects", objects(cx.store, &request.objects));
    }
    cx.train_and_report(arguments)
}
