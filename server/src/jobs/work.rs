//! A job in a process of its own: `palpate job run`.

use std::{path::Path, process::ExitCode, sync::Arc};

use palpate_jobs::{Begun, JobFolder, Outcome, Working, WorkingConfig, check_inputs, on_stop_request};
use palpate_sim::job::{Cancel, Progress};

use super::{
    kinds::{self, JobWork},
    trainer::Trainer,
};
use crate::{Class, Error, Store, chain, data::library::Library};

/// Works on the job, or the shard of one, in the folder `dir`, which lies in `runs/` of a data folder; gives the exit
/// code of the process. How it went stands in the folder.
/// `train` is the `palpate-train` program, where it is not found by itself.
pub fn run_job(dir: &Path, config: WorkingConfig, train: Option<&Path>) -> Result<ExitCode, Error> {
    let dir = dir.canonicalize().map_err(Error::io("open", dir))?;
    let folder = JobFolder::at(&dir);
    let job = folder.job_of_shard().unwrap_or_else(|| folder.clone());
    let root = job.path().parent().and_then(Path::parent).ok_or_else(|| {
        Error::Argument(format!("{dir:?} is no folder of a job; those lie in runs/ of a data folder"))
    })?;
    let cancel = Arc::new(Cancel::default());
    let asked = cancel.clone();
    on_stop_request(move || asked.cancel())?;
    let working = match Working::begin(folder, config)? {
        Begun::Mine(working) => working,
        Begun::NotMine(code) => return Ok(code),
    };
    let store = Store::of_job(root);
    let trainer = Trainer { configured: train.map(Path::to_owned), palpate: std::env::current_exe().ok() };
    let outcome = match work(&working, &store, &trainer, &cancel) {
        Ok(()) => Outcome::Done,
        Err(err) if err.class() == Class::Cancelled => Outcome::Cancelled,
        Err(err) => {
            // With its paths, for the log; who asks for the job knows sessions and files by their names.
            eprintln!("error: {}", chain(&err));
            let code = err.exit_code();
            Outcome::Failed { problem: chain(&store.for_client(err)), code }
        }
    };
    Ok(working.end(outcome)?)
}

fn work(working: &Working, store: &Store, trainer: &Trainer, cancel: &Cancel) -> Result<(), Error> {
    let spec = working.spec();
    let kind = kinds::kind(&spec.kind)?;
    check_inputs(spec, store.root())?;
    let cx = JobWork {
        store,
        library: &Library::default(),
        folder: working.folder(),
        seed: spec.seed,
        gpu: spec.resources.gpu,
        trainer,
        metrics: &|point| working.metrics(point),
        progress: &Reporting(working),
        cancel,
    };
    kinds::take_over(&cx, kind, spec)?;
    (kind.work)(&cx, &spec.request)
}

struct Reporting<'a>(&'a Working);

impl Progress for Reporting<'_> {
    fn report(&self, fraction: f64, stage: &str) {
        self.0.report(fraction, stage);
    }
}
