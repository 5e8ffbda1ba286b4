//! The kinds of jobs: one file each, one line in [`KINDS`].

mod blind;
mod calibrate;
mod comparison;
mod demonstrations;
mod diagnose;
mod emulate;
mod evaluation;
mod expert;
mod gathering;
mod imitation;
mod names;
mod pipeline;
mod pretraining;
mod rollouts;
mod shards;
mod training;
mod tune;

use std::path::PathBuf;

use palpate_calibration::HoldOut;
use palpate_jobs::JobFolder;
use palpate_recording::Session;
use palpate_sim::job::{Cancel, Progress};
use palpate_wire::api::{ArtifactSort, Resources};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;

pub(crate) use calibrate::CALIBRATE;
pub(crate) use diagnose::{BASE_FILE, CALIBRATED_FILE, DIAGNOSE};
pub(crate) use shards::{Sharding, shards, take_over};

use super::trainer::Trainer;
use crate::{
    Error, Store,
    data::{files, library::Library},
};

/// Every kind that there is.
pub(crate) const KINDS: &[&JobKind] = &[
    &CALIBRATE,
    &DIAGNOSE,
    &blind::BLIND,
    &emulate::EMULATE,
    &tune::TUNE,
    &expert::EXPERT,
    &evaluation::EVALUATION,
    &demonstrations::DEMONSTRATIONS,
    &pretraining::PRETRAINING,
    &gathering::GATHERING,
    &imitation::IMITATION,
    &pipeline::PIPELINE,
    &rollouts::ROLLOUTS,
    &comparison::COMPARISON,
];

/// The numbers that a job found.
pub(crate) const REPORT_FILE: &str = "report.json";
/// The same for people.
pub(crate) const HTML_FILE: &str = "report.html";
/// The sensor model that a job found.
pub(crate) const MODEL_FILE: &str = "model.toml";

/// A kind of job.
pub(crate) struct JobKind {
    /// As requests name it.
    pub(crate) name: &'static str,
    /// Before the number in ids.
    pub(crate) prefix: &'static str,
    /// What it needs of the machine.
    pub(crate) resources: Resources,
    /// Whether `palpate-train` does the work.
    pub(crate) needs_trainer: bool,
    /// What it makes, if that is an artifact of its own.
    pub(crate) makes: Option<ArtifactSort>,
    /// How its jobs are divided, if they can be.
    pub(crate) sharding: Option<Sharding>,
    /// Refuses what cannot be done, before it is queued; gives the files that the job will read.
    pub(crate) check: fn(&Store, &Value) -> Result<Vec<PathBuf>, Error>,
    /// Does it, and leaves the results as files of the job's folder.
    pub(crate) work: fn(&JobWork<'_>, &Value) -> Result<(), Error>,
}

/// What a job works with.
#[derive(Clone, Copy)]
pub(crate) struct JobWork<'a> {
    pub(crate) store: &'a Store,
    pub(crate) library: &'a Library,
    pub(crate) folder: &'a JobFolder,
    pub(crate) seed: u64,
    /// Whether the graphics card is this job's.
    pub(crate) gpu: bool,
    pub(crate) trainer: &'a Trainer,
    pub(crate) progress: &'a dyn Progress,
    /// Adds a point to the curves: an object of numbers by name, `step` among them.
    pub(crate) metrics: &'a dyn Fn(&Value),
    pub(crate) cancel: &'a Cancel,
}

/// Seconds of work at most, as a rule.
const SHORT: Resources =
    Resources { cores: 0, gpu: false, station: false, memory_mib: None, short: true, shards: 0, at_once: 0 };
/// Minutes of work on every core.
const LONG: Resources = Resources { short: false, ..SHORT };

/// The kind called `name`.
pub(crate) fn kind(name: &str) -> Result<&'static JobKind, Error> {
    KINDS.iter().copied().find(|kind| kind.name == name).ok_or_else(|| {
        let known: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
        Error::Argument(format!("no kind of job {name:?}; there are {}", known.join(", ")))
    })
}

impl JobWork<'_> {
    /// Leaves the numbers.
    fn save_report(&self, report: &impl Serialize) -> Result<(), Error> {
        let json = serde_json::to_vec(report).map_err(|err| Error::Internal(err.to_string()))?;
        files::write(&self.folder.file(REPORT_FILE), &json)
    }

    /// Leaves a text as file `name`.
    fn save(&self, name: &str, text: &str) -> Result<(), Error> {
        files::write(&self.folder.file(name), text.as_bytes())
    }
}

/// A request in the form of its kind.
fn parse<T: DeserializeOwned>(kind: &str, request: &Value) -> Result<T, Error> {
    T::deserialize(request).map_err(|err| Error::Content(format!("request of a job of kind {kind:?}: {err}")))
}

/// Everything that a job on `session` reads: its file and the takes that were accepted.
fn files_of(session: &Session) -> Vec<PathBuf> {
    let accepted = session.file.takes.iter().filter(|take| take.accepted);
    let takes = accepted.map(|take| session.take_path(take)).filter(|path| path.is_file());
    std::iter::once(session.dir.join("session.toml")).chain(takes).collect()
}

/// Takes of `session` to hold out, or why they cannot be.
fn hold_out(ids: Option<&[String]>, session: &Session) -> Result<HoldOut, Error> {
    let Some(ids) = ids else { return Ok(HoldOut::Auto) };
    for id in ids {
        if !session.file.takes.iter().any(|take| take.id() == id) {
            let takes: Vec<&str> = session.file.takes.iter().map(|take| take.id()).collect();
            return Err(Error::Argument(format!(
                "no take {id:?} to hold out in session {:?}; its takes are {}",
                session.id,
                takes.join(", ")
            )));
        }
    }
    Ok(HoldOut::Takes(ids.to_vec()))
}

/// Refuses anything but the name of a truth file that the binary carries: a request must not name files of this
/// computer.
fn check_truth_name(name: &str) -> Result<(), Error> {
    if name.contains(['/', '\\', '.']) {
        return Err(Error::Argument(format!(
            "{name:?} is no name of a shipped truth file; give one such as \"demo\" or \"bench\""
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn names_and_prefixes_tell_kinds_apart() {
        let names: BTreeSet<&str> = KINDS.iter().map(|kind| kind.name).collect();
        let prefixes: BTreeSet<&str> = KINDS.iter().map(|kind| kind.prefix).collect();
        assert_eq!((names.len(), prefixes.len()), (KINDS.len(), KINDS.len()));
        for kind in KINDS {
            assert!(
                kind.prefix.ends_with('-') && files::check_id("job", kind.prefix).is_ok(),
                "{}",
                kind.prefix
            );
            assert_eq!(super::kind(kind.name).unwrap().prefix, kind.prefix);
        }
        let err = super::kind("dance").err().unwrap().to_string();
        assert!(err.contains("dance") && err.contains("calibrate"), "{err}");
    }
}
