//! `palpate session check`.

use std::{path::PathBuf, process::ExitCode};

use clap::{Args, Subcommand};
use palpate_recording::{Session, check_session};
use palpate_reports::{CheckReport, Severity};

use super::{Outcome, output};

/// Bad input, as with every command.
const NOT_OK: u8 = 2;

#[derive(Subcommand)]
pub(crate) enum SessionCommand {
    /// Rates, gaps, clock order, coverage, and what is wrong; exit code 2 if the session cannot be used
    Check(CheckArgs),
}

#[derive(Args)]
pub(crate) struct CheckArgs {
    /// Folder of the session
    #[arg(value_name = "SESSION")]
    session: PathBuf,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(command: &SessionCommand) -> Outcome {
    let SessionCommand::Check(args) = command;
    let report = check_session(&Session::open(&args.session)?)?;
    if args.json {
        output::json(&report)?;
    } else {
        output::line(text(&report).trim_end())?;
    }
    Ok(if report.ok { ExitCode::SUCCESS } else { ExitCode::from(NOT_OK) })
}

fn text(report: &CheckReport) -> String {
    let mut lines = vec![format!(
        "{}: {} takes, {} frames, {}",
        report.session,
        report.takes.len(),
        report.frames,
        output::duration(report.duration_s)
    )];
    lines.push(format!(
        "\n{:<12} {:<12} {:>8} {:>9} {:>9} {:>12} {:>6} {:>6}",
        "take", "stream", "samples", "Hz", "nominal", "longest gap", "gaps", "back"
    ));
    for take in &report.takes {
        for stream in &take.streams {
            lines.push(format!(
                "{:<12} {:<12} {:>8} {:>9.2} {:>9.2} {:>10.3} s {:>6} {:>6}",
                take.id,
                stream.stream,
                stream.samples,
                stream.rate_hz,
                stream.nominal_rate_hz,
                stream.longest_gap_s,
                stream.gaps,
                stream.clock_steps_back
            ));
        }
    }
    lines.push(format!("\n{:<24} {:>8} {:>14} {:>10}", "channel", "touches", "by half", "active"));
    for channel in &report.coverage {
        let [first, second] = channel.touches_by_half;
        lines.push(format!(
            "{:<24} {:>8} {:>14} {:>8.1} s",
            channel.channel,
            channel.touches,
            format!("{first} + {second}"),
            channel.active_s
        ));
    }
    lines.push(String::new());
    for problem in &report.problems {
        let severity = match problem.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
            Severity::Info => "note",
        };
        lines.push(format!("{severity}: {}: {}", problem.place, problem.message));
    }
    lines.push(if report.ok { "usable".to_owned() } else { "cannot be used as it is".to_owned() });
    lines.join("\n")
}
