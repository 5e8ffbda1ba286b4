//! Where jobs run.

mod file;
mod process;
mod slurm;

pub use file::runners;
use palpate_wire::api::{JobExit, JobSpec};
pub use process::{ProcessRunner, ProcessRunnerConfig};
pub use slurm::{SlurmConfig, SlurmRunner};

use crate::{JobFolder, JobsError};

/// One attempt at a job.
#[derive(Clone, Debug, PartialEq)]
pub struct Launch {
    /// Id of the job.
    pub id: String,
    /// Which attempt; the first is 1.
    pub attempt: u32,
    /// What is asked.
    pub spec: JobSpec,
    /// The job's folder.
    pub folder: JobFolder,
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
}
