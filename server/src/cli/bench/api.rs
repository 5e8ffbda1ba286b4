//! `palpate bench api`: the API while a thousand jobs wait and many pages watch, and what the control loop does
//! meanwhile.
//!
//! The studio is a process of its own with an emulated station, as in a lab; one job runs, all others wait behind it.
//! `--peer PYTHON` lets MLflow's tracking server do the same in the same run: make runs, log metrics, list.

use std::{
    fs,
    net::SocketAddr,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use clap::Args;
use palpate_server::{Error, assets};
use palpate_terminal::{Bar, cancel_on_ctrl_c};
use palpate_truth::record_session;
use palpate_wire::api::{Job, JobPage};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::{runtime::Runtime, sync::watch};

use super::{
    output,
    stream::{Pace, Watched, load_average, quantile, watch_stream},
    studio::{Client, PATIENCE, Studio},
};

/// The loop's first frames tell of the start.
const SETTLE: Duration = Duration::from_secs(3);

/// Jobs that a request lists; as many are looked up one by one.
const LISTED: usize = 100;

#[derive(Args)]
pub(crate) struct ApiArgs {
    /// Jobs that wait
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..))]
    jobs: u32,
    /// Pages that watch
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u16).range(1..=500))]
    pages: u16,
    /// For how long the API is asked while they do
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u16).range(5..))]
    seconds: u16,
    /// Clients that ask one request after the other
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=64))]
    clients: u16,
    /// Python with the packages mlflow and requests, to measure its tracking server as well
    #[arg(long, value_name = "PYTHON")]
    peer: Option<PathBuf>,
    /// The peer's script
    #[arg(long, value_name = "FILE", default_value = "tests/peers/mlflow_tracking.py")]
    peer_script: PathBuf,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Of all requests of a kind, ms.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Delays {
    requests: usize,
    p50: f64,
    p99: f64,
    max: f64,
}

impl Delays {
    fn of(seconds: &[f64]) -> Self {
        let ms = |share| 1e3 * quantile(seconds, share);
        Self { requests: seconds.len(), p50: ms(0.5), p99: ms(0.99), max: ms(1.0) }
    }
}

/// What both servers do.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Work {
    /// A job is queued, or a run made.
    create: Delays,
    /// Hundred of them are listed.
    list: Delays,
    /// One is looked up.
    get: Delays,
    /// A point of a curve is noted: by the job itself in its folder, or by a request.
    log_metric: Delays,
    /// The curves of one are read.
    read_metrics: Delays,
}

#[derive(Debug, Serialize)]
struct ApiBenchReport {
    jobs: u32,
    pages: u16,
    clients: u16,
    studio: Work,
    /// Every request to the API while jobs wait and pages watch.
    all_requests: Delays,
    /// The control loop meanwhile: mean rate, and rate of its worst second, Hz.
    loop_hz: [f64; 2],
    /// Frames that pages got, a second and page.
    frames_per_page_s: f64,
    /// Processes that wanted to run in the minute before.
    load_average: f64,
    peer: Option<Work>,
}

pub(super) fn run(args: &ApiArgs) -> Result<(), Error> {
    let (truth, _unpacked) = assets::truth(Path::new("demo"))?;
    let data = tempfile::tempdir().map_err(Error::io("make", std::env::temp_dir()))?;
    record_session(&truth, &data.path().join("sessions/load"), 0, &Bar::new(), &cancel_on_ctrl_c())?;
    // One job at a time, so that the others wait.
    let runners = data.path().join("runners.toml");
    fs::write(&runners, "[process]\ncores = 1\n").map_err(Error::io("write", &runners))?;
    let load_average = load_average();
    let studio = Studio::start(data.path(), &["--emulate".to_owned(), "demo".to_owned()])?;
    let (mut work, all_requests, watched) = measure(args, studio.addr)?;
    drop(studio);
    work.log_metric = log_metrics(data.path())?;
    let loop_hz: Vec<f64> = watched.iter().flat_map(|page| page.loop_hz.iter().copied()).collect();
    let frames: f64 = watched.iter().map(Watched::frames_per_s).sum();
    let peer = args.peer.as_deref().map(|python| peer(args, python)).transpose()?;
    let report = ApiBenchReport {
        jobs: args.jobs,
        pages: args.pages,
        clients: args.clients,
        studio: work,
        all_requests,
        loop_hz: [
            loop_hz.iter().sum::<f64>() / loop_hz.len().max(1) as f64,
            loop_hz.iter().copied().fold(f64::INFINITY, f64::min),
        ],
        frames_per_page_s: frames / f64::from(args.pages),
        load_average,
        peer,
    };
    if args.json { output::json(&report) } else { print(&report) }
}

fn print(report: &ApiBenchReport) -> Result<(), Error> {
    output::line(&format!(
        "{} jobs wait, {} pages watch ({:.1} frames a second each), {} clients ask: p50 {:.1} ms, p99 {:.1} ms of {} requests; \
         control loop {:.1} Hz, worst second {:.1} Hz",
        report.jobs,
        report.pages,
        report.frames_per_page_s,
        report.clients,
        report.all_requests.p50,
        report.all_requests.p99,
        report.all_requests.requests,
        report.loop_hz[0],
        report.loop_hz[1]
    ))?;
    output::line(&format!("{:28} {:>18} {:>18}", "p50 / p99, ms", "palpate", "MLflow"))?;
    let shown = |delays: &Delays| format!("{:.2} / {:.2}", delays.p50, delays.p99);
    let columns =
        |work: &Work| [&work.create, &work.list, &work.get, &work.log_metric, &work.read_metrics].map(shown);
    let names = ["create", "list 100", "look one up", "note a point of a curve", "read the curves of one"];
    let peer = report.peer.as_ref().map_or_else(|| ["-"; 5].map(str::to_owned), columns);
    for (name, (studio, peer)) in names.iter().zip(columns(&report.studio).iter().zip(&peer)) {
        output::line(&format!("{name:28} {studio:>18} {peer:>18}"))?;
    }
    Ok(())
}

/// Queues the jobs, lets the pages watch, and asks.
fn measure(args: &ApiArgs, addr: SocketAddr) -> Result<(Work, Delays, Vec<Watched>), Error> {
    let mut client = Client::connect(addr)?;
    // Holds the core that there is, and tells how far it is now and then.
    let first = json!({ "kind": "blind", "request": { "seeds": 1_000_000 }, "resources": { "cores": 1 } });
    let first: Job = client.ask("POST", "jobs", Some(&first))?.0;
    let waiting = json!({ "kind": "diagnose", "request": { "session": "load" } });
    let (mut created, mut ids) = (Vec::new(), Vec::new());
    for _ in 0..args.jobs {
        let (job, seconds): (Job, _) = client.ask("POST", "jobs", Some(&waiting))?;
        created.push(seconds);
        ids.push(job.id);
    }
    let runtime = Runtime::new()
        .map_err(|err| Error::Internal(format!("failed to start the pages' threads: {err}")))?;
    let (end, ends) = watch::channel(false);
    let begun = Instant::now();
    let pages: Vec<_> = (0..args.pages)
        .map(|_| runtime.spawn(watch_stream(addr, Pace::AsItComes, begun, ends.clone())))
        .collect();
    thread::sleep(SETTLE);
    let until = Instant::now() + Duration::from_secs(u64::from(args.seconds));
    let looked_at = &ids[..ids.len().min(LISTED)];
    let asked: Vec<Result<Asked, Error>> = thread::scope(|scope| {
        let clients: Vec<_> = (0..args.clients)
            .map(|number| scope.spawn(move || ask_until(addr, looked_at, number, until)))
            .collect();
        let broken = || Err(Error::Internal("a client ended".to_owned()));
        clients.into_iter().map(|client| client.join().unwrap_or_else(|_| broken())).collect()
    });
    end.send_replace(true);
    let mut watched = Vec::new();
    for page in pages {
        let page = runtime.block_on(page);
        watched.push(page.map_err(|err| Error::Internal(format!("a page ended: {err}")))??);
    }
    let mut all = Asked::default();
    for asked in asked {
        let Asked { list, get, metrics } = asked?;
        all.list.extend(list);
        all.get.extend(get);
        all.metrics.extend(metrics);
    }
    // The studio has closed the connection that was quiet meanwhile.
    let mut client = Client::connect(addr)?;
    let page: JobPage = client.ask("GET", "jobs?state=queued&limit=1000", None)?.0;
    if (page.jobs.len() as u32) < args.jobs.min(1000) {
        return Err(Error::Internal(format!("only {} of {} jobs waited", page.jobs.len(), args.jobs)));
    }
    // Jobs outlive their studio; these must not.
    for id in ids.iter().chain([&first.id]) {
        client.ask::<Job>("POST", &format!("jobs/{id}/cancel"), None)?;
    }
    let patience = Instant::now();
    while client.ask::<Job>("GET", &format!("jobs/{}", first.id), None)?.0.is_unfinished() {
        if patience.elapsed() > PATIENCE {
            return Err(Error::Internal(format!("job {} does not end", first.id)));
        }
        thread::sleep(Duration::from_millis(50));
    }
    let every = [&all.list[..], &all.get, &all.metrics].concat();
    let work = Work {
        create: Delays::of(&created),
        list: Delays::of(&all.list),
        get: Delays::of(&all.get),
        read_metrics: Delays::of(&all.metrics),
        ..Work::default()
    };
    Ok((work, Delays::of(&every), watched))
}

/// How long requests took, s.
#[derive(Default)]
struct Asked {
    list: Vec<f64>,
    get: Vec<f64>,
    metrics: Vec<f64>,
}

/// Asks one request after the other, as a script does that looks after its jobs.
fn ask_until(addr: SocketAddr, ids: &[String], number: u16, until: Instant) -> Result<Asked, Error> {
    let mut client = Client::connect(addr)?;
    let mut asked = Asked::default();
    for id in ids.iter().cycle().skip(usize::from(number)) {
        if Instant::now() >= until {
            break;
        }
        asked.list.push(client.ask::<JobPage>("GET", &format!("jobs?limit={LISTED}"), None)?.1);
        let job = format!("jobs/{id}");
        asked.get.push(client.ask::<Job>("GET", &job, None)?.1);
        asked.metrics.push(client.exchange("GET", &format!("/api/v1/{job}/metrics"), None)?.1);
        // A person's script does not ask all the time.
        thread::sleep(Duration::from_millis(20));
    }
    Ok(asked)
}

/// Notes points as a job does: a line appended to a file of its folder.
fn log_metrics(data: &Path) -> Result<Delays, Error> {
    let folder = palpate_jobs::JobFolder::at(data.join("runs/diagnosis-1"));
    let mut seconds = Vec::new();
    for step in 0..1000 {
        let point = json!({ "step": step, "loss": 1.0 / f64::from(step + 1) });
        let begun = Instant::now();
        folder.append_metrics(&point)?;
        seconds.push(begun.elapsed().as_secs_f64());
    }
    Ok(Delays::of(&seconds))
}

/// Lets MLflow's tracking server do the same.
fn peer(args: &ApiArgs, python: &Path) -> Result<Work, Error> {
    let output = Command::new(python)
        .arg(&args.peer_script)
        .args(["--runs", &args.jobs.to_string(), "--seconds", &args.seconds.to_string()])
        .args(["--clients", &args.clients.to_string()])
        .stderr(Stdio::inherit())
        .output()
        .map_err(Error::io("start", python))?;
    if !output.status.success() {
        return Err(Error::Internal(format!("{:?} failed: {}", args.peer_script, output.status)));
    }
    serde_json::from_slice(&output.stdout)
        .map_err(|err| Error::Internal(format!("{:?} gave no figures: {err}", args.peer_script)))
}
