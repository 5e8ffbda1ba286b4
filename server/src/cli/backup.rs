//! `palpate backup`.

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use palpate_server::backup;

use super::{Outcome, output};

#[derive(Args)]
pub(crate) struct BackupArgs {
    /// The data folder of `palpate serve`; a studio may have it open
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    /// The new file, a tar archive; unpacking it into an empty folder gives a data folder
    #[arg(long, value_name = "FILE.tar")]
    out: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &BackupArgs) -> Outcome {
    let report = backup(&args.data, &args.out)?;
    if args.json {
        output::json(&report)?;
        return Ok(ExitCode::SUCCESS);
    }
    output::line(&format!(
        "{}: {} files, {:.1} MB; restore with: mkdir DIR && tar -xf {0} -C DIR",
        args.out.display(),
        report.files,
        report.bytes as f64 / 1e6
    ))?;
    for link in &report.links {
        output::line(&format!("{} is a link: what it leads to is not in the backup", link.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}
