//! Calibration over HTTP: start, watch, cancel, save, restart.

use std::time::Duration;

use axum::{Router, http::header};
use palpate_sim::SensorModel;
use palpate_wire::{
    api::{CalibrationRun, JobState, ModelSummary},
    proto::ReplayTrace,
};
use prost::Message as _;
use serde_json::json;

use crate::support::{Data, NUM_CHANNELS, NUM_FRAMES, NUM_TAKES, get, post, send};

async fn wait_until_ended(app: &Router, id: &str) -> CalibrationRun {
    for _ in 0..1200 {
        let run: CalibrationRun = get(app, &format!("/api/v1/calibrations/{id}")).await.json();
        if !matches!(run.state, JobState::Queued | JobState::Running) {
            return run;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("{id} did not end");
}

#[tokio::test]
async fn calibration_is_started_watched_saved_and_kept() {
    let data = Data::with_session();
    let app = data.app();
    let answer =
        post(&app, "/api/v1/calibrations", &json!({"session": "taps", "hold_out": ["take-03"]})).await;
    assert_eq!(answer.status, 202);
    let started: CalibrationRun = answer.json();
    assert_eq!(answer.header(header::LOCATION), format!("/api/v1/calibrations/{}", started.id));
    let run = wait_until_ended(&app, &started.id).await;
    assert_eq!((run.state, run.error.as_deref(), run.fraction), (JobState::Done, None, 1.0));
    let report = run.report.as_ref().unwrap();
    assert_eq!((report.frames, report.channels), (NUM_TAKES * NUM_FRAMES, NUM_CHANNELS));
    assert_eq!(report.held_out_takes, ["take-03"]);
    assert!(report.calibrated.l1 <= report.nominal.l1);

    let model_text = run.model_toml.as_deref().unwrap();
    let model = SensorModel::from_toml("model", model_text).unwrap();
    assert_eq!(model.theta.lambda_con_m, report.theta.lambda_con_m);
    assert!(model.provenance.iter().any(|line| line.contains("taps")), "{:?}", model.provenance);
    let html = get(&app, &format!("/api/v1/calibrations/{}/report.html", run.id)).await;
    assert!(html.header(header::CONTENT_TYPE).starts_with("text/html"));
    assert!(String::from_utf8_lossy(&html.body).contains("taps"));

    let table = async |name: &str| get(&app, &format!("/api/v1/calibrations/{}/tables/{name}", run.id)).await;
    let metrics = table("metrics.csv").await;
    assert!(metrics.header(header::CONTENT_TYPE).starts_with("text/csv"));
    let metrics = String::from_utf8_lossy(&metrics.body).into_owned();
    // Both models on all takes, on held-out ones, by stream, take and channel, below the header.
    let groups = 2 + report.by_modality.len() + NUM_TAKES + NUM_CHANNELS;
    assert_eq!(metrics.lines().count(), 1 + 2 * groups, "{metrics}");
    assert!(metrics.contains("\nheld-out take,take-03,calibrated,"), "{metrics}");
    let l1 = report.calibrated.l1.to_string();
    let line = metrics.lines().find(|line| line.starts_with("all takes,,calibrated,")).unwrap();
    assert_eq!(line.split(',').nth(7), Some(l1.as_str()), "{metrics}");
    let intervals = String::from_utf8_lossy(&table("intervals.csv").await.body).into_owned();
    assert!(intervals.starts_with("model,metric,low,high\n"), "{intervals}");
    let detail = table("numbers.csv").await.problem(404);
    assert!(detail.contains("metrics.csv"), "{detail}");

    let save = format!("/api/v1/calibrations/{}/save", run.id);
    post(&app, &save, &json!({"name": " ... "})).await.problem(400);
    let mut saved = Vec::new();
    for expected in ["bench-no-1", "bench-no-1-2"] {
        let answer = post(&app, &save, &json!({"name": "Bench, no. 1"})).await;
        assert_eq!(answer.status, 201);
        let summary: ModelSummary = answer.json();
        assert_eq!((summary.id.as_str(), summary.name.as_str()), (expected, "Bench, no. 1"));
        assert_eq!(answer.header(header::LOCATION), format!("/api/v1/models/{expected}"));
        saved.push(summary);
    }
    let reserved: ModelSummary = post(&app, &save, &json!({"name": "Nominal"})).await.json();
    assert_eq!(reserved.id, "nominal-2", "\"nominal\" always means the station's own");

    let replay = async |model: &str| {
        let path = format!("/api/v1/sessions/taps/takes/take-02/replay?model={model}");
        ReplayTrace::decode(get(&app, &path).await.body).unwrap()
    };
    let of_run = replay(&format!("run:{}", run.id)).await;
    assert_eq!(of_run.active, replay("bench-no-1").await.active);
    assert_eq!(of_run.thresholds[9], report.theta.lambda_con_m as f32);

    // Another studio on the same folder, started later, knows all of it.
    let again = data.restart(app).await;
    let runs: Vec<CalibrationRun> = get(&again, "/api/v1/calibrations").await.json();
    assert_eq!((runs.len(), runs[0].state, &runs[0].report), (1, JobState::Done, &None));
    assert_eq!(runs[0].saved_as.as_deref(), Some("nominal-2"));
    let run_again: CalibrationRun = get(&again, &format!("/api/v1/calibrations/{}", run.id)).await.json();
    assert_eq!(run_again.report, run.report);
    let models: Vec<ModelSummary> = get(&again, "/api/v1/models").await.json();
    assert!(saved.iter().all(|summary| models.contains(summary)), "{models:?}");
    // Its next run does not overwrite this one.
    let next: CalibrationRun =
        post(&again, "/api/v1/calibrations", &json!({"session": "taps", "method": "grid"})).await.json();
    assert_ne!(next.id, run.id);
    let next = wait_until_ended(&again, &next.id).await;
    assert_eq!(next.state, JobState::Done, "{:?}", next.error);
}

#[tokio::test]
async fn waiting_run_is_cancelled_at_once() {
    let data = Data::with_session();
    let app = data.app();
    let mut ids = Vec::new();
    for _ in 0..4 {
        let run: CalibrationRun =
            post(&app, "/api/v1/calibrations", &json!({"session": "taps"})).await.json();
        ids.push(run.id);
    }
    let last = ids.last().unwrap();
    let cancel = format!("/api/v1/calibrations/{last}/cancel");
    let cancelled: CalibrationRun = send(&app, "POST", &cancel, None).await.json();
    assert!(matches!(cancelled.state, JobState::Cancelled | JobState::Done), "{cancelled:?}");
    let again: CalibrationRun = send(&app, "POST", &cancel, None).await.json();
    assert_eq!(again.state, cancelled.state, "cancelling what has ended changes nothing");
    for id in &ids[..3] {
        assert_eq!(wait_until_ended(&app, id).await.state, JobState::Done);
    }
    if cancelled.state == JobState::Cancelled {
        let save = format!("/api/v1/calibrations/{last}/save");
        let detail = post(&app, &save, &json!({"name": "x"})).await.problem(409);
        assert!(detail.contains("cancelled"), "{detail}");
        get(&app, &format!("/api/v1/calibrations/{last}/report.html")).await.problem(404);
    }
    let runs: Vec<CalibrationRun> = get(&app, "/api/v1/calibrations").await.json();
    let listed: Vec<&String> = runs.iter().map(|run| &run.id).collect();
    assert_eq!(listed, ids.iter().rev().collect::<Vec<_>>(), "newest first");
}

#[tokio::test]
async fn failed_run_says_why() {
    let data = Data::with_session();
    let file = data.truncate_take();
    let app = data.app();
    let run: CalibrationRun = post(&app, "/api/v1/calibrations", &json!({"session": "taps"})).await.json();
    let run = wait_until_ended(&app, &run.id).await;
    assert_eq!(run.state, JobState::Failed);
    assert!(run.error.as_deref().unwrap().contains(&file), "{:?}", run.error);
    assert!(run.report.is_none() && run.model_toml.is_none());
}

#[tokio::test]
async fn run_that_a_stop_cut_off_is_shown_as_failed() {
    let data = Data::with_session();
    let run = CalibrationRun {
        id: "run-7".to_owned(),
        request: serde_json::from_value(json!({"session": "taps"})).unwrap(),
        state: JobState::Running,
        fraction: 0.4,
        stage: "searching".to_owned(),
        seconds_left: Some(3.0),
        error: None,
        report: None,
        model_toml: None,
        saved_as: None,
    };
    std::fs::create_dir_all(data.root().join("runs")).unwrap();
    std::fs::write(data.root().join("runs/run-7.json"), serde_json::to_vec(&run).unwrap()).unwrap();
    std::fs::write(data.root().join("runs/run-8.json"), "{").unwrap();
    let app = data.app();
    let runs: Vec<CalibrationRun> = get(&app, "/api/v1/calibrations").await.json();
    assert_eq!((runs.len(), runs[0].state), (1, JobState::Failed), "what cannot be read is left out");
    assert!(runs[0].error.as_deref().unwrap().contains("start it again"));
}
