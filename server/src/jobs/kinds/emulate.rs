//! `palpate emulate` as a job: records a session from an emulated station.

use std::{
    fs,
    path::{Path, PathBuf},
};

use palpate_truth::record_session;
use palpate_wire::api::{ArtifactSort, EmulateRequest};
use serde_json::Value;

use super::{JobKind, JobWork, SHORT, check_truth_name, parse};
use crate::{Error, Store, assets};

/// Records a session from an emulated station.
pub(crate) const EMULATE: JobKind = JobKind {
    name: "emulate",
    prefix: "emulation-",
    resources: SHORT,
    needs_trainer: false,
    makes: Some(ArtifactSort::Session),
    sharding: None,
    check,
    work,
};

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: EmulateRequest = parse(EMULATE.name, request)?;
    check_truth_name(&request.truth)?;
    assets::truth(Path::new(&request.truth))?;
    store.free_session_dir(&request.session)?;
    Ok(Vec::new())
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: EmulateRequest = parse(EMULATE.name, request)?;
    let (truth, _unpacked) = assets::truth(Path::new(&request.truth))?;
    let dir = cx.folder.file("recording");
    let takes = dir.join(&request.session);
    if dir.exists() {
        // What an attempt that was cut off left.
        fs::remove_dir_all(&dir).map_err(Error::io("remove", &dir))?;
    }
    fs::create_dir_all(&dir).map_err(Error::io("make", &dir))?;
    record_session(&truth, &takes, cx.seed, cx.progress, cx.cancel)?;
    let session = cx.store.adopt_session(&request.session, &takes)?;
    fs::remove_dir_all(&dir).map_err(Error::io("remove", &dir))?;
    cx.save_report(&cx.library.detail(&session)?)
}
