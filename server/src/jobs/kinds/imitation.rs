//! `palpate-train clone` as a job.

use std::{fs, path::PathBuf};

use palpate_wire::api::{ArtifactSort, ImitationRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, names, parse,
    training::{POLICY_FILE, TRAINING_DIR, check_counts, check_preset, learned_from, training, trials},
};
use crate::{Error, Store, data::files};

/// Learns to do what an expert did.
pub(crate) const IMITATION: JobKind =
    training(names::IMITATION, "imitation-", ArtifactSort::Policy, check, work);

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: ImitationRequest = parse(IMITATION.name, request)?;
    check_counts(&[("updates", request.updates)])?;
    check_preset(request.preset.as_deref(), request.config.as_deref(), ["small", "paper"])?;
    match request.head.as_deref() {
        None | Some("regression" | "diffusion") => {}
        Some(head) => {
            return Err(Error::Argument(format!(
                "head = {head:?}; expected \"regression\" or \"diffusion\""
            )));
        }
    }
    learned_from("trials", &request.trials, |id| trials(store, id))
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: ImitationRequest = parse(IMITATION.name, request)?;
    let mut arguments = cx
        .learning("clone", request.preset, request.config.as_deref())?
        .maybe("head", request.head)
        .maybe("updates", request.updates)
        .flag("silence-touch", request.silence_touch)
        .flag("hide-tracking", request.hide_tracking)
        .flag("only-won", request.only_won)
        .maybe("device", cx.gpu.then_some("gpu"));
    for id in &request.trials {
        arguments = arguments.with("data", trials(cx.store, id)?.0);
    }
    let report = cx.train(arguments)?;
    let learned = cx.folder.file(TRAINING_DIR).join("policy.safetensors");
    let weights = fs::read(&learned).map_err(Error::io("read", &learned))?;
    files::write(&cx.folder.file(POLICY_FILE), &weights)?;
    cx.save_report(&report)
}
