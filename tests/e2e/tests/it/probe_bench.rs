//! A very different station goes through the same commands.

use std::{path::Path, process::Command};

use e2e::{Tools, root, run_json};
use serde_json::Value;

fn record(tools: &Tools, session: &Path) {
    let status = tools
        .palpate()
        .arg("emulate")
        .arg("--truth")
        .arg(root().join("assets/truth/bench.toml"))
        .arg("--out")
        .arg(session)
        .status()
        .unwrap();
    assert!(status.success());
}

fn check(tools: &Tools, session: &Path) -> Value {
    let check = run_json(tools.palpate().args(["session", "check", "--json"]).arg(session)).unwrap();
    assert_eq!(check["ok"], true, "{check}");
    assert_eq!(check["coverage"].as_array().unwrap().len(), 15, "{check}");
    check
}

fn calibrate(tools: &Tools, session: &Path, model: &Path) -> Value {
    let mut command = tools.palpate();
    command.args(["calibrate", "--json", "--session"]).arg(session).arg("--out").arg(model);
    let report = run_json(&mut command).unwrap();
    assert_eq!(report["channels"], 15);
    assert!(report["calibrated"]["l1"].as_u64() < report["nominal"]["l1"].as_u64(), "{report}");
    report
}

#[test]
fn probe_bench_replays_and_calibrates() {
    let Some(tools) = Tools::find() else { return };
    let dir = tempfile::tempdir().unwrap();
    let session = dir.path().join("bench");
    record(&tools, &session);
    check(&tools, &session);
    let model = dir.path().join("model.toml");
    calibrate(&tools, &session, &model);
    let replayed = dir.path().join("replayed.mcap");
    let status = tools
        .palpate()
        .arg("replay")
        .arg("--take")
        .arg(session.join("take-01.mcap"))
        .arg("--model")
        .arg(&model)
        .arg("--out")
        .arg(&replayed)
        .status()
        .unwrap();
    assert!(status.success());
    assert!(replayed.metadata().unwrap().len() > 1000);
}

#[test]
fn recordings_made_elsewhere_import_as_csv() {
    let Some(tools) = Tools::find() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (recorded, csv, session) =
        (dir.path().join("bench"), dir.path().join("csv"), dir.path().join("imported"));
    record(&tools, &recorded);
    // Third-party readers turn the takes into CSV, so the import sees files that no code of ours wrote.
    let script = root().join("tests/e2e/python/takes_to_csv.py");
    let status = Command::new(&tools.python).arg(script).arg(&recorded).arg(&csv).status().unwrap();
    assert!(status.success());
    let status = tools
        .palpate()
        .args(["import", "--station", "probe-bench", "--csv"])
        .arg(&csv)
        .arg("--out")
        .arg(&session)
        .status()
        .unwrap();
    assert!(status.success());
    assert_eq!(check(&tools, &session)["frames"], check(&tools, &recorded)["frames"]);
    calibrate(&tools, &session, &dir.path().join("model.toml"));
}
