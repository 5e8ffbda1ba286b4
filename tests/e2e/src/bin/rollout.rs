//! `palpate-train rollout` without learned policies, which need a tensor library: to be killed or stopped by tests.

use std::process::ExitCode;

use clap::Parser;
use palpate_rollout::RolloutArgs;

#[derive(Parser)]
struct Args {
    #[command(flatten)]
    rollout: RolloutArgs,
}

fn main() -> ExitCode {
    match palpate_rollout::run(&Args::parse().rollout) {
        Ok(()) => ExitCode::SUCCESS,
        Err(err) => {
            eprintln!("rollout: {err:#}");
            ExitCode::FAILURE
        }
    }
}
