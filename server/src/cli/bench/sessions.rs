//! `palpate bench sessions`: how long a studio takes to start and to list a data folder of many sessions.
//!
//! Sessions are the shipped emulated one again and again. Their takes are hard links, because a thousand copies fill
//! seven gigabytes; the studio takes each for a file of its own.

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use clap::Args;
use palpate_emulator::record_session;
use palpate_recording::Session;
use palpate_server::{Error, assets};
use palpate_sim::job::Progress as _;
use palpate_terminal::{Bar, cancel_on_ctrl_c};
use palpate_wire::api::SessionSummary;
use serde::Serialize;

use super::{
    output,
    stream::{load_average, quantile},
    studio::{Client, Studio},
};

/// A first list decodes every take.
const FIRST_LIST_PATIENCE: Duration = Duration::from_secs(3600);

#[derive(Args)]
pub(crate) struct SessionsArgs {
    /// Sessions in the folder
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u16).range(1..))]
    sessions: u16,
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
    /// The list when nothing is known of the takes, so that each is decoded, s.
    first_list_s: f64,
    starts: u16,
    /// From the start of the process until it says where it listens.
    listening_s: Durations,
    /// Until `GET /healthz` was answered too.
    healthy_s: Durations,
    /// Until the first list was answered too.
    listed_s: Durations,
    /// The list once more.
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
    let bar = Bar::new();
    let studio = Studio::start(data.path(), &[])?;
    bar.report(0.0, "first list");
    let mut client = Client::connect(studio.addr)?;
    client.wait_up_to(FIRST_LIST_PATIENCE)?;
    let (listed, first_list_s): (Vec<SessionSummary>, f64) = client.ask("GET", "sessions", None)?;
    check(&listed, usize::from(args.sessions), takes)?;
    drop(studio);

    let load_average = load_average();
    let (mut listening, mut healthy, mut listed, mut again) = (vec![], vec![], vec![], vec![]);
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
        first_list_s,
        starts: args.starts,
        listening_s: Durations::of(&listening),
        healthy_s: Durations::of(&healthy),
        listed_s: Durations::of(&listed),
        listed_again_s: Durations::of(&again),
        list_bytes,
        peak_memory_mb,
        load_average,
    };
    if args.json { output::json(&report) } else { print(&report) }
}

fn print(report: &SessionsBenchReport) -> Result<(), Error> {
    output::line(&format!(
        "{} sessions of {} takes in all: the first list, which decodes every take, took {:.1} s; load average {:.1}",
        report.sessions, report.takes, report.first_list_s, report.load_average
    ))?;
    output::line(&format!("{:34} {:>8} {:>8}", format!("{} starts, s", report.starts), "median", "longest"))?;
    for (name, of) in [
        ("until it listens", &report.listening_s),
        ("until it answers /healthz", &report.healthy_s),
        ("until it has listed all sessions", &report.listed_s),
        ("the list once more", &report.listed_again_s),
    ] {
        output::line(&format!("{name:34} {:>8.3} {:>8.3}", of.median, of.max))?;
    }
    output::line(&format!(
        "the list has {} kB; the studio had {:.0} MB at most",
        report.list_bytes / 1000,
        report.peak_memory_mb
    ))
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
