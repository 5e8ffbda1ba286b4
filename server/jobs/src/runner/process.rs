//! Jobs as processes of this computer: each a process group of its own that gives way to others, so that neither its
//! crash nor its memory reaches the studio. They outlive the studio, which finds them again.

use std::{
    collections::HashMap,
    fmt,
    io::Write as _,
    os::unix::process::{CommandExt as _, ExitStatusExt as _},
    path::PathBuf,
    process::{Child, Command, ExitStatus, Stdio},
    sync::{Arc, Mutex, PoisonError},
};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

use super::{Capacity, Launch, RunState, Runner};
use crate::{JobsError, clock::rfc3339_now, process_id};

/// Environment variables for an attempt at a job on the station, which others do not get: where the studio is, and what
/// lets the job in. Whatever it cannot be given keeps it from starting.
pub type StationVariables = Arc<dyn Fn(&Launch) -> Result<Vec<(String, String)>, JobsError> + Send + Sync>;

/// How processes are started.
#[derive(Clone)]
pub struct ProcessRunnerConfig {
    /// The program, and what comes before `--dir DIR --attempt N --nice N`.
    pub command: Vec<PathBuf>,
    /// How much jobs give way to other processes, 0..=19. Those on the station do not: the robot waits for what they send.
    pub nice: i32,
    /// What jobs share.
    pub capacity: Capacity,
    /// What jobs on the station are told; without, they are told nothing.
    pub station: Option<StationVariables>,
}

impl fmt::Debug for ProcessRunnerConfig {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ProcessRunnerConfig")
            .field("command", &self.command)
            .field("nice", &self.nice)
            .field("capacity", &self.capacity)
            .finish_non_exhaustive()
    }
}

/// Runs jobs as processes of this computer.
#[derive(Debug)]
pub struct ProcessRunner {
    config: ProcessRunnerConfig,
    /// Processes that this one started, by job or shard. Others are known by their folder's lock.
    children: Mutex<HashMap<String, (u32, Child)>>,
}

impl ProcessRunner {
    /// A runner that has started nothing yet.
    pub fn new(config: ProcessRunnerConfig) -> Self {
        Self { config, children: Mutex::default() }
    }

    fn children(&self) -> std::sync::MutexGuard<'_, HashMap<String, (u32, Child)>> {
        self.children.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How the child of `launch` ended; `None` while it works, `Some(None)` if this process did not start it.
    fn own_child(&self, launch: &Launch) -> Result<Option<Option<ExitStatus>>, JobsError> {
        let mut children = self.children();
        let Some((attempt, child)) = children.get_mut(&launch.key()) else { return Ok(Some(None)) };
        if *attempt != launch.attempt {
            return Ok(Some(None));
        }
        let failed = |what: &str, err: &dyn std::fmt::Display| {
            JobsError::Runner(format!("failed to {what} the process of job {:?}: {err}", launch.key()))
        };
        let pid = pid_of(child.id()).ok_or_else(|| failed("name", &"it has no number"))?;
        // It is left a zombie, so that its number, which is its group's, still belongs to it when the group is ended.
        let look = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let ended = waitid(WaitId::Pid(pid), look).map_err(|err| failed("look after", &err))?;
        if ended.is_none() {
            return Ok(None);
        }
        // What it started itself ends with it.
        let _ = kill_process_group(pid, Signal::KILL);
        let status = child.wait().map_err(|err| failed("wait for", &err))?;
        children.remove(&launch.key());
        Ok(Some(Some(status)))
    }
}

impl Runner for ProcessRunner {
    fn name(&self) -> &str {
        "process"
    }

    fn capacity(&self) -> Option<Capacity> {
        Some(self.config.capacity)
    }

    fn submit(&self, launch: &Launch) -> Result<String, JobsError> {
        let folder = &launch.folder;
        let is_on_station = launch.resources.station;
        let nice = if is_on_station { 0 } else { self.config.nice };
        let variables = match self.config.station.as_ref().filter(|_| is_on_station) {
            Some(variables) => variables(launch)?,
            None => Vec::new(),
        };
        let lock = folder.lock()?;
        folder.begin_attempt(launch.attempt, &lock)?;
        drop(lock);
        let mut log = folder.open_log()?;
        writeln!(log, "--- attempt {} at {}", launch.attempt, rfc3339_now())
            .map_err(JobsError::io("write", folder.file("log.txt")))?;
        let also = log.try_clone().map_err(JobsError::io("open", folder.file("log.txt")))?;
        let Some((program, arguments)) = self.config.command.split_first() else {
            return Err(JobsError::Runner("no program is given that runs jobs".to_owned()));
        };
        let mut command = Command::new(program);
        command
            .args(arguments)
            .arg("--dir")
            .arg(folder.path())
            .args(["--attempt", &launch.attempt.to_string(), "--nice", &nice.to_string()])
            .envs(variables)
            .stdin(Stdio::null())
            .stdout(log)
            .stderr(also)
            // Ctrl-C in the studio's terminal is not meant for it.
            .process_group(0);
        if launch.resources.cores > 0 {
            command.env("RAYON_NUM_THREADS", launch.resources.cores.to_string());
        }
        let child = command.spawn().map_err(|err| {
            JobsError::Runner(format!("failed to start {program:?} for job {:?}: {err}", launch.key()))
        })?;
        let pid = child.id();
        self.children().insert(launch.key(), (launch.attempt, child));
        Ok(pid.to_string())
    }

    fn state(&self, launch: &Launch, _handle: Option<&str>) -> Result<RunState, JobsError> {
        match self.own_child(launch)? {
            None => return Ok(RunState::Running),
            Some(Some(status)) => {
                return Ok(match launch.folder.exit(launch.attempt) {
                    Some(exit) => RunState::Ended(exit),
                    None => RunState::Died(in_words(status)),
                });
            }
            Some(None) => {}
        }
        if !launch.folder.path().is_dir() {
            return Ok(RunState::Lost);
        }
        // Who holds the lock works on it.
        let Some(lock) = launch.folder.try_lock()? else { return Ok(RunState::Running) };
        match launch.folder.exit(launch.attempt) {
            Some(exit) => Ok(RunState::Ended(exit)),
            None => {
                // A process that was started just before the studio was killed may still be on its way.
                launch.folder.give_up_attempt(launch.attempt, &lock)?;
                Ok(RunState::Lost)
            }
        }
    }

    fn cancel(&self, launch: &Launch, _handle: Option<&str>, insists: bool) -> Result<(), JobsError> {
        let signal = if insists { Signal::KILL } else { Signal::TERM };
        let own = self.children().get(&launch.key()).map(|(_, child)| child.id());
        let pid = match own {
            // A child that has ended keeps its number until it is waited for.
            Some(pid) => Some(pid),
            None => launch.folder.process().and_then(|process| {
                let is_it = process.attempt == launch.attempt
                    && process.boot == process_id::boot_id()
                    && process_id::start_ticks(process.pid) == Some(process.start_ticks);
                is_it.then_some(process.pid)
            }),
        };
        let Some(pid) = pid.and_then(pid_of) else { return Ok(()) };
        match kill_process_group(pid, signal) {
            // It has ended meanwhile.
            Ok(()) | Err(rustix::io::Errno::SRCH) => Ok(()),
            Err(err) => {
                Err(JobsError::Runner(format!("failed to stop the process of job {:?}: {err}", launch.key())))
            }
        }
    }
}

fn pid_of(pid: u32) -> Option<Pid> {
    Pid::from_raw(i32::try_from(pid).ok()?)
}

fn in_words(status: ExitStatus) -> String {
    match (status.signal(), status.code()) {
        (Some(9), _) => {
            "its process was killed (signal 9), by somebody or because memory ran out; see its log".to_owned()
        }
        (Some(signal), _) => format!("its process ended by signal {signal}; see its log"),
        (None, Some(code)) => format!("its process ended with code {code} and left no result; see its log"),
        (None, None) => "its process ended and left no result; see its log".to_owned(),
    }
}
