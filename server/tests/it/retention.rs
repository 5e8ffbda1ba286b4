//! What goes from a data folder by itself, and what never does.

use std::{
    fs,
    path::Path,
    time::{Duration, SystemTime},
};

use axum::Router;
use palpate_server::{RetentionConfig, RetentionPlan, carry_out_retention, plan_retention};
use palpate_wire::api::JobState;
use serde_json::json;

use crate::support::{Data, arg, ended, get, palpate_ok, palpate_refuses, post, send, tree};

const DAY: Duration = Duration::from_secs(86_400);
const ALL: RetentionConfig = RetentionConfig { jobs_days: Some(10), log_days: Some(5), trash_days: Some(20) };

fn going(plan: &RetentionPlan) -> Vec<&str> {
    let mut paths: Vec<&str> = plan.goes.iter().map(|step| step.path.as_str()).collect();
    paths.sort_unstable();
    paths
}

fn why_kept<'a>(plan: &'a RetentionPlan, path: &str) -> &'a str {
    plan.stays.iter().find(|kept| kept.path == path).map_or("", |kept| kept.why.as_str())
}

/// Three calibrations: the model of the first was saved, a campaign names the second, nothing refers to the third.
async fn three_runs(data: &Data) -> Router {
    let app = data.app();
    for key in 1..=3 {
        let request = json!({ "kind": "calibrate", "request": { "session": "taps" } });
        assert_eq!(post(&app, "/api/v1/jobs", &request).await.status, 202);
        assert_eq!(ended(&app, &format!("run-{key}")).await.state, JobState::Done);
    }
    let saved = post(&app, "/api/v1/calibrations/run-1/save", &json!({ "name": "Bench" })).await;
    assert_eq!(saved.status, 201);
    let campaign = json!({
        "name": "Night", "policies": [{ "id": "p", "source": "runs/run-2/policy.safetensors" }],
        "objects": [{ "id": "cube", "group": "seen" }], "starts": 1, "half_width_m": 0.02,
    });
    assert_eq!(post(&app, "/api/v1/campaigns", &campaign).await.status, 201);
    app
}

#[tokio::test]
async fn old_jobs_go_to_the_trash_unless_something_refers_to_them() {
    let data = Data::with_session();
    let app = three_runs(&data).await;
    let now = SystemTime::now();
    let before = tree(data.root());
    assert_eq!(going(&plan_retention(data.root(), ALL, now).unwrap()), [""; 0], "nothing is old");
    let logs = plan_retention(data.root(), ALL, now + 6 * DAY).unwrap();
    assert_eq!(going(&logs), ["runs/run-1/log.txt", "runs/run-2/log.txt", "runs/run-3/log.txt"]);
    let off = RetentionConfig::default();
    assert_eq!(plan_retention(data.root(), off, now + 9000 * DAY).unwrap(), RetentionPlan::default());
    let plan = plan_retention(data.root(), ALL, now + 11 * DAY).unwrap();
    assert_eq!(going(&plan), ["runs/run-1/log.txt", "runs/run-2/log.txt", "runs/run-3"]);
    assert_eq!(why_kept(&plan, "runs/run-1"), "model bench was saved from it");
    assert_eq!(why_kept(&plan, "runs/run-2"), "campaign night refers to it");
    let without_database = |tree: std::collections::BTreeMap<std::path::PathBuf, Vec<u8>>| {
        let is_written =
            |path: &Path| ["palpate.sqlite", "audit.jsonl"].iter().any(|name| arg(path).contains(name));
        tree.into_iter().filter(|(path, _)| !is_written(path)).collect::<Vec<_>>()
    };
    assert_eq!(without_database(tree(data.root())), without_database(before), "a plan touches nothing");

    carry_out_retention(data.root(), &plan).unwrap();
    get(&app, "/api/v1/jobs/run-3").await.problem(404);
    assert!(data.root().join("trash/runs/run-3/report.json").is_file());
    assert!(!data.root().join("runs/run-1/log.txt").exists());
    for path in ["/api/v1/jobs/run-1", "/api/v1/jobs/run-2/files/model.toml", "/api/v1/sessions/taps"] {
        assert_eq!(get(&app, path).await.status, 200, "{path}");
    }
    assert_eq!(get(&app, "/api/v1/models/bench").await.status, 200);
}

#[tokio::test]
async fn accepted_takes_are_never_deleted_and_models_in_use_are_not() {
    let data = Data::with_session();
    let app = three_runs(&data).await;
    let request =
        json!({ "kind": "diagnose", "request": { "session": "taps", "model": "bench", "max_effects": 1 } });
    assert_eq!(post(&app, "/api/v1/jobs", &request).await.status, 202);
    assert_eq!(ended(&app, "diagnosis-1").await.state, JobState::Done);
    for path in ["sessions/taps", "models/bench", "jobs/run-2", "jobs/run-3"] {
        assert_eq!(send(&app, "DELETE", &format!("/api/v1/{path}"), None).await.status, 204, "{path}");
    }
    // A session of which nothing was accepted, and one that cannot be read.
    let rejected = data.root().join("trash/sessions/rejected");
    copy(&data.root().join("trash/sessions/taps"), &rejected);
    let text = fs::read_to_string(rejected.join("session.toml")).unwrap();
    fs::write(rejected.join("session.toml"), text.replace("accepted = true", "accepted = false")).unwrap();
    let damaged = data.root().join("trash/sessions/damaged");
    copy(&rejected, &damaged);
    fs::write(damaged.join("session.toml"), "takes = 7").unwrap();
    let loose = data.root().join("trash/sessions/loose");
    fs::create_dir(&loose).unwrap();
    fs::write(loose.join("take-01.mcap"), "x").unwrap();

    let later = SystemTime::now() + 21 * DAY;
    let trash = RetentionConfig { trash_days: Some(20), ..RetentionConfig::default() };
    let plan = plan_retention(data.root(), trash, later).unwrap();
    assert_eq!(going(&plan), ["trash/runs/run-3", "trash/sessions/rejected"]);
    assert_eq!(why_kept(&plan, "trash/sessions/taps"), "4 of its takes are accepted");
    assert!(why_kept(&plan, "trash/sessions/damaged").contains("cannot be read"));
    assert!(why_kept(&plan, "trash/sessions/loose").contains("belongs to no session"));
    assert_eq!(why_kept(&plan, "trash/models/bench.toml"), "job diagnosis-1 refers to it");
    assert_eq!(why_kept(&plan, "trash/runs/run-2"), "campaign night refers to it");
    // Also where a plan says otherwise, because somebody accepted a take since.
    fs::write(rejected.join("session.toml"), text).unwrap();
    carry_out_retention(data.root(), &plan).unwrap();
    assert!(rejected.join("session.toml").is_file(), "it has accepted takes again");
    assert!(!data.root().join("trash/runs/run-3").exists());
    assert!(data.root().join("trash/sessions/taps/session.toml").is_file());
    assert_eq!(send(&app, "POST", "/api/v1/sessions/taps/restore", None).await.status, 200);
    assert_eq!(send(&app, "POST", "/api/v1/models/bench/restore", None).await.status, 200);
}

#[tokio::test]
async fn command_says_what_would_go_and_why() {
    let data = Data::with_session();
    let _app = three_runs(&data).await;
    let folder = ["--data", arg(data.root())];
    let nothing = palpate_refuses(&[&["retention", "--dry-run"], &folder[..]].concat());
    assert!(nothing.contains("[retention]"), "{nothing}");
    let config = data.path("palpate.toml");
    fs::write(&config, format!("data = {:?}\n[retention]\njobs_days = 0\n", data.root())).unwrap();
    let said = palpate_ok(&["retention", "--dry-run", "--config", arg(&config)]);
    assert!(said.contains("to the trash: runs/run-3 ("), "{said}");
    assert!(said.contains("kept runs/run-1: model bench was saved from it"), "{said}");
    assert!(data.root().join("runs/run-3/report.json").is_file());
    let json = palpate_ok(&["retention", "--json", "--config", arg(&config)]);
    let plan: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (&plan["goes"][0]["path"], &plan["goes"][0]["act"]),
        (&json!("runs/run-3"), &json!("move_to_trash"))
    );
    assert!(data.root().join("trash/runs/run-3/report.json").is_file());
}

fn copy(from: &Path, to: &Path) {
    for (path, bytes) in tree(from) {
        let path = to.join(path.strip_prefix(from).unwrap());
        if bytes.is_empty() && path.extension().is_none_or(|extension| extension != "mcap") {
            fs::create_dir_all(path).unwrap();
        } else {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, bytes).unwrap();
        }
    }
}
