//! `palpate index`: what is known of takes without decoding them.

use std::process::ExitCode;

use clap::Subcommand;
use palpate_server::data::rebuild_index;

use super::{Outcome, folder::FolderArgs, output};

#[derive(Subcommand)]
pub(crate) enum IndexCommand {
    /// Make the index of sessions and takes again from their files
    Rebuild(FolderArgs),
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
