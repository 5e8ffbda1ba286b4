//! Jobs that the database does not know.
//!
//! Runs of before there was a database are one JSON document each, `runs/ID.json`, with other files beside it by
//! suffix. They are taken over once, as folders and rows; the documents stay in those folders. Where the database was
//! lost, jobs are found again by their folders.

use std::{
    fs,
    path::{Path, PathBuf},
};

use palpate_jobs::{Database, JobFolder, ListFilter, rfc3339_now};
use palpate_wire::api::{Job, JobSpec, JobState, Resources, Run};
use serde_json::Value;

use super::kinds::{self, HTML_FILE, JobKind, KINDS, MODEL_FILE, REPORT_FILE};
use crate::{
    Error, Store, chain,
    data::{files, store::RunFile},
};

/// Highest number of a run that is taken over: nobody starts so many, and the numbers after it must not wrap.
const MAX_NUMBER: u64 = 1_000_000_000_000;

/// Files of a run beside its document, by suffix, and what they are called now.
const OTHER_FILES: &[(&str, &str)] =
    &[("html", HTML_FILE), ("calibrated.toml", kinds::CALIBRATED_FILE), ("base.toml", kinds::BASE_FILE)];

/// Takes over every run of before that can be read. Stopped in the middle, it goes on at the next start.
pub(super) fn take_over(store: &Store, database: &Database) -> Result<(), Error> {
    for RunFile { id, path, text } in store.run_documents()? {
        let taken = text.and_then(|text| {
            let (kind, number) = kind_of(&id).ok_or_else(|| {
                Error::Content(format!("{id:?} is no id of a run, or its number is above {MAX_NUMBER}"))
            })?;
            let run: Run<Value, Value> =
                serde_json::from_str(&text).map_err(|err| Error::Content(err.to_string()))?;
            if run.id != id {
                return Err(Error::Content(format!(
                    "its file is called {id:?}, and it calls itself {:?}",
                    run.id
                )));
            }
            take_over_one(store, database, &path, kind, number, run)
        });
        if let Err(err) = taken {
            tracing::warn!(path = %path.display(), err = chain(&err), "left out a run");
        }
    }
    Ok(())
}

/// Fills a database that knows no job from the folders of jobs. What had not ended is shown as failed.
pub(super) fn find_again(store: &Store, database: &Database) -> Result<(), Error> {
    let any = ListFilter { limit: Some(1), ..ListFilter::default() };
    if !database.list(&any)?.jobs.is_empty() {
        return Ok(());
    }
    for (id, path) in store.run_folders()? {
        let Some((kind, number)) = kind_of(&id) else { continue };
        let folder = JobFolder::at(&path);
        let document = folder.file("taken-over.json");
        if document.is_file() {
            // It is taken over once more.
            let before = store.root().join("runs").join(format!("{id}.json"));
            fs::rename(&document, &before).map_err(Error::io("move", &document))?;
            continue;
        }
        let spec = match folder.spec() {
            Ok(spec) => spec,
            Err(err) => {
                tracing::warn!(path = %path.display(), err = chain(&err), "left out the folder of a job");
                continue;
            }
        };
        let exit = folder.last_exit();
        let state = exit.as_ref().map_or(JobState::Failed, |exit| exit.outcome);
        let lost = "it had not ended when the database was lost; try it again".to_owned();
        let job = Job {
            id: id.clone(),
            kind: kind.name.to_owned(),
            state,
            created: exit.as_ref().map_or_else(rfc3339_now, |exit| exit.started.clone()),
            started: exit.as_ref().map(|exit| exit.started.clone()),
            ended: Some(exit.as_ref().map_or_else(rfc3339_now, |exit| exit.ended.clone())),
            attempts: folder.attempt()?,
            owner: String::new(),
            runner: "process".to_owned(),
            fraction: if state == JobState::Done { 1.0 } else { 0.0 },
            stage: state.name().to_owned(),
            seconds_left: None,
            problem: exit.as_ref().map_or(Some(lost), |exit| exit.problem.clone()),
            cancel_requested: state == JobState::Cancelled,
            saved_as: None,
            spec,
        };
        database.adopt(kind.prefix, number, &job)?;
        tracing::info!(job = id, "a job was found again by its folder");
    }
    Ok(())
}

fn kind_of(id: &str) -> Option<(&'static JobKind, u64)> {
    KINDS.iter().find_map(|kind| {
        let number: u64 = id.strip_prefix(kind.prefix)?.parse().ok()?;
        // The id of number 7 is run-7 and not run-07.
        (number <= MAX_NUMBER && format!("{}{number}", kind.prefix) == id).then_some((*kind, number))
    })
}

fn take_over_one(
    store: &Store,
    database: &Database,
    document: &Path,
    kind: &JobKind,
    number: u64,
    run: Run<Value, Value>,
) -> Result<(), Error> {
    let was_cut_off = run.is_unfinished();
    let state = if was_cut_off { JobState::Failed } else { run.state };
    let problem = match was_cut_off {
        true => Some("the studio stopped before this run ended; start it again".to_owned()),
        false => run.error.clone(),
    };
    let spec = JobSpec {
        kind: kind.name.to_owned(),
        request: run.request,
        inputs: Default::default(),
        seed: 0,
        software: "palpate".to_owned(),
        priority: 0,
        resources: Resources { ..kind.resources },
    };
    let runs: PathBuf = store.root().join("runs");
    let folder = JobFolder::at(runs.join(&run.id));
    folder.create(&spec, &[])?;
    if let Some(report) = &run.report {
        files::write(&folder.file(REPORT_FILE), report.to_string().as_bytes())?;
    }
    if let Some(model) = &run.model_toml {
        files::write(&folder.file(MODEL_FILE), model.as_bytes())?;
    }
    let others = OTHER_FILES.iter().map(|(suffix, name)| (runs.join(format!("{}.{suffix}", run.id)), *name));
    for (path, name) in others {
        // Moved already, where this was stopped in the middle.
        if path.symlink_metadata().is_ok_and(|meta| meta.is_file()) {
            fs::rename(&path, folder.file(name)).map_err(Error::io("move", &path))?;
        }
    }
    let modified = fs::metadata(document).and_then(|meta| meta.modified()).ok();
    let time = modified.map_or_else(rfc3339_now, palpate_jobs::rfc3339);
    let job = Job {
        id: run.id,
        kind: kind.name.to_owned(),
        state,
        created: time.clone(),
        started: None,
        ended: Some(time),
        attempts: 1,
        owner: String::new(),
        runner: "process".to_owned(),
        fraction: run.fraction,
        stage: state.name().to_owned(),
        seconds_left: None,
        problem,
        cancel_requested: state == JobState::Cancelled,
        saved_as: run.saved_as,
        spec,
    };
    database.adopt(kind.prefix, number, &job)?;
    // Last, so that whatever is stopped before is done again.
    fs::rename(document, folder.file("taken-over.json")).map_err(Error::io("move", document))
}
