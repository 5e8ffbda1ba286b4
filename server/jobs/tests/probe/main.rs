//! A job and a studio for the tests of jobs. `palpate-jobs-probe --dir DIR --attempt N --nice N` works on the job in a
//! folder: it works for a while and adds a line to a ledger. `palpate-jobs-probe studio DATA` keeps the jobs of a data
//! folder, obeys lines on standard input and acknowledges them on standard output.

use std::{
    fs::File,
    io::{BufRead as _, Write as _, stdin, stdout},
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use palpate_jobs::{
    Begun, Database, JobFolder, JobsError, Outcome, Scheduler, SchedulerConfig, Shard, Submission, Working,
    WorkingConfig, on_stop_request, runners,
};
use palpate_wire::api::{JobSpec, Resources};
use serde_json::{Value, json};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // Runners that start `palpate` say `job run` first.
    let words: Vec<&str> =
        arguments.iter().map(String::as_str).filter(|word| !["job", "run"].contains(word)).collect();
    let result = match words[..] {
        ["studio", data] => studio(Path::new(data)),
        ["--dir", dir, "--attempt", attempt, ..] => work(dir, attempt),
        _ => Err(JobsError::Argument(format!("what do {words:?} mean?"))),
    };
    result.unwrap_or_else(|err| {
        eprintln!("error: {err}");
        ExitCode::from(2)
    })
}

fn work(dir: &str, attempt: &str) -> Result<ExitCode, JobsError> {
    let attempt = attempt.parse().map_err(|_| JobsError::Argument(format!("attempt {attempt:?}")))?;
    let asked = Arc::new(AtomicBool::new(false));
    let hears = asked.clone();
    on_stop_request(move || hears.store(true, Ordering::Relaxed))?;
    let config = WorkingConfig { attempt: Some(attempt), nice: 5 };
    let working = match Working::begin(JobFolder::at(dir), config)? {
        Begun::Mine(working) => working,
        Begun::NotMine(code) => return Ok(code),
    };
    let mut request = working.spec().request.clone();
    if request["unless"].as_str().is_some_and(|path| Path::new(path).exists()) {
        // Whatever was wrong has been mended.
        request = json!({ "ledger": request["ledger"] });
    }
    println!("working as attempt {attempt}");
    if request["grandchild"] == true {
        let child = std::process::Command::new("sleep").arg("1000").spawn();
        println!("grandchild {}", child.map_or(0, |child| child.id()));
    }
    if request["hoard"] == true {
        let hoard = vec![1u8; 1 << 30];
        println!("hoarded {}", hoard.iter().map(|&byte| usize::from(byte)).sum::<usize>());
    }
    let duration = Duration::from_millis(request["sleep_ms"].as_u64().unwrap_or(0));
    let begun = Instant::now();
    while begun.elapsed() < duration {
        if asked.load(Ordering::Relaxed) && request["deaf"] != true {
            return working.end(Outcome::Cancelled);
        }
        working.report(begun.elapsed().as_secs_f64() / duration.as_secs_f64(), "sleeping");
        std::thread::sleep(Duration::from_millis(2));
    }
    working.metrics(&json!({ "step": 1, "slept_ms": duration.as_millis() as u64 }));
    match request["outcome"].as_str() {
        Some("fail") => {
            return working.end(Outcome::Failed { problem: "it was told to fail".into(), code: 3 });
        }
        Some("abort") => std::process::abort(),
        _ => {}
    }
    if let Some(ledger) = request["ledger"].as_str() {
        let line = format!("{dir} {attempt}\n");
        let written = File::options().create(true).append(true).open(ledger);
        let written =
            written.and_then(|mut file| file.write_all(line.as_bytes()).and_then(|()| file.sync_all()));
        if let Err(err) = written {
            return working.end(Outcome::Failed { problem: format!("{ledger}: {err}"), code: 1 });
        }
    }
    working.end(Outcome::Done)
}

fn studio(data: &Path) -> Result<ExitCode, JobsError> {
    let this = std::env::current_exe().unwrap_or_else(|_| PathBuf::from("palpate-jobs-probe"));
    let scheduler = Scheduler::start(SchedulerConfig {
        runs: data.join("runs"),
        trash: data.join("trash/runs"),
        database: Arc::new(Database::open(&data.join("palpate.sqlite"))?),
        runners: runners(data, vec![this], None)?,
        observer: Arc::new(|_| {}),
        cancel_grace: Some(Duration::from_millis(300)),
    })?;
    println!("ready");
    for line in stdin().lock().lines() {
        let line = line.unwrap_or_default();
        match line.split_once(' ') {
            Some(("submit", request)) => {
                let request: Value = serde_json::from_str(request).unwrap_or_default();
                let short = request["short"] == true;
                let num_shards = request["shards"].as_u64().unwrap_or(0) as usize;
                let shards = vec![Shard { request: request.clone(), seed: 0 }; num_shards];
                let spec = JobSpec {
                    kind: "probe".to_owned(),
                    request,
                    inputs: Default::default(),
                    seed: 0,
                    software: "probe".to_owned(),
                    priority: 0,
                    resources: Resources {
                        cores: 1,
                        short,
                        shards: num_shards as u32,
                        ..Resources::default()
                    },
                };
                let runner = spec.request["runner"].as_str();
                let submission = Submission {
                    prefix: "run-",
                    spec: &spec,
                    shards: &shards,
                    owner: "test",
                    runner,
                    key: None,
                };
                println!("queued {}", scheduler.submit(&submission)?.job.id);
            }
            Some(("cancel", id)) => println!("asked {}", scheduler.cancel(id)?.id),
            _ => println!("unfinished {}", scheduler.unfinished()?.len()),
        }
        // A line is an acknowledgement only once it has left.
        let _ = stdout().flush();
    }
    Ok(ExitCode::SUCCESS)
}
