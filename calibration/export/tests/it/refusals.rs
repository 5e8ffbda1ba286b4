//! What is refused, and that nothing stays behind.

use std::{
    fs,
    path::{Path, PathBuf},
};

use palpate_export::{
    ExportError,
    lerobot::{Action, LerobotConfig, export},
};
use palpate_sim::job::{Cancel, NoProgress};
use serde_json::json;

use crate::support::{TAP, TakeSpec, record, session, text, write};

/// Exports `sources` to `out` in `dir`, which must fail and leave nothing; gives the message.
fn refused(dir: &Path, sources: &[PathBuf], config: LerobotConfig) -> String {
    let before = fs::read_dir(dir).unwrap().count();
    let error = write(sources, &dir.join("out"), config).unwrap_err();
    assert_eq!(fs::read_dir(dir).unwrap().count(), before, "something stayed behind");
    error.to_string()
}

fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{message:?} does not say {part:?}");
    }
}

#[test]
fn folders_that_are_neither_session_nor_rollout() {
    let dir = tempfile::tempdir().unwrap();
    let default = LerobotConfig::default();
    assert_says(&refused(dir.path(), &[], default), &["no source"]);
    assert_says(&refused(dir.path(), &[dir.path().join("nowhere")], default), &["nowhere", "is no folder"]);
    let empty = dir.path().join("empty");
    fs::create_dir(&empty).unwrap();
    assert_says(&refused(dir.path(), &[empty], default), &["empty", "session.toml", "trial-0000.jsonl"]);
    let source = dir.path().join("s");
    session(&source, &[(&TAP, false)]);
    assert_says(&refused(dir.path(), std::slice::from_ref(&source), default), &["no accepted take"]);
    let twice = [source.clone(), dir.path().join("empty/../s")];
    assert_says(&refused(dir.path(), &twice, default), &["twice"]);
}

#[test]
fn what_is_there_already_is_not_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("s"), dir.path().join("out"));
    session(&source, &[(&TAP, true)]);
    fs::create_dir(&out).unwrap();
    fs::write(out.join("kept"), "x").unwrap();
    let error = write(&[source], &out, LerobotConfig::default()).unwrap_err();
    assert!(matches!(&error, ExportError::Exists { path } if *path == out), "{error}");
    assert_eq!(fs::read_to_string(out.join("kept")).unwrap(), "x");
}

#[test]
fn recordings_that_do_not_fit_together() {
    let dir = tempfile::tempdir().unwrap();
    let silent = TakeSpec { commands_from_ms: None, ..TAP };
    let source = |name: &str, specs: &[(&TakeSpec, bool)]| {
        let path = dir.path().join(name);
        session(&path, specs);
        path
    };
    let mixed = source("mixed", &[(&TAP, true), (&silent, true)]);
    let default = LerobotConfig::default();
    assert_says(
        &refused(dir.path(), std::slice::from_ref(&mixed), default),
        &["take-02.mcap", "has no commands", "--action"],
    );
    let commands = LerobotConfig { action: Some(Action::Commands), ..default };
    assert_says(&refused(dir.path(), &[mixed], commands), &["take-02.mcap", "next-state"]);
    let binary = source("binary", &[(&TAP, true), (&TakeSpec { with_raw: false, ..TAP }, true)]);
    assert_says(&refused(dir.path(), &[binary], default), &["take-02.mcap", "readings", "\"gel\""]);
    let takes = source("takes", &[(&TAP, true)]);
    let rollout = dir.path().join("rollout");
    fs::create_dir(&rollout).unwrap();
    fs::write(
        rollout.join("trial-0000.jsonl"),
        text(&record(Some(json!({ "suggested": "ES", "truth": null })))),
    )
    .unwrap();
    assert_says(
        &refused(dir.path(), &[takes, rollout], default),
        &["trial-0000.jsonl", "reference", "take-01.mcap"],
    );
}

#[test]
fn rates_out_of_range() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("s");
    session(&source, &[(&TAP, true)]);
    for fps in [0, 1001] {
        let config = LerobotConfig { fps: Some(fps), action: None };
        assert_says(
            &refused(dir.path(), std::slice::from_ref(&source), config),
            &[&fps.to_string(), "1 to 1000"],
        );
    }
}

#[test]
fn damaged_takes_and_records_are_named_with_the_place() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("s");
    session(&source, &[(&TAP, true)]);
    let take = source.join("take-01.mcap");
    let bytes = fs::read(&take).unwrap();
    fs::write(&take, &bytes[..bytes.len() / 2]).unwrap();
    assert_says(&refused(dir.path(), &[source], LerobotConfig::default()), &["take-01.mcap"]);

    let rollout = dir.path().join("rollout");
    fs::create_dir(&rollout).unwrap();
    let outcome = || Some(json!({ "suggested": "success", "truth": null }));
    let with = |change: &dyn Fn(&mut Vec<serde_json::Value>)| {
        let mut lines = record(outcome());
        change(&mut lines);
        fs::write(rollout.join("trial-0000.jsonl"), text(&lines)).unwrap();
        refused(dir.path(), std::slice::from_ref(&rollout), LerobotConfig::default())
    };
    assert_says(&with(&|lines| lines.clear()), &["trial-0000.jsonl", "empty"]);
    assert_says(&with(&|lines| drop(lines.remove(0))), &["line 1", "\"trial\""]);
    assert_says(&with(&|lines| lines[1]["positions"] = json!([1.0])), &["line 2", "positions has 1", "2"]);
    assert_says(&with(&|lines| lines[1]["active"] = json!([3])), &["line 2", "channel 3"]);
    assert_says(&with(&|lines| lines[1]["raw"] = json!([])), &["line 2", "raw has 0"]);
    assert_says(&with(&|lines| lines[1]["at_s"] = json!(-1.0)), &["line 2", "at_s is -1"]);
    assert_says(&with(&|lines| lines[3]["at_s"] = json!(0.0)), &["line 4", "at_s is 0"]);
    assert_says(
        &with(&|lines| lines[0]["trial"]["control_rate_hz"] = json!(0.0)),
        &["line 1", "control_rate_hz"],
    );
    let last = record(outcome()).len() - 1;
    assert_says(&with(&|lines| lines[last]["outcome"]["suggested"] = json!("luck")), &["\"luck\"", "void"]);
}

#[test]
fn a_cancelled_export_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("s");
    session(&source, &[(&TAP, true)]);
    let cancel = Cancel::default();
    cancel.cancel();
    let error = export(&[source], &dir.path().join("out"), LerobotConfig::default(), &NoProgress, &cancel);
    assert!(matches!(error, Err(ExportError::Cancelled)));
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}
