//! A very different station goes through the same commands.

use std::{path::Path, process::Command};

use anyhow::ensure;
use e2e::{Tools, root, run_json, together};
use serde_json::Value;

fn succeed(command: &mut Command) -> anyhow::Result<()> {
    let status = command.status()?;
    ensure!(status.success(), "{command:?}: {status}");
    Ok(())
}

fn record(tools: &Tools, session: &Path) -> anyhow::Result<()> {
    let truth = root().join("assets/truth/bench.toml");
    succeed(tools.palpate().arg("emulate").arg("--truth").arg(truth).arg("--out").arg(session))
}

/// Joint frames of a session that must be in order.
fn checked_frames(tools: &Tools, session: &Path) -> anyhow::Result<Option<u64>> {
    let check = run_json(tools.palpate().args(["session", "check", "--json"]).arg(session))?;
    ensure!(check["ok"] == true, "{check}");
    ensure!(check["coverage"].as_array().map(Vec::len) == Some(15), "{check}");
    Ok(check["frames"].as_u64())
}

fn calibrate(tools: &Tools, session: &Path, model: &Path) -> anyhow::Result<()> {
    let mut command = tools.palpate();
    command.args(["calibrate", "--json", "--session"]).arg(session).arg("--out").arg(model);
    let report: Value = run_json(&mut command)?;
    ensure!(report["channels"] == 15, "{report}");
    ensure!(report["calibrated"]["l1"].as_u64() < report["nominal"]["l1"].as_u64(), "{report}");
    Ok(())
}

#[test]
fn probe_bench_replays_and_calibrates() -> anyhow::Result<()> {
    let Some(tools) = Tools::find() else { return Ok(()) };
    let _turn = together();
    let dir = tempfile::tempdir()?;
    let (session, model) = (dir.path().join("bench"), dir.path().join("model.toml"));
    record(&tools, &session)?;
    checked_frames(&tools, &session)?;
    calibrate(&tools, &session, &model)?;
    let (take, replayed) = (session.join("take-01.mcap"), dir.path().join("replayed.mcap"));
    let mut replay = tools.palpate();
    succeed(
        replay.arg("replay").arg("--take").arg(take).arg("--model").arg(model).arg("--out").arg(&replayed),
    )?;
    // What was simulated opens where recordings open.
    let script = root().join("tests/e2e/python/read_take.py");
    let seen = run_json(Command::new(&tools.python).arg(script).arg(replayed))?;
    ensure!(seen.to_string().contains("/tactile/gel"), "{seen}");
    Ok(())
}

#[test]
fn recordings_made_elsewhere_import_as_csv() -> anyhow::Result<()> {
    let Some(tools) = Tools::find() else { return Ok(()) };
    let _turn = together();
    let dir = tempfile::tempdir()?;
    let [recorded, csv, session] = ["bench", "csv", "imported"].map(|name| dir.path().join(name));
    record(&tools, &recorded)?;
    // Third-party readers turn the takes into CSV, so the import sees files that no code of ours wrote.
    let script = root().join("tests/e2e/python/takes_to_csv.py");
    succeed(Command::new(&tools.python).arg(script).arg(&recorded).arg(&csv))?;
    let mut import = tools.palpate();
    import.args(["import", "--station", "probe-bench", "--csv"]).arg(&csv).arg("--out").arg(&session);
    succeed(&mut import)?;
    ensure!(checked_frames(&tools, &session)? == checked_frames(&tools, &recorded)?);
    calibrate(&tools, &session, &dir.path().join("model.toml"))
}
