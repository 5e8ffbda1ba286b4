//! Runs: jobs of one kind in the form in which scripts and the page know them, with what is done with their outcome.

mod calibrations;
mod diagnoses;

use std::marker::PhantomData;

pub(crate) use calibrations::Calibrations;
pub(crate) use diagnoses::Diagnoses;
use palpate_jobs::ListFilter;
use palpate_recording::{RecordingError, files::read_text};
use palpate_sim::SensorModel;
use palpate_wire::api::{Job, JobRequest, JobState, Run};
use serde::{Deserialize as _, Serialize, de::DeserializeOwned};

use super::{
    board::Jobs,
    kinds::{HTML_FILE, JobKind, MODEL_FILE, REPORT_FILE},
    tables::Tables,
};
use crate::{Error, data::files};

/// Largest file of a run that is read, bytes: a report of a long session has some megabytes.
const MAX_FILE_BYTES: u64 = 256 << 20;

/// What kinds of runs differ in.
pub(crate) trait RunKind: 'static {
    /// What is asked.
    type Request: Serialize + DeserializeOwned;
    /// What is found.
    type Report: DeserializeOwned;
    /// The kind of job.
    const KIND: &'static JobKind;
    /// Singular, as in messages.
    const WHAT: &'static str;
    /// Where to look, in messages.
    const HINT: &'static str;
}

/// A run of kind `K`.
type RunOf<K> = Run<<K as RunKind>::Request, <K as RunKind>::Report>;

/// The runs of one kind.
pub(crate) struct Runs<'a, K: RunKind> {
    jobs: &'a Jobs,
    kind: PhantomData<K>,
}

impl<'a, K: RunKind> Runs<'a, K> {
    pub(crate) fn of(jobs: &'a Jobs) -> Self {
        Self { jobs, kind: PhantomData }
    }

    /// Checks `request` and queues it for `owner`; says whether it is new. The same `key` again gives the same run again.
    pub(crate) fn start(
        &self,
        request: &K::Request,
        owner: &str,
        key: Option<&str>,
    ) -> Result<(RunOf<K>, bool), Error> {
        let request = JobRequest {
            kind: K::KIND.name.to_owned(),
            request: serde_json::to_value(request).map_err(|err| Error::Internal(err.to_string()))?,
            seed: 0,
            priority: 0,
            resources: None,
            runner: None,
        };
        let submitted = self.jobs.submit(&request, owner, key)?;
        Ok((Self::head(submitted.job)?, submitted.is_new))
    }

    /// Runs, newest first, without what is large: all of them, or a page and where the next one begins.
    pub(crate) fn list(
        &self,
        limit: Option<u32>,
        cursor: Option<String>,
    ) -> Result<(Vec<RunOf<K>>, Option<String>), Error> {
        let scheduler = self.jobs.scheduler();
        let (jobs, next) = match (limit, &cursor) {
            (None, None) => (scheduler.all_of_kind(K::KIND.name)?, None),
            _ => {
                let kind = Some(K::KIND.name.to_owned());
                let page = scheduler.list(&ListFilter { kind, limit, cursor, state: None })?;
                (page.jobs, page.next_cursor)
            }
        };
        let heads = jobs.into_iter().filter_map(|job| {
            let id = job.id.clone();
            Self::head(job).inspect_err(|err| tracing::warn!(id, %err, "left out a run")).ok()
        });
        Ok((heads.collect(), next))
    }

    /// The run called `id`.
    pub(crate) fn get(&self, id: &str) -> Result<RunOf<K>, Error> {
        let mut run = Self::head(self.job(id)?)?;
        if run.state == JobState::Done {
            run.model_toml = self.file(id, MODEL_FILE)?;
            let report = self.file(id, REPORT_FILE)?;
            run.report = report.map(|text| serde_json::from_str(&text)).transpose().map_err(|err| {
                Error::Internal(format!("the report of {} {id:?} cannot be read: {err}", K::WHAT))
            })?;
        }
        Ok(run)
    }

    /// Asks run `id` to stop. One that waits stops at once, one that has ended stays as it is.
    pub(crate) fn cancel(&self, id: &str) -> Result<RunOf<K>, Error> {
        self.job(id)?;
        self.jobs.scheduler().cancel(id)?;
        self.get(id)
    }

    /// The model that run `id` found.
    pub(crate) fn model(&self, id: &str) -> Result<SensorModel, Error> {
        let job = self.job(id)?;
        let text = if job.state == JobState::Done { self.file(id, MODEL_FILE)? } else { None };
        let Some(text) = text else {
            let (what, state) = (K::WHAT, job.state.name());
            return Err(Error::Conflict(format!(
                "{what} {id:?} is {state} and has found no model; wait until it is done, or start another"
            )));
        };
        Ok(SensorModel::from_toml(&format!("model of {} {id}", K::WHAT), &text)?)
    }

    /// The report of run `id` for people.
    pub(crate) fn html(&self, id: &str) -> Result<String, Error> {
        let job = self.job(id)?;
        let html = if job.state == JobState::Done { self.file(id, HTML_FILE)? } else { None };
        html.ok_or_else(|| Error::NotFound {
            what: "report of run",
            id: id.to_owned(),
            hint: "a run has a report once it is done",
        })
    }

    /// The table `name` of the report of run `id`, as CSV.
    pub(crate) fn table(&self, id: &str, name: String) -> Result<String, Error>
    where
        K::Report: Tables,
    {
        let run = self.get(id)?;
        let Some(report) = run.report else {
            let (what, state) = (K::WHAT, run.state.name());
            return Err(Error::Conflict(format!("{what} {id:?} is {state}; it has tables once it is done")));
        };
        let missing = || Err(Error::NotFound { what: "table", id: name.clone(), hint: K::Report::NAMES });
        report.csv(&name).unwrap_or_else(missing)
    }

    /// Notes under which id the model of run `id` was saved.
    fn set_saved_as(&self, id: &str, model: &str) -> Result<(), Error> {
        Ok(self.jobs.scheduler().set_saved_as(id, Some(model))?)
    }

    /// The job that is run `id`.
    fn job(&self, id: &str) -> Result<Job, Error> {
        files::check_id(K::WHAT, id)?;
        let not_found = || Error::NotFound { what: K::WHAT, id: id.to_owned(), hint: K::HINT };
        let job = self.jobs.scheduler().job(id).map_err(|err| match err {
            palpate_jobs::JobsError::NotFound(_) => not_found(),
            other => other.into(),
        })?;
        if job.kind == K::KIND.name { Ok(job) } else { Err(not_found()) }
    }

    /// File `name` of run `id`, if it has one.
    fn file(&self, id: &str, name: &str) -> Result<Option<String>, Error> {
        let path = self.jobs.scheduler().folder(id).file(name);
        match read_text(&path, MAX_FILE_BYTES) {
            Ok(text) => Ok(Some(text)),
            Err(RecordingError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                Ok(None)
            }
            Err(err) => Err(err.into()),
        }
    }

    fn head(job: Job) -> Result<RunOf<K>, Error> {
        let request = K::Request::deserialize(&job.spec.request).map_err(|err| {
            Error::Internal(format!("the request of {} {:?} cannot be read: {err}", K::WHAT, job.id))
        })?;
        Ok(Run {
            id: job.id,
            request,
            state: job.state,
            fraction: job.fraction,
            stage: job.stage,
            seconds_left: job.seconds_left,
            error: job.problem,
            report: None,
            model_toml: None,
            saved_as: job.saved_as,
        })
    }
}
