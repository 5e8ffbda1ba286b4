//! Makes a small file of a policy, and one of how it learned; or a small file of an encoder.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use palpate_encoder::{CHECKPOINT_FILE, Encoder};

use crate::files::write_in_one_move;
use crate::{curves, policy};

#[derive(clap::Args)]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    of: Of,
    /// File to write; the learning curve of a policy's folder goes beside it
    #[arg(long)]
    out: PathBuf,
}

#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct Of {
    /// A training's folder, or a checkpoint
    #[arg(long)]
    policy: Option<PathBuf>,
    /// The same of a pretraining
    #[arg(long)]
    encoder: Option<PathBuf>,
}

pub(crate) fn run(args: &ExportArgs) -> anyhow::Result<()> {
    match &args.of {
        Of { policy: Some(policy), .. } => export_policy(policy, &args.out),
        Of { encoder, .. } => {
            export_encoder(encoder.as_deref().context("--policy or --encoder is given")?, &args.out)
        }
    }
}

fn export_policy(path: &Path, out: &Path) -> anyhow::Result<()> {
    let (actor, _) = policy::read(path)?;
    let bytes = actor.to_bytes()?;
    write_in_one_move(out, &bytes)?;
    if path.is_dir() {
        curves::export(path, out)?;
    }
    eprintln!("{} holds the policy of {} steps in {} kB", out.display(), actor.steps(), bytes.len() / 1000);
    Ok(())
}

/// The encoder of a pretraining's folder, of a checkpoint or of an exported file.
pub(crate) fn encoder(path: &Path) -> anyhow::Result<Encoder> {
    let file = if path.is_dir() { path.join(CHECKPOINT_FILE) } else { path.to_owned() };
    let bytes = std::fs::read(&file).with_context(|| {
        format!(
            "failed to read {file:?}; --encoder is a pretraining's folder, a checkpoint or an exported encoder"
        )
    })?;
    Ok(Encoder::from_bytes(&file, &bytes)?)
}

fn export_encoder(path: &Path, out: &Path) -> anyhow::Result<()> {
    let encoder = encoder(path)?;
    let bytes = encoder.to_bytes()?;
    write_in_one_move(out, &bytes)?;
    eprintln!(
        "{} holds the encoder of {} updates in {} kB",
        out.display(),
        encoder.updates(),
        bytes.len() / 1000
    );
    Ok(())
}
