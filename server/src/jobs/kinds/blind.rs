//! `palpate blind` as a job.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    ops::Range,
    path::{Path, PathBuf},
};

use palpate_blind::{BlindConfig, World, actuator, tactile};
use palpate_jobs::{JobFolder, Shard};
use palpate_wire::api::{BlindDomain, BlindRequest};
use serde_json::Value;

use super::{JobKind, JobWork, LONG, Sharding, check_truth_name, parse, shards};
use crate::{Error, Store, assets};

/// Hides effects in emulated sessions, has them diagnosed, and scores the names.
pub(crate) const BLIND: JobKind = JobKind {
    name: "blind",
    prefix: "blind-",
    resources: LONG,
    needs_trainer: false,
    makes: None,
    sharding: Some(Sharding { parts: "seeds", count, shard, take_over }),
    check,
    work,
};

/// Where answers are kept.
const ANSWERS_FILE: &str = "answers.jsonl";
/// The world of the touch sessions, where the request names none.
const TRUTH: &str = "blind_report";

fn check(_: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: BlindRequest = parse(BLIND.name, request)?;
    if request.seeds == 0 {
        return Err(Error::Argument("seeds = 0: no round, no score; ask for at least 1".to_owned()));
    }
    if let Some(truth) = &request.truth {
        check_truth_name(truth)?;
        assets::truth(Path::new(truth))?;
    }
    Ok(Vec::new())
}

fn count(request: &Value) -> Result<u64, Error> {
    Ok(parse::<BlindRequest>(BLIND.name, request)?.seeds)
}

fn shard(request: &Value, seed: u64, seeds: Range<u64>) -> Result<Shard, Error> {
    let of_all: BlindRequest = parse(BLIND.name, request)?;
    let request = BlindRequest { seeds: seeds.end - seeds.start, ..of_all };
    shards::shard(&request, seed.saturating_add(seeds.start))
}

/// Adds the shard's answers to the job's: those that are there are not asked for again.
fn take_over(cx: &JobWork<'_>, shard: &JobFolder) -> Result<(), Error> {
    let lines = |folder: &JobFolder| -> Result<String, Error> {
        let path = folder.file(ANSWERS_FILE);
        match fs::read_to_string(&path) {
            Err(err) if err.kind() == io::ErrorKind::NotFound => Ok(String::new()),
            text => {
                let mut text = text.map_err(Error::io("read", &path))?;
                // A last line that was cut off in the middle is no answer.
                text.truncate(text.rfind('\n').map_or(0, |end| end + 1));
                Ok(text)
            }
        }
    };
    let (mut all, added) = (lines(cx.folder)?, lines(shard)?);
    let known: BTreeSet<&str> = all.lines().collect();
    let new: String = added.split_inclusive('\n').filter(|line| !known.contains(line.trim_end())).collect();
    if new.is_empty() {
        return Ok(());
    }
    all.push_str(&new);
    cx.save(ANSWERS_FILE, &all)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: BlindRequest = parse(BLIND.name, request)?;
    let config = BlindConfig {
        world: World::A,
        rule_scales: BTreeMap::new(),
        ablation: false,
        references: 0,
        seeds: request.seeds,
        first_seed: cx.seed,
        nulls: request.nulls,
        binary_only: !request.raw_only,
        leave_out: !request.whole_library,
        only: request.only.clone(),
        // An attempt that was cut off goes on where it was.
        answers: Some(cx.folder.file(ANSWERS_FILE)),
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
