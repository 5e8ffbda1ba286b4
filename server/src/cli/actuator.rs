//! `palpate actuator`.

use std::{path::PathBuf, process::ExitCode, time::Instant};

use clap::{Args, Subcommand};
use palpate_diagnosis::actuator::{ActuatorConfig, LogHoldOut, diagnose_actuator};
use palpate_recording::{ServoLog, Session};
use palpate_reports::{DiagnosisReport, wording};
use palpate_server::Error;
use palpate_terminal::{Bar, cancel_on_ctrl_c};
use serde::Serialize;

use super::{Outcome, output};

#[derive(Subcommand)]
pub(crate) enum ActuatorCommand {
    /// Name what the model of a joint's servo lacks, from goals sent and positions measured
    Diagnose(DiagnoseArgs),
}

#[derive(Args)]
pub(crate) struct DiagnoseArgs {
    /// Folder of servo logs (JSON), or of a session whose takes hold joint commands
    #[arg(long, value_name = "DIR")]
    logs: PathBuf,
    /// Joints to diagnose, one after the other, where the folder is a session; `all` for every one
    #[arg(long, value_name = "JOINT,...|all", value_delimiter = ',')]
    joint: Vec<String>,
    /// Logs that nothing is fitted to, as in kp=400; `auto` keeps those of the middle gain
    #[arg(long, value_name = "FIELD=VALUE|auto|none", default_value = "auto")]
    hold_out: LogHoldOut,
    /// Most effects to name
    #[arg(long, value_name = "N")]
    max_effects: Option<usize>,
    /// Effects to leave out of the library, by id
    #[arg(long, value_name = "ID,...", value_delimiter = ',')]
    without: Vec<String>,
    /// Seed of restarts and resampling
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print the report as JSON; of several joints, `joints` with a report each
    #[arg(long)]
    json: bool,
}

pub(super) fn run(command: &ActuatorCommand) -> Outcome {
    let ActuatorCommand::Diagnose(args) = command;
    let of_joints = logs(args)?;
    let default = ActuatorConfig::default();
    let config = ActuatorConfig {
        hold_out: args.hold_out.clone(),
        max_effects: args.max_effects.unwrap_or(default.max_effects),
        without: args.without.iter().map(|id| id.trim().to_owned()).collect(),
        seed: args.seed,
        ..default
    };
    let cancel = cancel_on_ctrl_c();
    let mut reports = Vec::new();
    for logs in &of_joints {
        let start = Instant::now();
        let bar = Bar::new();
        let outcome = diagnose_actuator(&config, logs, &bar, &cancel, &|| start.elapsed().as_secs_f64())?;
        reports.push(OfJoint { joint: logs[0].joint.clone(), report: outcome.report });
    }
    match (&reports[..], args.json) {
        ([one], true) => output::json(&one.report)?,
        ([one], false) => output::line(&text(&one.report))?,
        (_, true) => output::json(&Reports { joints: reports })?,
        (_, false) => {
            let texts = reports.iter().map(|of| format!("{}\n\n{}", of.joint, text(&of.report)));
            output::line(&texts.collect::<Vec<_>>().join("\n\n"))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Reports on several joints.
#[derive(Serialize)]
struct Reports {
    joints: Vec<OfJoint>,
}

#[derive(Serialize)]
struct OfJoint {
    joint: String,
    report: DiagnosisReport,
}

/// Logs of each joint to diagnose.
fn logs(args: &DiagnoseArgs) -> Result<Vec<Vec<ServoLog>>, Error> {
    if !args.logs.join("session.toml").is_file() {
        return Ok(vec![ServoLog::read_folder(&args.logs)?]);
    }
    let session = Session::open(&args.logs)?;
    let takes = session.accepted_takes()?;
    let logs: Vec<ServoLog> = takes.iter().flat_map(ServoLog::from_take).collect();
    if logs.is_empty() {
        return Err(Error::Content(format!(
            "the takes of session {:?} hold no joint commands, so there is nothing to compare positions with; record \
             with commands or give a folder of servo logs",
            session.id
        )));
    }
    let mut joints: Vec<String> = Vec::new();
    for log in &logs {
        if !joints.contains(&log.joint) {
            joints.push(log.joint.clone());
        }
    }
    let there_are = joints.join(", ");
    let asked = match &args.joint[..] {
        [] => {
            return Err(Error::Argument(format!("--joint: say which joint, or all; there are {there_are}")));
        }
        [all] if all == "all" => joints,
        some => some.iter().map(|joint| joint.trim().to_owned()).collect(),
    };
    asked
        .iter()
        .map(|joint| {
            let of_joint: Vec<ServoLog> = logs.iter().filter(|log| log.joint == *joint).cloned().collect();
            if of_joint.is_empty() {
                let problem = format!("--joint: no joint {joint:?}; there are {there_are}");
                return Err(Error::Argument(problem));
            }
            Ok(of_joint)
        })
        .collect()
}

fn text(report: &DiagnosisReport) -> String {
    let mut lines = vec![report.sentence.clone(), String::new()];
    for effect in &report.effects {
        lines.push(effect.explanation.clone());
        for (name, value) in &effect.parameters {
            let interval = effect
                .interval
                .get(name)
                .map_or_else(String::new, |[low, high]| format!("  (95 %: {low:.4} to {high:.4})"));
            lines.push(format!("    {name} = {value:.4}{interval}"));
        }
        let rivals: Vec<&str> = effect.rivals.iter().map(|rival| rival.id.as_str()).collect();
        if !rivals.is_empty() {
            lines.push(format!("    the logs do not tell it apart from {}", rivals.join(", ")));
        }
    }
    lines.push(format!("\n{:<26} {:>22}  {:>18}", "model", "position error (mrad)", "95 %"));
    for step in &report.waterfall {
        let interval = step
            .interval_95
            .map_or_else(String::new, |[low, high]| format!("{:.1} to {:.1}", low * 1e3, high * 1e3));
        lines.push(format!("{:<26} {:>22.1}  {interval:>18}", step.step, step.gap * 1e3));
    }
    lines.push(String::new());
    lines.extend(report.next_experiment.iter().map(|next| next.sentence.clone()));
    lines.extend(report.in_doubt.iter().map(wording::in_doubt_sentence));
    lines.extend(report.notes.iter().map(|note| format!("note: {note}")));
    lines.push(format!("{:.1} s", report.seconds));
    lines.join("\n")
}
