//! `palpate calibrate`.

use std::{path::PathBuf, process::ExitCode};

use clap::{Args, ValueEnum};
use palpate_calibration::{CalibrationConfig, HoldOut, Method, report::headline};
use palpate_recording::Session;
use palpate_reports::{CalibrationReport, Metrics, StreamFit};
use palpate_server::{
    Error,
    data::{files, library::Library},
    jobs::calibrate_session,
};
use palpate_terminal::{Bar, cancel_on_ctrl_c};

use super::{Outcome, report::ReportArgs};

#[derive(Args)]
pub(crate) struct CalibrateArgs {
    /// Folder of the session
    #[arg(long, value_name = "SESSION")]
    session: PathBuf,
    /// How to search
    #[arg(long, value_enum, default_value = "exact")]
    method: MethodArg,
    /// Takes that the fit must not see, by id; `auto` keeps about a third of them
    #[arg(long, value_name = "TAKE,...|auto", default_value = "auto")]
    hold_out: String,
    /// Fit one theta to all streams of a kind; else each stream has its own
    #[arg(long)]
    shared_theta: bool,
    /// Write the fitted model here
    #[arg(long, value_name = "MODEL.toml")]
    out: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArgs,
}

#[derive(Clone, Copy, ValueEnum)]
enum MethodArg {
    /// The best thresholds over all real values, by sorting
    Exact,
    /// The paper's grid
    Grid,
}

pub(super) fn run(args: &CalibrateArgs) -> Outcome {
    let session = Session::open(&args.session)?;
    if let Some(out) = &args.out {
        files::check_target(out)?;
    }
    let config = CalibrationConfig {
        method: match args.method {
            MethodArg::Exact => Method::Exact,
            MethodArg::Grid => Method::Grid,
        },
        hold_out: hold_out(&args.hold_out, &session)?,
        shared_theta: args.shared_theta,
        seed: args.report.seed,
        ..CalibrationConfig::default()
    };
    let artifacts = {
        let bar = Bar::new();
        calibrate_session(&Library::default(), &session, &config, &bar, &cancel_on_ctrl_c())?
    };
    args.report.write(args.out.as_deref(), &artifacts.report, &artifacts.html, &artifacts.model)?;
    args.report.print(&artifacts.report, text)?;
    Ok(ExitCode::SUCCESS)
}

/// What `--hold-out` asks for.
pub(super) fn hold_out(text: &str, session: &Session) -> Result<HoldOut, Error> {
    if text == "auto" {
        return Ok(HoldOut::Auto);
    }
    let ids: Vec<String> = text.split(',').map(|id| id.trim().to_owned()).collect();
    for id in &ids {
        if !session.file.takes.iter().any(|take| take.id() == id) {
            let takes: Vec<&str> = session.file.takes.iter().map(|take| take.id()).collect();
            return Err(Error::Argument(format!(
                "--hold-out: no take {id:?} in session {:?}; its takes are {}",
                session.id,
                takes.join(", ")
            )));
        }
    }
    Ok(HoldOut::Takes(ids))
}

fn text(report: &CalibrationReport) -> String {
    let mut lines = vec![headline(report), String::new()];
    lines.push(format!(
        "{:<24} {:>12} {:>12} {:>8} {:>9} {:>10}",
        "", "onset (ms)", "offset (ms)", "F1", "FPR", "L1"
    ));
    let mut row = |label: &str, metrics: &Metrics| {
        lines.push(format!(
            "{label:<24} {:>12} {:>12} {:>8} {:>9} {:>10}",
            number(metrics.onset_error_ms, 0),
            number(metrics.offset_error_ms, 0),
            number(metrics.f1, 3),
            number(metrics.fpr, 4),
            metrics.l1
        ));
    };
    if !report.held_out_takes.is_empty() {
        row("held out, nominal", &report.held_out.nominal);
        row("held out, calibrated", &report.held_out.calibrated);
    }
    row("all takes, nominal", &report.nominal);
    row("all takes, calibrated", &report.calibrated);
    let theta = &report.theta;
    if report.streams.is_empty() {
        lines.push(format!(
            "\nlambda_con {:.3} mm, alpha {:.1} 1/m, lambda_pre {:.1} Pa",
            theta.lambda_con_m * 1000.0,
            theta.alpha_per_m,
            theta.lambda_pre_pa
        ));
    } else {
        lines.push(format!(
            "\n{:<24} {:>15} {:>13} {:>15}",
            "stream", "lambda_con (mm)", "alpha (1/m)", "lambda_pre (Pa)"
        ));
        for (stream, StreamFit { theta, .. }) in &report.streams {
            lines.push(format!(
                "{stream:<24} {:>15} {:>13} {:>15}",
                number(theta.lambda_con_m.map(|lambda_con_m| lambda_con_m * 1000.0), 3),
                number(theta.alpha_per_m, 1),
                number(theta.lambda_pre_pa, 1),
            ));
        }
    }
    let takes =
        if report.held_out_takes.is_empty() { "none".to_owned() } else { report.held_out_takes.join(", ") };
    lines.push(format!("held out: {takes}"));
    lines.push(format!(
        "{} search: {} evaluations in {:.2} s, {} frames, {} channels",
        report.method, report.evaluations, report.seconds, report.frames, report.channels
    ));
    lines.extend(report.notes.iter().map(|note| format!("note: {note}")));
    lines.join("\n")
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}
