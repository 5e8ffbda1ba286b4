//! Runs: long work that clients start, watch, cancel and come back to. One at a time, each on disk, each reported to the
//! stream. [`Runs`] is the table of one kind of them, [`RunKind`] what the kinds differ in, [`Queue`] the thread that
//! works all of them off.

mod calibrations;
mod diagnoses;
mod queue;

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

pub(crate) use calibrations::Calibrations;
pub(crate) use diagnoses::Diagnoses;
use palpate_calibration::HoldOut;
use palpate_recording::Session;
use palpate_sim::{
    SensorModel,
    job::{Cancel, Progress},
};
use palpate_wire::{
    api::{JobState, Run},
    proto::JobUpdate,
};
pub(crate) use queue::Queue;
use serde::{Serialize, de::DeserializeOwned};

use crate::{
    Class, Error, Hub, Store, chain,
    data::{cache::lock, files, library::Library},
};

/// Progress is published this often at most; a change of state or stage at once.
const UPDATE_PERIOD: Duration = Duration::from_millis(50);

/// Highest number of a run that is listed: nobody starts so many, and the numbers after it must not wrap.
const MAX_NUMBER: u64 = 1_000_000_000_000;

/// What a kind of run does.
pub(crate) trait RunKind: 'static {
    /// What is asked.
    type Request: Clone + Serialize + DeserializeOwned + Send + 'static;
    /// What is found.
    type Report: Clone + Serialize + DeserializeOwned + Send + 'static;
    /// Singular, as in messages.
    const WHAT: &'static str;
    /// Before the number in ids.
    const PREFIX: &'static str;
    /// Where to look, in messages.
    const HINT: &'static str;

    /// Refuses what cannot be done, before it is queued.
    fn check(store: &Store, request: &Self::Request) -> Result<(), Error>;

    /// Does it.
    fn work(cx: &Work<'_>, request: &Self::Request) -> Result<Finished<Self::Report>, Error>;
}

/// What a run works with.
pub(crate) struct Work<'a> {
    pub(crate) store: &'a Store,
    pub(crate) library: &'a Library,
    pub(crate) progress: &'a dyn Progress,
    pub(crate) cancel: &'a Cancel,
}

/// What a run leaves.
pub(crate) struct Finished<R> {
    pub(crate) report: R,
    pub(crate) model: SensorModel,
    /// Other files of the run, by suffix: `html` is the report for people.
    pub(crate) files: Vec<(&'static str, String)>,
}

/// The table of runs of one kind.
pub(crate) struct Runs<K: RunKind> {
    table: Arc<Table<K>>,
    queue: Arc<Queue>,
}

struct Table<K: RunKind> {
    store: Arc<Store>,
    library: Arc<Library>,
    hub: Arc<Hub>,
    /// By number, oldest first. Updates are published while this is locked, so that they leave in the order in which
    /// things happened.
    entries: Mutex<BTreeMap<u64, Entry<K>>>,
}

struct Entry<K: RunKind> {
    run: Run<K::Request, K::Report>,
    cancel: Arc<Cancel>,
}

impl<K: RunKind> Runs<K> {
    /// Reads the runs of `store`.
    pub(crate) fn open(
        store: Arc<Store>,
        library: Arc<Library>,
        hub: Arc<Hub>,
        queue: Arc<Queue>,
    ) -> Result<Self, Error> {
        let mut entries = BTreeMap::new();
        for (id, mut run) in store.runs::<Run<K::Request, K::Report>>(K::PREFIX)? {
            let Some(number) = number_of::<K>(&id).filter(|_| run.id == id) else {
                tracing::warn!(
                    file = id,
                    id = run.id,
                    "left out a run whose file has another name, or a number above {MAX_NUMBER}"
                );
                continue;
            };
            if run.is_unfinished() {
                run.state = JobState::Failed;
                run.error = Some("the studio stopped before this run ended; start it again".to_owned());
                run.seconds_left = None;
                store.save_run(&run.id, &run)?;
            }
            entries.insert(number, Entry { run, cancel: Arc::default() });
        }
        let table = Arc::new(Table { store, library, hub, entries: Mutex::new(entries) });
        Ok(Self { table, queue })
    }

    /// Checks `request` and puts it at the end of the queue.
    pub(crate) fn start(&self, request: K::Request) -> Result<Run<K::Request, K::Report>, Error> {
        K::check(&self.table.store, &request)?;
        let run = {
            let mut entries = lock(&self.table.entries);
            let number = entries.last_key_value().map_or(1, |(number, _)| number + 1);
            if number > MAX_NUMBER {
                return Err(Error::Conflict(format!(
                    "a run has the highest number that there is, {MAX_NUMBER}; take its file out of runs/ and restart the \
                     studio"
                )));
            }
            let run = Run {
                id: format!("{}{number}", K::PREFIX),
                request,
                state: JobState::Queued,
                fraction: 0.0,
                stage: "waiting for other runs".to_owned(),
                seconds_left: None,
                error: None,
                report: None,
                model_toml: None,
                saved_as: None,
            };
            self.table.store.save_run(&run.id, &run)?;
            entries.insert(number, Entry { run: run.clone(), cancel: Arc::default() });
            self.table.hub.publish_job(&update_of(&run));
            run
        };
        let (table, id) = (self.table.clone(), run.id.clone());
        match self.queue.push(Box::new(move || table.work(&id))) {
            Ok(()) => Ok(run),
            Err(err) => {
                self.table.finish(&run.id, JobState::Failed, Some(chain(&err)), None);
                Err(err)
            }
        }
    }

    /// Every run, newest first, without what is large.
    pub(crate) fn list(&self) -> Vec<Run<K::Request, K::Report>> {
        let entries = lock(&self.table.entries);
        let runs = entries.values().rev().map(|entry| {
            let run = &entry.run;
            Run {
                id: run.id.clone(),
                request: run.request.clone(),
                state: run.state,
                fraction: run.fraction,
                stage: run.stage.clone(),
                seconds_left: run.seconds_left,
                error: run.error.clone(),
                report: None,
                model_toml: None,
                saved_as: run.saved_as.clone(),
            }
        });
        runs.collect()
    }

    /// The run called `id`.
    pub(crate) fn get(&self, id: &str) -> Result<Run<K::Request, K::Report>, Error> {
        self.table.with(id, |entry| entry.run.clone())
    }

    /// Asks run `id` to stop. One that waits stops at once, one that has ended stays as it is.
    pub(crate) fn cancel(&self, id: &str) -> Result<Run<K::Request, K::Report>, Error> {
        let state = self.table.with(id, |entry| {
            entry.cancel.cancel();
            entry.run.state
        })?;
        if state == JobState::Queued {
            self.table.finish(id, JobState::Cancelled, None, None);
        }
        self.get(id)
    }

    /// The model that run `id` found.
    pub(crate) fn model(&self, id: &str) -> Result<SensorModel, Error> {
        let run = self.get(id)?;
        let Some(text) = run.model_toml else {
            let (what, state) = (K::WHAT, state_name(run.state));
            return Err(Error::Conflict(format!(
                "{what} {id:?} is {state} and has found no model; wait until it is done, or start another"
            )));
        };
        Ok(SensorModel::from_toml(&format!("model of {} {id}", K::WHAT), &text)?)
    }

    /// The report of run `id` for people.
    pub(crate) fn html(&self, id: &str) -> Result<String, Error> {
        self.get(id)?;
        self.table.store.run_file(id, "html")?.ok_or_else(|| Error::NotFound {
            what: "report of run",
            id: id.to_owned(),
            hint: "a run has a report once it is done",
        })
    }

    /// Notes under which id the model of run `id` was saved; `None` takes the note back.
    fn set_saved_as(&self, id: &str, model: Option<&str>) -> Result<(), Error> {
        let run = self.table.with(id, |entry| {
            entry.run.saved_as = model.map(str::to_owned);
            entry.run.clone()
        })?;
        self.table.store.save_run(id, &run)
    }

    /// Forgets that runs were saved as `model` (`by` names one of them, `None` all), because that was undone.
    pub(crate) fn forget_saved(&self, model: &str, by: Option<&str>) -> Result<(), Error> {
        let mut changed = Vec::new();
        for entry in lock(&self.table.entries).values_mut() {
            let meant = by.is_none_or(|by| by == entry.run.id);
            if meant && entry.run.saved_as.as_deref() == Some(model) {
                entry.run.saved_as = None;
                changed.push(entry.run.clone());
            }
        }
        changed.iter().try_for_each(|run| self.table.store.save_run(&run.id, run))
    }

    /// Where every unfinished run stands, for a client that has just come.
    pub(crate) fn unfinished_updates(&self) -> Vec<JobUpdate> {
        let entries = lock(&self.table.entries);
        let unfinished = entries.values().filter(|entry| entry.run.is_unfinished());
        unfinished.map(|entry| update_of(&entry.run)).collect()
    }

    /// Asks everything to stop, because the server does.
    pub(crate) fn cancel_all(&self) {
        for entry in lock(&self.table.entries).values() {
            entry.cancel.cancel();
        }
    }
}

impl<K: RunKind> Table<K> {
    /// Does run `id`, on the queue's thread, unless it was cancelled while it waited.
    fn work(&self, id: &str) {
        let started = self.with(id, |entry| {
            if entry.run.state != JobState::Queued || entry.cancel.is_cancelled() {
                return None;
            }
            entry.run.state = JobState::Running;
            entry.run.stage = "reading the session".to_owned();
            self.hub.publish_job(&update_of(&entry.run));
            Some((entry.run.request.clone(), entry.cancel.clone()))
        });
        let Ok(Some((request, cancel))) = started else { return };
        let progress = RunProgress { table: self, id, start: Instant::now(), last: Mutex::default() };
        let cx = Work { store: &self.store, library: &self.library, progress: &progress, cancel: &cancel };
        // A fault in one run must not end the thread that all of them need.
        let result = catch_unwind(AssertUnwindSafe(|| {
            let finished = K::work(&cx, &request)?;
            for (suffix, text) in &finished.files {
                self.store.save_run_file(id, suffix, text)?;
            }
            Ok(finished)
        }));
        let result =
            result.unwrap_or_else(|_| Err(Error::Internal(format!("the {} panicked; see the log", K::WHAT))));
        match result {
            Ok(finished) => self.finish(id, JobState::Done, None, Some(finished)),
            Err(err) if err.class() == Class::Cancelled => self.finish(id, JobState::Cancelled, None, None),
            Err(err) => self.finish(id, JobState::Failed, Some(chain(&err)), None),
        }
    }

    /// Records how run `id` ended, unless it has ended already.
    fn finish(
        &self,
        id: &str,
        state: JobState,
        error: Option<String>,
        finished: Option<Finished<K::Report>>,
    ) {
        let ended = self.with(id, |entry| {
            let run = &mut entry.run;
            if !run.is_unfinished() {
                return None;
            }
            run.state = state;
            run.stage = state_name(state).to_owned();
            run.seconds_left = None;
            run.error = error;
            if let Some(finished) = finished {
                run.fraction = 1.0;
                run.model_toml = Some(finished.model.to_toml());
                run.report = Some(finished.report);
            }
            self.hub.publish_job(&update_of(run));
            Some(run.clone())
        });
        let Ok(Some(run)) = ended else { return };
        if let Err(err) = self.store.save_run(id, &run) {
            tracing::error!(run = id, err = chain(&err), "a run is lost at the next start");
        }
        if let Some(error) = &run.error {
            tracing::warn!(run = id, error, "{} failed", K::WHAT);
        }
    }

    fn with<T>(&self, id: &str, read: impl FnOnce(&mut Entry<K>) -> T) -> Result<T, Error> {
        files::check_id(K::WHAT, id)?;
        let mut entries = lock(&self.entries);
        // The id of number 7 is run-7 and not run-07.
        let entry = number_of::<K>(id).and_then(|number| entries.get_mut(&number));
        entry.filter(|entry| entry.run.id == id).map(read).ok_or_else(|| Error::NotFound {
            what: K::WHAT,
            id: id.to_owned(),
            hint: K::HINT,
        })
    }
}

struct RunProgress<'a, K: RunKind> {
    table: &'a Table<K>,
    id: &'a str,
    start: Instant,
    /// When and at which stage progress was last published.
    last: Mutex<Option<(Instant, String)>>,
}

impl<K: RunKind> Progress for RunProgress<'_, K> {
    fn report(&self, fraction: f64, stage: &str) {
        let fraction = fraction.clamp(0.0, 1.0);
        let elapsed_s = self.start.elapsed().as_secs_f64();
        // A run that ended while another thread reported is not there to be updated; nobody need know.
        let _ = self.table.with(self.id, |entry| {
            let run = &mut entry.run;
            // Reports of several threads may overtake each other; the bar never goes back.
            run.fraction = run.fraction.max(fraction);
            run.stage = stage.to_owned();
            run.seconds_left = (run.fraction > 0.05).then(|| elapsed_s / run.fraction * (1.0 - run.fraction));
            let mut last = lock(&self.last);
            let due = last
                .as_ref()
                .is_none_or(|(when, last_stage)| when.elapsed() >= UPDATE_PERIOD || last_stage != stage);
            if due {
                *last = Some((Instant::now(), stage.to_owned()));
                self.table.hub.publish_job(&update_of(run));
            }
        });
    }
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

fn number_of<K: RunKind>(id: &str) -> Option<u64> {
    id.strip_prefix(K::PREFIX)?.parse().ok().filter(|&number| number <= MAX_NUMBER)
}

fn state_name(state: JobState) -> &'static str {
    match state {
        JobState::Queued => "queued",
        JobState::Running => "running",
        JobState::Done => "done",
        JobState::Failed => "failed",
        JobState::Cancelled => "cancelled",
    }
}

fn update_of<Q, R>(run: &Run<Q, R>) -> JobUpdate {
    JobUpdate {
        job: run.id.clone(),
        state: state_name(run.state).to_owned(),
        fraction: run.fraction,
        stage: run.stage.clone(),
        seconds_left: run.seconds_left.unwrap_or(0.0),
        error: run.error.clone().unwrap_or_default(),
    }
}
