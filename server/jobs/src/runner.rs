//! Where jobs run.

mod file;
mod process;
mod slurm;

pub use file::runners;
use palpate_wire::api::{JobExit, Resources};
pub use process::{ProcessRunner, ProcessRunnerConfig, StationVariables};
pub use slurm::{SlurmConfig, SlurmRunner};

use crate::{JobFolder, JobsError};

/// One attempt at a job.
#[derive(Clone, Debug, PartialEq)]
pub struct Launch {
    /// Id of the job.
    pub id: String,
    /// Which of its shards; `None` for the job itself.
    pub shard: Option<u32>,
    /// Which attempt; the first is 1.
    pub attempt: u32,
    /// What it needs.
    pub resources: Resources,
    /// The job's folder, or its shard's.
    pub folder: JobFolder,
}

impl Launch {
    /// What tells the attempt's job or shard from all others.
    pub fn key(&self) -> String {
        match self.shard {
            None => self.id.clone(),
            Some(shard) => format!("{}/{shard}", self.id),
        }
    }
}

/// Where an attempt stands.
#[derive(Clone, Debug, PartialEq)]
pub enum RunState {
    /// It waits in the runner's own queue.
    Waiting(String),
    /// It works.
    Running,
    /// It ended and said how.
    Ended(JobExit),
    /// It ended without a word; why, as far as the runner knows.
    Died(String),
    /// Nobody knows it: it was never started, or it was cut off while nobody watched.
    Lost,
}

/// What the jobs of a runner share, for the scheduler to divide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capacity {
    /// Cores.
    pub cores: u32,
    /// Whether there is a GPU.
    pub gpu: bool,
    /// Short jobs that may run beside all others.
    pub short_jobs: u32,
}

/// Starts attempts, watches them, ends them. Calls may take as long as a program takes to start, or a network to
/// answer; they come from one thread.
pub trait Runner: Send + Sync {
    /// Name, as jobs and `runners.toml` give it.
    fn name(&self) -> &str;

    /// What is there to be divided; `None` for a runner with a queue of its own, which is given jobs at once.
    fn capacity(&self) -> Option<Capacity>;

    /// Starts `launch`; gives what the runner knows it by. Where that is never written down, because the studio is
    /// killed now, [`Runner::state`] must find the attempt without it.
    fn submit(&self, launch: &Launch) -> Result<String, JobsError>;

    /// Where `launch` stands. `handle` is what [`Runner::submit`] gave, if it was written down.
    fn state(&self, launch: &Launch, handle: Option<&str>) -> Result<RunState, JobsError>;

    /// Asks `launch` to stop, or, with `insists`, ends it.
    fn cancel(&self, launch: &Launch, handle: Option<&str>, insists: bool) -> Result<(), JobsError>;

    /// Starts shards of one job, all with the same number of attempt, of which `max_at_once` may work at once.
    /// [`Runner::state`] finds each without a handle.
    fn submit_shards(&self, shards: &[Launch], _max_at_once: u32) -> Result<(), JobsError> {
        shards.iter().try_for_each(|shard| self.submit(shard).map(|_| ()))
    }

    /// Asks shards of one job to stop, or, with `insists`, ends them.
    fn cancel_shards(&self, shards: &[Launch], insists: bool) -> Result<(), JobsError> {
        shards.iter().try_for_each(|shard| self.cancel(shard, None, insists))
    }
}
