//! Takes jobs, starts them when it is their turn, watches them, and notes how they end.
//!
//! The database is the truth: every change of a job's state is one statement that names the state before. One thread
//! starts and ends attempts; whoever submits or cancels never waits for it.

mod shards;
mod station;

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use palpate_wire::api::{Job, JobPage, JobProgress, JobSpec, JobState};

use crate::{
    Database, JobFolder, JobsError, ListFilter, Submitted,
    clock::rfc3339_now,
    database::{Ending, JobTotals, NewJob, QueuedJob, Row},
    folder::Shard,
    inputs,
    plan::{Holdings, plan},
    runner::{Launch, RunState, Runner},
    working::chain,
};

/// Running jobs are looked after this often.
const TICK: Duration = Duration::from_millis(50);
/// The same where many run: each look reads a file.
const SLOW_TICK: Duration = Duration::from_secs(1);
/// Where nothing runs, the queue is looked at this often, in case another process has added to it.
const IDLE_TICK: Duration = Duration::from_secs(2);
/// More running jobs than this are many.
const FEW_JOBS: usize = 20;
/// A job that was asked to stop has this long before it is ended.
const CANCEL_GRACE: Duration = Duration::from_secs(5);
/// Jobs of a lane that are looked at when something may start.
const MAX_PLANNED: u32 = 256;
/// A job that was cut off this often is not begun again by itself.
const MAX_CUT_OFF: u32 = 5;
/// What a divided job has in place of a handle while its last step is handed to the runner.
const LAST_STEP: &str = "last step";
/// What is searched of the log of a job that died, for the line that says why.
const SEARCHED_LOG_BYTES: u64 = 64 << 10;

/// Hears every change of a job, in order.
pub type Observer = Arc<dyn Fn(&Job) + Send + Sync>;

/// What a scheduler works with.
pub struct SchedulerConfig {
    /// Folder of the folders of jobs.
    pub runs: PathBuf,
    /// Where deleted ones go.
    pub trash: PathBuf,
    /// The database of the data folder.
    pub database: Arc<Database>,
    /// Where jobs run; the first is the usual one. At least one.
    pub runners: Vec<Arc<dyn Runner>>,
    /// Who hears of changes.
    pub observer: Observer,
    /// How long a job that was asked to stop may take; 5 s without.
    pub cancel_grace: Option<Duration>,
}

/// A job that is to be done.
#[derive(Clone, Debug)]
pub struct Submission<'a> {
    /// Before the number in its id.
    pub prefix: &'a str,
    /// What is asked.
    pub spec: &'a JobSpec,
    /// What each shard is asked, as many as the resources say.
    pub shards: &'a [Shard],
    /// Who asks.
    pub owner: &'a str,
    /// Where it should run; the usual place without.
    pub runner: Option<&'a str>,
    /// The client's idempotency key, and the request that came with it as a text: equal requests have equal texts.
    pub key: Option<(&'a str, &'a str)>,
}

/// The jobs of a data folder.
pub struct Scheduler {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

struct Shared {
    config: SchedulerConfig,
    /// Locked while a change is made and told, so that changes are told in order.
    live: Mutex<HashMap<String, Live>>,
    wake: (Mutex<bool>, Condvar),
    ends: AtomicBool,
    /// Jobs on the station that were asked for since this studio was started.
    wanted: Mutex<BTreeSet<String>>,
}

/// What is known of a running job beyond the database.
#[derive(Debug, Default)]
struct Live {
    progress: JobProgress,
    asked: Option<Instant>,
    /// Shards that are done and whose processes have ended.
    shards_done: BTreeSet<u32>,
    /// The last complaint about it, so that it is logged once.
    complaint: String,
}

impl Scheduler {
    /// Opens the jobs of a data folder and starts what waits. Jobs that an earlier studio left running are found again.
    pub fn start(config: SchedulerConfig) -> Result<Self, JobsError> {
        let scheduler = Self::open(config)?;
        let shared = scheduler.shared.clone();
        let thread = thread::Builder::new()
            .name("jobs".to_owned())
            .spawn(move || shared.run())
            .map_err(|err| JobsError::Runner(format!("failed to start the thread of jobs: {err}")))?;
        *lock(&scheduler.thread) = Some(thread);
        Ok(scheduler)
    }

    /// The same without a thread: nothing starts until another scheduler has the folder.
    pub fn open(config: SchedulerConfig) -> Result<Self, JobsError> {
        if config.runners.is_empty() {
            return Err(JobsError::Argument("jobs need a runner".to_owned()));
        }
        fs::create_dir_all(&config.runs).map_err(JobsError::io("make", &config.runs))?;
        let shared = Arc::new(Shared {
            config,
            live: Mutex::default(),
            wake: (Mutex::new(true), Condvar::new()),
            ends: AtomicBool::new(false),
            wanted: Mutex::default(),
        });
        Ok(Self { shared, thread: Mutex::default() })
    }

    /// Whether jobs of `runner`, or of the usual one, run on this computer.
    pub fn is_local(&self, runner: Option<&str>) -> bool {
        let runner = match runner {
            None => self.shared.config.runners.first(),
            Some(name) => self.shared.runner(name),
        };
        runner.is_some_and(|runner| runner.capacity().is_some())
    }

    /// Queues a job. It is on disk when this returns.
    pub fn submit(&self, submission: &Submission<'_>) -> Result<Submitted, JobsError> {
        let config = &self.shared.config;
        let runner = match submission.runner {
            None => &config.runners[0],
            Some(name) => self.shared.runner(name).ok_or_else(|| {
                let known: Vec<&str> = config.runners.iter().map(|runner| runner.name()).collect();
                JobsError::Argument(format!("no runner {name:?}; there are {}", known.join(", ")))
            })?,
        };
        let resources = submission.spec.resources;
        if resources.shards as usize != submission.shards.len() {
            return Err(JobsError::Argument(format!(
                "resources.shards = {}, and the job has {}; leave it out",
                resources.shards,
                submission.shards.len()
            )));
        }
        if resources.gpu && runner.capacity().is_some_and(|capacity| !capacity.gpu) {
            return Err(JobsError::Argument(format!(
                "the job needs a GPU, and runner {:?} has none; choose another runner",
                runner.name()
            )));
        }
        let new = NewJob {
            prefix: submission.prefix,
            spec: submission.spec,
            owner: submission.owner,
            runner: runner.name(),
            key: submission.key,
        };
        let submitted = {
            let live = self.shared.live();
            if resources.station {
                self.shared.refuse_second_on_station()?;
            }
            let submitted = config.database.insert(&new, |id| {
                JobFolder::at(config.runs.join(id)).create(submission.spec, submission.shards)
            })?;
            if submitted.is_new {
                self.shared.note_wanted(&submitted.job);
                (config.observer)(&submitted.job);
            }
            drop(live);
            submitted
        };
        self.shared.wake();
        Ok(submitted)
    }

    /// The job that `request` made when it came with the idempotency `key` before; refused if another request came with it.
    pub fn job_of_key(&self, key: &str, request: &str) -> Result<Option<Job>, JobsError> {
        let live = self.shared.live();
        let mut job = self.shared.config.database.job_of_key(key, request)?;
        if let Some(job) = &mut job {
            overlay(&live, job);
        }
        Ok(job)
    }

    /// Where job `id` stands.
    pub fn job(&self, id: &str) -> Result<Job, JobsError> {
        let live = self.shared.live();
        self.shared.job(&live, id)
    }

    /// A page of jobs, newest first.
    pub fn list(&self, filter: &ListFilter) -> Result<JobPage, JobsError> {
        let mut page = self.shared.config.database.list(filter)?;
        let live = self.shared.live();
        page.jobs.iter_mut().for_each(|job| overlay(&live, job));
        Ok(page)
    }

    /// Every job of `kind`, newest first.
    pub fn all_of_kind(&self, kind: &str) -> Result<Vec<Job>, JobsError> {
        let mut jobs = Vec::new();
        let mut filter =
            ListFilter { kind: Some(kind.to_owned()), limit: Some(1000), ..ListFilter::default() };
        loop {
            let page = self.list(&filter)?;
            jobs.extend(page.jobs);
            if page.next_cursor.is_none() {
                return Ok(jobs);
            }
            filter.cursor = page.next_cursor;
        }
    }

    /// How many jobs there are, by kind and state.
    pub fn totals(&self) -> Result<Vec<JobTotals>, JobsError> {
        self.shared.config.database.totals()
    }

    /// Jobs that wait or work, oldest first.
    pub fn unfinished(&self) -> Result<Vec<Job>, JobsError> {
        let database = &self.shared.config.database;
        let mut rows = database.in_state(JobState::Queued)?;
        rows.extend(database.in_state(JobState::Running)?);
        rows.sort_by_key(|row| row.serial);
        let live = self.shared.live();
        let jobs = rows.into_iter().map(|row| {
            let mut job = row.job;
            overlay(&live, &mut job);
            job
        });
        Ok(jobs.collect())
    }

    /// Asks job `id` to stop. One that waits stops at once, one that works is asked, and ended if it does not stop; one
    /// that has ended stays as it is.
    pub fn cancel(&self, id: &str) -> Result<Job, JobsError> {
        let job = {
            let live = self.shared.live();
            if self.shared.config.database.request_cancel(id)? {
                self.shared.tell(&live, id)?;
            }
            self.shared.job(&live, id)?
        };
        self.shared.wake();
        Ok(job)
    }

    /// Queues job `id`, which failed or was cancelled, once more.
    pub fn retry(&self, id: &str) -> Result<Job, JobsError> {
        let job = {
            let live = self.shared.live();
            let job = self.shared.job(&live, id)?;
            if job.spec.resources.station && !job.is_unfinished() {
                self.shared.refuse_second_on_station()?;
            }
            if !self.shared.config.database.retry(id)? {
                return Err(JobsError::Conflict(format!(
                    "job {id:?} is {}; only one that failed or was cancelled can be tried again, others can be asked for \
                     anew",
                    job.state.name()
                )));
            }
            self.shared.note_wanted(&job);
            self.shared.tell(&live, id)?;
            self.shared.job(&live, id)?
        };
        self.shared.wake();
        Ok(job)
    }

    /// Moves job `id`, which has ended, to the trash.
    pub fn delete(&self, id: &str) -> Result<(), JobsError> {
        let config = &self.shared.config;
        let live = self.shared.live();
        let job = self.shared.job(&live, id)?;
        if job.is_unfinished() {
            return Err(JobsError::Conflict(format!(
                "job {id:?} is {}; cancel it first, then delete it",
                job.state.name()
            )));
        }
        let folder = self.folder(id);
        if folder.path().is_dir() {
            // What the trash holds can be understood, and put back, without the database.
            folder.write_head(&job)?;
        }
        if !config.database.delete(id)? {
            return Err(JobsError::Conflict(format!(
                "job {id:?} has just been started again; cancel it first"
            )));
        }
        if !folder.path().is_dir() {
            return Ok(());
        }
        fs::create_dir_all(&config.trash).map_err(JobsError::io("make", &config.trash))?;
        // Numbers are given once, so nothing of that name is there.
        let target = config.trash.join(id);
        fs::rename(folder.path(), &target).map_err(JobsError::io("move", folder.path()))
    }

    /// The folder of job `id`. It must be the id of a job.
    pub fn folder(&self, id: &str) -> JobFolder {
        JobFolder::at(self.shared.config.runs.join(id))
    }

    /// Notes under which id the outcome of job `id` was saved; `None` takes the note back.
    pub fn set_saved_as(&self, id: &str, saved_as: Option<&str>) -> Result<(), JobsError> {
        match self.shared.config.database.set_saved_as(id, saved_as)? {
            true => Ok(()),
            false => Err(JobsError::NotFound(id.to_owned())),
        }
    }

    /// Forgets that jobs were saved as `saved_as` (`by` names one of them, `None` all), because that was undone.
    pub fn forget_saved(&self, saved_as: &str, by: Option<&str>) -> Result<(), JobsError> {
        self.shared.config.database.forget_saved(saved_as, by)
    }

    /// SHA-256 of each of `files` by its path relative to `root`. Files that have not changed are not read again.
    pub fn hash_inputs(&self, root: &Path, files: &[PathBuf]) -> Result<BTreeMap<String, String>, JobsError> {
        inputs::hash(&self.shared.config.database, root, files)
    }

    /// Starts nothing any more. Running jobs go on; the next studio on this folder finds them again.
    pub fn begin_to_stop(&self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        self.shared.wake();
    }

    /// Ends the thread. Running jobs go on; the next studio on this folder finds them again.
    pub fn stop(&self) {
        self.begin_to_stop();
        if let Some(thread) = lock(&self.thread).take() {
            // A thread that panicked has said so.
            let _ = thread.join();
        }
    }

    #[cfg(test)]
    fn tick(&self) {
        self.shared.tick();
    }
}

impl Drop for Scheduler {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Shared {
    fn live(&self) -> MutexGuard<'_, HashMap<String, Live>> {
        lock(&self.live)
    }

    fn wake(&self) {
        *lock(&self.wake.0) = true;
        self.wake.1.notify_one();
    }

    fn runner(&self, name: &str) -> Option<&Arc<dyn Runner>> {
        self.config.runners.iter().find(|runner| runner.name() == name)
    }

    fn job(&self, live: &HashMap<String, Live>, id: &str) -> Result<Job, JobsError> {
        let row = self.config.database.row(id)?;
        let mut job = row.ok_or_else(|| JobsError::NotFound(id.to_owned()))?.job;
        overlay(live, &mut job);
        Ok(job)
    }

    fn tell(&self, live: &HashMap<String, Live>, id: &str) -> Result<(), JobsError> {
        let job = self.job(live, id)?;
        (self.config.observer)(&job);
        Ok(())
    }

    fn run(&self) {
        while !self.ends.load(Ordering::Relaxed) {
            let num_running = self.tick();
            let pause = match num_running {
                0 => IDLE_TICK,
                few if few <= FEW_JOBS => TICK,
                _ => SLOW_TICK,
            };
            let (woken, bell) = &self.wake;
            let mut woken = lock(woken);
            if !*woken {
                woken = bell.wait_timeout(woken, pause).unwrap_or_else(PoisonError::into_inner).0;
            }
            *woken = false;
        }
    }

    /// Looks after everything that runs, and starts what may start; gives the number of running jobs.
    fn tick(&self) -> usize {
        let looked_after = self.look_after_running().and_then(|()| self.start_waiting());
        match looked_after {
            Ok(num_running) => num_running,
            Err(err) => {
                tracing::error!(err = chain(&err), "jobs cannot be looked after; they are tried again");
                // Not at once, and not never.
                FEW_JOBS + 1
            }
        }
    }

    fn look_after_running(&self) -> Result<(), JobsError> {
        for row in self.config.database.in_state(JobState::Running)? {
            let Some(runner) = self.runner(&row.job.runner) else {
                let problem = format!("runner {:?} is not configured any more", row.job.runner);
                self.complain(&row.job.id, &problem);
                continue;
            };
            let launch = self.launch(&row);
            if launch.resources.shards > 0 && row.handle.is_none() {
                if let Err(err) = self.look_after_shards(&**runner, &row, &launch) {
                    self.complain(&row.job.id, &chain(&err));
                }
                continue;
            }
            match runner.state(&launch, handle(&row)) {
                Ok(state) => self.apply(&**runner, &row, &launch, state)?,
                Err(err) => self.complain(&row.job.id, &chain(&err)),
            }
        }
        Ok(())
    }

    fn launch(&self, row: &Row) -> Launch {
        Launch {
            id: row.job.id.clone(),
            shard: None,
            attempt: row.job.attempts,
            resources: row.job.spec.resources,
            folder: JobFolder::at(self.config.runs.join(&row.job.id)),
        }
    }

    fn apply(
        &self,
        runner: &dyn Runner,
        row: &Row,
        launch: &Launch,
        state: RunState,
    ) -> Result<(), JobsError> {
        let asked = row.job.cancel_requested;
        match state {
            RunState::Waiting(stage) => {
                self.note_progress(
                    launch,
                    JobProgress { attempt: launch.attempt, stage, ..JobProgress::default() },
                )?;
                self.cancel_if_asked(runner, row, launch);
                Ok(())
            }
            RunState::Running => {
                if let Some(progress) = launch.folder.progress() {
                    self.note_progress(launch, progress)?;
                }
                self.cancel_if_asked(runner, row, launch);
                Ok(())
            }
            RunState::Ended(exit) => match exit.outcome {
                JobState::Done => self.end(row, JobState::Done, None, &exit.ended),
                _ if asked => self.end(row, JobState::Cancelled, None, &exit.ended),
                // Somebody else has asked the process: a computer that is shut down, for instance.
                JobState::Cancelled => self.begin_again(row),
                _ => {
                    let problem =
                        exit.problem.as_deref().unwrap_or("it failed and did not say why; see its log");
                    self.end(row, JobState::Failed, Some(problem), &exit.ended)
                }
            },
            RunState::Died(_) | RunState::Lost if asked => {
                self.end(row, JobState::Cancelled, None, &rfc3339_now())
            }
            RunState::Died(why) => {
                let log = launch.folder.log_tail(SEARCHED_LOG_BYTES).unwrap_or_default();
                let problem = match telling_line(&log) {
                    Some(line) => format!("{why}: {line}"),
                    None => why,
                };
                self.end(row, JobState::Failed, Some(&problem), &rfc3339_now())
            }
            RunState::Lost => self.begin_again(row),
        }
    }

    /// A job that was cut off is done again, unless it moves the robot: nobody may stand beside it any more.
    fn begin_again(&self, row: &Row) -> Result<(), JobsError> {
        if row.job.spec.resources.station {
            return self.end(row, JobState::Failed, Some(station::CUT_OFF), &rfc3339_now());
        }
        if row.cut_off + 1 >= MAX_CUT_OFF {
            let problem = format!(
                "it was cut off {MAX_CUT_OFF} times before it ended; find out what ends it, then try it again"
            );
            return self.end(row, JobState::Failed, Some(&problem), &rfc3339_now());
        }
        let mut live = self.live();
        if self.config.database.requeue(&row.job.id, row.job.attempts)? {
            live.remove(&row.job.id);
            tracing::warn!(
                job = row.job.id,
                attempt = row.job.attempts,
                "a job was cut off; it begins again"
            );
            self.tell(&live, &row.job.id)?;
        }
        Ok(())
    }

    fn end(&self, row: &Row, state: JobState, problem: Option<&str>, ended: &str) -> Result<(), JobsError> {
        let id = &row.job.id;
        let mut live = self.live();
        let reached = live.get(id).map_or(0.0, |live| live.progress.fraction);
        let fraction = if state == JobState::Done { 1.0 } else { reached };
        if self.config.database.end(id, row.job.attempts, Ending { state, problem, ended, fraction })? {
            live.remove(id);
            if let Some(problem) = problem {
                tracing::warn!(job = id, problem, "a job failed");
            }
            self.tell(&live, id)?;
        }
        Ok(())
    }

    fn note_progress(&self, launch: &Launch, progress: JobProgress) -> Result<(), JobsError> {
        if progress.attempt != launch.attempt {
            return Ok(());
        }
        let mut live = self.live();
        let known = live.entry(launch.id.clone()).or_default();
        if known.progress == progress {
            return Ok(());
        }
        known.progress = progress;
        self.tell(&live, &launch.id)
    }

    fn cancel_if_asked(&self, runner: &dyn Runner, row: &Row, launch: &Launch) {
        if !row.job.cancel_requested {
            return;
        }
        if let Some(insists) = self.insists(&launch.id)
            && let Err(err) = runner.cancel(launch, handle(row), insists)
        {
            self.complain(&launch.id, &chain(&err));
        }
    }

    /// Whether job `id`, which should stop, is asked now (false) or ended (true); `None` while it has time to obey.
    fn insists(&self, id: &str) -> Option<bool> {
        let mut live = self.live();
        let known = live.entry(id.to_owned()).or_default();
        match known.asked {
            None => {
                known.asked = Some(Instant::now());
                Some(false)
            }
            Some(asked) => {
                (asked.elapsed() >= self.config.cancel_grace.unwrap_or(CANCEL_GRACE)).then_some(true)
            }
        }
    }

    fn start_waiting(&self) -> Result<usize, JobsError> {
        let database = &self.config.database;
        let capacity = |name: &str| self.runner(name).map(|runner| runner.capacity());
        let running = database.in_state(JobState::Running)?;
        // Shards are looked after one by one.
        let mut num_running: usize =
            running.iter().map(|row| row.job.spec.resources.max_at_once() as usize).sum();
        let mut holdings = Holdings::default();
        for row in &running {
            holdings.add(&QueuedJob::from(row), capacity(&row.job.runner).flatten());
        }
        for short in [true, false] {
            for id in plan(&database.queue(short, MAX_PLANNED)?, &mut holdings, capacity) {
                if self.ends.load(Ordering::Relaxed) {
                    return Ok(num_running);
                }
                if self.begin(&id)? {
                    num_running += 1;
                }
            }
        }
        Ok(num_running)
    }

    /// Starts job `id`, unless it waits no more.
    fn begin(&self, id: &str) -> Result<bool, JobsError> {
        let row = {
            let mut live = self.live();
            if !self.config.database.begin(id)? {
                return Ok(false);
            }
            live.insert(id.to_owned(), Live::default());
            self.tell(&live, id)?;
            match self.config.database.row(id)? {
                Some(row) => row,
                None => return Ok(false),
            }
        };
        let launch = self.launch(&row);
        if launch.resources.shards > 0 {
            // Its shards begin with the next look.
            return Ok(true);
        }
        let started = match self.runner(&row.job.runner) {
            _ if !self.is_wanted_now(&launch) => Err(JobsError::Conflict(station::NOT_WANTED.to_owned())),
            Some(runner) => runner.submit(&launch),
            None => Err(JobsError::Runner(format!("runner {:?} is not configured", row.job.runner))),
        };
        match started {
            Ok(handle) => self.config.database.set_handle(id, launch.attempt, &handle).map(|_| true),
            Err(err) => {
                let problem = format!("it could not be started: {}", chain(&err));
                self.end(&row, JobState::Failed, Some(&problem), &rfc3339_now())?;
                Ok(false)
            }
        }
    }

    /// Logs `problem` of job `id`, once.
    fn complain(&self, id: &str, problem: &str) {
        let mut live = self.live();
        let known = live.entry(id.to_owned()).or_default();
        if known.complaint != problem {
            tracing::warn!(job = id, problem, "a job cannot be looked after");
            known.complaint = problem.to_owned();
        }
    }
}

/// The line of a log that most likely says what happened: that of an error, else the last one.
fn telling_line(log: &str) -> Option<&str> {
    let lines =
        || log.lines().rev().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with("--- "));
    let is_error = |line: &&str| {
        line.starts_with("error")
            || line.starts_with("memory allocation of ")
            || line.contains(" panicked at ")
    };
    lines().find(is_error).or_else(|| lines().next())
}

/// What the runner gave for the job's own process, if that was written down.
fn handle(row: &Row) -> Option<&str> {
    row.handle.as_deref().filter(|handle| *handle != LAST_STEP)
}

/// Adds what is known of a running job beyond the database.
fn overlay(live: &HashMap<String, Live>, job: &mut Job) {
    if job.state != JobState::Running {
        return;
    }
    if let Some(known) = live.get(&job.id).filter(|known| known.progress.attempt == job.attempts) {
        job.fraction = known.progress.fraction;
        job.stage = known.progress.stage.clone();
        job.seconds_left = known.progress.seconds_left;
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
