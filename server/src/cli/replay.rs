//! `palpate replay`.

use std::{fs, path::PathBuf, process::ExitCode};

use clap::Args;
use palpate_calibration::PairedTake;
use palpate_recording::Take;
use palpate_server::{Error, data::files, jobs::write_replay};
use palpate_sim::{SensorModel, job::Progress as _};
use palpate_terminal::Bar;
use serde_json::json;

use super::{Outcome, output};

#[derive(Args)]
pub(crate) struct ReplayArgs {
    /// The recorded take
    #[arg(long, value_name = "FILE")]
    take: PathBuf,
    /// The sensor model
    #[arg(long, value_name = "MODEL.toml")]
    model: PathBuf,
    /// The take to write, with simulated events in place of the recorded ones
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// Print what was written as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ReplayArgs) -> Outcome {
    files::check_target(&args.out)?;
    let text = fs::read_to_string(&args.model).map_err(Error::io("read", &args.model))?;
    let model = SensorModel::from_toml(&args.model.display().to_string(), &text)?;
    let take = Take::read(&args.take)?;
    {
        let bar = Bar::new();
        bar.report(0.0, "replaying");
        let contact = PairedTake::from_take(&take)?;
        write_replay(&take, &contact, &model, &args.out, &bar)?;
    }
    let (frames, channels) = (take.num_frames(), take.station.layout.num_channels());
    if args.json {
        output::json(&json!({
            "take": take.id,
            "model": model.name,
            "out": args.out,
            "frames": frames,
            "channels": channels,
        }))?;
    } else {
        output::line(&format!(
            "wrote {}: {frames} frames of {channels} channels, model {:?}",
            args.out.display(),
            model.name
        ))?;
    }
    Ok(ExitCode::SUCCESS)
}
