//! The page in a real browser.

use std::{fs, process::Command};

use e2e::{Studio, Tools, demo_session};

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

/// Runs a script of the browser tests on a studio with the demonstration session.
fn browser_test(script: &str) {
    let Some(tools) = Tools::find() else { return };
    let data = own_data(&tools).expect("the demonstration session");
    let studio = Studio::start(&tools, data.path()).expect("a studio");
    let status = Command::new("node")
        .arg(script)
        .arg(&studio.url)
        .arg(&tools.artifacts)
        .current_dir(&tools.browser_tests)
        .status()
        .expect("node");
    assert!(status.success(), "{script} failed; see {:?}", tools.artifacts);
}

#[test]
fn operator_calibrates_by_clicking() {
    browser_test("studio.mjs");
}

#[test]
fn operator_diagnoses_adds_and_undoes_by_clicking() {
    browser_test("diagnose.mjs");
}
