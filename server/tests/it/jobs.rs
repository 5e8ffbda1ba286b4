//! Jobs of every kind over HTTP, and what of them survives.

use std::{fs, time::Instant};

use axum::{
    Router,
    body::Body,
    http::{Request, StatusCode, header},
};
use http_body_util::BodyExt as _;
use palpate_wire::api::{DiagnosisRun, Job, JobPage, JobState, SessionDetail};
use serde_json::{Value, json};
use tower::ServiceExt as _;

use crate::support::{Data, access, arg, ended, get, palpate, palpate_ok, palpate_refuses, post, send, wait};

async fn submit(app: &Router, key: &str, request: &Value) -> (StatusCode, Value) {
    let request = Request::post("/api/v1/jobs")
        .header(header::HOST, "localhost")
        .header(header::CONTENT_TYPE, "application/json")
        .header("Idempotency-Key", key)
        .body(Body::from(request.to_string()))
        .unwrap();
    let response = app.clone().oneshot(request).await.unwrap();
    let status = response.status();
    let body = response.into_body().collect().await.unwrap().to_bytes();
    (status, serde_json::from_slice(&body).unwrap())
}

#[tokio::test]
async fn session_is_emulated_as_a_job_and_everything_of_it_can_be_read() {
    let data = Data::empty();
    let app = data.app();
    let request = json!({ "kind": "emulate", "request": { "truth": "bench", "session": "made" }, "seed": 3 });
    let answer = post(&app, "/api/v1/jobs", &request).await;
    assert_eq!(answer.status, 202, "{:?}", answer.body);
    let job: Job = answer.json();
    assert_eq!((job.id.as_str(), job.state), ("emulation-1", JobState::Queued));
    assert_eq!(answer.header(header::LOCATION), "/api/v1/jobs/emulation-1");
    let job = ended(&app, &job.id).await;
    assert_eq!((job.state, job.problem.as_deref(), job.attempts), (JobState::Done, None, 1));
    assert!(job.started.is_some() && job.ended >= job.started && job.spec.seed == 3);
    assert!(job.spec.software.starts_with("palpate "), "{:?}", job.spec.software);

    let made: SessionDetail = get(&app, "/api/v1/sessions/made").await.json();
    assert!(made.takes.len() > 1);
    let report = get(&app, "/api/v1/jobs/emulation-1/files/report.json").await;
    assert_eq!(report.header(header::CONTENT_TYPE), "application/json");
    assert_eq!(report.json::<SessionDetail>(), made);
    let log = get(&app, "/api/v1/jobs/emulation-1/log").await;
    assert!(String::from_utf8_lossy(&log.body).starts_with("--- attempt 1 at 2"), "{:?}", log.body);
    assert_eq!(get(&app, "/api/v1/jobs/emulation-1/metrics").await.status, 200);
    get(&app, "/api/v1/jobs/emulation-1/files/nothing.json").await.problem(404);
    get(&app, "/api/v1/jobs/emulation-1/files/..%2F..%2Fpalpate.sqlite").await.problem(400);
    get(&app, "/api/v1/jobs/emulation-2").await.problem(404);

    // What is there already is refused, before it is queued.
    post(&app, "/api/v1/jobs", &request).await.problem(409);
    let unknown = json!({ "kind": "dance", "request": {} });
    assert!(post(&app, "/api/v1/jobs", &unknown).await.problem(400).contains("calibrate, diagnose"));
    let path = json!({ "kind": "emulate", "request": { "truth": "/etc/passwd", "session": "x" } });
    post(&app, "/api/v1/jobs", &path).await.problem(400);
    let nonsense = json!({ "kind": "emulate", "request": { "truth": "bench", "session": "x", "speed": 2 } });
    assert!(post(&app, "/api/v1/jobs", &nonsense).await.problem(422).contains("speed"));
    let elsewhere =
        json!({ "kind": "emulate", "request": { "truth": "bench", "session": "x" }, "runner": "moon" });
    assert!(post(&app, "/api/v1/jobs", &elsewhere).await.problem(400).contains("moon"));

    assert_eq!(send(&app, "DELETE", "/api/v1/jobs/emulation-1", None).await.status, 204);
    get(&app, "/api/v1/jobs/emulation-1").await.problem(404);
    assert!(data.root().join("trash/runs/emulation-1/report.json").is_file());
    assert_eq!(get(&app, "/api/v1/sessions/made").await.status, 200, "what it made stays");
}

#[tokio::test]
async fn divided_bench_reports_the_same_bits_as_one_in_one_process() {
    let data = Data::empty();
    let app = data.app();
    let request = json!({
        "kind": "blind",
        "request": { "domain": "actuator", "seeds": 3, "only": ["coulomb_friction, strong"], "nulls": 0 },
        "seed": 7,
    });
    let mut divided = request.clone();
    divided["resources"] = json!({ "shards": 2, "at_once": 1 });
    let mut reports = Vec::new();
    for request in [&request, &divided] {
        let answer = post(&app, "/api/v1/jobs", request).await;
        assert_eq!(answer.status, 202, "{:?}", answer.body);
        let job = ended(&app, &answer.json::<Job>().id).await;
        assert_eq!((job.state, job.problem.as_deref(), job.fraction), (JobState::Done, None, 1.0));
        reports.push(get(&app, &format!("/api/v1/jobs/{}/files/report.json", job.id)).await.body);
    }
    assert_eq!(reports[0], reports[1]);
    let runs = data.root().join("runs");
    let read = |path: &str| fs::read_to_string(runs.join(path)).unwrap();
    // Seeds 7 and 8 were asked of one shard, 9 of the other; the job's own process asked for none again.
    let shards = [read("blind-2/shards/0/answers.jsonl"), read("blind-2/shards/1/answers.jsonl")];
    assert_eq!(shards.each_ref().map(|answers| answers.lines().count()), [4, 2]);
    assert_eq!(read("blind-2/answers.jsonl"), shards.concat());
    let spec: Value = serde_json::from_str(&read("blind-2/shards/1/spec.json")).unwrap();
    assert_eq!((&spec["seed"], &spec["request"]["seeds"]), (&json!(9), &json!(1)));

    for (kind, asked, shards, word) in [
        ("emulate", json!({ "truth": "bench", "session": "x" }), 2, "cannot be divided"),
        ("blind", request["request"].clone(), 4, "at most 3"),
        ("blind", request["request"].clone(), 0, "at_once = 1"),
    ] {
        let resources = json!({ "shards": shards, "at_once": 1 });
        let refused = json!({ "kind": kind, "request": asked, "resources": resources });
        let problem = post(&app, "/api/v1/jobs", &refused).await.problem(400);
        assert!(problem.contains("resources.") && problem.contains(word), "{problem}");
    }
}

#[tokio::test]
async fn request_that_is_sent_twice_makes_one_job() {
    let data = Data::with_session();
    let app = data.app();
    let request = json!({ "kind": "calibrate", "request": { "session": "taps" } });
    let (status, first) = submit(&app, "monday-1", &request).await;
    assert_eq!(status, 202, "{first}");
    let (status, again) = submit(&app, "monday-1", &request).await;
    assert_eq!((status.as_u16(), &again["id"]), (200, &first["id"]));
    let other = json!({ "kind": "calibrate", "request": { "session": "taps", "method": "grid" } });
    let (status, problem) = submit(&app, "monday-1", &other).await;
    assert_eq!(status, 409, "{problem}");
    let (status, other) = submit(&app, "monday-2", &other).await;
    assert_eq!(status, 202, "{other}");
    assert_ne!(other["id"], first["id"]);

    let page: JobPage = get(&app, "/api/v1/jobs?limit=1").await.json();
    assert_eq!((page.jobs.len(), page.jobs[0].id.as_str()), (1, "run-2"));
    let next = format!("/api/v1/jobs?limit=1&kind=calibrate&cursor={}", page.next_cursor.unwrap());
    let page: JobPage = get(&app, &next).await.json();
    assert_eq!((page.jobs[0].id.as_str(), page.next_cursor), ("run-1", None));
    get(&app, "/api/v1/jobs?state=dancing").await.problem(400);
    get(&app, "/api/v1/jobs?cursor=x").await.problem(400);
    // Calibrations are jobs in another form.
    let job = ended(&app, "run-1").await;
    assert_eq!(job.state, JobState::Done, "{job:?}");
    let inputs: Vec<&String> = job.spec.inputs.keys().collect();
    assert_eq!(inputs.len(), 5, "session.toml and four takes: {inputs:?}");
    let run: Value = get(&app, "/api/v1/calibrations/run-1").await.json();
    assert_eq!((&run["state"], &run["request"]["session"]), (&json!("done"), &json!("taps")));
    get(&app, "/api/v1/diagnoses/run-1").await.problem(404);
}

#[tokio::test]
async fn diagnosis_outlives_its_studio_and_is_cancelled_by_the_next_one() {
    let data = Data::with_emulated_session();
    let app = data.app();
    let run: DiagnosisRun = post(&app, "/api/v1/diagnoses", &json!({ "session": "bench" })).await.json();
    let waits: DiagnosisRun = post(&app, "/api/v1/diagnoses", &json!({ "session": "bench" })).await.json();
    wait(&app, &run.id, |job| job.fraction > 0.0).await;
    let again = data.restart(app).await;
    let job = wait(&again, &run.id, |_| true).await;
    assert_eq!((job.state, job.attempts), (JobState::Running, 1), "{job:?}");
    assert_eq!(wait(&again, &waits.id, |_| true).await.state, JobState::Queued);
    for id in [&waits.id, &run.id] {
        send(&again, "DELETE", &format!("/api/v1/jobs/{id}"), None).await.problem(409);
        send(&again, "POST", &format!("/api/v1/jobs/{id}/cancel"), None).await;
        assert_eq!(ended(&again, id).await.state, JobState::Cancelled);
    }
    // Tried again, it is the same job in its second attempt.
    let retried: Job = send(&again, "POST", &format!("/api/v1/jobs/{}/retry", run.id), None).await.json();
    assert!(retried.is_unfinished() && !retried.cancel_requested, "{retried:?}");
    let job = wait(&again, &run.id, |job| job.attempts == 2).await;
    send(&again, "POST", &format!("/api/v1/jobs/{}/cancel", job.id), None).await;
    assert_eq!(ended(&again, &run.id).await.state, JobState::Cancelled);
}

#[tokio::test]
async fn retry_on_data_that_has_changed_says_so() {
    let data = Data::with_session();
    let file = data.truncate_take();
    let app = data.app();
    let request = json!({ "kind": "calibrate", "request": { "session": "taps" } });
    let job: Job = post(&app, "/api/v1/jobs", &request).await.json();
    assert_eq!(ended(&app, &job.id).await.state, JobState::Failed);
    let path = data.session().join(&file);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert_eq!(send(&app, "POST", &format!("/api/v1/jobs/{}/retry", job.id), None).await.status, 200);
    let job = wait(&app, &job.id, |job| job.attempts == 2 && !job.is_unfinished()).await;
    let problem = job.problem.unwrap();
    assert!(problem.contains(&file) && problem.contains("has changed"), "{problem}");
}

#[tokio::test]
async fn clone_is_another_job_with_changes() {
    let data = Data::with_session();
    let app = data.app();
    let request = json!({
        "kind": "calibrate", "seed": 3, "priority": 2, "request": { "session": "taps", "hold_out": ["take-03"] },
    });
    let job: Job = post(&app, "/api/v1/jobs", &request).await.json();
    let changes = json!({ "request": { "method": "grid", "hold_out": null }, "seed": 4 });
    let answer = post(&app, &format!("/api/v1/jobs/{}/clone", job.id), &changes).await;
    assert_eq!(answer.status, 202, "{:?}", answer.body);
    let other: Job = answer.json();
    assert_eq!(answer.header(header::LOCATION), "/api/v1/jobs/run-2");
    assert_eq!(other.spec.request, json!({ "session": "taps", "method": "grid" }));
    assert_eq!((other.spec.seed, other.spec.priority, &other.spec.inputs), (4, 2, &job.spec.inputs));
    let wrong = json!({ "request": { "speed": 3 } });
    assert!(post(&app, "/api/v1/jobs/run-1/clone", &wrong).await.problem(422).contains("speed"));
    post(&app, "/api/v1/jobs/run-9/clone", &changes).await.problem(404);
    for id in ["run-1", "run-2"] {
        assert_eq!(ended(&app, id).await.state, JobState::Done);
    }
    let report: Value = get(&app, "/api/v1/jobs/run-2/files/report.json").await.json();
    assert_eq!(report["method"], "grid");
}

#[tokio::test]
async fn studio_with_ten_thousand_jobs_is_ready_in_two_seconds() {
    const NUM_JOBS: usize = 10_000;
    let data = Data::with_session();
    let app = data.app();
    let run: Value = post(&app, "/api/v1/calibrations", &json!({ "session": "taps" })).await.json();
    ended(&app, run["id"].as_str().unwrap()).await;
    drop(app);
    let database = rusqlite::Connection::open(data.root().join("palpate.sqlite")).unwrap();
    let copy = format!(
        "WITH RECURSIVE n (i) AS (SELECT 2 UNION ALL SELECT i + 1 FROM n WHERE i < {NUM_JOBS})
         INSERT INTO jobs (id, kind, state, spec, owner, runner, priority, cores, gpu, station, short, created, stage, fraction)
         SELECT 'run-' || i, kind, state, spec, owner, runner, priority, cores, gpu, station, short, created, stage, fraction
         FROM jobs, n WHERE id = 'run-1'"
    );
    assert_eq!(database.execute(&copy, []).unwrap(), NUM_JOBS - 1);
    drop(database);
    for number in 2..=NUM_JOBS {
        let folder = data.root().join(format!("runs/run-{number}"));
        fs::create_dir(&folder).unwrap();
        fs::write(folder.join("report.json"), "{}").unwrap();
    }
    let begun = Instant::now();
    let app = data.app();
    let page: JobPage = get(&app, "/api/v1/jobs").await.json();
    let seconds = begun.elapsed().as_secs_f64();
    assert_eq!((page.jobs.len(), page.jobs[0].id.as_str()), (100, "run-10000"));
    assert!(seconds < 2.0, "{seconds} s");
    eprintln!("ready with {NUM_JOBS} jobs after {seconds:.3} s");
}

#[tokio::test]
async fn jobs_are_found_again_by_their_folders_where_the_database_is_lost() {
    let data = Data::with_session();
    let app = data.app();
    let run: Value = post(&app, "/api/v1/calibrations", &json!({ "session": "taps" })).await.json();
    assert_eq!(ended(&app, run["id"].as_str().unwrap()).await.state, JobState::Done);
    let before: Value = get(&app, "/api/v1/calibrations/run-1").await.json();
    drop(app);
    for name in ["palpate.sqlite", "palpate.sqlite-wal", "palpate.sqlite-shm"] {
        let path = data.root().join(name);
        assert!(fs::remove_file(&path).is_ok() || !path.exists());
    }
    let app = data.app();
    let again: Value = get(&app, "/api/v1/calibrations/run-1").await.json();
    assert_eq!((&again["state"], &again["report"]), (&json!("done"), &before["report"]));
    let next: Value = post(&app, "/api/v1/calibrations", &json!({ "session": "taps" })).await.json();
    assert_eq!(next["id"], "run-2");
    assert_eq!(ended(&app, "run-2").await.state, JobState::Done);
}

#[tokio::test]
async fn runs_of_before_there_was_a_database_are_taken_over_once_with_all_their_files() {
    let data = Data::with_session();
    let app = data.app();
    post(&app, "/api/v1/calibrations", &json!({ "session": "taps" })).await;
    assert_eq!(ended(&app, "run-1").await.state, JobState::Done);
    let done: Value = get(&app, "/api/v1/calibrations/run-1").await.json();
    drop(app);
    // As version 0.1 left it.
    let old = Data::with_session();
    let runs = old.root().join("runs");
    fs::create_dir_all(&runs).unwrap();
    let mut run = done.clone();
    run["id"] = json!("run-5");
    run["saved_as"] = json!("my-model");
    fs::write(runs.join("run-5.json"), run.to_string()).unwrap();
    fs::write(runs.join("run-5.html"), "<p>for people</p>").unwrap();
    let diagnosis = json!({
        "id": "diagnosis-2", "request": {
            "session": "taps", "model": null, "hold_out": null, "max_effects": null, "without": [], "null_sessions": null,
        }, "state": "cancelled", "fraction": 0.3, "stage": "cancelled", "seconds_left": null, "error": null, "report": null, "model_toml": null, "saved_as": null,
    });
    fs::write(runs.join("diagnosis-2.json"), diagnosis.to_string()).unwrap();
    fs::write(runs.join("diagnosis-2.calibrated.toml"), "x = 1").unwrap();
    let app = old.app();
    for _ in 0..2 {
        let listed: Vec<Value> = get(&app, "/api/v1/calibrations").await.json();
        assert_eq!((listed.len(), &listed[0]["id"]), (1, &json!("run-5")));
        assert_eq!(get(&app, "/api/v1/calibrations/run-5").await.json::<Value>(), run, "to the bit");
        let html = get(&app, "/api/v1/calibrations/run-5/report.html").await;
        assert_eq!(html.body, "<p>for people</p>");
        let listed: Vec<Value> = get(&app, "/api/v1/diagnoses").await.json();
        assert_eq!((listed.len(), &listed[0]), (1, &diagnosis));
    }
    assert!(
        runs.join("diagnosis-2/calibrated.toml").is_file() && runs.join("run-5/taken-over.json").is_file()
    );
    let app = old.restart(app).await;
    let page: JobPage = get(&app, "/api/v1/jobs").await.json();
    assert_eq!(page.jobs.len(), 2);
    let next: Value = post(&app, "/api/v1/calibrations", &json!({ "session": "taps" })).await.json();
    assert_eq!(next["id"], "run-6");
    assert_eq!(ended(&app, "run-6").await.state, JobState::Done);
}

#[test]
fn damaged_database_is_refused_by_name() {
    let data = Data::with_session();
    fs::write(data.root().join("palpate.sqlite"), "not a database").unwrap();
    let Err(err) = palpate_server::Studio::open(data.root(), None, access()) else { panic!("it was opened") };
    let text = err.to_string();
    assert!(text.contains("damaged") && text.contains("palpate.sqlite"), "{text}");
}

#[tokio::test]
async fn command_line_sees_and_cancels_the_jobs_of_a_studio_that_runs() {
    let data = Data::with_emulated_session();
    let app = data.app();
    let run: DiagnosisRun = post(&app, "/api/v1/diagnoses", &json!({ "session": "bench" })).await.json();
    wait(&app, &run.id, |job| job.state == JobState::Running).await;
    let folder = arg(data.root());
    let page: JobPage =
        serde_json::from_str(&palpate_ok(&["jobs", "list", "--data", folder, "--json"])).unwrap();
    assert_eq!((page.jobs.len(), page.jobs[0].id.as_str()), (1, "diagnosis-1"));
    let none: JobPage = serde_json::from_str(&palpate_ok(&[
        "jobs", "list", "--data", folder, "--json", "--state", "failed", "--kind", "diagnose",
    ]))
    .unwrap();
    assert_eq!(none.jobs, []);
    palpate_ok(&["jobs", "cancel", "diagnosis-1", "--data", folder]);
    assert_eq!(ended(&app, &run.id).await.state, JobState::Cancelled, "the studio has heard of it");
    assert!(palpate_ok(&["jobs", "log", "diagnosis-1", "--data", folder]).starts_with("--- attempt 1"));
    let job: Job =
        serde_json::from_str(&palpate_ok(&["jobs", "retry", "diagnosis-1", "--data", folder, "--json"]))
            .unwrap();
    assert_eq!(job.state, JobState::Queued);
    wait(&app, &run.id, |job| job.attempts == 2).await;
    send(&app, "POST", "/api/v1/jobs/diagnosis-1/cancel", None).await;
    assert_eq!(ended(&app, &run.id).await.state, JobState::Cancelled);
    assert!(palpate_ok(&["jobs", "show", "diagnosis-1", "--data", folder]).contains("cancelled"));
    assert!(palpate_refuses(&["jobs", "show", "diagnosis-7", "--data", folder]).contains("diagnosis-7"));
    assert!(palpate_refuses(&["jobs", "list", "--data", "/nowhere"]).contains("--data"));
}

#[test]
fn folder_that_is_no_job_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let output = palpate(&["job", "run", "--dir", dir.path().to_str().unwrap()]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("spec.json") && stderr.contains("folder of a job"), "{stderr}");
}
