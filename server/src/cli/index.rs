//! `palpate index`: what is known of takes without decoding them.

use std::{path::PathBuf, process::ExitCode};

use clap::{Args, Subcommand};
use palpate_server::data::rebuild_index;

use super::{Outcome, output};

#[derive(Subcommand)]
pub(crate) enum IndexCommand {
    /// Make the index of sessions and takes again from their files
    Rebuild(RebuildArgs),
}

#[derive(Args)]
pub(crate) struct RebuildArgs {
    /// The data folder of `palpate serve`
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(command: &IndexCommand) -> Outcome {
    let IndexCommand::Rebuild(args) = command;
    let report = rebuild_index(&args.data)?;
    if args.json {
        output::json(&report)?;
        return Ok(ExitCode::SUCCESS);
    }
    for problem in &report.problems {
        output::line(&format!("left out {problem}"))?;
    }
    output::line(&format!("sessions: {}, takes: {}", report.sessions, report.takes))?;
    Ok(ExitCode::SUCCESS)
}
