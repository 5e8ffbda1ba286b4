//! `palpate-train gather` as a job.

use std::{fs, io, ops::Range, path::PathBuf};

use palpate_jobs::{JobFolder, Shard};
use palpate_wire::api::{ArtifactSort, GatheringRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, Sharding, parse,
    training::{
        Arguments, TRIALS_DIR, check_counts, check_objects, check_protocol, model_file, named_objects,
        objects, training,
    },
};
use crate::{Error, Store};

/// Keeps what the searching expert does.
pub(crate) const GATHERING: JobKind = JobKind {
    sharding: Some(Sharding { parts: "objects", count, shard, take_over }),
    ..training("gathering", "gathering-", ArtifactSort::Demonstrations, check, work)
};

/// Objects of a request that names none.
const USUAL_OBJECTS: &str = "seen";

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

fn count(request: &Value) -> Result<u64, Error> {
    let request: GatheringRequest = parse(&GATHERING, request)?;
    Ok(named_objects(&request.objects, USUAL_OBJECTS).len() as u64)
}

fn shard(request: &Value, seed: u64, objects: Range<u64>) -> Result<Shard, Error> {
    let of_all: GatheringRequest = parse(&GATHERING, request)?;
    let named = named_objects(&of_all.objects, USUAL_OBJECTS).into_iter();
    let objects = named.skip(objects.start as usize).take((objects.end - objects.start) as usize).collect();
    let request = serde_json::to_value(GatheringRequest { objects, ..of_all })
        .map_err(|err| Error::Internal(err.to_string()))?;
    Ok(Shard { request, seed })
}

/// Moves the shard's files, one an object, to the job's: what is there is not made again.
fn take_over(cx: &JobWork<'_>, shard: &JobFolder) -> Result<(), Error> {
    let (from, to) = (shard.file(TRIALS_DIR), cx.folder.file(TRIALS_DIR));
    let entries = match fs::read_dir(&from) {
        Err(err) if err.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(Error::io("read", &from))?,
    };
    fs::create_dir_all(&to).map_err(Error::io("make", &to))?;
    for entry in entries {
        let entry = entry.map_err(Error::io("read", &from))?;
        // Each object is one shard's; of what was cut off while it was written nobody takes notice.
        fs::rename(entry.path(), to.join(entry.file_name())).map_err(Error::io("move", entry.path()))?;
    }
    Ok(())
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
