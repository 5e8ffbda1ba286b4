//! Starts the studio with an emulated station and a recorded session.

use std::{path::PathBuf, process::Command};

use clap::Args;

use crate::{build, paths, shell};

#[derive(Args)]
pub(crate) struct StudioArgs {
    /// Address to listen on
    #[arg(long, default_value = "127.0.0.1:8080")]
    listen: String,
    /// Where sessions, models and runs are kept [default: data in the checkout]
    #[arg(long)]
    data: Option<PathBuf>,
    /// Truth file of the emulated station and of the ready session
    #[arg(long)]
    truth: Option<PathBuf>,
    /// Use this `palpate` instead of building one
    #[arg(long)]
    bin: Option<PathBuf>,
}

/// Builds, records the session once, and serves until interrupted.
pub(crate) fn run(args: &StudioArgs) -> anyhow::Result<()> {
    let palpate = args.bin.clone().map_or_else(build::release, Ok)?;
    let data = args.data.clone().unwrap_or_else(|| paths::root().join("data"));
    let truth = args.truth.clone().unwrap_or_else(|| paths::root().join("assets/truth/demo.toml"));
    let session = data.join("sessions").join("demo");
    if !session.exists() {
        eprintln!("recording the demo session on the emulated station (once)");
        shell::run(
            Command::new(&palpate).arg("emulate").arg("--truth").arg(&truth).arg("--out").arg(&session),
        )?;
    }
    shell::become_command(
        Command::new(&palpate)
            .args(["serve", "--listen", &args.listen])
            .arg("--data")
            .arg(&data)
            .arg("--emulate")
            .arg(&truth),
    )
}
