//! `palpate import`.

mod explain;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use palpate_recording::{
    Session,
    import::{self, ImportOptions, MAPPING_FILE, Mapping},
    load_station,
};
use palpate_robot_model::Station;
use palpate_server::{Error, assets, data::library::Library};

use super::{Outcome, output};

/// Bad input, as with every command.
const NOT_OK: u8 = 2;

#[derive(Args)]
pub(crate) struct ImportArgs {
    /// Folder with the recordings: one sub-folder a take with take.toml, joints.csv and one CSV or Parquet file a stream, or
    /// whatever the mapping file says (docs/recordings.md)
    #[arg(long, value_name = "DIR")]
    csv: PathBuf,
    /// Folder of the session to make
    #[arg(long, value_name = "SESSION", required_unless_present = "explain")]
    out: Option<PathBuf>,
    /// The station they were recorded on: a station file, or the id of a shipped one [default: the one that the mapping
    /// file names, or the only shipped one whose joints, streams and objects the recordings have]
    #[arg(long, value_name = "FILE|ID")]
    station: Option<String>,
    /// What files and columns mean, where they are not called as the station calls them [default: mapping.toml in DIR,
    /// if there is one]
    #[arg(long, value_name = "FILE")]
    mapping: Option<PathBuf>,
    /// Print what is understood of the recordings, and write nothing; exit code 2 if they cannot be imported
    #[arg(long, conflicts_with = "out")]
    explain: bool,
    /// Print what was imported, or understood, as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ImportArgs) -> Outcome {
    let beside = args.csv.join(MAPPING_FILE);
    let mapping = match &args.mapping {
        Some(path) => Some(Mapping::read(path)?),
        None if beside.exists() => Some(Mapping::read(&beside)?),
        None => None,
    };
    let (station, because) = station(args, mapping.as_ref())?;
    let options = ImportOptions { mapping: mapping.as_ref(), find_repetitions: true };
    let Some(out) = args.out.as_ref().filter(|_| !args.explain) else {
        let mut report = import::explain(&station, &args.csv, options)?;
        report.station_because = because;
        if args.json {
            output::json(&report)?;
        } else {
            output::line(&explain::text(&report))?;
        }
        return Ok(if report.ok { ExitCode::SUCCESS } else { ExitCode::from(NOT_OK) });
    };
    let (dir, report) = import::import(&station, &args.csv, options, out)?;
    let detail = Library::default().detail(&Session::open(&dir)?)?;
    if args.json {
        output::json(&detail)?;
    } else {
        output::line(&format!("station {}: {because}", station.id))?;
        for take in &report.takes {
            for warning in &take.warnings {
                output::line(&format!("warning: {}: {warning}", take.take))?;
            }
        }
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

/// The station, and why it is that one.
fn station(args: &ImportArgs, mapping: Option<&Mapping>) -> Result<(Station, String), Error> {
    if let Some(file_or_id) = &args.station {
        return Ok((named_station(file_or_id, Path::new(""))?, "given with --station".to_owned()));
    }
    if let Some(mapping) = mapping
        && let Some(file_or_id) = mapping.station()
    {
        let folder = mapping.path().parent().unwrap_or(Path::new(""));
        return Ok((named_station(file_or_id, folder)?, format!("named by {}", mapping.path().display())));
    }
    assets::station_of_recordings(&args.csv, mapping)
}

/// The station file, relative to `folder`, or the shipped station of that id.
pub(super) fn named_station(file_or_id: &str, folder: &Path) -> Result<Station, Error> {
    let path = folder.join(file_or_id);
    // What looks like a file is reported as a missing file, not as an unknown id.
    if path.exists() || path.extension().is_some() || file_or_id.contains('/') {
        Ok(load_station(&path)?)
    } else {
        assets::station(file_or_id)
    }
}
