//! The side of the job: what its own process does with its folder.

use std::{
    io,
    path::PathBuf,
    process::ExitCode,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use palpate_wire::api::{JobExit, JobProgress, JobSpec, JobState};
use rustix::process::{Resource, Rlimit, getrlimit, nice, setrlimit};
use tokio::signal::unix::{SignalKind, signal};

use crate::{
    JobFolder, JobsError,
    clock::rfc3339_now,
    folder::{FolderLock, ProcessFile},
    process_id,
};

/// Progress is written this often at most; a change of stage at once.
const PROGRESS_PERIOD: Duration = Duration::from_millis(100);
/// Share of a divided job's work that its shards do; its own process, which comes last, does the rest.
pub(crate) const SHARE_OF_SHARDS: f64 = 0.99;
/// Signs of life come this often.
const HEARTBEAT_PERIOD: Duration = Duration::from_secs(5);
/// Exit code of a process whose work somebody else does or has done (`EX_TEMPFAIL` of sysexits).
const NOT_MINE: u8 = 75;

/// How a process may begin.
#[derive(Clone, Copy, Debug, Default)]
pub struct WorkingConfig {
    /// The attempt that it was started for; without one, the one that counts.
    pub attempt: Option<u32>,
    /// How much it gives way to other processes, 0..=19.
    pub nice: i32,
}

/// An attempt at a job, in the process that works on it.
#[derive(Debug)]
pub struct Working {
    folder: JobFolder,
    spec: JobSpec,
    attempt: u32,
    started: String,
    begun: Instant,
    progress: Mutex<Reported>,
    _heartbeat: Heartbeat,
    /// Held for as long as the process lives: a thread that still computes at the end must not be mistaken for nobody.
    _lock: FolderLock,
}

/// How the attempt may begin.
#[derive(Debug)]
pub enum Begun {
    /// It is this process's.
    Mine(Box<Working>),
    /// Another attempt counts, or this one has ended already: nothing is to be done.
    NotMine(ExitCode),
}

#[derive(Debug, Default)]
struct Reported {
    last: JobProgress,
    written: Option<Instant>,
}

/// How the work ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It is done, and its files are complete.
    Done,
    /// It was asked to stop.
    Cancelled,
    /// It could not be done.
    Failed {
        /// Why not, and what to do.
        problem: String,
        /// Exit code of the process.
        code: u8,
    },
}

impl Working {
    /// Begins the attempt that `folder` waits for.
    pub fn begin(folder: JobFolder, config: WorkingConfig) -> Result<Begun, JobsError> {
        let spec = folder.spec()?;
        let lock = folder.lock()?;
        folder.remove_leftovers(&lock);
        let counts = folder.attempt()?;
        let attempt = config.attempt.unwrap_or(counts.max(1));
        if config.attempt.is_none() && counts == 0 {
            folder.begin_attempt(attempt, &lock)?;
        } else if attempt != counts {
            tracing::info!(attempt, counts, "another attempt counts");
            return Ok(Begun::NotMine(ExitCode::from(NOT_MINE)));
        }
        if let Some(exit) = folder.exit(attempt) {
            tracing::info!(attempt, "this attempt has ended already");
            return Ok(Begun::NotMine(ExitCode::from(exit.code)));
        }
        if config.nice > 0 {
            // Where it is not allowed, the job competes with others on equal terms.
            let _ = nice(config.nice);
        }
        if let Some(mib) = spec.resources.memory_mib {
            let bytes = mib.saturating_mul(1 << 20);
            // What is written, and not what is only reserved, which some allocators do by the gigabyte.
            let limit = Rlimit { current: Some(bytes), maximum: getrlimit(Resource::Data).maximum };
            setrlimit(Resource::Data, limit).map_err(|err| {
                JobsError::Argument(format!("failed to limit memory to {mib} MiB: {err}; ask for less"))
            })?;
        }
        let pid = std::process::id();
        folder.write_process(&ProcessFile {
            attempt,
            pid,
            start_ticks: process_id::start_ticks(pid).unwrap_or(0),
            boot: process_id::boot_id(),
            host: process_id::host(),
        })?;
        let heartbeat = Heartbeat::begin(folder.file("heartbeat"));
        let working = Self {
            folder,
            spec,
            attempt,
            started: rfc3339_now(),
            begun: Instant::now(),
            progress: Mutex::default(),
            _heartbeat: heartbeat,
            _lock: lock,
        };
        working.report(0.0, "starting");
        Ok(Begun::Mine(Box::new(working)))
    }

    /// What is asked.
    pub fn spec(&self) -> &JobSpec {
        &self.spec
    }

    /// Where the results go.
    pub fn folder(&self) -> &JobFolder {
        &self.folder
    }

    /// Tells how far the work is: `fraction` in 0..=1, and what is being done, for people.
    pub fn report(&self, fraction: f64, stage: &str) {
        let mut reported = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        // Reports of several threads may overtake each other; the bar never goes back.
        let fraction = if fraction.is_finite() { fraction.clamp(0.0, 1.0) } else { 0.0 };
        let before = if self.spec.resources.shards > 0 { SHARE_OF_SHARDS } else { 0.0 };
        let done = reported.last.fraction.max(before + (1.0 - before) * fraction);
        let elapsed_s = self.begun.elapsed().as_secs_f64();
        let due = reported.written.is_none_or(|when| when.elapsed() >= PROGRESS_PERIOD)
            || reported.last.stage != stage;
        reported.last = JobProgress {
            attempt: self.attempt,
            fraction: done,
            stage: stage.to_owned(),
            seconds_left: (fraction > 0.05).then(|| elapsed_s / fraction * (1.0 - fraction)),
        };
        if due {
            reported.written = Some(Instant::now());
            if let Err(err) = self.folder.write_progress(&reported.last) {
                tracing::warn!(err = chain(&err), "failed to say how far the job is");
            }
        }
    }

    /// Adds a point to the job's curves: an object of numbers by name, `step` among them.
    pub fn metrics(&self, point: &serde_json::Value) {
        if let Err(err) = self.folder.append_metrics(point) {
            tracing::warn!(err = chain(&err), "failed to write a metric");
        }
    }

    /// Says how the work ended, once everything else is on disk; gives the exit code of the process, which must end
    /// now.
    pub fn end(self, outcome: Outcome) -> Result<ExitCode, JobsError> {
        if self.folder.attempt()? != self.attempt {
            // It was taken for lost, where locks do not reach: a computer that stood still for minutes.
            return Ok(ExitCode::from(NOT_MINE));
        }
        let (state, code, problem) = match outcome {
            Outcome::Done => (JobState::Done, 0, None),
            Outcome::Cancelled => (JobState::Cancelled, 1, None),
            Outcome::Failed { problem, code } => (JobState::Failed, code.max(1), Some(problem)),
        };
        self.folder.write_exit(&JobExit {
            attempt: self.attempt,
            outcome: state,
            code,
            problem,
            started: self.started.clone(),
            ended: rfc3339_now(),
            host: process_id::host(),
        })?;
        Ok(ExitCode::from(code))
    }
}

/// Touches a file for as long as it lives: a sign of life for those who see neither the process nor its lock. Ends the process
/// when the folder is gone.
#[derive(Debug)]
struct Heartbeat(Arc<AtomicBool>);

impl Heartbeat {
    fn begin(path: PathBuf) -> Self {
        let ended = Arc::new(AtomicBool::new(false));
        let heart = {
            let ended = ended.clone();
            move || {
                while !ended.load(Ordering::Relaxed) {
                    let beat = std::fs::write(&path, "");
                    if beat.is_err_and(|err| err.kind() == io::ErrorKind::NotFound)
                        && !ended.load(Ordering::Relaxed)
                    {
                        // The folder is gone, and with it whoever waited for the result.
                        eprintln!("error: the folder of the job is gone");
                        std::process::exit(i32::from(NOT_MINE));
                    }
                    // One that fails otherwise comes again.
                    thread::park_timeout(HEARTBEAT_PERIOD);
                }
            }
        };
        // Without a thread the job is watched by its process and its lock alone.
        let _ = thread::Builder::new().name("heartbeat".to_owned()).spawn(heart);
        Self(ended)
    }
}

impl Drop for Heartbeat {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Calls `asked` when this process is asked to stop (SIGTERM, SIGINT). It goes on living: the job should end soon.
pub fn on_stop_request(mut asked: impl FnMut() + Send + 'static) -> Result<(), JobsError> {
    let failed = |err| JobsError::Runner(format!("failed to listen for signals: {err}"));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(failed)?;
    let (mut terminate, mut interrupt) = {
        let _entered = runtime.enter();
        (signal(SignalKind::terminate()).map_err(failed)?, signal(SignalKind::interrupt()).map_err(failed)?)
    };
    let listen = async move {
        loop {
            tokio::select! {
                _ = terminate.recv() => {}
                _ = interrupt.recv() => {}
            }
            asked();
        }
    };
    thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || runtime.block_on(listen))
        .map_err(failed)?;
    Ok(())
}

/// `err` and its causes on one line.
pub(crate) fn chain(err: &dyn std::error::Error) -> String {
    let mut text = err.to_string();
    let mut cause = err.source();
    while let Some(err) = cause {
        text.push_str(": ");
        text.push_str(&err.to_string());
        cause = err.source();
    }
    text
}
