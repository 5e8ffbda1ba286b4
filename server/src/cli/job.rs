//! `palpate job`: what runners of jobs call.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use palpate_jobs::WorkingConfig;
use palpate_server::jobs::run_job;

use super::Outcome;

#[derive(Subcommand)]
pub(crate) enum JobCommand {
    /// Work on the job in a folder, as the studio and clusters do
    Run(RunArgs),
}

#[derive(Args)]
pub(crate) struct RunArgs {
    /// Folder of the job: `runs/ID` of a data folder
    #[arg(long, value_name = "DIR")]
    dir: PathBuf,
    /// Do nothing unless this is the attempt that counts
    #[arg(long, value_name = "N")]
    attempt: Option<u32>,
    /// How much to give way to other processes
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(i32).range(0..=19))]
    nice: i32,
    /// The palpate-train program; without, it is looked for beside this one and on PATH
    #[arg(long, value_name = "FILE")]
    train: Option<PathBuf>,
}

pub(super) fn run(command: &JobCommand) -> Outcome {
    match command {
        JobCommand::Run(args) => {
            let config = WorkingConfig { attempt: args.attempt, nice: args.nice };
            run_job(&args.dir, config, args.train.as_deref())
        }
    }
}
