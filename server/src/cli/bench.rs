//! `palpate bench`: the paths that have to be fast, measured on a whole session or a live station.

mod api;
mod http;
mod servos;
mod sessions;
mod stop;
mod stream;
mod studio;

use std::{path::PathBuf, process::ExitCode, time::Instant};

use clap::{Args, Subcommand};
use palpate_calibration::{
    PairedTake,
    bench::{SweepBenchConfig, sweep as bench_sweep, write_peer_inputs},
};
use palpate_recording::{Session, Take};
use palpate_robot_model::TactileLayout;
use palpate_server::{Error, assets};
use palpate_terminal::{Bar, cancel_on_ctrl_c};
use palpate_truth::record_session;
use serde::Serialize;
use tempfile::TempDir;

use super::{Outcome, output};

#[derive(Subcommand)]
pub(crate) enum BenchCommand {
    /// The exact search for theta against the paper's grid, on the same signals
    Sweep(SweepArgs),
    /// Kinematics, signed distance of every surface node, and penalty pressure, over a whole session
    Replay(BenchArgs),
    /// An emulated station that records while many clients watch it
    Stream(stream::StreamArgs),
    /// The API while a thousand jobs wait and many pages watch, beside MLflow's tracking server
    Api(api::ApiArgs),
    /// How long a studio takes to start and to list a data folder of many sessions
    Sessions(sessions::SessionsArgs),
    /// The diagnosis of measured servo logs, one gain held out in turn, beside BAM's friction models
    Servos(servos::ServosArgs),
    /// STOP under load: from a client's message to the bytes that switch the servos off
    Stop(stop::StopArgs),
}

#[derive(Args)]
pub(crate) struct BenchArgs {
    /// Folder of the session [default: records the shipped emulated one]
    #[arg(long, value_name = "SESSION")]
    session: Option<PathBuf>,
    /// Measured this often; the fastest counts, as the one that was disturbed least
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..))]
    repeats: u16,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub(crate) struct SweepArgs {
    #[command(flatten)]
    bench: BenchArgs,
    /// Also write the precomputed signals as NumPy arrays into this folder, for a peer in another language
    #[arg(long, value_name = "DIR")]
    peer: Option<PathBuf>,
}

pub(super) fn run(command: &BenchCommand) -> Outcome {
    match command {
        BenchCommand::Sweep(args) => sweep(args)?,
        BenchCommand::Replay(args) => replay(args)?,
        BenchCommand::Stream(args) => stream::run(args)?,
        BenchCommand::Api(args) => api::run(args)?,
        BenchCommand::Sessions(args) => sessions::run(args)?,
        BenchCommand::Servos(args) => servos::run(args)?,
        BenchCommand::Stop(args) => stop::run(args)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// The accepted takes of the session, in order, of which there is at least one.
fn takes(args: &BenchArgs) -> Result<Vec<Take>, Error> {
    let (session, _recorded): (Session, Option<TempDir>) = match &args.session {
        Some(dir) => (Session::open(dir)?, None),
        None => {
            let unpacked = assets::unpack()?;
            let truth = unpacked.path().join("truth/demo.toml");
            let out = unpacked.path().join("session");
            let session = record_session(&truth, &out, 0, &Bar::new(), &cancel_on_ctrl_c())?;
            (session, Some(unpacked))
        }
    };
    Ok(session.accepted_takes()?)
}

fn layout(takes: &[Take]) -> Result<&TactileLayout, Error> {
    let first = takes.first().ok_or_else(|| Error::Content("the session has no accepted take".to_owned()))?;
    Ok(&first.station.layout)
}

#[derive(Serialize)]
struct ReplayBenchReport {
    /// Joint frames.
    frames: usize,
    /// Surface nodes of all patches.
    nodes: usize,
    /// Threads.
    threads: usize,
    /// Fastest replay of the whole session, s: kinematics, every node, events at frames.
    seconds: f64,
    /// Frames per second.
    frames_per_s: f64,
    /// Nodes looked at per second, those that a bound dismissed included.
    nodes_per_s: f64,
}

fn replay(args: &BenchArgs) -> Result<(), Error> {
    let takes = takes(args)?;
    let mut seconds = f64::INFINITY;
    for _ in 0..args.repeats {
        let start = Instant::now();
        for take in &takes {
            PairedTake::from_take(take)?;
        }
        seconds = seconds.min(start.elapsed().as_secs_f64());
    }
    let frames: usize = takes.iter().map(Take::num_frames).sum();
    let nodes: usize = layout(&takes)?.patches.iter().map(|patch| patch.nodes.len()).sum();
    print(
        args.json,
        &ReplayBenchReport {
            frames,
            nodes,
            threads: rayon::current_num_threads(),
            seconds,
            frames_per_s: frames as f64 / seconds,
            nodes_per_s: (frames * nodes) as f64 / seconds,
        },
    )
}

fn sweep(args: &SweepArgs) -> Result<(), Error> {
    let takes = takes(&args.bench)?;
    let layout = layout(&takes)?;
    let paired = takes.iter().map(PairedTake::from_take).collect::<Result<Vec<_>, _>>()?;
    let config = SweepBenchConfig { repeats: usize::from(args.bench.repeats), ..SweepBenchConfig::default() };
    if let Some(dir) = &args.peer {
        write_peer_inputs(config, layout, &paired, dir).map_err(Error::io("write", dir))?;
    }
    let start = Instant::now();
    let report = bench_sweep(config, layout, &paired, &|| start.elapsed().as_secs_f64())?;
    print(args.bench.json, &report)
}

/// Prints `report` as JSON, or a line for each figure.
fn print(json: bool, report: &impl Serialize) -> Result<(), Error> {
    if json {
        return output::json(report);
    }
    let document = serde_json::to_value(report).map_err(|err| Error::Internal(err.to_string()))?;
    for (name, value) in document.as_object().into_iter().flatten() {
        output::line(&format!("{name}: {value}"))?;
    }
    Ok(())
}
