//! Jobs of every kind as the page knows them.

use std::{collections::BTreeMap, sync::Arc};

use palpate_wire::{
    api::{ComparisonReport, Job, JobKindDocument, JobPage, JobRequest, JobState},
    proto::JobUpdate,
};

use super::{Loadable, ask, curves::Curves, parse_json, reset, shared};
use crate::api_client::{JobAct, Request};

/// The newest jobs, older ones as far as they were asked for, and the log of those that were opened.
#[derive(Debug, Default)]
pub struct JobTable {
    list: Loadable<Arc<Vec<Job>>>,
    next_cursor: Option<String>,
    logs: BTreeMap<String, Loadable<Arc<String>>>,
    curves: BTreeMap<String, Loadable<Arc<Curves>>>,
    comparisons: BTreeMap<String, Loadable<Arc<ComparisonReport>>>,
    kinds: Loadable<Arc<Vec<JobKindDocument>>>,
    /// A job that was started or cloned: the new one's id once the server took it.
    pub cloned: Loadable<String>,
    /// Why the last thing that was done with a job did not work; `None` when all is well.
    pub problem: Option<String>,
    outbox: Vec<Request>,
}

impl JobTable {
    /// Jobs, newest first.
    pub fn list(&mut self) -> Loadable<Arc<Vec<Job>>> {
        ask(&mut self.list, &mut self.outbox, || Request::Jobs(None))
    }

    /// Whether there are older jobs than those that are known.
    pub fn has_more(&self) -> bool {
        self.next_cursor.is_some()
    }

    /// Asks for older jobs.
    pub fn ask_for_more(&mut self) {
        if let Some(cursor) = self.next_cursor.take() {
            self.outbox.push(Request::Jobs(Some(cursor)));
        }
    }

    /// What the process of job `id` printed.
    pub fn log(&mut self, id: &str) -> Loadable<Arc<String>> {
        let slot = self.logs.entry(id.to_owned()).or_default();
        ask(slot, &mut self.outbox, || Request::JobLog(id.to_owned()))
    }

    /// Asks for the log of job `id` again. What is known of it stays on the page until then.
    pub fn ask_log_again(&mut self, id: &str) {
        self.outbox.push(Request::JobLog(id.to_owned()));
    }

    /// The curves of job `id`.
    pub fn curves(&mut self, id: &str) -> Loadable<Arc<Curves>> {
        let slot = self.curves.entry(id.to_owned()).or_default();
        ask(slot, &mut self.outbox, || Request::JobMetrics(id.to_owned()))
    }

    /// Asks for the curves of job `id` again. What is known of them stays on the page until then.
    pub fn ask_curves_again(&mut self, id: &str) {
        self.outbox.push(Request::JobMetrics(id.to_owned()));
    }

    /// What job `id` of kind `comparison` found, once it is done.
    pub fn comparison(&mut self, id: &str) -> Loadable<Arc<ComparisonReport>> {
        let slot = self.comparisons.entry(id.to_owned()).or_default();
        ask(slot, &mut self.outbox, || Request::ComparisonReport(id.to_owned()))
    }

    /// The kinds of jobs, and which of them the studio can do.
    pub fn kinds(&mut self) -> Loadable<Arc<Vec<JobKindDocument>>> {
        ask(&mut self.kinds, &mut self.outbox, || Request::Kinds)
    }

    /// Starts a job.
    pub fn submit(&mut self, request: JobRequest) {
        self.problem = None;
        self.cloned = Loadable::Loading;
        self.outbox.push(Request::SubmitJob(request));
    }

    /// Does something with job `id`.
    pub fn act(&mut self, id: &str, act: JobAct) {
        self.problem = None;
        if act == JobAct::Clone {
            self.cloned = Loadable::Loading;
        }
        self.outbox.push(Request::ActOnJob { job: id.to_owned(), act });
    }

    pub(super) fn take_outbox(&mut self) -> Vec<Request> {
        std::mem::take(&mut self.outbox)
    }

    pub(super) fn receive_list(&mut self, cursor: Option<String>, result: Result<Vec<u8>, String>) {
        match parse_json::<JobPage>(result) {
            Loadable::Ready(page) => {
                self.next_cursor = page.next_cursor;
                let mut jobs: Vec<Job> = match (&self.list, cursor) {
                    (Loadable::Ready(known), Some(_)) => known.to_vec(),
                    _ => Vec::new(),
                };
                jobs.extend(page.jobs);
                self.list = Loadable::Ready(Arc::new(jobs));
            }
            Loadable::Failed(error) if cursor.is_some() => {
                // The list stays; it can be asked for its rest again.
                self.next_cursor = cursor;
                self.problem = Some(error);
            }
            Loadable::Failed(error) => self.list = Loadable::Failed(error),
            Loadable::Idle | Loadable::Loading => {}
        }
    }

    pub(super) fn receive_job(&mut self, result: Result<Vec<u8>, String>) {
        let Loadable::Ready(job) = parse_json::<Job>(result) else { return };
        self.put(job);
    }

    pub(super) fn receive_log(&mut self, id: String, result: Result<Vec<u8>, String>) {
        let text = result.map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
        self.logs.insert(id, shared(Loadable::from_result(text)));
    }

    pub(super) fn receive_metrics(&mut self, id: String, result: Result<Vec<u8>, String>) {
        let curves = result.map(|bytes| Curves::parse(&String::from_utf8_lossy(&bytes)));
        self.curves.insert(id, shared(Loadable::from_result(curves)));
    }

    pub(super) fn receive_comparison(&mut self, id: String, result: Result<Vec<u8>, String>) {
        self.comparisons.insert(id, shared(parse_json(result)));
    }

    pub(super) fn receive_kinds(&mut self, result: Result<Vec<u8>, String>) {
        self.kinds = shared(parse_json(result));
    }

    pub(super) fn receive_submitted(&mut self, result: Result<Vec<u8>, String>) {
        match parse_json::<Job>(result) {
            Loadable::Ready(job) => {
                self.cloned = Loadable::Ready(job.id.clone());
                self.put(job);
            }
            Loadable::Failed(error) => {
                self.cloned = Loadable::Idle;
                self.problem = Some(error);
                // What is missing may have changed since it was asked.
                self.outbox.push(Request::Kinds);
            }
            Loadable::Idle | Loadable::Loading => {}
        }
    }

    pub(super) fn receive_acted(&mut self, id: String, act: JobAct, result: Result<Vec<u8>, String>) {
        match (act, result) {
            (JobAct::Delete, Ok(_)) => {
                if let Loadable::Ready(jobs) = &mut self.list {
                    Arc::make_mut(jobs).retain(|job| job.id != id);
                }
            }
            (JobAct::Clone, result) => self.receive_submitted(result),
            (_, Ok(body)) => self.receive_job(Ok(body)),
            (_, Err(error)) => self.problem = Some(error),
        }
    }

    /// Takes in how a job gets on.
    pub(super) fn update(&mut self, state: JobState, update: &JobUpdate) {
        let Loadable::Ready(jobs) = &mut self.list else { return };
        let known = Arc::make_mut(jobs).iter_mut().find(|job| job.id == update.job);
        let is_finished = !matches!(state, JobState::Queued | JobState::Running);
        match known {
            Some(job) if job.state == state && !is_finished => {
                job.fraction = update.fraction;
                job.stage.clone_from(&update.stage);
                job.seconds_left = Some(update.seconds_left).filter(|seconds| *seconds > 0.0);
            }
            // It is new here, or its times have changed: the server knows the rest.
            _ => self.outbox.push(Request::Job(update.job.clone())),
        }
    }

    pub(super) fn retry_failed(&mut self) {
        reset(&mut self.list);
        self.logs.values_mut().for_each(reset);
        self.curves.values_mut().for_each(reset);
        self.comparisons.values_mut().for_each(reset);
        reset(&mut self.kinds);
    }

    /// Asks for everything again that may have changed while nobody listened.
    pub(super) fn refresh(&mut self) {
        if self.kinds.ready().is_some() {
            self.outbox.push(Request::Kinds);
        }
        if self.list.ready().is_some() {
            self.outbox.push(Request::Jobs(None));
        }
    }

    fn put(&mut self, job: Job) {
        let Loadable::Ready(jobs) = &mut self.list else { return };
        let jobs = Arc::make_mut(jobs);
        match jobs.iter_mut().find(|known| known.id == job.id) {
            Some(known) => {
                if known.is_unfinished() && !job.is_unfinished() {
                    // What it said last.
                    if self.logs.contains_key(&job.id) {
                        self.outbox.push(Request::JobLog(job.id.clone()));
                    }
                    if self.curves.contains_key(&job.id) {
                        self.outbox.push(Request::JobMetrics(job.id.clone()));
                    }
                }
                *known = job;
            }
            None => jobs.insert(0, job),
        }
    }
}
