//! `palpate contact-map`.

use std::{fs, path::PathBuf, process::ExitCode};

use clap::{Args, Subcommand};
use palpate_calibration::{
    CalibrationConfig,
    contact_map::{
        ContactMap, MapConfig,
        judge::{number, sentences},
    },
};
use palpate_recording::Session;
use palpate_reports::{ContactMapReport, ContactRow};
use palpate_server::{
    Error,
    data::{files, library::Library},
    jobs::{ContactMapConfig, ContactTarget, fit_contact_map, judge_contact_map},
};
use palpate_sim::SensorModel;
use palpate_terminal::{Bar, cancel_on_ctrl_c};

use super::{Outcome, calibrate::hold_out, output};

#[derive(Subcommand)]
pub(crate) enum ContactMapCommand {
    /// Learn one on some takes of a session, and judge it on the others beside the station's thresholds
    Fit(FitArgs),
    /// Judge one on takes that it has not seen, beside the station's thresholds
    Judge(JudgeArgs),
}

#[derive(Args)]
pub(crate) struct FitArgs {
    /// Folder of the session, whose takes hold raw readings
    #[arg(long, value_name = "SESSION")]
    session: PathBuf,
    /// Write the map here
    #[arg(long, value_name = "MAP.toml")]
    out: Option<PathBuf>,
    /// Whose contacts it learns: nominal, calibrated or diagnosed (both fitted to the same takes as the map), or the file of a
    /// sensor model
    #[arg(long, value_name = "nominal|calibrated|diagnosed|MODEL.toml", default_value = "calibrated")]
    target: String,
    /// Takes that judge and are not fitted to, by id; `auto` keeps about a third of them
    #[arg(long, value_name = "TAKE,...|auto", default_value = "auto")]
    hold_out: String,
    /// Judge every take by a map that was fitted to all others, instead of the held-out takes alone
    #[arg(long)]
    leave_one_out: bool,
    /// Judge beside the diagnosed model as well, which takes longer
    #[arg(long)]
    diagnose: bool,
    /// Units of the hidden layer; 0 for a linear map
    #[arg(long, value_name = "N", default_value_t = MapConfig::default().hidden)]
    hidden: usize,
    /// Seed of first weights, of the order of samples and of the resampling behind the intervals
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub(crate) struct JudgeArgs {
    /// The map
    #[arg(long, value_name = "MAP.toml")]
    map: PathBuf,
    /// Folder of the session that judges
    #[arg(long, value_name = "SESSION")]
    session: PathBuf,
    /// Judge beside the station's thresholds with this sensor model as well; may be given several times
    #[arg(long, value_name = "MODEL.toml")]
    model: Vec<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// Most units of a hidden layer: beyond that a map knows its takes by heart.
const MOST_HIDDEN: usize = 256;

pub(super) fn run(command: &ContactMapCommand) -> Outcome {
    match command {
        ContactMapCommand::Fit(args) => fit(args),
        ContactMapCommand::Judge(args) => judge(args),
    }
}

fn fit(args: &FitArgs) -> Outcome {
    let session = Session::open(&args.session)?;
    if let Some(out) = &args.out {
        files::check_target(out)?;
    }
    if args.hidden > MOST_HIDDEN {
        return Err(Error::Argument(format!("--hidden is {}, expected at most {MOST_HIDDEN}", args.hidden)));
    }
    let target = match args.target.as_str() {
        "nominal" => ContactTarget::Nominal,
        "calibrated" => ContactTarget::Calibrated,
        "diagnosed" => ContactTarget::Diagnosed,
        path => ContactTarget::Model(Box::new(read_model(&PathBuf::from(path))?)),
    };
    let config = ContactMapConfig {
        target,
        hold_out: hold_out(&args.hold_out, &session)?,
        leave_one_out: args.leave_one_out,
        diagnose: args.diagnose,
        map: MapConfig { hidden: args.hidden, seed: args.seed, ..MapConfig::default() },
        resamples: CalibrationConfig::default().bootstrap_resamples,
    };
    let artifacts = {
        let bar = Bar::new();
        fit_contact_map(&Library::default(), &session, &config, &bar, &cancel_on_ctrl_c())?
    };
    if let Some(out) = &args.out {
        files::write(out, artifacts.map.to_toml().as_bytes())?;
    }
    print(&artifacts.report, args.json)
}

fn judge(args: &JudgeArgs) -> Outcome {
    let session = Session::open(&args.session)?;
    let text = fs::read_to_string(&args.map).map_err(Error::io("read", &args.map))?;
    let map = ContactMap::from_toml(&args.map.display().to_string(), &text)?;
    let models = args.model.iter().map(read_model).collect::<Result<Vec<_>, Error>>()?;
    let report = {
        let bar = Bar::new();
        let resamples = CalibrationConfig::default().bootstrap_resamples;
        judge_contact_map(&Library::default(), &session, &map, &models, resamples, &bar, &cancel_on_ctrl_c())?
    };
    print(&report, args.json)
}

fn read_model(path: &PathBuf) -> Result<SensorModel, Error> {
    let text = fs::read_to_string(path).map_err(Error::io("read", path))?;
    Ok(SensorModel::from_toml(&path.display().to_string(), &text)?)
}

fn print(report: &ContactMapReport, json: bool) -> Outcome {
    if json {
        output::json(report)?;
    } else {
        output::line(&text(report))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn text(report: &ContactMapReport) -> String {
    let how = if report.leave_one_out {
        format!("{} takes, each for a map that was fitted to all others", report.judged_takes.len())
    } else {
        format!("{} takes that the map has not seen", report.judged_takes.len())
    };
    let mut lines =
        vec![format!("Judged on {how}; target: contacts of the model {:?}.", report.target), String::new()];
    lines.push(format!(
        "{:<14} {:<32} {:>10} {:>16} {:>12} {:>16} {:>12} {:>9}",
        "hardware", "simulation", "onset (ms)", "95 %", "F1", "95 %", "offset (ms)", "coverage"
    ));
    lines.extend(report.rows.iter().map(row));
    lines.push(String::new());
    lines.extend(sentences(report));
    if !report.streams.is_empty() {
        lines.push(String::new());
    }
    for (id, stream) in &report.streams {
        lines.push(format!(
            "{id}: {} channel-frames fitted, {:.1} % contact, mean loss {:.4}, F1 {:.3} on the fitted takes",
            stream.samples,
            100.0 * stream.contact,
            stream.loss,
            stream.f1
        ));
    }
    lines.push(format!("\nfitted: {}", report.fitted_takes.join(", ")));
    lines.push(format!("judged: {}", report.judged_takes.join(", ")));
    lines.extend(report.notes.iter().map(|note| format!("note: {note}")));
    lines.join("\n")
}

fn row(row: &ContactRow) -> String {
    let intervals = row.intervals_95.clone().unwrap_or_default();
    let interval = |of: Option<[f64; 2]>, digits: usize| {
        of.map_or_else(String::new, |[low, high]| format!("{low:.digits$} to {high:.digits$}"))
    };
    format!(
        "{:<14} {:<32} {:>10} {:>16} {:>12} {:>16} {:>12} {:>9}",
        row.hardware,
        row.simulation,
        number(row.metrics.onset_error_ms, 0),
        interval(intervals.onset_error_ms, 0),
        number(row.metrics.f1, 3),
        interval(intervals.f1, 3),
        number(row.metrics.offset_error_ms, 0),
        number(row.metrics.onset_coverage, 3),
    )
}
