//! Arguments of commands that look into a data folder.

use std::path::PathBuf;

use clap::Args;

#[derive(Args)]
pub(crate) struct FolderArgs {
    /// The data folder of `palpate serve`
    #[arg(long, value_name = "DIR", default_value = "data")]
    pub(super) data: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub(super) json: bool,
}
