//! `palpate emulate`.

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use palpate_server::{assets, data::library::Library};
use palpate_terminal::{Bar, cancel_on_ctrl_c};
use palpate_truth::record_session;

use super::{Outcome, output};

#[derive(Args)]
pub(crate) struct EmulateArgs {
    /// What the emulated world is like: a truth file, or the name of a shipped one
    #[arg(long, value_name = "TRUTH.toml")]
    truth: PathBuf,
    /// Folder of the session to make
    #[arg(long, value_name = "SESSION")]
    out: PathBuf,
    /// Same truth, same seed: same bytes
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print what was recorded as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &EmulateArgs) -> Outcome {
    let (truth, _unpacked) = assets::truth(&args.truth)?;
    let session = {
        let bar = Bar::new();
        record_session(&truth, &args.out, args.seed, &bar, &cancel_on_ctrl_c())?
    };
    let detail = Library::default().detail(&session)?;
    if args.json {
        output::json(&detail)?;
    } else {
        let summary = &detail.summary;
        output::line(&format!(
            "recorded {}: {} takes, {} frames, {}",
            session.dir.display(),
            summary.takes,
            summary.frames,
            output::duration(summary.duration_s)
        ))?;
    }
    Ok(ExitCode::SUCCESS)
}
