//! The jobs of a studio: what clients ask for, made into data that a scheduler works off.

use std::{path::Path, sync::Arc};

use palpate_jobs::{Database, Observer, Scheduler, SchedulerConfig, Submission, Submitted, runners};
use palpate_wire::{
    api::{Job, JobChanges, JobRequest, JobSpec},
    proto::JobUpdate,
};

use serde_json::{Map, Value, json};

use super::{kinds, legacy};
use crate::{Error, Hub, Store};

/// The database of a data folder.
pub(crate) const DATABASE_FILE: &str = "palpate.sqlite";

/// Jobs of every kind.
pub(crate) struct Jobs {
    store: Arc<Store>,
    scheduler: Scheduler,
}

impl Jobs {
    /// Opens the jobs of `store`'s folder; what waits is started. `program` is this one, which jobs run as.
    pub(crate) fn open(store: Arc<Store>, hub: Arc<Hub>, program: &Path) -> Result<Self, Error> {
        let root = store.root().canonicalize().map_err(Error::io("open", store.root()))?;
        let database = Arc::new(Database::open(&root.join(DATABASE_FILE))?);
        let observer: Observer = Arc::new(move |job| {
            hub.publish_job(&update_of(job));
            hub.tell_watchers(job);
        });
        legacy::find_again(&store, &database)?;
        legacy::take_over(&store, &database)?;
        let scheduler = Scheduler::start(SchedulerConfig {
            runs: root.join("runs"),
            trash: root.join("trash/runs"),
            database,
            runners: runners(&root, program)?,
            observer,
            cancel_grace: None,
        })?;
        Ok(Self { store, scheduler })
    }

    /// The table itself.
    pub(crate) fn scheduler(&self) -> &Scheduler {
        &self.scheduler
    }

    /// The data folder.
    pub(crate) fn store(&self) -> &Arc<Store> {
        &self.store
    }

    /// Checks `request` and queues it for `owner`. The same `key` with the same request gives the same job again, whatever
    /// has become of it and of the data meanwhile.
    pub(crate) fn submit(
        &self,
        request: &JobRequest,
        owner: &str,
        key: Option<&str>,
    ) -> Result<Submitted, Error> {
        let came = text_of(&json!({ "job": request }))?;
        self.submit_once(key.map(|key| (key, came.as_str())), owner, || Ok(request.clone()))
    }

    /// Queues a job like `id`, but for `changes`, on the data as it is now.
    pub(crate) fn clone_job(
        &self,
        id: &str,
        changes: JobChanges,
        owner: &str,
        key: Option<&str>,
    ) -> Result<Submitted, Error> {
        let came = text_of(&json!({ "clone": id, "changes": changes }))?;
        self.submit_once(key.map(|key| (key, came.as_str())), owner, || {
            let Job { spec, runner, .. } = self.scheduler.job(id)?;
            Ok(JobRequest {
                kind: spec.kind,
                request: changed(spec.request, changes.request),
                seed: changes.seed.unwrap_or(spec.seed),
                priority: changes.priority.unwrap_or(spec.priority),
                resources: Some(changes.resources.unwrap_or(spec.resources)),
                runner: Some(changes.runner.unwrap_or(runner)),
            })
        })
    }

    /// Looks for the job of an earlier request with the same key first: what that job has done may stand in the way of
    /// another one like it.
    fn submit_once(
        &self,
        key: Option<(&str, &str)>,
        owner: &str,
        request: impl FnOnce() -> Result<JobRequest, Error>,
    ) -> Result<Submitted, Error> {
        if let Some((key, came)) = key
            && let Some(job) = self.scheduler.job_of_key(key, came)?
        {
            return Ok(Submitted { job, is_new: false });
        }
        let request = request()?;
        let kind = kinds::kind(&request.kind)?;
        let files = (kind.check)(&self.store, &request.request)?;
        let spec = JobSpec {
            kind: kind.name.to_owned(),
            inputs: self.scheduler.hash_inputs(self.store.root(), &files)?,
            request: request.request,
            seed: request.seed,
            software: super::software(),
            priority: request.priority,
            resources: request.resources.unwrap_or(kind.resources),
        };
        let submission =
            Submission { prefix: kind.prefix, spec: &spec, owner, runner: request.runner.as_deref(), key };
        Ok(self.scheduler.submit(&submission)?)
    }

    /// Where every unfinished job stands, for a client that has just come.
    pub(crate) fn unfinished_updates(&self) -> Result<Vec<JobUpdate>, Error> {
        Ok(self.scheduler.unfinished()?.iter().map(update_of).collect())
    }
}

/// A request as a text; those of equal requests are equal.
fn text_of(request: &Value) -> Result<String, Error> {
    serde_json::to_string(request).map_err(|err| Error::Internal(err.to_string()))
}

/// `request` with other fields.
fn changed(request: Value, fields: Map<String, Value>) -> Value {
    let Value::Object(mut request) = request else { return request };
    for (name, value) in fields {
        match value {
            Value::Null => request.remove(&name),
            value => request.insert(name, value),
        };
    }
    Value::Object(request)
}

fn update_of(job: &Job) -> JobUpdate {
    JobUpdate {
        job: job.id.clone(),
        state: job.state.name().to_owned(),
        fraction: job.fraction,
        stage: job.stage.clone(),
        seconds_left: job.seconds_left.unwrap_or(0.0),
        error: job.problem.clone().unwrap_or_default(),
    }
}
