//! The command line of programs that do nothing but roll out.

use std::process::ExitCode;

use clap::{CommandFactory as _, FromArgMatches as _, Parser};

use crate::{RolloutArgs, run};

#[derive(Parser)]
#[command(about = "Trials of a policy on the hand that a studio drives", version)]
struct Args {
    #[command(flatten)]
    rollout: RolloutArgs,
}

/// Does what the command line of the program `name` says, and prints what went wrong.
pub fn command(name: &'static str) -> ExitCode {
    let matches = Args::command().name(name).get_matches();
    let args = Args::from_arg_matches(&matches).unwrap_or_else(|err| err.exit());
    match run(&args.rollout) {
        Ok(()) => ExitCode::SUCCESS,
        Err(err) => {
            eprintln!("{name}: {err:#}");
            ExitCode::FAILURE
        }
    }
}
