//! Jobs: long work as data, which survives the studio that was asked for it.
//!
//! [`Scheduler`] takes jobs, starts them when it is their turn and notes how they end, in the [`Database`] of the data
//! folder. A job runs wherever a [`Runner`] puts it: as a process of this computer, or on a Slurm cluster. Both ends
//! share the job's [`JobFolder`] and nothing else; [`Working`] is the end in the job's own process. What a kind of job
//! computes is the caller's business.

mod clock;
mod database;
mod error;
mod folder;
mod inputs;
mod plan;
mod process_id;
mod runner;
mod scheduler;
mod working;

pub use clock::{rfc3339, rfc3339_now, seconds_between};
pub use database::{Database, JobTotals, ListFilter, Submitted};
pub use error::JobsError;
pub use folder::{FolderLock, JobFolder, Shard};
pub use inputs::check_inputs;
pub use runner::{
    Capacity, Launch, ProcessRunner, ProcessRunnerConfig, RunState, Runner, SlurmConfig, SlurmRunner,
    StationVariables, runners,
};
pub use scheduler::{Observer, Scheduler, SchedulerConfig, Submission};
pub use working::{Begun, Outcome, Working, WorkingConfig, on_stop_request};
