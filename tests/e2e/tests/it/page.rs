//! The page in a real browser.

use std::{ffi::OsStr, fs, process::Command};

use e2e::{Studio, Tools, alone, demo_session, root, together};

/// A data folder with the demonstration session alone: what one test saves is not there for another.
fn own_data(tools: &Tools) -> anyhow::Result<tempfile::TempDir> {
    let recorded = demo_session(tools)?.join("sessions/demo");
    let data = tempfile::tempdir()?;
    let session = data.path().join("sessions/demo");
    fs::create_dir_all(&session)?;
    for entry in fs::read_dir(recorded)? {
        let entry = entry?;
        fs::copy(entry.path(), session.join(entry.file_name()))?;
    }
    Ok(data)
}

/// Runs a script of the browser tests on `studio`.
fn run_script(tools: &Tools, studio: &Studio, script: &str) {
    let status = Command::new("node")
        .arg(script)
        .arg(&studio.url)
        .arg(&tools.artifacts)
        .current_dir(&tools.browser_tests)
        .status()
        .expect("node");
    assert!(status.success(), "{script} failed; see {:?}", tools.artifacts);
}

/// Runs a script of the browser tests on a studio with the demonstration session.
fn browser_test(script: &str) {
    let Some(tools) = Tools::find() else { return };
    let _turn = together();
    let data = own_data(&tools).expect("the demonstration session");
    let studio = Studio::start(&tools, data.path()).expect("a studio");
    run_script(&tools, &studio, script);
}

/// Runs a script that commands the emulated station. It comes first on the machine: a page that waits a moment does no
/// harm, a station that does holds.
fn station_test(script: &str) {
    let Some(tools) = Tools::find() else { return };
    let _turn = alone();
    let data = tempfile::tempdir().expect("a folder");
    let truth = root().join("assets/truth/demo.toml");
    let arguments = [OsStr::new("--emulate"), truth.as_os_str()];
    let studio = Studio::serve(&tools, data.path(), arguments).expect("a studio");
    run_script(&tools, &studio, script);
}

#[test]
fn operator_calibrates_by_clicking() {
    browser_test("studio.mjs");
}

#[test]
fn operator_diagnoses_adds_and_undoes_by_clicking() {
    browser_test("diagnose.mjs");
}

#[test]
fn operator_commands_the_station_and_others_can_watch() {
    station_test("operate.mjs");
}
