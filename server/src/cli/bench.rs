//! `palpate bench`: the paths that have to be fast, measured on a whole session.

use std::{path::PathBuf, process::ExitCode, time::Instant};

use clap::{Args, Subcommand};
use palpate_calibration::{CalibrationConfig, Method, PairedTake, calibrate};
use palpate_emulator::record_session;
use palpate_recording::{Session, Take};
use palpate_server::{Error, assets, library::nominal_model};
use palpate_sim::{SensorModel, job::NoProgress};
use serde_json::json;
use tempfile::TempDir;

use super::{
    Outcome, output,
    progress::{Bar, cancel_on_ctrl_c},
};

#[derive(Subcommand)]
pub(crate) enum BenchCommand {
    /// The exact search for theta against the paper's grid, on the same signals
    Sweep(BenchArgs),
    /// Kinematics, signed distance of every surface node, and penalty pressure, over a whole session
    Replay(BenchArgs),
}

#[derive(Args)]
pub(crate) struct BenchArgs {
    /// Folder of the session [default: records the shipped emulated one]
    #[arg(long, value_name = "SESSION")]
    session: Option<PathBuf>,
    /// Measured this often; the median is reported
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(command: &BenchCommand) -> Outcome {
    let (BenchCommand::Sweep(args) | BenchCommand::Replay(args)) = command;
    let (session, _recorded) = open(args)?;
    let takes = session.accepted_takes()?;
    let report = match command {
        BenchCommand::Sweep(args) => sweep(args, &takes)?,
        BenchCommand::Replay(args) => replay(args, &takes)?,
    };
    if args.json {
        output::json(&report)?;
    } else if let Some(fields) = report.as_object() {
        for (name, value) in fields {
            output::line(&format!("{name}: {value}"))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn open(args: &BenchArgs) -> Result<(Session, Option<TempDir>), Error> {
    if let Some(dir) = &args.session {
        return Ok((Session::open(dir)?, None));
    }
    let unpacked = assets::unpack()?;
    let truth = unpacked.path().join("truth/demo.toml");
    let bar = Bar::new();
    let session = record_session(&truth, &unpacked.path().join("session"), 0, &bar, &cancel_on_ctrl_c())?;
    Ok((session, Some(unpacked)))
}

fn replay(args: &BenchArgs, takes: &[Take]) -> Result<serde_json::Value, Error> {
    let mut seconds = Vec::new();
    for _ in 0..args.repeats {
        let start = Instant::now();
        for take in takes {
            PairedTake::from_take(take)?;
        }
        seconds.push(start.elapsed().as_secs_f64());
    }
    let frames: usize = takes.iter().map(Take::num_frames).sum();
    let nodes: usize = takes
        .first()
        .map_or(0, |take| take.station.layout.patches.iter().map(|patch| patch.nodes.len()).sum());
    let median_s = median(&mut seconds);
    Ok(json!({
        "name": "replay",
        "frames": frames,
        "nodes": nodes,
        "threads": rayon::current_num_threads(),
        "repeats": args.repeats,
        "seconds": median_s,
        "seconds_min": seconds.first(),
        "frames_per_s": frames as f64 / median_s,
        "node_distances_per_s": (frames * nodes) as f64 / median_s,
    }))
}

fn sweep(args: &BenchArgs, takes: &[Take]) -> Result<serde_json::Value, Error> {
    let paired = takes.iter().map(PairedTake::from_take).collect::<Result<Vec<_>, _>>()?;
    let Some(first) = takes.first() else {
        return Err(Error::Content("the session has no accepted take".to_owned()));
    };
    let nominal = nominal_model(first)?;
    let exact = search(args, Method::Exact, first, &nominal, &paired)?;
    let grid = search(args, Method::Grid, first, &nominal, &paired)?;
    Ok(json!({
        "name": "sweep",
        "frames": takes.iter().map(Take::num_frames).sum::<usize>(),
        "channels": first.station.layout.num_channels(),
        "alphas": CalibrationConfig::default().num_alphas,
        "threads": rayon::current_num_threads(),
        "repeats": args.repeats,
        "seconds": exact.seconds,
        "seconds_grid": grid.seconds,
        "times_faster": grid.seconds / exact.seconds,
        "l1": exact.fitted_l1,
        "l1_grid": grid.fitted_l1,
        "evaluations": exact.evaluations,
        "evaluations_grid": grid.evaluations,
    }))
}

struct Search {
    seconds: f64,
    /// The objective: L1 on the takes that were fitted.
    fitted_l1: u64,
    evaluations: u64,
}

fn search(
    args: &BenchArgs,
    method: Method,
    first: &Take,
    nominal: &SensorModel,
    paired: &[PairedTake],
) -> Result<Search, Error> {
    let config = CalibrationConfig { method, bootstrap_resamples: 0, ..CalibrationConfig::default() };
    let start = Instant::now();
    let clock_s = || start.elapsed().as_secs_f64();
    let cancel = cancel_on_ctrl_c();
    let mut seconds = Vec::new();
    let mut fitted_l1 = 0;
    let mut evaluations = 0;
    for _ in 0..args.repeats {
        let layout = &first.station.layout;
        let report = calibrate(&config, layout, nominal, paired, &NoProgress, &cancel, &clock_s)?.report;
        seconds.push(report.seconds);
        evaluations = report.evaluations;
        fitted_l1 =
            report.by_take.values().filter(|take| !take.held_out).map(|take| take.calibrated.l1).sum();
    }
    Ok(Search { seconds: median(&mut seconds), fitted_l1, evaluations })
}

/// Sorts `seconds`.
fn median(seconds: &mut [f64]) -> f64 {
    seconds.sort_by(f64::total_cmp);
    match seconds.len() {
        0 => 0.0,
        len if len % 2 == 1 => seconds[len / 2],
        len => (seconds[len / 2 - 1] + seconds[len / 2]) / 2.0,
    }
}
