//! Trainings that are started from the page, with the real program behind it.

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Command, Stdio};

use serde_json::Value;

use super::station::{self, browser};
use super::turn;

#[test]
fn trainings_are_started_watched_and_ended_from_the_page() {
    let Some(browser) = browser() else { return };
    let _turn = turn();
    let folder = tempfile::tempdir().expect("a folder");
    let flags = ["--train", env!("CARGO_BIN_EXE_palpate-train")];
    let (running, url) = station::studio(&browser.palpate, folder.path(), &flags, &Value::Null);
    let mut running = Some(running);
    let mut script = Command::new("node")
        .arg("training.mjs")
        .arg(url)
        .arg(&browser.artifacts)
        .current_dir(&browser.scripts)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("node");
    for line in BufReader::new(script.stdout.take().expect("its output")).lines().map_while(Result::ok) {
        println!("{line}");
        if line == "restart" {
            drop(running.take());
            let (again, url) = station::studio(&browser.palpate, folder.path(), &flags, &Value::Null);
            running = Some(again);
            writeln!(script.stdin.as_mut().expect("its input"), "{url}").expect("it listens");
        }
    }
    let status = script.wait().expect("node");
    assert!(status.success(), "training.mjs failed; see above and the pictures in target/e2e");
}
