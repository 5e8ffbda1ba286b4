//! `palpate campaign`: trials of a data folder, with or without a studio that has it open.

use std::{fs, path::PathBuf, process::ExitCode};

use clap::{Args, Subcommand};
use palpate_server::{Error, assets, data::files};
use palpate_trials::{Campaigns, Format, render, results_of_folder};
use palpate_wire::api::CampaignResults;

use super::{Outcome, folder::FolderArgs, output};

#[derive(Subcommand)]
pub(crate) enum CampaignCommand {
    /// Newest first
    List(FolderArgs),
    /// Success rates with intervals, failures, comparisons
    Results(ResultsArgs),
}

#[derive(Args)]
pub(crate) struct ResultsArgs {
    /// Id of the campaign
    id: String,
    #[command(flatten)]
    folder: FolderArgs,
    /// Write the results to this file too; its ending says how: .csv, .tex, .svg, .txt or .json
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(super) fn run(command: &CampaignCommand) -> Outcome {
    match command {
        CampaignCommand::List(args) => list(args)?,
        CampaignCommand::Results(args) => results(args)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn list(args: &FolderArgs) -> Result<(), Error> {
    let campaigns = Campaigns::new(args.data.join("campaigns"), Vec::new()).list()?;
    if args.json {
        return output::json(&campaigns);
    }
    if campaigns.is_empty() {
        return output::line("no campaigns; POST /api/v1/campaigns makes one (docs/campaigns.md)");
    }
    output::line(&format!("{:<24} {:<24} {:>9} {:>9}  state", "campaign", "created", "scored", "to score"))?;
    campaigns.iter().try_for_each(|campaign| {
        let state = match (&campaign.error, &campaign.closed) {
            (Some(error), _) => format!("cannot be read: {error}"),
            (None, Some(time)) => format!("closed {time}"),
            (None, None) => {
                campaign.paused.as_ref().map_or_else(|| "open".to_owned(), |time| format!("paused {time}"))
            }
        };
        let scored = format!("{}/{}", campaign.scored, campaign.planned);
        output::line(&format!(
            "{:<24} {:<24} {scored:>9} {:>9}  {state}",
            campaign.id, campaign.created, campaign.to_score
        ))
    })
}

fn results(args: &ResultsArgs) -> Result<(), Error> {
    files::check_id("campaign", &args.id)?;
    let folder = args.folder.data.join("campaigns").join(&args.id);
    let results = results_of_folder(&folder, &assets::published_results()?)?;
    if let Some(out) = &args.out {
        let ending = out.extension().map(|ending| ending.to_string_lossy().into_owned()).unwrap_or_default();
        let text = match (ending.as_str(), Format::from_ending(&ending)) {
            ("json", _) => json(&results)?,
            (_, Some(format)) => render(&results, format)?,
            _ => {
                return Err(Error::Argument(format!(
                    "file {out:?} has no ending that says how to write it; expected .csv, .tex, .svg, .txt or .json"
                )));
            }
        };
        fs::write(out, text).map_err(Error::io("write", out))?;
    }
    match args.folder.json {
        true => output::json(&results),
        false => output::line(render(&results, Format::Text)?.trim_end()),
    }
}

fn json(results: &CampaignResults) -> Result<String, Error> {
    serde_json::to_string_pretty(results).map_err(|err| Error::Internal(err.to_string()))
}
