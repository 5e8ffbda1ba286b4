//! `palpate-train ppo` as a job.

use std::{fs, path::PathBuf};

use palpate_wire::api::{ArtifactSort, ExpertRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, names, parse,
    training::{
        Arguments, POLICY_FILE, SCRIPT_FILE, TRAINING_DIR, check_counts, check_object, check_preset,
        check_start, model_file, object, script_for, training,
    },
};
use crate::{Error, Store};

/// Learns to grasp one object.
pub(crate) const EXPERT: JobKind = training(names::EXPERT, "expert-", ArtifactSort::Policy, check, work);

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: ExpertRequest = parse(EXPERT.name, request)?;
    check_counts(&[("total_steps", request.total_steps)])?;
    check_start(request.start_cm)?;
    check_preset(request.preset.as_deref(), request.config.as_deref(), &["quick", "paper"])?;
    if request.without_script && request.script.is_some() {
        return Err(Error::Argument(
            "without_script leaves no script to learn on top of; leave one out".to_owned(),
        ));
    }
    let mut files: Vec<PathBuf> = check_object(store, &request.object)?.into_iter().collect();
    files.extend(script_for(store, request.script.as_deref(), &request.object)?.own());
    files.extend(model_file(store, request.model.as_deref())?);
    Ok(files)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: ExpertRequest = parse(EXPERT.name, request)?;
    let mut arguments = cx
        .learning("ppo", request.preset, request.config.as_deref())?
        .with("object", object(cx.store, &request.object))
        .maybe("total-steps", request.total_steps)
        .path("model", model_file(cx.store, request.model.as_deref())?)
        .maybe("start-cm", request.start_cm)
        .flag("without-script", request.without_script)
        .flag("silence-touch", request.silence_touch);
    if !request.without_script {
        // What it was learned on top of stays with the policy, which fits no other script.
        let script = cx.folder.file(SCRIPT_FILE);
        if !script.exists() {
            let found = script_for(cx.store, request.script.as_deref(), &request.object)?;
            let text = cx.text_of(&found)?;
            cx.save(SCRIPT_FILE, &text)?;
        }
        arguments = arguments.with("script", script);
    }
    let mut report = cx.train(arguments)?;
    let policy = cx.folder.file(POLICY_FILE);
    cx.run_trainer(
        Arguments::of("export").with("policy", cx.folder.file(TRAINING_DIR)).with("out", &policy),
    )?;
    if let Value::Object(report) = &mut report {
        let bytes = fs::metadata(&policy).map_err(Error::io("read", &policy))?.len();
        report.insert("object".to_owned(), request.object.into());
        report.insert("policy_bytes".to_owned(), bytes.into());
    }
    cx.save_report(&report)
}
