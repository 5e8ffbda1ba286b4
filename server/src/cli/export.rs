//! `palpate export`.

use std::{path::PathBuf, process::ExitCode};

use clap::{Args, Subcommand, ValueEnum};
use palpate_export::lerobot::{Action, LerobotConfig, LerobotReport, MAX_FPS, export};
use palpate_terminal::{Bar, cancel_on_ctrl_c};

use super::{Outcome, output};

#[derive(Subcommand)]
pub(crate) enum ExportCommand {
    /// Write takes of sessions, or trials of rollouts, as a LeRobotDataset v3.0
    Lerobot(LerobotArgs),
}

#[derive(Args)]
pub(crate) struct LerobotArgs {
    /// Folders of sessions, or of rollouts
    #[arg(value_name = "SESSION", required = true)]
    sources: Vec<PathBuf>,
    /// Folder of the data set to make
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Frames per second [default: the nominal rate of the joint log]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_FPS)))]
    fps: Option<u32>,
    /// What is written as action [default: commands where every recording has some, else none]
    #[arg(long, value_name = "WHAT")]
    action: Option<ActionArg>,
    /// Print what was exported as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum ActionArg {
    /// What joints were told last
    Commands,
    /// Where joints are one frame later
    NextState,
    /// No action
    None,
}

pub(super) fn run(command: &ExportCommand) -> Outcome {
    let ExportCommand::Lerobot(args) = command;
    let action = args.action.map(|action| match action {
        ActionArg::Commands => Action::Commands,
        ActionArg::NextState => Action::NextState,
        ActionArg::None => Action::None,
    });
    let config = LerobotConfig { fps: args.fps, action };
    let report = {
        let bar = Bar::new();
        export(&args.sources, &args.out, config, &bar, &cancel_on_ctrl_c())?
    };
    if args.json {
        output::json(&report)?;
    } else {
        output::line(&text(&report, action.is_none()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn text(report: &LerobotReport, action_by_default: bool) -> String {
    let mut lines = vec![format!(
        "wrote {}: {} episodes, {} frames at {} Hz, tasks: {}",
        report.out.display(),
        report.episodes,
        report.frames,
        report.fps,
        report.tasks.join("; ")
    )];
    let features: Vec<String> =
        report.features.iter().map(|feature| format!("{} [{}]", feature.name, feature.size)).collect();
    lines.push(format!("features: {}", features.join(", ")));
    if report.successes + report.failures > 0 {
        lines.push(format!("{} successes, {} failures", report.successes, report.failures));
    }
    if report.action == Action::None && action_by_default {
        lines.push(
            "no commands were recorded, so there is no action; --action next-state writes where joints went next".to_owned(),
        );
    }
    for left_out in &report.left_out {
        lines.push(format!("left out {}: {}", left_out.file.display(), left_out.reason));
    }
    lines.join("\n")
}
