//! Makes a small file of a policy, and one of how it learned.

use std::path::PathBuf;

use crate::files::write_in_one_move;
use crate::{curves, policy};

#[derive(clap::Args)]
pub(crate) struct ExportArgs {
    /// A training's folder, or a checkpoint
    #[arg(long)]
    policy: PathBuf,
    /// File to write; the learning curve of a training's folder goes beside it
    #[arg(long)]
    out: PathBuf,
}

pub(crate) fn run(args: &ExportArgs) -> anyhow::Result<()> {
    let (actor, _) = policy::read(&args.policy)?;
    let bytes = actor.to_bytes()?;
    write_in_one_move(&args.out, &bytes)?;
    if args.policy.is_dir() {
        curves::export(&args.policy, &args.out)?;
    }
    eprintln!(
        "{} holds the policy of {} steps in {} kB",
        args.out.display(),
        actor.steps(),
        bytes.len() / 1000
    );
    Ok(())
}
