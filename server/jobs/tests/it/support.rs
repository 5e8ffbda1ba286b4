//! A scheduler over real processes, in a folder of its own.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    thread::sleep,
    time::{Duration, Instant},
};

use palpate_jobs::{
    Capacity, Database, ProcessRunner, ProcessRunnerConfig, Runner, Scheduler, SchedulerConfig, Shard,
    Submission,
};
use palpate_wire::api::{Job, JobSpec, JobState, Resources};
use serde_json::Value;

pub(crate) const PROBE: &str = env!("CARGO_BIN_EXE_palpate-jobs-probe");

/// Everything that a busy machine may need.
pub(crate) const PATIENCE: Duration = Duration::from_secs(150);

pub(crate) struct Scene {
    pub(crate) dir: tempfile::TempDir,
    pub(crate) scheduler: Scheduler,
    /// State and stage of every change that was told, in order.
    pub(crate) told: Arc<Mutex<Vec<(String, JobState, f64)>>>,
}

pub(crate) fn process_runner() -> Arc<dyn Runner> {
    Arc::new(ProcessRunner::new(ProcessRunnerConfig {
        command: vec![PathBuf::from(PROBE)],
        nice: 5,
        capacity: Capacity { cores: 2, gpu: false, short_jobs: 2 },
        station: None,
    }))
}

pub(crate) type Told = Arc<Mutex<Vec<(String, JobState, f64)>>>;

pub(crate) fn open(dir: &Path, runners: Vec<Arc<dyn Runner>>) -> (Scheduler, Told) {
    let told = Told::default();
    let hears = told.clone();
    let config = SchedulerConfig {
        runs: dir.join("runs"),
        trash: dir.join("trash/runs"),
        database: Arc::new(Database::open(&dir.join("palpate.sqlite")).unwrap()),
        runners,
        observer: Arc::new(move |job| {
            hears.lock().unwrap().push((job.id.clone(), job.state, job.fraction));
        }),
        cancel_grace: Some(Duration::from_millis(300)),
    };
    (Scheduler::start(config).unwrap(), told)
}

impl Scene {
    pub(crate) fn new() -> Self {
        Self::in_dir(tempfile::tempdir().unwrap(), vec![process_runner()])
    }

    pub(crate) fn in_dir(dir: tempfile::TempDir, runners: Vec<Arc<dyn Runner>>) -> Self {
        let (scheduler, told) = open(dir.path(), runners);
        Self { dir, scheduler, told }
    }

    pub(crate) fn submit(&self, request: Value) -> Job {
        self.submit_with(request, Resources { cores: 1, ..Resources::default() })
    }

    pub(crate) fn submit_with(&self, request: Value, resources: Resources) -> Job {
        self.submit_divided(request, resources, Vec::new())
    }

    /// A job with shards of these requests.
    pub(crate) fn submit_divided(&self, request: Value, resources: Resources, shards: Vec<Value>) -> Job {
        let resources = Resources { shards: shards.len() as u32, ..resources };
        let spec = JobSpec {
            kind: "probe".to_owned(),
            request,
            inputs: Default::default(),
            seed: 0,
            software: "probe".to_owned(),
            priority: 0,
            resources,
        };
        let shards: Vec<Shard> = shards.into_iter().map(|request| Shard { request, seed: 0 }).collect();
        let submission = Submission {
            prefix: "run-",
            spec: &spec,
            shards: &shards,
            owner: "test",
            runner: None,
            key: None,
        };
        self.scheduler.submit(&submission).unwrap().job
    }

    pub(crate) fn wait(&self, id: &str, until: impl Fn(&Job) -> bool) -> Job {
        wait(&self.scheduler, id, until)
    }

    pub(crate) fn ended(&self, id: &str) -> Job {
        self.wait(id, |job| !job.is_unfinished())
    }

    /// Lines of `ledger.txt`.
    pub(crate) fn ledger(&self) -> Vec<String> {
        let text = std::fs::read_to_string(self.ledger_path()).unwrap_or_default();
        text.lines().map(str::to_owned).collect()
    }

    pub(crate) fn ledger_path(&self) -> PathBuf {
        self.dir.path().join("ledger.txt")
    }
}

pub(crate) fn wait(scheduler: &Scheduler, id: &str, until: impl Fn(&Job) -> bool) -> Job {
    let begun = Instant::now();
    loop {
        let job = scheduler.job(id).unwrap();
        if until(&job) {
            return job;
        }
        assert!(begun.elapsed() < PATIENCE, "{job:?}");
        sleep(Duration::from_millis(5));
    }
}

/// Command lines of processes that name `word`.
pub(crate) fn processes_naming(word: &str) -> Vec<String> {
    let entries = std::fs::read_dir("/proc").unwrap();
    let lines = entries.filter_map(|entry| {
        let line = std::fs::read(entry.unwrap().path().join("cmdline")).ok()?;
        let line = String::from_utf8_lossy(&line).replace('\0', " ");
        line.contains(word).then_some(line)
    });
    lines.collect()
}
