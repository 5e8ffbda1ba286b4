//! `palpate completions` and `palpate man`: from the same definition as `--help`.

use std::{
    fs,
    io::{self, Write as _},
    path::PathBuf,
    process::ExitCode,
};

use clap::{Args, Command};
use clap_complete::Shell;
use palpate_server::Error;

use super::Outcome;

#[derive(Args)]
pub(crate) struct CompletionsArgs {
    /// bash, zsh, fish, elvish or powershell
    shell: Shell,
}

#[derive(Args)]
pub(crate) struct ManArgs {
    /// Folder for the pages, a file a command; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(super) fn completions(args: &CompletionsArgs, mut command: Command) -> Outcome {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "palpate", &mut text);
    match io::stdout().lock().write_all(&text) {
        Err(err) if err.kind() != io::ErrorKind::BrokenPipe => {
            Err(Error::Io { action: "write", path: "standard output".into(), source: err })
        }
        _ => Ok(ExitCode::SUCCESS),
    }
}

pub(super) fn man(args: &ManArgs, command: Command) -> Outcome {
    fs::create_dir_all(&args.out).map_err(Error::io("make", &args.out))?;
    clap_mangen::generate_to(command, &args.out).map_err(Error::io("write man pages to", &args.out))?;
    Ok(ExitCode::SUCCESS)
}
