//! `palpate blind` as a job.

use std::path::{Path, PathBuf};

use palpate_blind::{BlindConfig, World, actuator, tactile};
use palpate_wire::api::{BlindDomain, BlindRequest};
use serde_json::Value;

use super::{JobKind, JobWork, LONG, check_truth_name, parse};
use crate::{Error, Store, assets};

/// Hides effects in emulated sessions, has them diagnosed, and scores the names.
pub(crate) const BLIND: JobKind = JobKind {
    name: "blind",
    prefix: "blind-",
    resources: LONG,
    needs_trainer: false,
    makes: None,
    check,
    work,
};

/// The world of the touch sessions, where the request names none.
const TRUTH: &str = "blind_report";

fn check(_: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: BlindRequest = parse(&BLIND, request)?;
    if request.seeds == 0 {
        return Err(Error::Argument("seeds = 0: no round, no score; ask for at least 1".to_owned()));
    }
    if let Some(truth) = &request.truth {
        check_truth_name(truth)?;
        assets::truth(Path::new(truth))?;
    }
    Ok(Vec::new())
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: BlindRequest = parse(&BLIND, request)?;
    let config = BlindConfig {
        world: World::A,
        without_rules: Vec::new(),
        seeds: request.seeds,
        first_seed: cx.seed,
        nulls: request.nulls,
        binary_only: !request.raw_only,
        leave_out: !request.whole_library,
        only: request.only.clone(),
        // An attempt that was cut off goes on where it was.
        answers: Some(cx.folder.file("answers.jsonl")),
    };
    let report = match request.domain {
        BlindDomain::Tactile => {
            let (truth, _unpacked) = assets::truth(Path::new(request.truth.as_deref().unwrap_or(TRUTH)))?;
            tactile(&truth, &config, cx.progress, cx.cancel)
        }
        BlindDomain::Actuator => actuator(&config, cx.progress, cx.cancel),
    };
    cx.save_report(&report?)
}
