//! `palpate-train encode` as a job.

use std::path::PathBuf;

use palpate_wire::api::PretrainingRequest;
use serde_json::Value;

use super::{
    JobKind, JobWork, parse,
    training::{Arguments, ENCODER_FILE, TRAINING, TRAINING_DIR, check_counts, check_preset, demonstrations},
};
use crate::{Error, Store};

/// Pretrains the tactile encoder.
pub(crate) const PRETRAINING: JobKind = JobKind {
    name: "pretraining",
    prefix: "pretraining-",
    resources: TRAINING,
    needs_trainer: true,
    check,
    work,
};

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: PretrainingRequest = parse(&PRETRAINING, request)?;
    check_counts(&[("epochs", request.epochs)])?;
    check_preset(request.preset.as_deref(), request.config.as_deref())?;
    if request.demonstrations.is_empty() {
        return Err(Error::Argument(
            "demonstrations is empty, so there is nothing to learn from; give jobs of kind \"demonstrations\"".to_owned(),
        ));
    }
    if request.without_positions && request.silence_touch {
        return Err(Error::Argument(
            "an encoder that is told neither where taxels are nor what they feel has nothing to learn from; leave out \
             without_positions or silence_touch"
                .to_owned(),
        ));
    }
    let mut files = Vec::new();
    for id in &request.demonstrations {
        files.extend(demonstrations(store, id)?.1);
    }
    Ok(files)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: PretrainingRequest = parse(&PRETRAINING, request)?;
    let training = cx.folder.file(TRAINING_DIR);
    if !training.join("checkpoint.safetensors").exists() {
        cx.forget_metrics()?;
    }
    let mut arguments = Arguments::of("encode");
    for id in &request.demonstrations {
        arguments = arguments.with("demos", demonstrations(cx.store, id)?.0);
    }
    let arguments = arguments
        .maybe("preset", request.preset)
        .path("config", cx.config_file(request.config.as_deref())?)
        .maybe("epochs", request.epochs)
        .with("seed", cx.seed.to_string())
        .flag("without-positions", request.without_positions)
        .flag("silence-touch", request.silence_touch)
        .with("out", &training)
        .flag("resume", true);
    let report = cx.train(arguments)?;
    let encoder = cx.folder.file(ENCODER_FILE);
    cx.run_trainer(Arguments::of("export").with("encoder", &training).with("out", &encoder))?;
    cx.save_report(&report)
}
