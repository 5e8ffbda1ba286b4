//! The `palpate-rollout` command: trials of a policy on the hand that a studio drives.

use std::process::ExitCode;

use clap::Parser;
use palpate_rollout::RolloutArgs;

#[derive(Parser)]
#[command(name = "palpate-rollout", about = "Trials of a policy on the hand that a studio drives", version)]
struct Args {
    #[command(flatten)]
    rollout: RolloutArgs,
}

fn main() -> ExitCode {
    match palpate_rollout::run(&Args::parse().rollout) {
        Ok(()) => ExitCode::SUCCESS,
        Err(err) => {
            eprintln!("palpate-rollout: {err:#}");
            ExitCode::FAILURE
        }
    }
}
