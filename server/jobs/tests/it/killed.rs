//! The studio is killed at any moment, again and again.

use std::{
    collections::BTreeMap,
    fs,
    io::{BufRead as _, BufReader, Write as _},
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, sync_channel},
    thread::sleep,
    time::{Duration, Instant},
};

use palpate_jobs::{Database, runners};
use palpate_wire::api::JobState;
use serde_json::json;

use self::rand_like::Numbers;
use crate::slurm::Cluster;
use crate::support::{PATIENCE, PROBE, open, processes_naming};

const NUM_KILLS: usize = 50;

/// Numbers that look random, the same in every run.
mod rand_like {
    /// A linear congruential generator (Knuth's MMIX).
    pub(super) struct Numbers(pub(super) u64);

    impl Numbers {
        pub(super) fn below(&mut self, end: u64) -> u64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 33) % end
        }
    }
}

struct Studio {
    process: Child,
    lines: Receiver<String>,
}

impl Studio {
    fn start(data: &Path) -> Self {
        let mut process = Command::new(PROBE)
            .arg("studio")
            .arg(data)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let output = process.stdout.take().unwrap();
        let (tell, lines) = sync_channel(10_000);
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                if tell.send(line).is_err() {
                    return;
                }
            }
        });
        Self { process, lines }
    }

    fn ask(&mut self, line: &str) {
        // A studio that is dead by now does not hear.
        let _ = writeln!(self.process.stdin.as_mut().unwrap(), "{line}");
    }

    fn kill(mut self) -> Vec<String> {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
        self.lines.iter().collect()
    }
}

#[test]
fn killed_at_fifty_moments_it_loses_no_acknowledged_job_and_does_none_twice() {
    let dir = tempfile::tempdir().unwrap();
    let ledger = dir.path().join("ledger.txt");
    // A part of the jobs runs on Slurm, where there is one.
    let cluster = Cluster::start();
    let slurm = cluster.as_ref().map(Cluster::runner_file).unwrap_or_default();
    let process = "[process]\ncores = 2\nshort_jobs = 2\ngpu = false\nnice = 5\n";
    fs::write(dir.path().join("runners.toml"), format!("{process}{slurm}")).unwrap();
    let mut numbers = Numbers(20_261_125);
    let (mut queued, mut asked) = (Vec::new(), Vec::new());
    let (mut killed_while_running, mut submitted) = (0, 0);
    for _ in 0..NUM_KILLS {
        let mut studio = Studio::start(dir.path());
        let until = Instant::now() + Duration::from_millis(20 + numbers.below(180));
        while Instant::now() < until {
            submitted += 1;
            let (on_slurm, shards) = match submitted % 32 {
                3 => (cluster.is_some(), 2),
                19 => (cluster.is_some(), 0),
                7 | 23 => (false, 3),
                _ => (false, 0),
            };
            let request = json!({
                "sleep_ms": numbers.below(250), "ledger": ledger, "short": numbers.below(2) == 0,
                "shards": shards,
                "runner": if on_slurm { "cluster" } else { "process" },
            });
            studio.ask(&format!("submit {request}"));
            if numbers.below(6) == 0 && !queued.is_empty() {
                let which = numbers.below(queued.len() as u64) as usize;
                studio.ask(&format!("cancel {}", queued[which]));
            }
            sleep(Duration::from_millis(numbers.below(40)));
        }
        for line in studio.kill() {
            match line.split_once(' ') {
                Some(("queued", id)) => queued.push(id.to_owned()),
                Some(("asked", id)) => asked.push(id.to_owned()),
                _ => {}
            }
        }
        let running = processes_naming(&format!("{}/runs", dir.path().display()));
        killed_while_running += usize::from(!running.is_empty());
    }
    assert!(queued.len() > NUM_KILLS / 2, "only {} jobs were acknowledged", queued.len());
    assert!(killed_while_running > NUM_KILLS / 10, "jobs ran at {killed_while_running} of {NUM_KILLS} kills");

    let runners = runners(dir.path(), vec![PROBE.into()], None).unwrap();
    let (scheduler, _) = open(dir.path(), runners);
    let begun = Instant::now();
    while !scheduler.unfinished().unwrap().is_empty() {
        assert!(begun.elapsed() < 4 * PATIENCE, "{:?}", scheduler.unfinished().unwrap());
        sleep(Duration::from_millis(20));
    }
    let mut done_by_job: BTreeMap<String, usize> = BTreeMap::new();
    for line in fs::read_to_string(&ledger).unwrap().lines() {
        // Of a job, `run-1`, or of a shard, `run-1/shards/0`.
        let (folder, _attempt) = line.rsplit_once(' ').unwrap();
        let (_, id) = folder.rsplit_once("/runs/").unwrap();
        *done_by_job.entry(id.to_owned()).or_default() += 1;
    }
    for (id, count) in &done_by_job {
        assert_eq!(*count, 1, "{id} was done {count} times");
    }
    for id in &queued {
        let job = scheduler.job(id).unwrap();
        match job.state {
            JobState::Done => {
                assert_eq!(done_by_job.get(id), Some(&1), "{job:?}");
                for shard in 0..job.spec.resources.shards {
                    assert_eq!(done_by_job.get(&format!("{id}/shards/{shard}")), Some(&1), "{job:?}");
                }
            }
            // Whose acknowledgement was cut off may have been heard all the same.
            JobState::Cancelled => assert!(job.cancel_requested, "{job:?}"),
            _ => panic!("{job:?}"),
        }
    }
    for id in &asked {
        let job = scheduler.job(id).unwrap();
        assert!(matches!(job.state, JobState::Cancelled | JobState::Done), "{job:?}");
    }
    let done = |on: &str, divided: bool| {
        queued.iter().any(|id| {
            let job = scheduler.job(id).unwrap();
            job.state == JobState::Done && job.runner == on && (job.spec.resources.shards > 0) == divided
        })
    };
    assert!(done("process", false) && done("process", true));
    assert!(cluster.is_none() || (done("cluster", false) && done("cluster", true)));
    drop(scheduler);
    let left = processes_naming(dir.path().to_str().unwrap());
    assert!(left.is_empty(), "orphans: {left:?}");
    Database::open(&dir.path().join("palpate.sqlite")).unwrap();
}
