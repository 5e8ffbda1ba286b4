//! Trainings that are started from the page, with the real program behind it.

use std::process::Command;

use serde_json::Value;

use super::station::{Ready, browser};
use super::turn;

#[test]
fn trainings_are_started_watched_and_ended_from_the_page() {
    let Some(browser) = browser() else { return };
    let _turn = turn();
    let folder = tempfile::tempdir().expect("a folder");
    let running = Ready::start(
        Command::new(&browser.palpate)
            .args(["serve", "--json", "--listen", "127.0.0.1:0"])
            .args(["--train", env!("CARGO_BIN_EXE_palpate-train"), "--data"])
            .arg(folder.path()),
    );
    let line: Value = serde_json::from_str(&running.line).expect("an address");
    let status = Command::new("node")
        .arg("training.mjs")
        .arg(line["url"].as_str().expect("an address"))
        .arg(&browser.artifacts)
        .current_dir(&browser.scripts)
        .status()
        .expect("node");
    assert!(status.success(), "training.mjs failed; see above and the pictures in target/e2e");
}
