//! `palpate bench stream`: everything that a live station does at once, in this process: emulated devices, drivers,
//! control loop, twin, a guided session that records, and clients of the real sockets, one of which reads slowly.

mod cpu;
pub(super) mod operator;
mod report;
mod traffic;
mod watcher;

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

use clap::Args;
use palpate_server::{Access, AppState, Error, LiveStation, Studio, assets, serve_on};
use tokio::{net::TcpListener, sync::watch};

use super::super::output;
pub(super) use cpu::load_average;
use cpu::{cpu_difference, cpu_seconds};
use operator::Operator;
pub(super) use report::quantile;
use report::{ControlLoop, StreamBenchReport, clients};
use traffic::TrafficWatch;
pub(super) use watcher::{Pace, Watched, watch_stream};

#[derive(Args)]
pub(crate) struct StreamArgs {
    /// For how long to measure, once every device is ready and a take is about to be recorded
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u16).range(5..))]
    seconds: u16,
    /// Clients that watch; the last one reads slowly
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(2..=500))]
    clients: u16,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &StreamArgs) -> Result<(), Error> {
    let (truth, _unpacked) = assets::truth(Path::new("demo"))?;
    let data = tempfile::tempdir().map_err(Error::io("make", std::env::temp_dir()))?;
    let Studio { state, station: running } =
        Studio::open(data.path(), Some(&LiveStation::Emulated(truth)), Access::default())?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|err| Error::Internal(format!("failed to start the server's threads: {err}")))?;
    let station = state
        .emulated_station()
        .cloned()
        .ok_or_else(|| Error::Internal("the station is not emulated".to_owned()))?;
    let traffic = TrafficWatch::start(station);
    let measured = runtime.block_on(measure(args, state.clone()));
    let sent = traffic.end();
    state.begin_shutdown();
    runtime.shutdown_timeout(Duration::from_secs(5));
    // The take under way ends with the control loop.
    drop(running);
    drop(state);
    let mut report = measured?;
    let session = data.path().join("sessions").join(operator::SESSION);
    (report.takes, report.recorded) = traffic::recorded(&session, &sent)?;
    report.judge();
    if args.json { output::json(&report) } else { output::line(report.to_text().trim_end()) }
}

async fn measure(args: &StreamArgs, state: Arc<AppState>) -> Result<StreamBenchReport, Error> {
    let failed = |err: std::io::Error| Error::Internal(format!("failed to serve on a local port: {err}"));
    let ended = |err: tokio::task::JoinError| Error::Internal(format!("a part of the bench ended: {err}"));
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.map_err(failed)?;
    let addr = listener.local_addr().map_err(failed)?;
    tokio::spawn(serve_on(listener, state, std::future::pending()));

    let operator = Operator::prepare(addr).await?;
    let (end, ends) = watch::channel(false);
    let begun = Instant::now();
    let mut running = Vec::new();
    for client in 0..args.clients {
        let pace = if client + 1 == args.clients { Pace::Slow } else { Pace::AsItComes };
        running.push((pace, tokio::spawn(watch_stream(addr, pace, begun, ends.clone()))));
    }
    let recording = tokio::spawn(operator.record(ends));
    let (cpu_before, load_before) = (cpu_seconds(), load_average());
    tokio::time::sleep(Duration::from_secs(u64::from(args.seconds))).await;
    let (seconds, cpu_after) = (begun.elapsed().as_secs_f64(), cpu_seconds());
    end.send_replace(true);
    let mut watched: Vec<(Pace, Watched)> = Vec::new();
    for (pace, client) in running {
        watched.push((pace, client.await.map_err(ended)??));
    }
    let problems = recording.await.map_err(ended)??;

    let first = watched.first().map(|(_, first)| first.clone()).unwrap_or_default();
    let fastest = first.delays_s.iter().copied().fold(f64::INFINITY, f64::min);
    let delays: Vec<f64> = first.delays_s.iter().map(|delay_s| (delay_s - fastest) * 1e3).collect();
    let cpu = cpu_difference(&cpu_before, &cpu_after);
    Ok(StreamBenchReport {
        seconds,
        control_loop: ControlLoop::of(&first),
        latency_ms: [
            first.latency_ms.last().copied().unwrap_or(0.0),
            quantile(&first.latency_ms, 0.5),
            quantile(&first.latency_ms, 0.95),
            quantile(&first.latency_ms, 1.0),
        ],
        delivery_above_fastest_ms: [0.5, 0.95, 1.0].map(|share| quantile(&delays, share)),
        lost_samples: first.lost_samples,
        problems,
        clients: clients(&watched),
        cores_used: cpu.values().sum::<f64>() / seconds,
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        cores_by_thread: cpu
            .into_iter()
            .map(|(name, used_s)| (name, used_s / seconds))
            .filter(|(_, share)| *share >= 0.01)
            .collect(),
        load_average: [load_before, load_average()],
        ..StreamBenchReport::default()
    })
}

/// The address of a socket of the server.
fn socket_url(addr: SocketAddr, path: &str) -> String {
    format!("ws://{addr}/api/v1/{path}")
}
