//! `palpate import`.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use palpate_recording::{Session, import::import_csv, load_station};
use palpate_robot_model::Station;
use palpate_server::{Error, assets, data::library::Library};

use super::{Outcome, output};

#[derive(Args)]
pub(crate) struct ImportArgs {
    /// Folder with one sub-folder a take: joints.csv, one CSV file a stream, take.toml
    #[arg(long, value_name = "DIR")]
    csv: PathBuf,
    /// Folder of the session to make
    #[arg(long, value_name = "SESSION")]
    out: PathBuf,
    /// The station they were recorded on: a station file, or the id of a shipped one [default: the shipped one whose
    /// streams the first take has]
    #[arg(long, value_name = "FILE|ID")]
    station: Option<String>,
    /// Print what was imported as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ImportArgs) -> Outcome {
    let station = match &args.station {
        Some(file_or_id) => station(file_or_id)?,
        None => assets::station_of_recordings(&args.csv)?,
    };
    let dir = import_csv(&station, &args.csv, &args.out)?;
    let detail = Library::default().detail(&Session::open(&dir)?)?;
    if args.json {
        output::json(&detail)?;
    } else {
        let summary = &detail.summary;
        output::line(&format!(
            "imported {}: {} takes, {} frames, {}; `palpate session check` says whether they can be used",
            dir.display(),
            summary.takes,
            summary.frames,
            output::duration(summary.duration_s)
        ))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn station(file_or_id: &str) -> Result<Station, Error> {
    let path = Path::new(file_or_id);
    // What looks like a file is reported as a missing file, not as an unknown id.
    if path.exists() || path.extension().is_some() || file_or_id.contains('/') {
        Ok(load_station(path)?)
    } else {
        assets::station(file_or_id)
    }
}
