//! Calibration runs: one at a time, each on disk, each reported to the stream.

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Mutex,
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use palpate_calibration::{CalibrationConfig, HoldOut, Method};
use palpate_recording::Session;
use palpate_sim::{
    SensorModel,
    job::{Cancel, Progress},
};
use palpate_wire::{
    api::{CalibrationRequest, CalibrationRun, JobState, ModelSummary},
    proto::JobUpdate,
};

use crate::{
    Class, Error, Hub, Store,
    cache::lock,
    chain, files,
    jobs::{CalibrationArtifacts, calibrate_session},
    library::Library,
};

/// Runs that may wait.
const MAX_QUEUED: usize = 32;
/// Progress is published this often at most; a change of state or stage at once.
const UPDATE_PERIOD: Duration = Duration::from_millis(50);

/// The table of runs, with the thread that works them off. A run uses every core, so they take turns.
pub(crate) struct Runs {
    table: Arc<Table>,
    queue: SyncSender<String>,
}

struct Table {
    store: Arc<Store>,
    library: Arc<Library>,
    hub: Arc<Hub>,
    /// By number, oldest first. Updates are published while this is locked, so that they leave in the order in which
    /// things happened.
    entries: Mutex<BTreeMap<u64, Entry>>,
}

struct Entry {
    run: CalibrationRun,
    cancel: Arc<Cancel>,
}

impl Runs {
    /// Reads the runs of `store` and starts to wait for more.
    pub(crate) fn open(store: Arc<Store>, library: Arc<Library>, hub: Arc<Hub>) -> Result<Self, Error> {
        let mut entries = BTreeMap::new();
        for mut run in store.runs()? {
            let Some(number) = number_of(&run.id) else { continue };
            if is_unfinished(run.state) {
                run.state = JobState::Failed;
                run.error = Some("the studio stopped before this run ended; start it again".to_owned());
                run.seconds_left = None;
                store.save_run(&run)?;
            }
            entries.insert(number, Entry { run, cancel: Arc::default() });
        }
        let table = Arc::new(Table { store, library, hub, entries: Mutex::new(entries) });
        let (queue, waiting) = sync_channel(MAX_QUEUED);
        let worker = table.clone();
        thread::Builder::new()
            .name("calibration-runs".to_owned())
            .spawn(move || worker.work_off(&waiting))
            .map_err(|err| Error::Internal(format!("failed to start the calibration thread: {err}")))?;
        Ok(Self { table, queue })
    }

    /// Checks `request` and puts it at the end of the queue.
    pub(crate) fn start(&self, request: CalibrationRequest) -> Result<CalibrationRun, Error> {
        let session = self.table.store.session(&request.session)?;
        config_of(&request, &session)?;
        let run = {
            let mut entries = lock(&self.table.entries);
            let number = entries.last_key_value().map_or(1, |(number, _)| number + 1);
            let run = CalibrationRun {
                id: id_of(number),
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
            self.table.store.save_run(&run)?;
            entries.insert(number, Entry { run: run.clone(), cancel: Arc::default() });
            self.table.hub.publish_job(&update_of(&run));
            run
        };
        match self.queue.try_send(run.id.clone()) {
            Ok(()) => Ok(run),
            Err(TrySendError::Full(_)) => {
                let problem = format!("{MAX_QUEUED} runs wait already; cancel some, or wait");
                self.table.finish(&run.id, JobState::Failed, Some(problem.clone()), None);
                Err(Error::Conflict(problem))
            }
            Err(TrySendError::Disconnected(_)) => {
                let problem = "the calibration thread has ended; restart the studio".to_owned();
                self.table.finish(&run.id, JobState::Failed, Some(problem.clone()), None);
                Err(Error::Internal(problem))
            }
        }
    }

    /// Every run, newest first, without what is large.
    pub(crate) fn list(&self) -> Vec<CalibrationRun> {
        let entries = lock(&self.table.entries);
        let runs = entries.values().rev().map(|entry| {
            let run = &entry.run;
            CalibrationRun {
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
    pub(crate) fn get(&self, id: &str) -> Result<CalibrationRun, Error> {
        self.table.with(id, |entry| entry.run.clone())
    }

    /// Asks run `id` to stop. One that waits stops at once, one that has ended stays as it is.
    pub(crate) fn cancel(&self, id: &str) -> Result<CalibrationRun, Error> {
        let state = self.table.with(id, |entry| {
            entry.cancel.cancel();
            entry.run.state
        })?;
        if state == JobState::Queued {
            self.table.finish(id, JobState::Cancelled, None, None);
        }
        self.get(id)
    }

    /// Keeps the model that run `id` found.
    pub(crate) fn save_model(&self, id: &str, name: &str) -> Result<ModelSummary, Error> {
        let mut model = self.model(id)?;
        model.name = name.trim().to_owned();
        let summary = self.table.store.save_model(&model)?;
        let run = self.table.with(id, |entry| {
            entry.run.saved_as = Some(summary.id.clone());
            entry.run.clone()
        })?;
        self.table.store.save_run(&run)?;
        Ok(summary)
    }

    /// The model that run `id` found.
    pub(crate) fn model(&self, id: &str) -> Result<SensorModel, Error> {
        let run = self.get(id)?;
        let Some(text) = run.model_toml else {
            let state = state_name(run.state);
            return Err(Error::Conflict(format!(
                "calibration {id:?} is {state} and has found no model; wait until it is done, or start another"
            )));
        };
        Ok(SensorModel::from_toml(&format!("model of calibration {id}"), &text)?)
    }

    /// The report of run `id` for people.
    pub(crate) fn html(&self, id: &str) -> Result<String, Error> {
        self.get(id)?;
        self.table.store.run_html(id)
    }

    /// Where every unfinished run stands, for a client that has just come.
    pub(crate) fn unfinished_updates(&self) -> Vec<JobUpdate> {
        let entries = lock(&self.table.entries);
        let unfinished = entries.values().filter(|entry| is_unfinished(entry.run.state));
        unfinished.map(|entry| update_of(&entry.run)).collect()
    }

    /// Asks everything to stop, because the server does.
    pub(crate) fn cancel_all(&self) {
        for entry in lock(&self.table.entries).values() {
            entry.cancel.cancel();
        }
    }
}

impl Table {
    fn work_off(&self, waiting: &Receiver<String>) {
        while let Ok(id) = waiting.recv() {
            let started = self.with(&id, |entry| {
                if entry.run.state != JobState::Queued || entry.cancel.is_cancelled() {
                    return None;
                }
                entry.run.state = JobState::Running;
                entry.run.stage = "reading the session".to_owned();
                self.hub.publish_job(&update_of(&entry.run));
                Some((entry.run.clone(), entry.cancel.clone()))
            });
            let Ok(Some((run, cancel))) = started else { continue };
            let progress =
                RunProgress { table: self, id: &id, start: Instant::now(), last: Mutex::default() };
            // A fault in one run must not end the thread that all of them need.
            let result = catch_unwind(AssertUnwindSafe(|| self.calibrate(&run, &progress, &cancel)))
                .unwrap_or_else(|_| Err(Error::Internal("the calibration panicked; see the log".to_owned())));
            match result {
                Ok(artifacts) => self.finish(&id, JobState::Done, None, Some(artifacts)),
                Err(err) if err.class() == Class::Cancelled => {
                    self.finish(&id, JobState::Cancelled, None, None);
                }
                Err(err) => self.finish(&id, JobState::Failed, Some(chain(&err)), None),
            }
        }
    }

    fn calibrate(
        &self,
        run: &CalibrationRun,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<CalibrationArtifacts, Error> {
        let session = self.store.session(&run.request.session)?;
        let config = config_of(&run.request, &session)?;
        let artifacts = calibrate_session(&self.library, &session, &config, progress, cancel)?;
        self.store.save_run_html(&run.id, &artifacts.html)?;
        Ok(artifacts)
    }

    /// Records how run `id` ended, unless it has ended already.
    fn finish(
        &self,
        id: &str,
        state: JobState,
        error: Option<String>,
        artifacts: Option<CalibrationArtifacts>,
    ) {
        let finished = self.with(id, |entry| {
            let run = &mut entry.run;
            if !is_unfinished(run.state) {
                return None;
            }
            run.state = state;
            run.stage = state_name(state).to_owned();
            run.seconds_left = None;
            run.error = error;
            if let Some(artifacts) = artifacts {
                run.fraction = 1.0;
                run.report = Some(artifacts.report);
                run.model_toml = Some(artifacts.model.to_toml());
            }
            self.hub.publish_job(&update_of(run));
            Some(run.clone())
        });
        let Ok(Some(run)) = finished else { return };
        if let Err(err) = self.store.save_run(&run) {
            tracing::error!(run = id, err = chain(&err), "a calibration run is lost at the next start");
        }
        if let Some(error) = &run.error {
            tracing::warn!(run = id, error, "calibration failed");
        }
    }

    fn with<T>(&self, id: &str, read: impl FnOnce(&mut Entry) -> T) -> Result<T, Error> {
        files::check_id("calibration", id)?;
        let mut entries = lock(&self.entries);
        // The id of number 7 is run-7 and not run-07.
        let entry = number_of(id).and_then(|number| entries.get_mut(&number));
        entry.filter(|entry| entry.run.id == id).map(read).ok_or_else(|| Error::NotFound {
            what: "calibration",
            id: id.to_owned(),
            hint: "GET /api/v1/calibrations lists them",
        })
    }
}

struct RunProgress<'a> {
    table: &'a Table,
    id: &'a str,
    start: Instant,
    /// When and at which stage progress was last published.
    last: Mutex<Option<(Instant, String)>>,
}

impl Progress for RunProgress<'_> {
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

/// What `request` asks of `session`, or why it cannot be done.
fn config_of(request: &CalibrationRequest, session: &Session) -> Result<CalibrationConfig, Error> {
    let method = match request.method.as_deref() {
        None | Some("exact") => Method::Exact,
        Some("grid") => Method::Grid,
        Some(other) => {
            return Err(Error::Argument(format!("no method {other:?}; expected \"exact\" or \"grid\"")));
        }
    };
    let hold_out = match &request.hold_out {
        None => HoldOut::Auto,
        Some(ids) => {
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
            HoldOut::Takes(ids.clone())
        }
    };
    Ok(CalibrationConfig { method, hold_out, ..CalibrationConfig::default() })
}

fn id_of(number: u64) -> String {
    format!("run-{number}")
}

fn number_of(id: &str) -> Option<u64> {
    id.strip_prefix("run-")?.parse().ok()
}

fn is_unfinished(state: JobState) -> bool {
    matches!(state, JobState::Queued | JobState::Running)
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

fn update_of(run: &CalibrationRun) -> JobUpdate {
    JobUpdate {
        job: run.id.clone(),
        state: state_name(run.state).to_owned(),
        fraction: run.fraction,
        stage: run.stage.clone(),
        seconds_left: run.seconds_left.unwrap_or(0.0),
        error: run.error.clone().unwrap_or_default(),
    }
}
