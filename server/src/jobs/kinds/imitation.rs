//! `palpate-train clone` as a job.

use std::{fs, path::PathBuf};

use palpate_wire::api::{ArtifactSort, ConfiguredObservation, ImitationRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, gathering, names, parse,
    training::{
        POLICY_FILE, TRAINING_DIR, check_counts, check_preset, encoder_file, learned_from, training, trials,
    },
};
use crate::{Error, Store, data::files};

/// Learns to do what an expert did.
pub(crate) const IMITATION: JobKind =
    training(names::IMITATION, "imitation-", ArtifactSort::Policy, check, work);

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: ImitationRequest = parse(IMITATION.name, request)?;
    check_counts(&[("updates", request.updates)])?;
    check_preset(request.preset.as_deref(), request.config.as_deref(), &["small", "paper"])?;
    let configured = configured(request.config.as_deref());
    request.check(configured).map_err(|problem| Error::Argument(problem.to_string()))?;
    let mut files = learned_from("trials", &request.trials, |id| trials(store, id))?;
    if request.region || configured.region {
        check_regions(store, &request.trials)?;
    }
    if let Some(id) = &request.encoder {
        files.push(encoder_file(store, id)?);
    }
    Ok(files)
}

/// What `config`, the text of a configuration that is TOML, says of what the policy sees.
fn configured(config: Option<&str>) -> ConfiguredObservation {
    let table: toml::Table = config.and_then(|text| text.parse().ok()).unwrap_or_default();
    let observation = table.get("observation");
    let is_seen = |name: &str| {
        let seen = observation.and_then(|observation| observation.get(name));
        seen.and_then(toml::Value::as_bool) == Some(true)
    };
    ConfiguredObservation { features: is_seen("features"), region: is_seen("region") }
}

/// Refuses trials that all began in one region, where the policy is told which.
fn check_regions(store: &Store, trials: &[String]) -> Result<(), Error> {
    let mut regions = Vec::new();
    for id in trials {
        let half_width_m = gathering::half_width_m(store, id)?;
        if !regions.contains(&half_width_m) {
            regions.push(half_width_m);
        }
    }
    match regions[..] {
        [half_width_m] => Err(Error::Argument(format!(
            "region: all of {} are of the region ±{} cm, and nothing is learned of a number that never changes; add a gathering \
             of another region (the protocol wide has ±8 cm, paper ±2 cm), or leave this out",
            trials.join(", "),
            100.0 * half_width_m
        ))),
        _ => Ok(()),
    }
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: ImitationRequest = parse(IMITATION.name, request)?;
    let encoder = request.encoder.as_deref().map(|id| encoder_file(cx.store, id)).transpose()?;
    let mut arguments = cx
        .learning("clone", request.preset, request.config.as_deref())?
        .maybe("policy", request.policy)
        .maybe("head", request.head)
        .maybe("memory", request.memory)
        .maybe("updates", request.updates)
        .flag("silence-touch", request.silence_touch)
        .flag("hide-tracking", request.hide_tracking)
        .flag("features", request.features)
        .path("encoder", encoder)
        .flag("region", request.region)
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
