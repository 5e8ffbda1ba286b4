//! A very different station goes through the same commands.

use e2e::{Tools, root, run_json};

#[test]
fn probe_bench_replays_and_calibrates() {
    let Some(tools) = Tools::find() else { return };
    let dir = tempfile::tempdir().unwrap();
    let session = dir.path().join("bench");
    let status = tools
        .palpate()
        .arg("emulate")
        .arg("--truth")
        .arg(root().join("assets/truth/bench.toml"))
        .arg("--out")
        .arg(&session)
        .status()
        .unwrap();
    assert!(status.success());
    let check = run_json(tools.palpate().args(["session", "check", "--json"]).arg(&session)).unwrap();
    assert_eq!(check["coverage"].as_array().unwrap().len(), 15, "{check}");
    let model = dir.path().join("model.toml");
    let report = run_json(
        tools.palpate().args(["calibrate", "--json", "--session"]).arg(&session).arg("--out").arg(&model),
    )
    .unwrap();
    assert_eq!(report["channels"], 15);
    assert!(report["calibrated"]["l1"].as_u64() < report["nominal"]["l1"].as_u64(), "{report}");
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
