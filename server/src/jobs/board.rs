//! The jobs of a studio: what clients ask for, made into data that a scheduler works off.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use palpate_jobs::{
    Database, Observer, Scheduler, SchedulerConfig, StationVariables, Submission, Submitted, runners,
};
use palpate_wire::{
    api::{ArtifactSort, Job, JobChanges, JobKindDocument, JobRequest, JobSpec, JobState},
    proto::JobUpdate,
};

use serde_json::{Map, Value, json};

use super::{kinds, legacy, trainer::Trainer, way_in::WayIn};
use crate::{Error, Hub, Store, data::database::DATABASE_FILE, hub::List};

/// The runner of jobs that have to be on this computer.
const LOCAL_RUNNER: &str = "process";

/// Jobs of every kind.
pub(crate) struct Jobs {
    store: Arc<Store>,
    scheduler: Scheduler,
    trainer: Trainer,
}

/// Where jobs are, and what they are worked on with.
#[derive(Clone, Debug)]
pub struct JobSource<'a> {
    /// The data folder.
    pub data: &'a Path,
    /// The `palpate-train` program, where it is not found by itself.
    pub train: Option<&'a Path>,
}

/// Queues a job in a data folder, whether a studio has it open or not; one that has it open starts it. A job that moves the
/// robot is refused: it begins when the studio itself is asked for it.
pub fn submit_job(source: &JobSource<'_>, request: &JobRequest, owner: &str) -> Result<Job, Error> {
    if kinds::kind(&request.kind)?.resources.station {
        return Err(Error::Argument(format!(
            "a job of kind {:?} moves the robot, so the studio that has it must be asked: at its page, or by POST /api/v1/jobs",
            request.kind
        )));
    }
    let (root, scheduler) = beside_a_studio(source.data, source.train)?;
    let trainer = trainer_of(source.train)?;
    let jobs = Jobs { store: Arc::new(Store::of_job(&root)), scheduler, trainer };
    Ok(jobs.submit(request, owner, None)?.job)
}

/// The path of the data folder `data` and its jobs, for a command that starts none of them.
pub(crate) fn beside_a_studio(data: &Path, train: Option<&Path>) -> Result<(PathBuf, Scheduler), Error> {
    let path = data.join(DATABASE_FILE);
    if !path.is_file() {
        return Err(Error::Argument(format!(
            "{data:?} holds no table of jobs; give the data folder of a studio (--data)"
        )));
    }
    let root = data.canonicalize().map_err(Error::io("open", data))?;
    let database = Arc::new(Database::open(&path)?);
    let config = config_of(&root, database, &trainer_of(train)?, Arc::new(|_| {}), None)?;
    Ok((root, Scheduler::open(config)?))
}

fn trainer_of(train: Option<&Path>) -> Result<Trainer, Error> {
    let palpate = std::env::current_exe().map_err(Error::io("find", "this program"))?;
    Ok(Trainer { configured: train.map(Path::to_owned), palpate: Some(palpate) })
}

/// A scheduler for the data folder `root`.
fn config_of(
    root: &Path,
    database: Arc<Database>,
    trainer: &Trainer,
    observer: Observer,
    station: Option<StationVariables>,
) -> Result<SchedulerConfig, Error> {
    let palpate = trainer.palpate.clone().unwrap_or_else(|| "palpate".into());
    let mut command = vec![palpate, "job".into(), "run".into()];
    if let Some(train) = &trainer.configured {
        command.extend(["--train".into(), train.clone()]);
    }
    Ok(SchedulerConfig {
        runs: root.join("runs"),
        trash: root.join("trash/runs"),
        database,
        runners: runners(root, command, station)?,
        observer,
        cancel_grace: None,
    })
}

/// Id of the session that `job` has just made, if it is of a kind that makes one.
fn session_made_by(job: &Job) -> Option<&str> {
    let makes = kinds::kind(&job.kind).ok()?.makes?;
    let is_made = job.state == JobState::Done && makes == ArtifactSort::Session;
    job.spec.request["session"].as_str().filter(|_| is_made)
}

impl Jobs {
    /// Opens the jobs of `store`'s folder; what waits is started. Jobs on the station come back by `way_in`.
    pub(crate) fn open(
        store: Arc<Store>,
        hub: Arc<Hub>,
        trainer: Trainer,
        way_in: WayIn,
    ) -> Result<Self, Error> {
        let root = store.root().canonicalize().map_err(Error::io("open", store.root()))?;
        let database = Arc::new(Database::open(&root.join(DATABASE_FILE))?);
        let way_in = Arc::new(way_in);
        let station = way_in.variables(database.clone());
        let observer: Observer = Arc::new(move |job| {
            way_in.close(job);
            hub.publish_job(&update_of(job));
            hub.tell_watchers(job);
            if let Some(session) = session_made_by(job) {
                hub.publish_changed(List::Sessions, session);
            }
        });
        legacy::find_again(&store, &database)?;
        legacy::take_over(&store, &database)?;
        let scheduler = Scheduler::start(config_of(&root, database, &trainer, observer, Some(station))?)?;
        Ok(Self { store, scheduler, trainer })
    }

    /// Every kind of job, and whether it can be done on this computer.
    pub(crate) fn kinds(&self) -> Vec<JobKindDocument> {
        let missing = self.trainer.find().err().map(|err| crate::chain(&err));
        let document = |kind: &&kinds::JobKind| {
            let problem = missing.clone().filter(|_| kind.needs_trainer);
            JobKindDocument {
                kind: kind.name.to_owned(),
                resources: kind.resources,
                is_available: problem.is_none(),
                problem,
            }
        };
        kinds::KINDS.iter().map(document).collect()
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
        // Other computers have programs of their own.
        if kind.needs_trainer && self.scheduler.is_local(request.runner.as_deref()) {
            self.trainer.find()?;
        }
        let files = (kind.check)(&self.store, &request.request)?;
        let mut resources = request.resources.unwrap_or(kind.resources);
        // Whoever asks cannot change whether a kind moves the robot.
        resources.station = kind.resources.station;
        let runner = request.runner.as_deref().or(kind.resources.station.then_some(LOCAL_RUNNER));
        if kind.resources.station && !self.scheduler.is_local(runner) {
            return Err(Error::Argument(format!(
                "the station is at this computer; leave out the runner, or give {LOCAL_RUNNER:?}"
            )));
        }
        let shards = kinds::shards(kind, &request.request, request.seed, &resources)?;
        let spec = JobSpec {
            kind: kind.name.to_owned(),
            inputs: self.scheduler.hash_inputs(self.store.root(), &files)?,
            request: request.request,
            seed: request.seed,
            software: super::software(),
            priority: request.priority,
            resources,
        };
        let submission = Submission { prefix: kind.prefix, spec: &spec, shards: &shards, owner, runner, key };
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
