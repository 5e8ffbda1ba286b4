//! Set-up, build, run, test: what the README and CI call.
//!
//! Every command installs what it needs first (the wasm target or Debian's toolchain with the standard library's source,
//! Chromium, Node, Python packages and MuJoCo's library) and says plainly what is missing where it cannot.

mod browser;
mod build;
mod documentation;
mod mujoco;
mod others;
mod page;
mod paths;
mod programs;
mod python;
mod shell;
mod skip;
mod slurm;
mod studio;
mod test;
mod wasm;

use std::{path::PathBuf, process::ExitCode};

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "cargo xtask", about = "Set up, build, run and test Palpate")]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Build everything and start the studio with an emulated station and a recorded session
    Studio(studio::StudioArgs),
    /// Build the page and `target/release/palpate`
    Build,
    /// Build the page only, into target/page
    BuildUi,
    /// Install what the tests need, then run every test
    Test(test::TestArgs),
    /// What CI runs: formatting, lints, links of the documentation, every test
    Check,
    /// Have pandas, pyarrow and `datasets` read an exported session: 400 MB of Python packages
    CheckLerobot(others::LerobotArgs),
    /// Have Foxglove's client library watch an emulated station: 7 MB of npm packages
    CheckFoxglove(others::FoxgloveArgs),
    /// Fetch MuJoCo's library and print its folder
    Mujoco,
    /// Take the README's screenshot from a running studio
    Screenshot {
        /// Address of the studio, as it printed it
        #[arg(long)]
        url: String,
        /// Folder for the pictures
        #[arg(long)]
        out: PathBuf,
    },
}

fn main() -> anyhow::Result<ExitCode> {
    if let Some(rustdoc) = documentation::stood_in_for() {
        return documentation::stand_in(&rustdoc);
    }
    run(Args::parse().command).map(|()| ExitCode::SUCCESS)
}

fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Studio(args) => studio::run(&args),
        Command::Build => build::release().map(|binary| println!("built {}", binary.display())),
        Command::BuildUi => wasm::build_page(false).map(|dir| println!("built {}", dir.display())),
        Command::Test(args) => test::run(&args),
        Command::Check => test::check(),
        Command::CheckLerobot(args) => others::lerobot(&args),
        Command::CheckFoxglove(args) => others::foxglove(&args),
        Command::Mujoco => mujoco::link_dir().map(|dir| println!("{}", dir.display())),
        Command::Screenshot { url, out } => browser::screenshots(&url, &out),
    }
}
