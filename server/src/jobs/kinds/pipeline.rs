//! `palpate-train pipeline` as a job.

use std::{fs, path::PathBuf};

use palpate_wire::api::{ArtifactSort, PipelineRequest};
use serde_json::Value;

use super::{
    HTML_FILE, JobKind, JobWork, names, parse,
    training::{Arguments, POLICY_FILE, check_preset, model_file, training},
};
use crate::{Error, Store, data::files};

/// From a sensor model to policies that are scored. Its first policy is the job's.
pub(crate) const PIPELINE: JobKind =
    training(names::PIPELINE, "pipeline-", ArtifactSort::Policy, check, work);

/// Folder of everything that its stages leave.
const PIPELINE_DIR: &str = "pipeline";

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: PipelineRequest = parse(PIPELINE.name, request)?;
    check_preset(request.preset.as_deref(), request.config.as_deref(), &["small", "tables", "paper"])?;
    Ok(model_file(store, request.model.as_deref())?.into_iter().collect())
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: PipelineRequest = parse(PIPELINE.name, request)?;
    let out = cx.folder.file(PIPELINE_DIR);
    if !out.exists() {
        cx.forget_metrics()?;
    }
    let config = cx.configuration(request.config.as_deref())?;
    let arguments = Arguments::of("pipeline")
        .maybe("preset", request.preset)
        .path("config", config)
        .path("model", model_file(cx.store, request.model.as_deref())?)
        .maybe("device", cx.gpu.then_some("gpu"))
        .with("out", &out);
    let report = cx.train(arguments)?;
    let policy = report["policy"].as_str().ok_or_else(|| {
        Error::Internal(
            "the report of palpate-train pipeline names no policy; is it of the same version?".to_owned(),
        )
    })?;
    for (from, to) in [(out.join(policy), POLICY_FILE), (out.join(HTML_FILE), HTML_FILE)] {
        let bytes = fs::read(&from).map_err(Error::io("read", &from))?;
        files::write(&cx.folder.file(to), &bytes)?;
    }
    cx.save_report(&report)
}
