//! `palpate bench sessions`: how long a studio takes to start and to list a data folder of many sessions and jobs.
//!
//! Sessions are the shipped emulated one again and again. Their takes are hard links, because a thousand copies fill
//! seven gigabytes; the studio takes each for a file of its own.

use std::{
    fs,
    net::SocketAddr,
    path::Path,
    time::{Duration, Instant},
};

use clap::Args;
use palpate_recording::Session;
use palpate_server::{Error, assets};
use palpate_sim::job::Progress as _;
use palpate_terminal::{Bar, cancel_on_ctrl_c};
use palpate_truth::record_session;
use palpate_wire::api::{Job, JobPage, SessionSummary};
use serde::Serialize;
use serde_json::json;

use super::{
    output,
    stream::{load_average, quantile},
    studio::{Client, Studio},
};

/// A first list decodes every take.
const FIRST_LIST_PATIENCE: Duration = Duration::from_secs(3600);

/// A studio takes so many of one connection in a second, and as fast as they are answered here it would be more.
const REQUESTS_OF_A_CONNECTION: usize = 100;

#[derive(Args)]
pub(crate) struct SessionsArgs {
    /// Sessions in the folder
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u16).range(1..))]
    sessions: u16,
    /// Jobs that have ended there
    #[arg(long, default_value_t = 10_000)]
    jobs: u32,
    /// How often the studio is started
    #[arg(long, default_value_t = 9, value_parser = clap::value_parser!(u16).range(1..))]
    starts: u16,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Of all starts, s.
#[derive(Debug, Serialize)]
struct Durations {
    median: f64,
    max: f64,
}

impl Durations {
    fn of(seconds: &[f64]) -> Self {
        Self { median: quantile(seconds, 0.5), max: quantile(seconds, 1.0) }
    }
}

#[derive(Debug, Serialize)]
struct SessionsBenchReport {
    sessions: usize,
    takes: usize,
    jobs: u32,
    /// The list when nothing is known of the takes, so that each is decoded, s.
    first_list_s: f64,
    starts: u16,
    /// From the start of the process until it says where it listens.
    listening_s: Durations,
    /// Until `GET /healthz` was answered too.
    healthy_s: Durations,
    /// Until the first list was answered too.
    listed_s: Durations,
    /// Until the newest jobs were listed too.
    jobs_listed_s: Durations,
    /// The list of sessions once more.
    listed_again_s: Durations,
    /// The list as sent.
    list_bytes: usize,
    /// The studio's memory at its largest, MB.
    peak_memory_mb: f64,
    /// Processes that wanted to run in the minute before the starts.
    load_average: f64,
}

pub(super) fn run(args: &SessionsArgs) -> Result<(), Error> {
    let (truth, _unpacked) = assets::truth(Path::new("demo"))?;
    let data = tempfile::tempdir().map_err(Error::io("make", std::env::temp_dir()))?;
    let sessions = data.path().join("sessions");
    let first = sessions.join("session-00001");
    let recorded = record_session(&truth, &first, 0, &Bar::new(), &cancel_on_ctrl_c())?;
    for number in 2..=args.sessions {
        link(&recorded, &sessions.join(format!("session-{number:05}")))?;
    }
    let takes = usize::from(args.sessions) * recorded.file.takes.len();
    // One job at a time, so that others wait.
    let runners = data.path().join("runners.toml");
    fs::write(&runners, "[process]\ncores = 1\n").map_err(Error::io("write", &runners))?;
    let bar = Bar::new();
    let studio = Studio::start(data.path(), &[])?;
    bar.report(0.0, "first list");
    let mut client = Client::connect(studio.addr)?;
    client.wait_up_to(FIRST_LIST_PATIENCE);
    let (listed, first_list_s): (Vec<SessionSummary>, f64) = client.ask("GET", "sessions", None)?;
    check(&listed, usize::from(args.sessions), takes)?;
    leave_jobs(studio.addr, args.jobs, &bar)?;
    drop(studio);

    let load_average = load_average();
    let (mut listening, mut healthy, mut listed, mut again) = (vec![], vec![], vec![], vec![]);
    let mut jobs_listed = vec![];
    let (mut list_bytes, mut peak_memory_mb) = (0, 0.0);
    for start in 0..args.starts {
        bar.report(f64::from(start) / f64::from(args.starts), "starts");
        let begun = Instant::now();
        let studio = Studio::start(data.path(), &[])?;
        listening.push(begun.elapsed().as_secs_f64());
        let mut client = Client::connect(studio.addr)?;
        client.exchange("GET", "/healthz", None)?;
        healthy.push(begun.elapsed().as_secs_f64());
        let (list, _) = client.exchange("GET", "/api/v1/sessions", None)?;
        listed.push(begun.elapsed().as_secs_f64());
        let (page, _): (JobPage, _) = client.ask("GET", "jobs", None)?;
        jobs_listed.push(begun.elapsed().as_secs_f64());
        if page.jobs.is_empty() != (args.jobs == 0) {
            return Err(Error::Internal(format!("{} jobs were listed of {}", page.jobs.len(), args.jobs)));
        }
        again.push(client.exchange("GET", "/api/v1/sessions", None)?.1);
        let entries: Vec<SessionSummary> =
            serde_json::from_slice(&list).map_err(|err| Error::Internal(format!("no list: {err}")))?;
        check(&entries, usize::from(args.sessions), takes)?;
        list_bytes = list.len();
        peak_memory_mb = studio.peak_memory_mb().max(peak_memory_mb);
    }
    drop(bar);
    let report = SessionsBenchReport {
        sessions: usize::from(args.sessions),
        takes,
        jobs: args.jobs,
        first_list_s,
        starts: args.starts,
        listening_s: Durations::of(&listening),
        healthy_s: Durations::of(&healthy),
        listed_s: Durations::of(&listed),
        jobs_listed_s: Durations::of(&jobs_listed),
        listed_again_s: Durations::of(&again),
        list_bytes,
        peak_memory_mb,
        load_average,
    };
    if args.json { output::json(&report) } else { print(&report) }
}

fn print(report: &SessionsBenchReport) -> Result<(), Error> {
    output::line(&format!(
        "{} sessions of {} takes in all, {} jobs: the first list, which decodes every take, took {:.1} s; load average {:.1}",
        report.sessions, report.takes, report.jobs, report.first_list_s, report.load_average
    ))?;
    output::line(&format!("{:34} {:>8} {:>8}", format!("{} starts, s", report.starts), "median", "longest"))?;
    for (name, of) in [
        ("until it listens", &report.listening_s),
        ("until it answers /healthz", &report.healthy_s),
        ("until it has listed all sessions", &report.listed_s),
        ("until it has listed jobs too", &report.jobs_listed_s),
        ("the list of sessions once more", &report.listed_again_s),
    ] {
        output::line(&format!("{name:34} {:>8.3} {:>8.3}", of.median, of.max))?;
    }
    output::line(&format!(
        "the list has {} kB; the studio had {:.0} MB at most",
        report.list_bytes / 1000,
        report.peak_memory_mb
    ))
}

/// Queues `jobs` behind one that runs, and cancels each.
fn leave_jobs(addr: SocketAddr, jobs: u32, bar: &Bar) -> Result<(), Error> {
    let holder = json!({ "kind": "blind", "request": { "seeds": 1_000_000 }, "resources": { "cores": 1 } });
    let waiting = json!({ "kind": "diagnose", "request": { "session": "session-00001" } });
    let mut client = Client::connect(addr)?;
    let mut ids = Vec::new();
    for number in 0..jobs {
        bar.report(f64::from(number) / f64::from(jobs), "jobs");
        if ids.len() % REQUESTS_OF_A_CONNECTION == 0 {
            client = Client::connect(addr)?;
        }
        let request = if number == 0 { &holder } else { &waiting };
        let (job, _): (Job, _) = client.ask("POST", "jobs", Some(request))?;
        ids.push(job.id);
    }
    // Those that wait end at once; the one that runs comes last, or another would take its place.
    for (number, id) in ids.iter().rev().enumerate() {
        if number % REQUESTS_OF_A_CONNECTION == 0 {
            client = Client::connect(addr)?;
        }
        let _: (Job, _) = client.ask("POST", &format!("jobs/{id}/cancel"), None)?;
    }
    Ok(())
}

/// Makes a session in the folder `dir` with the takes of `session`.
fn link(session: &Session, dir: &Path) -> Result<(), Error> {
    fs::create_dir(dir).map_err(Error::io("make", dir))?;
    let entries = fs::read_dir(&session.dir).map_err(Error::io("read", &session.dir))?;
    for entry in entries {
        let path = entry.map_err(Error::io("read", &session.dir))?.path();
        let Some(name) = path.file_name() else { continue };
        let target = dir.join(name);
        if path.extension().is_some_and(|extension| extension == "mcap") {
            fs::hard_link(&path, &target).map_err(Error::io("link", &target))?;
        } else {
            fs::copy(&path, &target).map_err(Error::io("make", &target))?;
        }
    }
    Ok(())
}

/// A list that is not whole says nothing of how long the whole takes.
fn check(listed: &[SessionSummary], sessions: usize, takes: usize) -> Result<(), Error> {
    let found: usize = listed.iter().map(|session| session.takes).sum();
    if let Some((id, problem)) =
        listed.iter().find_map(|session| Some((&session.id, session.error.as_ref()?)))
    {
        return Err(Error::Internal(format!("session {id} cannot be read: {problem}")));
    }
    if (listed.len(), found) != (sessions, takes) {
        return Err(Error::Internal(format!(
            "{} sessions with {found} takes were listed, expected {sessions} with {takes}",
            listed.len()
        )));
    }
    Ok(())
}
