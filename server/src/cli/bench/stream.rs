//! `palpate bench stream`: everything that a live station does at once, in this process: emulated devices, drivers,
//! control loop, twin, a guided session that records, and clients of the real sockets, one of which reads slowly.

mod operator;
mod watcher;

use std::{
    collections::BTreeMap,
    fs,
    net::{Ipv4Addr, SocketAddr},
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

use clap::Args;
use palpate_control::LOOP_HZ;
use palpate_recording::Take;
use palpate_server::{AppState, Error, LiveStation, app, assets};
use serde::Serialize;
use tokio::{net::TcpListener, sync::watch};

use operator::Operator;
use watcher::{Pace, Watched, watch_stream};

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

#[derive(Serialize)]
struct StreamBenchReport {
    /// For how long was measured, s.
    seconds: f64,
    /// Clients, the slow one included.
    clients: u16,
    /// Turns of the control loop that are meant, Hz.
    loop_target_hz: f64,
    /// Turns over the last second: at the end, on average, and the fewest, Hz.
    loop_hz: [f64; 3],
    /// The same over the target.
    loop_share: [f64; 3],
    /// From a device's byte to the published message, ms: the newest, the median, the 95th percentile, the most.
    latency_ms: [f64; 4],
    /// From publishing to a client, ms above the fastest delivery: median, 95th percentile, most.
    delivery_above_fastest_ms: [f64; 3],
    /// Takes that were written; the last one is cut off by the end of the measurement.
    takes: usize,
    /// What they hold, by stream.
    recorded: BTreeMap<String, RecordedStream>,
    /// What the operator was refused while recording, and got over.
    problems: Vec<String>,
    /// Samples that the recorder could not keep.
    lost_samples: u64,
    /// Messages that each client got, those that keep up: fewest and most.
    frames_per_client: [u64; 2],
    /// Of the clients that keep up, the most that one lost.
    dropped_most: u64,
    /// What the slow client got, and what it was told that it lost.
    slow_client_frames: u64,
    slow_client_dropped: u64,
    /// How old the slow client's picture was at the end, s: what the lines in between hold is not lost, but late.
    slow_client_behind_s: f64,
    /// Cores that this process used, the emulated hardware and the clients included, and how many there are.
    cores_used: f64,
    cores: usize,
    /// By the names of threads, those that used a hundredth of a core and more.
    cores_by_thread: BTreeMap<String, f64>,
    /// Load of the machine before and after, processes that want to run: above `cores`, somebody waits.
    load_average: [f64; 2],
}

#[derive(Serialize)]
struct RecordedStream {
    samples: usize,
    /// Samples per second of take.
    rate_hz: f64,
    /// Between two samples, ms.
    longest_gap_ms: f64,
}

pub(super) fn run(args: &StreamArgs) -> Result<(), Error> {
    let (truth, _unpacked) = assets::truth(Path::new("demo"))?;
    let data = tempfile::tempdir().map_err(Error::io("make", std::env::temp_dir()))?;
    let state = AppState::open(data.path(), Some(&LiveStation::Emulated(truth)))?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|err| Error::Internal(format!("failed to start the server's threads: {err}")))?;
    let measured = runtime.block_on(measure(args, state.clone()));
    state.begin_shutdown();
    runtime.shutdown_timeout(Duration::from_secs(5));
    // The take under way ends with the control loop.
    drop(state);
    let mut report = measured?;
    let recorded = recorded(&data.path().join("sessions").join(operator::SESSION))?;
    (report.takes, report.recorded) = recorded;
    super::print(args.json, &report)
}

async fn measure(args: &StreamArgs, state: Arc<AppState>) -> Result<StreamBenchReport, Error> {
    let failed = |err: std::io::Error| Error::Internal(format!("failed to serve on a local port: {err}"));
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.map_err(failed)?;
    let addr = listener.local_addr().map_err(failed)?;
    tokio::spawn(async move { axum::serve(listener, app(state)).await });

    let operator = Operator::prepare(addr).await?;
    let (end, ends) = watch::channel(false);
    let mut clients = Vec::new();
    for client in 0..args.clients {
        let pace = if client + 1 == args.clients { Pace::Slow } else { Pace::AsItComes };
        clients.push(tokio::spawn(watch_stream(addr, pace, ends.clone())));
    }
    let recording = tokio::spawn(operator.record(ends));
    let (begun, cpu_before, load_before) = (Instant::now(), cpu_seconds(), load_average());
    tokio::time::sleep(Duration::from_secs(u64::from(args.seconds))).await;
    let (seconds, cpu_after) = (begun.elapsed().as_secs_f64(), cpu_seconds());
    end.send_replace(true);
    let mut watched = Vec::new();
    for client in clients {
        watched.push(client.await.map_err(|err| Error::Internal(format!("a client ended: {err}")))??);
    }
    let problems = recording.await.map_err(|err| Error::Internal(format!("the operator ended: {err}")))??;
    let slow = watched.pop().unwrap_or_default();
    let cpu = cpu_difference(&cpu_before, &cpu_after);
    Ok(StreamBenchReport { problems, ..report(args, seconds, &watched, &slow, &cpu, load_before) })
}

fn report(
    args: &StreamArgs,
    seconds: f64,
    watched: &[Watched],
    slow: &Watched,
    cpu: &BTreeMap<String, f64>,
    load_before: f64,
) -> StreamBenchReport {
    let first = watched.first().cloned().unwrap_or_default();
    let mean = first.loop_hz.iter().sum::<f64>() / first.loop_hz.len().max(1) as f64;
    let loop_hz = [
        first.loop_hz.last().copied().unwrap_or(0.0),
        mean,
        first.loop_hz.iter().copied().fold(f64::INFINITY, f64::min),
    ];
    let fastest = first.delays_s.iter().copied().fold(f64::INFINITY, f64::min);
    let delays: Vec<f64> = first.delays_s.iter().map(|delay_s| (delay_s - fastest) * 1e3).collect();
    let frames = || watched.iter().map(|client| client.frames);
    StreamBenchReport {
        seconds,
        clients: args.clients,
        loop_target_hz: LOOP_HZ,
        loop_hz,
        loop_share: loop_hz.map(|hz| hz / LOOP_HZ),
        latency_ms: [
            first.latency_ms.last().copied().unwrap_or(0.0),
            quantile(&first.latency_ms, 0.5),
            quantile(&first.latency_ms, 0.95),
            quantile(&first.latency_ms, 1.0),
        ],
        delivery_above_fastest_ms: [0.5, 0.95, 1.0].map(|share| quantile(&delays, share)),
        takes: 0,
        recorded: BTreeMap::new(),
        problems: Vec::new(),
        lost_samples: first.lost_samples,
        frames_per_client: [frames().min().unwrap_or(0), frames().max().unwrap_or(0)],
        dropped_most: watched.iter().map(|client| client.dropped).max().unwrap_or(0),
        slow_client_frames: slow.frames,
        slow_client_dropped: slow.dropped,
        slow_client_behind_s: slow.behind_s,
        cores_used: cpu.values().sum::<f64>() / seconds,
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        cores_by_thread: cpu
            .iter()
            .map(|(name, used_s)| (name.clone(), used_s / seconds))
            .filter(|(_, share)| *share >= 0.01)
            .collect(),
        load_average: [load_before, load_average()],
    }
}

/// The value that `share` of all are at most; 0 without any.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let idx = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(idx).copied().unwrap_or(0.0)
}

/// How many takes lie in the session's folder, and what all of them hold.
fn recorded(session: &Path) -> Result<(usize, BTreeMap<String, RecordedStream>), Error> {
    let mut takes = Vec::new();
    for entry in fs::read_dir(session).map_err(Error::io("read", session))? {
        let path = entry.map_err(Error::io("read", session))?.path();
        if path.extension().is_some_and(|extension| extension == "mcap") {
            takes.push(Take::read(&path)?);
        }
    }
    let mut streams: BTreeMap<String, (usize, f64, f64)> = BTreeMap::new();
    for take in &takes {
        let layout = &take.station.layout;
        let logs = layout.streams.iter().map(|stream| stream.id.as_str()).zip(&take.streams);
        let times = logs.map(|(id, log)| (id, &log.times_s)).chain([("joints", &take.joints.times_s)]);
        for (id, times_s) in times {
            let gaps = times_s.windows(2).map(|pair| pair[1] - pair[0]);
            let (samples, length_s, gap_s) = streams.entry(id.to_owned()).or_default();
            *samples += times_s.len();
            *length_s += times_s.last().zip(times_s.first()).map_or(0.0, |(last, first)| last - first);
            *gap_s = gaps.fold(*gap_s, f64::max);
        }
    }
    let streams = streams.into_iter().map(|(id, (samples, length_s, gap_s))| {
        let rate_hz = if length_s > 0.0 { samples as f64 / length_s } else { 0.0 };
        (id, RecordedStream { samples, rate_hz, longest_gap_ms: gap_s * 1e3 })
    });
    Ok((takes.len(), streams.collect()))
}

/// Processor time that this process has used so far by thread name and number, s; empty where there is no `/proc`.
fn cpu_seconds() -> BTreeMap<(String, String), f64> {
    /// Ticks of `/proc` on every Linux.
    const TICKS_PER_S: f64 = 100.0;
    let tasks = fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let used = tasks.filter_map(|task| {
        let text = fs::read_to_string(task.path().join("stat")).ok()?;
        // The name stands in brackets and may hold anything.
        let (start, rest) = text.rsplit_once(") ")?;
        let name = start.split_once('(')?.1.to_owned();
        let fields: Vec<&str> = rest.split(' ').collect();
        let ticks = fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?;
        Some(((name, task.file_name().to_string_lossy().into_owned()), ticks / TICKS_PER_S))
    });
    used.collect()
}

/// Processor time by thread name, s.
fn cpu_difference(
    before: &BTreeMap<(String, String), f64>,
    after: &BTreeMap<(String, String), f64>,
) -> BTreeMap<String, f64> {
    let mut used = BTreeMap::new();
    for (thread, seconds) in after {
        let since = before.get(thread).copied().unwrap_or(0.0);
        *used.entry(thread.0.clone()).or_insert(0.0) += seconds - since;
    }
    used
}

/// Processes that wanted to run in the last minute; 0 where there is no `/proc`.
fn load_average() -> f64 {
    let text = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').next().and_then(|first| first.parse().ok()).unwrap_or(0.0)
}

/// The address of a socket of the server.
fn socket_url(addr: SocketAddr, path: &str) -> String {
    format!("ws://{addr}/api/v1/{path}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_of_the_sorted_values() {
        let values = [5.0, 1.0, 3.0, 2.0, 4.0];
        assert_eq!([0.0, 0.5, 1.0].map(|share| quantile(&values, share)), [1.0, 3.0, 5.0]);
        assert_eq!(quantile(&[], 0.5), 0.0);
    }

    #[test]
    fn processor_time_is_counted_by_thread_name() {
        let thread = |name: &str, id: &str| (name.to_owned(), id.to_owned());
        let before = BTreeMap::from([(thread("control", "7"), 1.0), (thread("worker", "8"), 2.0)]);
        let after = BTreeMap::from([
            (thread("control", "7"), 1.5),
            (thread("worker", "8"), 3.0),
            (thread("worker", "9"), 0.25),
        ]);
        let used = cpu_difference(&before, &after);
        assert_eq!(used, BTreeMap::from([("control".to_owned(), 0.5), ("worker".to_owned(), 1.25)]));
    }
}
