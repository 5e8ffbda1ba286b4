//! The command as people call it.
#![cfg(feature = "mujoco")]

mod cloning;
mod comparisons;
mod demonstrations;
mod encoders;
mod films;
mod mujoco_export;
mod pipeline;
mod policies;

use std::path::Path;
use std::process::{Command, Output};

/// Runs the command at the root of the repository.
fn palpate_train(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_palpate-train"))
        .args(args)
        .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("../.."))
        .output()
        .expect("the command starts")
}

#[test]
fn what_is_wrong_with_a_call_is_named_before_anything_starts() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("s.toml");
    let out = out.to_str().expect("a path");
    for (args, expected) in [
        (
            ["--object", "cueb"],
            "--object is \"cueb\", which is no file and no object in assets/objects: ball, big_egg",
        ),
        (["--trials", "0"], "--trials is 0, expected at least 1"),
        (["--trials", "-1"], "invalid value '-1' for '--trials <TRIALS>'"),
        (["--check-trials", "0"], "--check-trials is 0"),
        (["--generations", "0"], "--generations is 0"),
        (["--elite", "65"], "--elite is 65, expected at most the 64 of --candidates"),
        (["--start-cm", "-2"], "--start-cm is -2, expected a number that is not negative"),
        (["--start-cm", "nan"], "--start-cm is NaN"),
        (["--threads", "0"], "--threads is 0"),
        (["--out", "no_such_folder/s.toml"], "there is no folder \"no_such_folder\""),
        (["--tuning", "no_such_file.toml"], "failed to read \"no_such_file.toml\""),
    ] {
        let mut call = vec!["tune"];
        call.extend(args);
        if args[0] != "--out" {
            call.extend(["--out", out]);
        }
        let output = palpate_train(&call);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(expected), "{args:?}: {said}");
        assert!(!Path::new(out).exists(), "{args:?} wrote a script");
    }
}

#[test]
fn a_tuned_script_runs_as_a_script() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("cube.toml");
    let out = out.to_str().expect("a path");
    let counts =
        ["--generations", "1", "--candidates", "2", "--elite", "1", "--trials", "1", "--check-trials", "2"];
    let mut call = vec!["tune", "--json", "--out", out];
    call.extend(counts);
    let output = palpate_train(&call);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines: Vec<serde_json::Value> = String::from_utf8_lossy(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line of JSON"))
        .collect();
    assert_eq!(lines.len(), 2);
    assert_eq!((&lines[1]["generation"], &lines[1]["check"]["trials"]), (&1.into(), &2.into()));
    assert!(lines[1]["mean_score"].is_f64() && lines[0]["mean_score"].is_null());
    let output = palpate_train(&["script", "--trials", "2", "--json", "--script", out]);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("a report");
    assert_eq!(report["objects"]["cube"]["trials"], 2);
}
