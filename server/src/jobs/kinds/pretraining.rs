//! `palpate-train encode` as a job.

use std::path::PathBuf;

use palpate_wire::api::{ArtifactSort, PretrainingRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, names, parse,
    training::{
        Arguments, ENCODER_FILE, TRAINING_DIR, check_counts, check_preset, demonstrations, learned_from,
        training,
    },
};
use crate::{Error, Store};

/// Pretrains the tactile encoder.
pub(crate) const PRETRAINING: JobKind =
    training(names::PRETRAINING, "pretraining-", ArtifactSort::Encoder, check, work);

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: PretrainingRequest = parse(PRETRAINING.name, request)?;
    check_counts(&[("epochs", request.epochs)])?;
    check_preset(request.preset.as_deref(), request.config.as_deref(), &["quick", "paper"])?;
    if request.without_positions && request.silence_touch {
        return Err(Error::Argument(
            "an encoder that is told neither where taxels are nor what they feel has nothing to learn from; leave out \
             without_positions or silence_touch"
                .to_owned(),
        ));
    }
    learned_from("demonstrations", &request.demonstrations, |id| demonstrations(store, id))
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: PretrainingRequest = parse(PRETRAINING.name, request)?;
    let mut arguments = cx
        .learning("encode", request.preset, request.config.as_deref())?
        .maybe("epochs", request.epochs)
        .flag("without-positions", request.without_positions)
        .flag("silence-touch", request.silence_touch);
    for id in &request.demonstrations {
        arguments = arguments.with("demos", demonstrations(cx.store, id)?.0);
    }
    let report = cx.train(arguments)?;
    let (training, encoder) = (cx.folder.file(TRAINING_DIR), cx.folder.file(ENCODER_FILE));
    cx.run_trainer(Arguments::of("export").with("encoder", training).with("out", encoder))?;
    cx.save_report(&report)
}
