//! Trainings that are started from the page, with the real program behind it.

use std::process::Command;

use serde_json::Value;

use super::station::{self, browser};
use super::turn;

#[test]
fn trainings_are_started_watched_and_ended_from_the_page() {
    let Some(browser) = browser() else { return };
    let _turn = turn();
    let folder = tempfile::tempdir().expect("a folder");
    let flags = ["--train", env!("CARGO_BIN_EXE_palpate-train")];
    let (_running, url) = station::studio(&browser.palpate, folder.path(), &flags, &Value::Null);
    let status = Command::new("node")
        .arg("training.mjs")
        .arg(url)
        .arg(&browser.artifacts)
        .current_dir(&browser.scripts)
        .status()
        .expect("node");
    assert!(status.success(), "training.mjs failed; see above and the pictures in target/e2e");
}
