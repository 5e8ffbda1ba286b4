//! `palpate bench servos`: the diagnosis of measured servo logs, one value of a field held out in turn.
//!
//! `--peer PYTHON` fits BAM's friction models to the same logs in the same run, and judges them by the same metric:
//! the mean absolute position error of rollouts that never look at the log again.

use std::{
    collections::{BTreeMap, BTreeSet},
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use clap::Args;
use palpate_diagnosis::actuator::{
    ActuatorConfig, ActuatorDomain, LogHoldOut, diagnose_actuator, mean_interval_95,
};
use palpate_recording::ServoLog;
use palpate_server::Error;
use palpate_terminal::{Bar, cancel_on_ctrl_c};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::output;

/// Resamples behind intervals.
const RESAMPLES: usize = 10_000;

#[derive(Args)]
pub(crate) struct ServosArgs {
    /// Folder of servo logs (JSON)
    #[arg(long, value_name = "DIR")]
    logs: PathBuf,
    /// Field of the logs of which one value after the other is held out
    #[arg(long, value_name = "FIELD", default_value = "kp")]
    by: String,
    /// Seed of restarts, of the peer as well
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Python with the packages numpy, numba and cma, to fit BAM's models M1 to M6 as well
    #[arg(long, value_name = "PYTHON")]
    peer: Option<PathBuf>,
    /// The peer's script
    #[arg(long, value_name = "FILE", default_value = "tests/peers/bam_friction.py")]
    peer_script: PathBuf,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Mean absolute position error of every held-out log, rad, by fold.
type Errors = Vec<Vec<f64>>;

#[derive(Serialize)]
struct Figures {
    /// Values that were held out.
    held_out: Vec<String>,
    models: Vec<OfModel>,
}

#[derive(Serialize)]
struct OfModel {
    model: String,
    /// By fold, rad.
    by_fold_rad: Vec<f64>,
    /// Mean over folds, rad.
    mean_rad: f64,
    /// How much higher it is than that of the diagnosed model, paired by log, rad, with a 95 % interval from
    /// resampling logs.
    above_diagnosed_rad: Option<(f64, [f64; 2])>,
}

#[derive(Deserialize)]
struct OfPeer {
    errors_rad: BTreeMap<String, Errors>,
}

pub(super) fn run(args: &ServosArgs) -> Result<(), Error> {
    let logs = ServoLog::read_folder(&args.logs)?;
    let value_of = |log: &ServoLog| log.fields.get(&args.by).cloned();
    let values: BTreeSet<String> = logs.iter().filter_map(value_of).collect();
    if values.len() < 2 {
        return Err(Error::Argument(format!(
            "--by: the logs in {:?} have {} values of {:?}; two are needed, so that one can be held out",
            args.logs,
            values.len(),
            args.by
        )));
    }
    let folds: Vec<Vec<usize>> = values
        .iter()
        .map(|value| (0..logs.len()).filter(|&idx| value_of(&logs[idx]).as_ref() == Some(value)).collect())
        .collect();
    let domain = ActuatorDomain::new(&logs)?;
    let mut models = Vec::new();
    let diagnosed = diagnosed(args, &logs, &domain, &values, &folds)?;
    models.push(of_model("diagnosed", &diagnosed, None, args.seed));
    if let Some(python) = &args.peer {
        for (model, errors) in peer(args, python, &domain, &folds)?.errors_rad {
            models.push(of_model(&model, &errors, Some(&diagnosed), args.seed));
        }
    }
    let figures = Figures { held_out: values.into_iter().collect(), models };
    if args.json { output::json(&figures) } else { output::line(&text(args, &figures)) }
}

/// Of the diagnosed models.
fn diagnosed(
    args: &ServosArgs,
    logs: &[ServoLog],
    domain: &ActuatorDomain<'_>,
    values: &BTreeSet<String>,
    folds: &[Vec<usize>],
) -> Result<Errors, Error> {
    let (bar, cancel) = (Bar::new(), cancel_on_ctrl_c());
    values
        .iter()
        .zip(folds)
        .map(|(value, fold)| {
            let hold_out = LogHoldOut::Field { field: args.by.clone(), value: value.clone() };
            let config = ActuatorConfig { hold_out, seed: args.seed, ..ActuatorConfig::default() };
            let model = diagnose_actuator(&config, logs, &bar, &cancel, &|| 0.0)?.model;
            let error = |&take: &usize| {
                let predicted = domain.open_loop(take, &model)?;
                let measured = &logs[take].positions_rad;
                let sum: f64 = predicted.iter().zip(measured).map(|(one, other)| (one - other).abs()).sum();
                Ok(sum / measured.len() as f64)
            };
            fold.iter().map(error).collect()
        })
        .collect()
}

/// Lets the peer fit its models.
fn peer(
    args: &ServosArgs,
    python: &Path,
    domain: &ActuatorDomain<'_>,
    folds: &[Vec<usize>],
) -> Result<OfPeer, Error> {
    let logs = (0..folds.iter().map(Vec::len).sum()).map(|take| {
        let (drive, start, log) = (domain.drive(take), domain.start(take), domain.log(take));
        json!({
            "times_s": drive.times_s,
            "goals_rad": drive.goals_rad,
            "torque_on": drive.torque_on,
            "positions_rad": log.positions_rad,
            "gain_per_rad": drive.gain_per_rad,
            "supply_v": drive.supply_v,
            "mass_kg": drive.mass_kg,
            "length_m": drive.length_m,
            "start": [start.position_rad, start.speed_rad_per_s],
        })
    });
    let inputs = json!({ "logs": logs.collect::<Vec<_>>(), "folds": folds, "seed": args.seed });
    let mut child = Command::new(python)
        .arg(&args.peer_script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .map_err(Error::io("start", python))?;
    if let Some(mut stdin) = child.stdin.take() {
        writeln!(stdin, "{inputs}").map_err(Error::io("write to", python))?;
    }
    let output = child.wait_with_output().map_err(Error::io("read from", python))?;
    if !output.status.success() {
        return Err(Error::Internal(format!("{:?} failed: {}", args.peer_script, output.status)));
    }
    serde_json::from_slice(&output.stdout)
        .map_err(|err| Error::Internal(format!("{:?} gave no figures: {err}", args.peer_script)))
}

fn of_model(model: &str, errors: &Errors, diagnosed: Option<&Errors>, seed: u64) -> OfModel {
    let by_fold_rad: Vec<f64> = errors.iter().map(|fold| mean(fold)).collect();
    let above_diagnosed_rad = diagnosed.map(|diagnosed| {
        let pairs = errors.iter().flatten().zip(diagnosed.iter().flatten());
        let above: Vec<f64> = pairs.map(|(one, other)| one - other).collect();
        (mean(&above), mean_interval_95(&above, RESAMPLES, seed))
    });
    OfModel { model: model.to_owned(), mean_rad: mean(&by_fold_rad), by_fold_rad, above_diagnosed_rad }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn text(args: &ServosArgs, figures: &Figures) -> String {
    let held_out: Vec<String> =
        figures.held_out.iter().map(|value| format!("{:>10}", format!("{}={value}", args.by))).collect();
    let mut lines = vec![
        "mean absolute position error on held-out logs, mrad".to_owned(),
        format!("{:<10} {} {:>8}   {}", "model", held_out.join(" "), "mean", "above diagnosed (95 %)"),
    ];
    lines.extend(figures.models.iter().map(|model| {
        let folds: Vec<String> = model.by_fold_rad.iter().map(|rad| format!("{:>10.1}", 1e3 * rad)).collect();
        let above = model.above_diagnosed_rad.map_or_else(String::new, |(above, [low, high])| {
            format!("{:+.1} ({:+.1} to {:+.1})", 1e3 * above, 1e3 * low, 1e3 * high)
        });
        format!("{:<10} {} {:>8.1}   {above}", model.model, folds.join(" "), 1e3 * model.mean_rad)
    }));
    lines.join("\n")
}
