//! Diagnosis over HTTP: start, watch, cancel, add to a model, undo.

use std::{fs, time::Duration};

use axum::{Router, http::header};
use palpate_sim::SensorModel;
use palpate_wire::{
    api::{DiagnosisRun, JobState, ModelSummary},
    proto::ReplayTrace,
};
use prost::Message as _;
use serde_json::json;

use crate::support::{Data, NUM_CHANNELS, get, post, send, tree};

async fn wait_until_ended(app: &Router, id: &str) -> DiagnosisRun {
    for _ in 0..4000 {
        let run: DiagnosisRun = get(app, &format!("/api/v1/diagnoses/{id}")).await.json();
        if !run.is_unfinished() {
            return run;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("{id} did not end");
}

async fn diagnose(app: &Router, request: &serde_json::Value) -> DiagnosisRun {
    let started: DiagnosisRun = post(app, "/api/v1/diagnoses", request).await.json();
    let run = wait_until_ended(app, &started.id).await;
    assert_eq!((run.state, run.error.as_deref(), run.fraction), (JobState::Done, None, 1.0));
    run
}

async fn replay(app: &Router, model: &str) -> ReplayTrace {
    let path = format!("/api/v1/sessions/bench/takes/take-04/replay?model={model}");
    let answer = get(app, &path).await;
    assert_eq!(answer.status, 200, "{model}");
    ReplayTrace::decode(answer.body).unwrap()
}

#[tokio::test]
async fn what_is_named_is_added_and_taken_out_again_byte_for_byte() {
    let data = Data::with_emulated_session();
    // A model of before, with a comment and spacing of its own.
    let path = data.root().join("models/bench.toml");
    let before = "# by hand\nformat = 1\nname = \"Bench\"\n\n[theta]\nlambda_con_m   = 0.001\n\
        alpha_per_m = 80.0\nlambda_pre_pa = 500.0\n";
    let app = data.app();
    fs::write(&path, before).unwrap();

    let request =
        json!({"session": "bench", "model": "bench", "hold_out": ["take-04", "take-06"], "max_effects": 3});
    let answer = post(&app, "/api/v1/diagnoses", &request).await;
    assert_eq!(answer.status, 202);
    let started: DiagnosisRun = answer.json();
    assert_eq!(answer.header(header::LOCATION), format!("/api/v1/diagnoses/{}", started.id));
    let run = wait_until_ended(&app, &started.id).await;
    assert_eq!((run.state, run.error.as_deref()), (JobState::Done, None));
    let report = run.report.as_ref().unwrap();
    assert_eq!(report.residual_map.len(), NUM_CHANNELS);
    assert_eq!(report.takes["confirm"], ["take-04", "take-06"]);
    assert!(report.held_out.diagnosed < report.held_out.calibrated, "{:?}", report.held_out);
    assert!(report.effects.len() >= 2, "{:?}", report.effects);
    let chosen = &report.effects[1];
    let html = get(&app, &format!("/api/v1/diagnoses/{}/report.html", run.id)).await;
    assert!(html.header(header::CONTENT_TYPE).starts_with("text/html"));
    let html = String::from_utf8_lossy(&html.body).into_owned();
    assert!(html.contains("session bench") && html.contains("<h2>Find"));
    let table = async |name: &str| {
        let answer = get(&app, &format!("/api/v1/diagnoses/{}/tables/{name}", run.id)).await;
        assert!(answer.header(header::CONTENT_TYPE).starts_with("text/csv"));
        String::from_utf8_lossy(&answer.body).into_owned()
    };
    assert_eq!(table("waterfall.csv").await.lines().count(), 1 + report.waterfall.len());
    assert_eq!(table("metrics.csv").await.lines().count(), 1 + report.metrics.len());
    let parameters = report.effects.iter().map(|effect| effect.parameters.len()).sum::<usize>();
    assert_eq!(table("effects.csv").await.lines().count(), 1 + parameters);

    // Before and after are there to be compared without anything being saved.
    let (old, new) = (
        replay(&app, &format!("calibrated:{}", run.id)).await,
        replay(&app, &format!("diagnosis:{}", run.id)).await,
    );
    assert_ne!(old.active, new.active);

    let save = format!("/api/v1/diagnoses/{}/save", run.id);
    post(&app, &save, &json!({})).await.problem(400);
    post(&app, &save, &json!({"name": "x", "to": "bench"})).await.problem(400);
    post(&app, &save, &json!({"name": "x", "effects": []})).await.problem(400);
    let detail = post(&app, &save, &json!({"name": "x", "effects": [70]})).await.problem(400);
    assert!(detail.contains("70"), "{detail}");
    post(&app, &save, &json!({"to": "nowhere"})).await.problem(404);

    let answer = post(&app, &save, &json!({"to": "bench", "effects": [1]})).await;
    assert_eq!(answer.status, 200, "{:?}", answer.body);
    let summary: ModelSummary = answer.json();
    assert_eq!((summary.id.as_str(), summary.name.as_str(), summary.earlier_versions), ("bench", "Bench", 1));
    assert_eq!(summary.effects.len(), 1, "only what was chosen is added");
    assert_eq!((&summary.effects[0].id, &summary.effects[0].place), (&chosen.id, &chosen.place));
    let model = SensorModel::from_toml("bench.toml", &fs::read_to_string(&path).unwrap()).unwrap();
    for (name, value) in &chosen.parameters {
        // JSON keeps all but the last bit.
        assert!((model.effects[0].parameter(name) - value).abs() <= 1e-12 * value.abs(), "{name}");
    }
    let listed: Vec<ModelSummary> = get(&app, "/api/v1/models").await.json();
    assert_eq!(listed, [summary]);
    assert_ne!(replay(&app, "bench").await.active, old.active, "replays use the effect");
    let noted: DiagnosisRun = get(&app, &format!("/api/v1/diagnoses/{}", run.id)).await.json();
    assert_eq!(noted.saved_as.as_deref(), Some("bench"));
    // The model is not what it was when the diagnosis started from it.
    let detail = post(&app, &save, &json!({"to": "bench"})).await.problem(409);
    assert!(detail.contains("changed"), "{detail}");

    let undone: ModelSummary = send(&app, "POST", "/api/v1/models/bench/undo", None).await.json();
    assert_eq!((undone.effects.len(), undone.earlier_versions), (0, 0));
    assert_eq!(fs::read_to_string(&path).unwrap(), before, "byte for byte");
    let detail = send(&app, "POST", "/api/v1/models/bench/undo", None).await.problem(409);
    assert!(detail.contains("no earlier version"), "{detail}");
    let noted: DiagnosisRun = get(&app, &format!("/api/v1/diagnoses/{}", run.id)).await.json();
    assert_eq!(noted.saved_as, None);
    // And once more: undoing is no dead end.
    assert_eq!(post(&app, &save, &json!({"to": "bench"})).await.status, 200);
}

#[tokio::test]
async fn diagnosis_without_a_model_makes_a_new_one_and_survives_a_restart() {
    let data = Data::with_emulated_session();
    let app = data.app();
    let run = diagnose(&app, &json!({"session": "bench", "max_effects": 1})).await;
    let save = format!("/api/v1/diagnoses/{}/save", run.id);
    let answer = post(&app, &save, &json!({"name": "Bench, diagnosed"})).await;
    assert_eq!(answer.status, 201, "{:?}", answer.body);
    assert_eq!(answer.header(header::LOCATION), "/api/v1/models/bench-diagnosed");
    let summary: ModelSummary = answer.json();
    assert_eq!(summary.effects.len(), run.report.as_ref().unwrap().effects.len());
    // It did not start from this one, so nothing is known of its effects beside it.
    let detail = post(&app, &save, &json!({"to": "bench-diagnosed"})).await.problem(409);
    assert!(detail.contains("did not start from"), "{detail}");

    let again = data.restart(app).await;
    let runs: Vec<DiagnosisRun> = get(&again, "/api/v1/diagnoses").await.json();
    assert_eq!((runs.len(), runs[0].state, &runs[0].report), (1, JobState::Done, &None));
    assert_eq!(runs[0].saved_as.as_deref(), Some("bench-diagnosed"));
    let known: DiagnosisRun = get(&again, &format!("/api/v1/diagnoses/{}", run.id)).await.json();
    assert_eq!(known.report, run.report);
    // Calibrations and diagnoses have tables of their own.
    let calibrations: Vec<serde_json::Value> = get(&again, "/api/v1/calibrations").await.json();
    assert!(calibrations.is_empty());
    get(&again, &format!("/api/v1/calibrations/{}", run.id)).await.problem(404);
    // Deleting what was made of it is the undo of a new model.
    assert_eq!(send(&again, "DELETE", "/api/v1/models/bench-diagnosed", None).await.status, 204);
    let known: DiagnosisRun = get(&again, &format!("/api/v1/diagnoses/{}", run.id)).await.json();
    assert_eq!(known.saved_as, None);
}

#[tokio::test]
async fn left_out_effect_is_never_named() {
    let data = Data::with_emulated_session();
    let app = data.app();
    let first = diagnose(&app, &json!({"session": "bench", "max_effects": 1})).await;
    let named = first.report.unwrap().effects.remove(0).id;
    let run = diagnose(&app, &json!({"session": "bench", "without": [named], "max_effects": 1})).await;
    let report = run.report.unwrap();
    let ids = report.effects.iter().map(|effect| &effect.id);
    assert!(ids.chain(report.candidates.iter().map(|tried| &tried.id)).all(|id| *id != named));
}

#[tokio::test]
async fn diagnosis_is_cancelled_while_it_waits_and_while_it_runs() {
    let data = Data::with_emulated_session();
    let app = data.app();
    let mut ids = Vec::new();
    for _ in 0..2 {
        let run: DiagnosisRun = post(&app, "/api/v1/diagnoses", &json!({"session": "bench"})).await.json();
        ids.push(run.id);
    }
    for id in ids.iter().rev() {
        let cancel = format!("/api/v1/diagnoses/{id}/cancel");
        assert_eq!(send(&app, "POST", &cancel, None).await.status, 200);
        let run = wait_until_ended(&app, id).await;
        assert_eq!(run.state, JobState::Cancelled, "{run:?}");
        assert!(run.report.is_none() && run.model_toml.is_none());
    }
    let save = format!("/api/v1/diagnoses/{}/save", ids[0]);
    let detail = post(&app, &save, &json!({"name": "x"})).await.problem(409);
    assert!(detail.contains("cancelled"), "{detail}");
    get(&app, &format!("/api/v1/diagnoses/{}/report.html", ids[0])).await.problem(404);
    let detail = get(&app, &format!("/api/v1/diagnoses/{}/tables/effects.csv", ids[0])).await.problem(409);
    assert!(detail.contains("cancelled"), "{detail}");
    get(&app, &format!("/api/v1/sessions/bench/takes/take-01/replay?model=diagnosis:{}", ids[0]))
        .await
        .problem(409);
}

#[tokio::test]
async fn what_cannot_be_diagnosed_is_refused_before_it_is_queued() {
    let data = Data::with_session();
    let app = data.app();
    let before = tree(data.root());
    let start = async |request: serde_json::Value, status: u16, word: &str| {
        let detail = post(&app, "/api/v1/diagnoses", &request).await.problem(status);
        assert!(detail.contains(word), "{word:?} is missing in {detail:?}");
    };
    start(json!({"session": "nowhere"}), 404, "nowhere").await;
    start(json!({"session": "taps", "model": "nowhere"}), 404, "nowhere").await;
    start(json!({"session": "taps", "hold_out": ["take-77"]}), 400, "take-77").await;
    start(json!({"session": "taps", "without": ["gremlins"]}), 400, "latency").await;
    start(json!({"session": "taps", "max_effects": 0}), 400, "at least 1").await;
    start(json!({"session": "taps", "null_sessions": 3}), 400, "null sessions").await;
    start(json!({"session": "taps", "references": ["nowhere", "else", "or"]}), 404, "nowhere").await;
    start(json!({"session": "taps", "references": ["some"]}), 400, "at least 3").await;
    start(json!({"session": "taps", "references": ["a", "b", "a"]}), 400, "given twice").await;
    start(json!({"session": "taps", "references": ["a", "b", "taps"]}), 400, "given twice").await;
    start(json!({"session": "taps", "nonsense": 3}), 422, "nonsense").await;
    assert!(tree(data.root()) == before, "something was queued");
}

#[tokio::test]
async fn failed_diagnosis_says_why() {
    let data = Data::with_session();
    let file = data.truncate_take();
    let app = data.app();
    let run: DiagnosisRun = post(&app, "/api/v1/diagnoses", &json!({"session": "taps"})).await.json();
    let run = wait_until_ended(&app, &run.id).await;
    assert_eq!(run.state, JobState::Failed);
    assert!(run.error.as_deref().unwrap().contains(&file), "{:?}", run.error);
}
