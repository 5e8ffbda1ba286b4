//! Arguments of commands that judge a simulator, and what these commands leave.

use std::{
    fs,
    path::{Path, PathBuf},
};

use clap::Args;
use palpate_server::{Error, data::files};
use palpate_sim::SensorModel;
use serde::Serialize;

use super::output;

#[derive(Args)]
pub(crate) struct ReportArgs {
    /// Write report.json, report.html and model.toml into this folder
    #[arg(long = "report", value_name = "DIR")]
    dir: Option<PathBuf>,
    /// Seed of the resampling behind the intervals
    #[arg(long, default_value_t = 0)]
    pub(super) seed: u64,
    /// Print the report as JSON
    #[arg(long)]
    pub(super) json: bool,
}

impl ReportArgs {
    /// Writes what was found into the folder that is asked for, and the model to `out` as well.
    pub(super) fn write(
        &self,
        out: Option<&Path>,
        report: &impl Serialize,
        html: &str,
        model: &SensorModel,
    ) -> Result<(), Error> {
        let model = model.to_toml();
        if let Some(dir) = &self.dir {
            fs::create_dir_all(dir).map_err(Error::io("make", dir))?;
            let json = serde_json::to_vec_pretty(report).map_err(|err| Error::Internal(err.to_string()))?;
            files::write(&dir.join("report.json"), &json)?;
            files::write(&dir.join("report.html"), html.as_bytes())?;
            files::write(&dir.join("model.toml"), model.as_bytes())?;
        }
        out.map_or(Ok(()), |out| files::write(out, model.as_bytes()))
    }

    /// Prints `report`, for people as `text` has it.
    pub(super) fn print<R: Serialize>(&self, report: &R, text: fn(&R) -> String) -> Result<(), Error> {
        if self.json { output::json(report) } else { output::line(&text(report)) }
    }
}
