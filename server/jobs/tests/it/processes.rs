//! Jobs as processes of this computer.

use std::{
    fs,
    thread::sleep,
    time::{Duration, Instant},
};

use palpate_jobs::{Begun, JobFolder, Working, WorkingConfig};
use palpate_wire::api::{JobState, Resources};
use serde_json::json;

use crate::support::{PATIENCE, Scene, open, process_runner, processes_naming, wait};

#[test]
fn job_is_done_in_a_process_of_its_own_and_says_how_far_it_is() {
    let scene = Scene::new();
    let job = scene.submit(json!({ "sleep_ms": 400, "ledger": scene.ledger_path() }));
    assert_eq!((job.id.as_str(), job.state, job.attempts), ("run-1", JobState::Queued, 0));
    let running = scene.wait(&job.id, |job| job.fraction > 0.0);
    assert_eq!((running.state, running.stage.as_str(), running.attempts), (JobState::Running, "sleeping", 1));
    let done = scene.ended(&job.id);
    assert_eq!((done.state, done.fraction, done.problem.as_deref()), (JobState::Done, 1.0, None));
    assert!(done.created <= done.started.clone().unwrap() && done.started <= done.ended, "{done:?}");
    assert_eq!(scene.ledger().len(), 1);
    let folder = scene.scheduler.folder(&job.id);
    assert!(folder.log_tail(10_000).unwrap().ends_with("working as attempt 1\n"));
    assert_eq!(folder.metrics_tail(10_000).unwrap(), "{\"slept_ms\":400,\"step\":1}\n");
    let told = scene.told.lock().unwrap().clone();
    assert_eq!((told[0].1, told.last().unwrap().1), (JobState::Queued, JobState::Done));
    let fractions: Vec<f64> = told.iter().map(|(_, _, fraction)| *fraction).collect();
    assert!(fractions.is_sorted() && fractions.len() > 4, "{fractions:?}");
}

#[test]
fn failure_and_death_are_told_apart_and_tried_again() {
    let scene = Scene::new();
    let failed = scene.submit(json!({ "outcome": "fail" })).id;
    let died = scene.submit(json!({ "outcome": "abort" })).id;
    let job = scene.ended(&failed);
    assert_eq!((job.state, job.problem.as_deref()), (JobState::Failed, Some("it was told to fail")));
    let job = scene.ended(&died);
    let problem = job.problem.unwrap();
    assert!(problem.contains("signal 6") && problem.contains("working as attempt 1"), "{problem}");
    assert_eq!(job.state, JobState::Failed, "a job that crashes is not begun again by itself");

    scene.scheduler.retry(&failed).unwrap();
    let job = scene.ended(&failed);
    assert_eq!((job.state, job.attempts), (JobState::Failed, 2));
    let done = scene.submit(json!({})).id;
    scene.ended(&done);
    assert!(scene.scheduler.retry(&done).is_err(), "what is done is done");
}

#[test]
fn job_that_does_not_hear_is_ended_and_so_is_what_it_started() {
    let scene = Scene::new();
    let deaf = scene.submit(json!({ "sleep_ms": 600_000, "deaf": true, "grandchild": true })).id;
    let polite = scene.submit(json!({ "sleep_ms": 600_000 })).id;
    let waits = scene.submit(json!({ "ledger": scene.ledger_path() })).id;
    let folder = scene.scheduler.folder(&deaf);
    let begun = Instant::now();
    let grandchild = loop {
        let log = folder.log_tail(10_000).unwrap();
        if let Some((_, pid)) = log.trim_end().rsplit_once("grandchild ") {
            break pid.to_owned();
        }
        assert!(begun.elapsed() < PATIENCE, "{log}");
        sleep(Duration::from_millis(5));
    };
    scene.wait(&polite, |job| job.state == JobState::Running);
    assert_eq!(
        scene.scheduler.cancel(&waits).unwrap().state,
        JobState::Cancelled,
        "what waits stops at once"
    );
    for id in [&polite, &deaf] {
        let asked = scene.scheduler.cancel(id).unwrap();
        assert_eq!((asked.state, asked.cancel_requested), (JobState::Running, true));
        assert_eq!(scene.ended(id).state, JobState::Cancelled);
    }
    assert!(scene.ledger().is_empty());
    let stat = fs::read_to_string(format!("/proc/{grandchild}/stat")).unwrap_or_default();
    assert!(stat.is_empty() || stat.contains(") Z "), "{stat}");
    assert_eq!(
        scene.scheduler.cancel(&deaf).unwrap().state,
        JobState::Cancelled,
        "once more changes nothing"
    );
    scene.scheduler.delete(&deaf).unwrap();
    assert!(scene.dir.path().join("trash/runs").join(&deaf).join("log.txt").is_file());
}

#[test]
fn shards_are_processes_within_the_cores_and_one_that_crashes_is_named() {
    let scene = Scene::new();
    let shard = json!({ "sleep_ms": 200, "ledger": scene.ledger_path() });
    let one = Resources { cores: 1, ..Resources::default() };
    let last = json!({ "ledger": scene.ledger_path() });
    let job = scene.submit_divided(last, one, vec![shard.clone(); 5]);
    let working = scene.wait(&job.id, |job| job.stage.contains("2 at work"));
    assert!(working.state == JobState::Running && working.fraction < 0.99, "{working:?}");
    let done = scene.ended(&job.id);
    assert_eq!((done.state, done.fraction, done.attempts), (JobState::Done, 1.0, 1), "{done:?}");
    let ledger = scene.ledger();
    assert_eq!(ledger.len(), 6);
    assert!(ledger[..5].iter().all(|line| line.contains(&format!("/{}/shards/", job.id))), "{ledger:?}");
    assert!(ledger[5].ends_with(&format!("/{} 1", job.id)), "the job's own process comes last: {ledger:?}");
    let folder = scene.scheduler.folder(&job.id);
    assert_eq!(folder.shard(3).job_of_shard(), Some(folder.clone()));
    assert!(folder.shard(4).file("exit.json").is_file() && folder.job_of_shard().is_none());
    let told = scene.told.lock().unwrap().clone();
    let fractions: Vec<f64> = told.iter().map(|(_, _, fraction)| *fraction).collect();
    assert!(fractions.is_sorted() && fractions.len() > 4, "{fractions:?}");

    let slow = json!({ "sleep_ms": 600_000 });
    let crashing = vec![slow.clone(), json!({ "outcome": "abort" }), slow.clone()];
    let failed = scene.ended(&scene.submit_divided(json!({}), one, crashing).id);
    let problem = failed.problem.unwrap();
    assert!(problem.starts_with("shard 1: its process ended by signal 6"), "{problem}");
    assert!(problem.ends_with("working as attempt 1"), "{problem}");

    let cancelled = scene.submit_divided(json!({}), one, vec![slow; 3]).id;
    scene.wait(&cancelled, |job| job.stage.contains("2 at work"));
    scene.scheduler.cancel(&cancelled).unwrap();
    assert_eq!(scene.ended(&cancelled).state, JobState::Cancelled);
    assert!(processes_naming(scene.dir.path().to_str().unwrap()).is_empty(), "no process is left");
}

#[test]
fn memory_limit_ends_the_job_and_nothing_else() {
    let scene = Scene::new();
    let limit = Resources { cores: 1, memory_mib: Some(300), ..Resources::default() };
    let job = scene.submit_with(json!({ "hoard": true, "ledger": scene.ledger_path() }), limit);
    let job = scene.ended(&job.id);
    assert_eq!(job.state, JobState::Failed);
    let problem = job.problem.unwrap();
    assert!(problem.contains("memory allocation of 1073741824 bytes failed"), "{problem}");
    assert!(scene.ledger().is_empty());
}

#[test]
fn short_work_does_not_wait_for_long_work() {
    let scene = Scene::new();
    let all = Resources { cores: 0, ..Resources::default() };
    let long = scene.submit_with(json!({ "sleep_ms": 600_000 }), all).id;
    let also = scene.submit_with(json!({}), all).id;
    let short = scene.submit_with(json!({}), Resources { short: true, ..Resources::default() }).id;
    assert_eq!(scene.ended(&short).state, JobState::Done);
    assert_eq!(scene.wait(&long, |_| true).state, JobState::Running);
    assert_eq!(scene.wait(&also, |_| true).state, JobState::Queued);
    scene.scheduler.cancel(&long).unwrap();
    assert_eq!(scene.ended(&also).state, JobState::Done);
}

#[test]
fn running_job_is_found_again_by_the_next_studio() {
    let scene = Scene::new();
    let ids: Vec<String> =
        (0..3).map(|_| scene.submit(json!({ "sleep_ms": 1500, "ledger": scene.ledger_path() })).id).collect();
    let cancelled = &ids[1];
    for id in &ids[..2] {
        scene.wait(id, |job| job.fraction > 0.0);
    }
    scene.scheduler.stop();
    let (again, _) = open(scene.dir.path(), vec![process_runner()]);
    assert_eq!(again.job(&ids[0]).unwrap().state, JobState::Running);
    assert_eq!(again.job(&ids[2]).unwrap().state, JobState::Queued);
    // It can be cancelled though it is nobody's child any more.
    again.cancel(cancelled).unwrap();
    assert_eq!(wait(&again, cancelled, |job| !job.is_unfinished()).state, JobState::Cancelled);
    for id in [&ids[0], &ids[2]] {
        let job = wait(&again, id, |job| !job.is_unfinished());
        assert_eq!((job.state, job.attempts), (JobState::Done, 1), "{job:?}");
    }
    assert_eq!(scene.ledger().len(), 2, "{:?}", scene.ledger());
}

#[test]
fn process_whose_attempt_counts_no_more_does_nothing() {
    let scene = Scene::new();
    let id = scene.submit(json!({ "outcome": "fail" })).id;
    scene.ended(&id);
    scene.scheduler.retry(&id).unwrap();
    scene.wait(&id, |job| job.attempts == 2 && !job.is_unfinished());
    let folder = scene.scheduler.folder(&id);
    let before = fs::read(folder.file("exit.json")).unwrap();
    for attempt in [1, 3] {
        let config = WorkingConfig { attempt: Some(attempt), nice: 0 };
        let begun = Working::begin(JobFolder::at(folder.path()), config).unwrap();
        assert!(matches!(begun, Begun::NotMine(_)), "attempt {attempt}");
    }
    // Nor does one that a cluster starts a second time after it has ended.
    let config = WorkingConfig { attempt: Some(2), nice: 0 };
    assert!(matches!(Working::begin(folder.clone(), config).unwrap(), Begun::NotMine(_)));
    assert_eq!(fs::read(folder.file("exit.json")).unwrap(), before);
    assert_eq!(processes_naming(scene.dir.path().to_str().unwrap()), Vec::<String>::new());
}

#[test]
fn process_whose_folder_is_gone_ends() {
    let scene = Scene::new();
    let id = scene.submit(json!({ "sleep_ms": 600_000, "deaf": true })).id;
    scene.wait(&id, |job| job.stage == "sleeping");
    scene.scheduler.stop();
    let runs = scene.dir.path().join("runs");
    let name = runs.join(&id).to_str().unwrap().to_owned();
    assert_eq!(processes_naming(&name).len(), 1);
    fs::remove_dir_all(&runs).unwrap();
    let begun = Instant::now();
    while !processes_naming(&name).is_empty() {
        assert!(begun.elapsed() < PATIENCE, "it works for nobody");
        sleep(Duration::from_millis(50));
    }
}
